"""How fast a generated robot's compiled kernels are on this machine: ``stiffgen bench DIR``."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiffgen.check.verify import argument_samples, import_robot, kernels_of
from stiffgen.emit.manifest import chain_from_manifest, read_manifest
from stiffgen.errors import OutputError
from stiffgen.symbolic.kernels import chain_kernels
from stiffgen.symbolic.potentials import springs_of_manifest

_BATCH = 4096
_SECONDS = 0.01
_ROUNDS = 7


@dataclass(frozen=True)
class Timing:
    """Medians of one kernel from Python, with the Python call and the array of results: microseconds."""

    kernel: str
    call: float
    configuration: float


def bench(folder: str | Path, *, progress: Callable[[str], None] = lambda step: None) -> list[Timing]:
    """Time every kernel of a robot's folder: one call, and a configuration within a stack of 4096.

    Args:
        folder: what ``stiffgen generate`` wrote.
        progress: called with a few words before each kernel.

    Returns:
        One record a kernel.

    Raises:
        OutputError: the folder is none of stiffgen's.

    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    if manifest is None:
        raise OutputError(f"{folder}: is not a folder that 'stiffgen generate' wrote; give the robot's own folder")
    chain, options = chain_from_manifest(manifest), springs_of_manifest(manifest)
    pool = argument_samples(chain, _BATCH, 0, options)
    kernels = kernels_of(import_robot(folder), chain, options)
    timings = []
    for kernel in chain_kernels(chain, options):
        progress(f"timing {kernel.qualified_name}")
        function = kernels[kernel.qualified_name]
        stacks = [pool[argument] for argument in kernel.arguments]
        first = [stack[0].copy() for stack in stacks]
        out = function(*stacks)
        call = _median(function, first, {})
        many = _median(function, stacks, {"out": out})
        timings.append(Timing(kernel.qualified_name, call, many / _BATCH))
    return timings


def _median(function: Callable[..., object], arguments: Sequence[object], options: Mapping[str, object]) -> float:
    start = time.perf_counter()
    function(*arguments, **options)
    number = max(1, int(_SECONDS / max(time.perf_counter() - start, 1e-7)))
    rounds = []
    for _ in range(_ROUNDS):
        start = time.perf_counter()
        for _ in range(number):
            function(*arguments, **options)
        rounds.append((time.perf_counter() - start) / number * 1e6)
    return statistics.median(rounds)
