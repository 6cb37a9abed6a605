# SPDX-License-Identifier: MIT
"""Measure the speed of a generated robot's compiled kernels on this machine: ``stiffgen bench DIR``."""

from __future__ import annotations

import ctypes
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiffgen.core.emit.build import build_library
from stiffgen.core.errors import BuildError
from stiffgen.core.folder import temporary_folder
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import as_results

_BATCH = 4096
"""Configurations of a stack."""
_SECONDS = 0.01
"""Duration of a round [s]: a function is called as often as fits."""
_ROUNDS = 7
"""Rounds of which the median counts."""
_FLAGS = (("-O3", "-march=native"), ("-O3",))
"""Flags of the plain C build: the first set that the compiler accepts."""


@dataclass(frozen=True)
class Timing:
    """Medians of one function in microseconds.

    ``call``: one call from Python, including the array of results. ``configuration``: one configuration of a stack of
    4096, from Python. ``c``: a plain C call (NaN without a compiler).
    """

    kernel: str
    call: float
    configuration: float
    c: float


def bench(folder: str | Path, *, progress: Callable[[str], None] = lambda step: None) -> list[Timing]:
    """Time every kernel of a robot's folder: one Python call, a configuration of a stack of 4096, and one C call.

    Args:
        folder: what ``stiffgen generate`` wrote.
        progress: called with a few words before each kernel.

    Returns:
        One record per kernel.

    Raises:
        OutputError: the folder is not one of stiffgen's, is damaged, or is not compiled.

    """
    robot = open_robot(folder)
    kernels = robot.kernels
    pool = argument_samples(robot.chain, _BATCH, 0, robot.springs)
    timings = []
    with temporary_folder("bench") as build:
        progress("compiling C calls")
        library = _c_loops(robot, build)
        for kernel in robot.table:
            progress(f"timing {kernel.qualified_name}")
            function = kernels[kernel.qualified_name]
            stacks = [pool[argument].astype(robot.scalar.dtype) for argument in kernel.arguments]
            first = [stack[0].copy() for stack in stacks]
            out = function(*stacks)
            call = _median(function, first, {})
            many = _median(function, stacks, {"out": out})
            c = math.nan
            if library is not None:
                pointers = [stack.ctypes.data for stack in stacks] + [each.ctypes.data for each in as_results(out)]
                blocks = (ctypes.c_void_p * len(pointers))(*pointers)
                c = _median(library[f"loop_{kernel.qualified_name}"], [blocks], {}) / _BATCH
            timings.append(Timing(kernel.qualified_name, call, many / _BATCH, c))
    return timings


def _c_loops(robot: GeneratedRobot, build: Path) -> ctypes.CDLL | None:
    """Compile for every kernel a C function that calls it once per sample (4096); None without a compiler."""
    lines = [f'#include "{robot.name}.h"']
    for kernel in robot.table:
        sizes = [array.array(robot.chain).size for array in (*kernel.arguments, *kernel.results)]
        blocks = ", ".join(f"blocks[{k}] + {size} * c" for k, size in enumerate(sizes))
        lines += [
            f"void loop_{kernel.qualified_name}({robot.scalar.name} *const *blocks)",
            f"{{ for (size_t c = 0; c < {_BATCH}; ++c) {{ {robot.name}_{kernel.qualified_name}({blocks}); }} }}",
        ]
    driver = build / "loops.c"
    driver.write_text("\n".join(lines) + "\n")
    for flags in _FLAGS:
        try:
            return ctypes.CDLL(str(build_library(robot.folder, robot.name, build, flags, more=[driver])))
        except BuildError:
            continue
    return None


def _median(function: Callable[..., object], arguments: Sequence[object], options: Mapping[str, object]) -> float:
    """Return the median duration of a call [us]; a first call, which is not counted, decides how many make a round."""
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
