# SPDX-License-Identifier: MIT
"""Verify that functions access no memory outside arguments and results.

Arguments and results end, or begin, at memory without access. Each function runs in a process of its own, which a
signal ends at such an access. Then the function runs again part by part, to find the fault.
"""

from __future__ import annotations

import ctypes
import itertools
import mmap
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from stiffgen.core.lower.scalar import Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.folder.forked import confined
from stiffgen.core.verify.result import Check, faultless

COUNTS = (*range(1, 10), 16, 17)
_KEPT: list[ctypes.c_char] = []
"""Arguments of which a child process uses the memory up to its end; the parent has none."""


def check_bounds(
    library: ctypes.CDLL,
    name: str,
    table: tuple[Kernel, ...],
    chain: Chain,
    pool: Mapping[Argument, FloatArray],
    scalar: Scalar,
) -> list[Check]:
    """Call every C function and batch with guard pages around its arguments; return nothing without ``fork``."""
    if not hasattr(os, "fork"):
        return []
    checks = []
    for kernel in table:
        stacks = [pool[argument][: COUNTS[-1]].astype(scalar.dtype) for argument in kernel.arguments]
        functions = [("", kernel.results, _single), *((each.suffix, each.results, _batch) for each in kernel.batches)]
        public = f"{name}_{kernel.qualified_name}"
        runs: dict[str, Callable[[], None]] = {}  # by the fault of a run that an access ends
        for side, (suffix, results, call) in itertools.product(("before", "behind"), functions):
            sizes = [result.array(chain).size for result in results]
            run = partial(call, library[public + suffix], stacks, sizes, behind=side == "behind")
            runs[f"{public}{suffix} goes {side} its arguments or results"] = run
        # All in one process first: starting one takes as long as a hundred calls.
        faults = [] if _survive([*runs.values()]) else [fault for fault, run in runs.items() if not _survive([run])]
        checks.append(faultless(kernel.qualified_name, "C: guard pages", faults))
    return checks


def _survive(works: Sequence[Callable[[], None]]) -> bool:
    """Return whether a child process lives through all of ``works``."""

    def run() -> list[str]:
        for work in works:
            work()
        return []

    return not confined(run)


def _guarded(size: int, *, behind: bool) -> int:
    """Return the address of ``size`` bytes between pages without access, directly before or behind one of them."""
    length = -(-size // mmap.PAGESIZE) * mmap.PAGESIZE
    memory = ctypes.c_char.from_buffer(mmap.mmap(-1, length + 2 * mmap.PAGESIZE))
    _KEPT.append(memory)
    start = ctypes.addressof(memory)
    protect = ctypes.CDLL(None).mprotect
    for page in (start, start + mmap.PAGESIZE + length):
        if protect(ctypes.c_void_p(page), ctypes.c_size_t(mmap.PAGESIZE), 0) != 0:
            raise OSError("mprotect")
    return start + mmap.PAGESIZE + (length - size if behind else 0)


def _filled(values: FloatArray, *, behind: bool) -> int:
    """Return the address of a copy of ``values`` next to a page without access."""
    address = _guarded(values.nbytes, behind=behind)
    ctypes.memmove(address, values.tobytes(), values.nbytes)
    return address


def _single(call: Any, stacks: list[FloatArray], sizes: list[int], *, behind: bool) -> None:
    """Call a function once; ``sizes`` are the numbers in its results."""
    inputs = [_filled(stack[0], behind=behind) for stack in stacks]
    outputs = [_guarded(stacks[0].itemsize * size, behind=behind) for size in sizes]
    call(*map(ctypes.c_void_p, (*inputs, *outputs)))


def _batch(call: Any, stacks: list[FloatArray], sizes: list[int], *, behind: bool) -> None:
    """Call a batch for each count, with dense stacks; ``sizes`` are the numbers in the results of one configuration."""
    for count in COUNTS:
        arguments: list[Any] = [ctypes.c_size_t(count)]
        for stack in stacks:
            address = _filled(stack[:count], behind=behind)
            arguments += [ctypes.c_void_p(address), ctypes.c_ssize_t(stack[0].size)]
        outputs = [_guarded(stacks[0].itemsize * count * size, behind=behind) for size in sizes]
        call(*arguments, *map(ctypes.c_void_p, outputs))
