# SPDX-License-Identifier: MIT
"""Verify functions of many configurations: every count up to two vectors, every kind of step, no other memory."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stiffgen.core.lower.scalar import Scalar, scalar_of
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import PACKED, Kernel
from stiffgen.core.verify.kernels.rounding import beyond_rounding, rounding_errors
from stiffgen.core.verify.result import Check, Kernels, as_results, bound_of, faultless, relative_error

LENGTHS = (*range(18), 33)
"""Counts from 0 to two of the widest vectors plus one, for doubles (8) and for floats (16)."""
LONG = 131
"""Count of more than two chunks of 64; the Python module copies arguments that are not contiguous in chunks."""
_UNTOUCHED = -7.25
GUARD = 16
"""Numbers before and behind each array, in which nothing may be read or written."""


def check_stacks(
    kernels: Kernels, single: Kernels, table: tuple[Kernel, ...], chain: Chain, pool: Mapping[Argument, FloatArray]
) -> list[Check]:
    """Verify stacks of every length through the Python module: forwards, backwards, spread, with one argument shared.

    Upper triangles must also equal the whole matrices to the last bit.

    Args:
        kernels: functions of the module, which take stacks.
        single: the same, one configuration a call.
        table: their records.
        chain: the robot.
        pool: at least ``LONG`` values of every argument.

    """
    checks = []
    functions = []
    for kernel in table:
        functions.append((kernel, "", kernel.results))
        if kernel.packed:
            functions.append((kernel, PACKED, kernel.packed.results))
    for kernel, suffix, results in functions:
        form, name = _form(kernel, results), kernel.qualified_name
        call, reference = kernels[name + suffix], single[name]
        stacks = [pool[argument][:LONG] for argument in kernel.arguments]
        faults = []
        if suffix:
            pairs = zip(as_results(call(*stacks)), form(kernels[name](*stacks)), strict=True)
            if not all(np.array_equal(packed, whole, equal_nan=True) for packed, whole in pairs):
                faults.append(f"other bits than {name} has")
        faults += _layout_faults(call, stacks, form(reference(*stacks)))
        if len(stacks) > 1:
            faults += _sharing_faults(call, reference, chain, kernel, form, stacks)
        checks.append(faultless(name + suffix, "stacks: lengths, order, sharing", faults))
    return checks


def _sharing_faults(
    call: Any, reference: Any, chain: Chain, kernel: Kernel, form: _Form, stacks: list[FloatArray]
) -> list[str]:
    """Return the arguments of which one value for all configurations gives other results than as many equal ones."""
    faults = []
    for k, argument in enumerate(kernel.arguments):
        others_before, one, others_behind = stacks[:k], stacks[k][3], stacks[k + 1 :]  # 3: any configuration
        spread = [*others_before, np.broadcast_to(one, stacks[k].shape), *others_behind]
        found, expected = as_results(call(*others_before, one, *others_behind)), form(reference(*spread))
        is_rounding = _Rounding(chain, kernel, form, spread, scalar_of(expected[0])).explains
        if not (_agree(found, expected) or is_rounding(found, expected)):
            faults.append(f"{argument.name} shared")
    return faults


def _layout_faults(call: Any, stacks: Sequence[FloatArray], expected: Sequence[FloatArray]) -> list[str]:
    """Return the faults of a function at stacks of every length, and of every order in memory."""
    faults = [fault for length in (*LENGTHS, LONG) for fault in _length_faults(call, stacks, expected, length)]
    for title, order in (("backwards", slice(None, None, -1)), ("every second", slice(1, None, 2))):
        if not _agree(as_results(call(*(stack[order] for stack in stacks))), [each[order] for each in expected]):
            faults.append(f"a stack {title}")
    out = tuple(np.empty(each.shape[::-1], each.dtype).T for each in expected)
    call(*(np.asfortranarray(stack) for stack in stacks), out=out)
    if not _agree(out, expected):
        faults.append("columns first in memory")
    return faults


def _length_faults(call: Any, stacks: Sequence[FloatArray], expected: Sequence[FloatArray], length: int) -> list[str]:
    """Return the faults of a function at stacks of one length, with a number behind the results as a sentinel."""
    memory = tuple(np.full((length + 1, *each.shape[1:]), _UNTOUCHED, each.dtype) for each in expected)
    out = tuple(each[:length] for each in memory)
    call(*(stack[:length] for stack in stacks), out=out)
    faults = [] if _agree(out, [each[:length] for each in expected]) else [f"a stack of {length}"]
    if any((each[length] != _UNTOUCHED).any() for each in memory):
        faults.append(f"a stack of {length} is written beyond its end")
    return faults


_Form = Callable[[Any], tuple[Any, ...]]
"""Results of a kernel, or their errors, in the form that a function returns."""


def _form(kernel: Kernel, given: tuple[Argument, ...]) -> _Form:
    """Convert whole results to the form of ``given``: matrices, or upper triangles of a packed batch."""

    def formed(results: Any) -> tuple[Any, ...]:
        wanted = zip(as_results(results), kernel.results, given, strict=True)
        return tuple(
            each if result == kept else each[(..., *np.triu_indices(each.shape[-1]))] for each, result, kept in wanted
        )

    return formed


def check_c_batches(
    libraries: Mapping[str, ctypes.CDLL],
    name: str,
    single: Kernels,
    table: tuple[Kernel, ...],
    chain: Chain,
    pool: Mapping[Argument, FloatArray],
    scalar: Scalar,
) -> list[Check]:
    """Call NAME_..._batch from C's side, in every build: counts, steps of every sign, NaN around arguments, sentinels.

    Args:
        libraries: builds of the kernels, by the name of their vector width.
        name: prefix of the C functions.
        single: functions of one configuration per call.
        table: their records.
        chain: the robot.
        pool: values of every argument.
        scalar: type of the numbers.

    """
    checks = []
    for kernel in table:
        for batch in kernel.batches:
            public, faults = f"{kernel.qualified_name}{batch.suffix}", []
            for case in _cases(kernel, batch.results, single[kernel.qualified_name], chain, pool, scalar):
                for width, library in libraries.items():
                    faults += [f"{width}: {fault}" for fault in case.faults(library[f"{name}_{public}"])]
            checks.append(faultless(public, f"C: counts, steps, ends; {', '.join(libraries)}", faults))
    return checks


@dataclass(frozen=True)
class _BatchCase:
    """Arguments of a batch in one layout, and the results of single calls.

    Attributes:
        title: name of the layout.
        kinds: layout of each argument ("forwards", "backwards", "spread", "shared").
        flat: the arguments, one row per configuration.
        expected: results of single calls, one row per configuration.
        rounding: rounding of the expected results.

    """

    title: str
    kinds: list[str]
    flat: list[FloatArray]
    expected: list[FloatArray]
    rounding: _Rounding

    def faults(self, call: Any) -> list[str]:
        """Call the batch for every count; return descriptions of the faults.

        Results must agree with those of single calls, and nothing may be written outside them.
        """
        texts, sizes = [], [each.shape[1] for each in self.expected]
        for length in LENGTHS:
            laid = [_laid_out(stack[:length], kind) for stack, kind in zip(self.flat, self.kinds, strict=True)]
            outs = [np.full(2 * GUARD + length * size, _UNTOUCHED, self.rounding.scalar.dtype) for size in sizes]
            arguments: list[Any] = [ctypes.c_size_t(length)]
            for memory, first, step in laid:
                arguments += [ctypes.c_void_p(memory[first:].ctypes.data), ctypes.c_ssize_t(step)]
            arguments += [ctypes.c_void_p(out[GUARD:].ctypes.data) for out in outs]
            call(*arguments)
            values = tuple(out[GUARD:-GUARD].reshape(length, size) for out, size in zip(outs, sizes, strict=True))
            wanted = [each[:length] for each in self.expected]
            if not (_agree(values, wanted) or self.rounding.explains(values, wanted)):
                texts.append(f"{self.title}, count {length}")
            if any((out[:GUARD] != _UNTOUCHED).any() or (out[-GUARD:] != _UNTOUCHED).any() for out in outs):
                texts.append(f"{self.title}, count {length}: written beyond the ends")
        return texts


def _cases(
    kernel: Kernel,
    results: tuple[Argument, ...],
    reference: Callable[..., Any],
    chain: Chain,
    pool: Mapping[Argument, FloatArray],
    scalar: Scalar,
) -> Iterator[_BatchCase]:
    """Yield the layouts of a batch's arguments: all in a row, reversed, spread, and each one shared in turn.

    Args:
        kernel: record of the function.
        results: results of the batch: the kernel's, or upper triangles, to which ``form`` packs these.
        reference: the kernel's function of the module; for stacks, it makes a single call per configuration.
        chain: the robot.
        pool: values of every argument, as many as the largest of ``LENGTHS`` or more.
        scalar: type of the numbers.

    """
    form, most = _form(kernel, results), LENGTHS[-1]
    # one row of numbers per configuration, as C takes them
    stacks = [pool[argument][:most].reshape(most, -1).astype(scalar.dtype) for argument in kernel.arguments]
    shapes = [argument.array(chain).shape for argument in kernel.arguments]
    layouts: list[tuple[str, list[str]]] = [
        (kind, [kind] * len(stacks)) for kind in ("forwards", "backwards", "spread")
    ]
    for k, argument in enumerate(kernel.arguments):
        kinds = ["shared" if i == k else "forwards" for i in range(len(stacks))]
        layouts.append((f"{argument.name} shared", kinds))
    for title, kinds in layouts:
        flat = [
            np.broadcast_to(stack[0], stack.shape) if kind == "shared" else stack
            for stack, kind in zip(stacks, kinds, strict=True)
        ]
        # one array of the argument's shape per configuration, as the reference takes them
        shaped = [each.reshape(most, *shape) for each, shape in zip(flat, shapes, strict=True)]
        expected = [np.asarray(each).reshape(most, -1) for each in form(reference(*shaped))]
        yield _BatchCase(title, kinds, flat, expected, _Rounding(chain, kernel, form, shaped, scalar))


def _laid_out(stack: FloatArray, kind: str) -> tuple[FloatArray, int, int]:
    """Return memory with NaN around and between the entries, place of the first configuration, and step, in numbers."""
    length, size = stack.shape
    if kind == "shared":
        memory = np.full(size + 2 * GUARD, np.nan, stack.dtype)
        memory[GUARD : GUARD + size] = stack[0] if length else 0.0
        return memory, GUARD, 0
    step = size + 5 if kind == "spread" else size  # 5: any gap between configurations
    memory = np.full(max(length, 1) * step + 2 * GUARD, np.nan, stack.dtype)
    order = range(length - 1, -1, -1) if kind == "backwards" else range(length)
    for place, configuration in enumerate(order):
        at = GUARD + place * step
        memory[at : at + size] = stack[configuration]
    if kind == "backwards":
        return memory, GUARD + max(length - 1, 0) * step, -step
    return memory, GUARD, step


@dataclass(frozen=True)
class _Rounding:
    """Rounding of a kernel's results at stacks of arguments; analysed once, and only if results differ."""

    chain: Chain
    kernel: Kernel
    form: _Form
    stacks: list[Any]
    scalar: Scalar

    @cached_property
    def errors(self) -> tuple[FloatArray, ...] | None:
        """Standard errors in the form of the results; None where they are unknown."""
        errors = rounding_errors(self.chain, self.kernel, self.stacks, self.scalar)
        return None if errors is None else self.form(errors)

    def explains(self, values: Sequence[Any], expected: Sequence[Any]) -> bool:
        """Return whether values of the first states agree, up to rounding where contributions cancel."""
        if self.errors is None or not all(map(_same_numbers, values, expected)):
            return False
        pairs = zip(values, map(np.asarray, expected), self.errors, strict=True)
        return _agree(
            [each + beyond_rounding(np.asarray(value) - each, error[: len(each)]) for value, each, error in pairs],
            expected,
        )


def _same_numbers(value: Any, reference: Any) -> bool:
    """Return whether arrays have the same shape, and NaN at the same places."""
    return np.shape(value) == np.shape(reference) and np.array_equal(np.isnan(value), np.isnan(reference))


def _agree(values: Sequence[Any], expected: Sequence[Any]) -> bool:
    """Return whether results agree within their type's bound, with NaN at the same places."""
    return all(
        _same_numbers(value, reference)
        and relative_error(*(np.where(np.isnan(each), 0, each) for each in (value, reference))) <= bound_of(reference)
        for value, reference in zip(values, expected, strict=True)
    )
