# SPDX-License-Identifier: MIT
"""Many configurations a call: every length of the last block of lanes, every kind of step, nothing else touched."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stiffgen.lower.scalar import Scalar, scalar_of
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kernels import PACKED, Kernel
from stiffgen.verify.result import Array, Check, Kernels, as_results, bound_of, faultless, relative_error
from stiffgen.verify.rounding import beyond_rounding, rounding_errors

LENGTHS = (*range(18), 33)
"""0 to two blocks of the widest lanes and one more, of doubles (8) and of floats (16)."""
LONG = 131
"""More than two of the chunks of 64 in which the Python module copies arguments that do not lie in a row."""
_UNTOUCHED = -7.25


def check_stacks(
    kernels: Kernels, single: Kernels, table: tuple[Kernel, ...], chain: Chain, pool: Mapping[Argument, Array]
) -> list[Check]:
    """Stacks of every length through the Python module: forwards, backwards, spread, with one argument shared.

    What gives upper triangles is also held to what gives whole matrices, to the last bit.

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
        form = _form(kernel, results)
        whole, call = (kernels[kernel.qualified_name + which] for which in ("", suffix))
        reference = single[kernel.qualified_name]
        stacks = [pool[argument][:LONG] for argument in kernel.arguments]
        expected = form(reference(*stacks))
        faults = []
        if suffix and not all(map(np.array_equal, as_results(call(*stacks)), form(whole(*stacks)))):
            faults.append(f"other bits than {kernel.qualified_name} has")
        for length in (*LENGTHS, LONG):
            out = tuple(np.full((length + 1, *each.shape[1:]), _UNTOUCHED, each.dtype) for each in expected)
            kept = tuple(each[:length] for each in out)
            call(*(stack[:length] for stack in stacks), out=kept)
            if not _agree(kept, [each[:length] for each in expected]):
                faults.append(f"a stack of {length}")
            if any((each[length] != _UNTOUCHED).any() for each in out):
                faults.append(f"a stack of {length} is written beyond its end")
        for title, order in (("backwards", slice(None, None, -1)), ("every second", slice(1, None, 2))):
            if not _agree(as_results(call(*(stack[order] for stack in stacks))), [each[order] for each in expected]):
                faults.append(f"a stack {title}")
        out = tuple(np.empty(each.shape[::-1], each.dtype).T for each in expected)
        call(*(np.asfortranarray(stack) for stack in stacks), out=out)
        if not _agree(out, expected):
            faults.append("columns first in memory")
        for k, argument in enumerate(kernel.arguments):
            given: list[Any] = list(stacks)
            given[k] = stacks[k][3]
            shared = [stack if i != k else np.broadcast_to(stack[3], stack.shape) for i, stack in enumerate(stacks)]
            found, alone = as_results(call(*given)), form(reference(*shared))
            if len(stacks) > 1 and not (
                _agree(found, alone) or _agree_but_for_rounding(chain, kernel, form, shared, found, alone)
            ):
                faults.append(f"{argument.name} shared")
        checks.append(faultless(kernel.qualified_name + suffix, "stacks: lengths, order, sharing", faults))
    return checks


_Form = Callable[[Any], tuple[Any, ...]]
"""Results of a kernel, or their errors, as a function gives them."""


def _form(kernel: Kernel, given: tuple[Argument, ...]) -> _Form:
    """Whole results as those that are ``given``: matrices, or the upper triangles that a packed batch gives."""

    def formed(results: Any) -> tuple[Any, ...]:
        wanted = zip(as_results(results), kernel.results, given, strict=True)
        return tuple(
            each if result == kept else each[(..., *np.triu_indices(each.shape[-1]))] for each, result, kept in wanted
        )

    return formed


def check_c_batches(
    library: ctypes.CDLL,
    name: str,
    single: Kernels,
    table: tuple[Kernel, ...],
    chain: Chain,
    pool: Mapping[Argument, Array],
    scalar: Scalar,
) -> list[Check]:
    """NAME_..._batch called from C's side: counts 0 to 17, steps of every sign, NaN around arguments, sentinels."""
    checks = []
    for kernel in table:
        for batch in kernel.batches:
            public, form = f"{kernel.qualified_name}{batch.suffix}", _form(kernel, batch.results)
            reference = single[kernel.qualified_name]
            faults = _batch_faults(library[f"{name}_{public}"], reference, kernel, form, chain, pool, scalar)
            checks.append(faultless(public, "C: counts, steps, ends", faults))
    return checks


def _batch_faults(
    call: Any,
    reference: Callable[..., Any],
    kernel: Kernel,
    form: _Form,
    chain: Chain,
    pool: Mapping[Argument, Array],
    scalar: Scalar,
) -> list[str]:
    most = LENGTHS[-1]
    stacks = [pool[argument][:most].reshape(most, -1).astype(scalar.dtype) for argument in kernel.arguments]
    names = [argument.name for argument in kernel.arguments]
    shapes = [argument.array(chain).shape for argument in kernel.arguments]
    plans: list[tuple[str, list[str]]] = [(kind, [kind] * len(stacks)) for kind in ("forwards", "backwards", "spread")]
    plans += [(f"{names[k]} shared", ["forwards"] * k + ["shared"] + ["forwards"] * (len(stacks) - k - 1))
              for k in range(len(stacks))]  # fmt: skip
    faults = []
    for title, kinds in plans:
        given = [
            np.broadcast_to(stack[0], stack.shape) if kind == "shared" else stack
            for stack, kind in zip(stacks, kinds, strict=True)
        ]
        full = [each.reshape(most, *shape) for each, shape in zip(given, shapes, strict=True)]
        expected = [np.asarray(each).reshape(most, -1) for each in form(reference(*full))]
        sizes = [each.shape[1] for each in expected]
        for length in LENGTHS:
            laid = [_laid_out(stack[:length], kind) for stack, kind in zip(given, kinds, strict=True)]
            outs = [np.full(2 * 16 + length * size, _UNTOUCHED, scalar.dtype) for size in sizes]
            arguments: list[Any] = [ctypes.c_size_t(length)]
            for memory, first, step in laid:
                arguments += [ctypes.c_void_p(memory[first:].ctypes.data), ctypes.c_ssize_t(step)]
            arguments += [ctypes.c_void_p(out[16:].ctypes.data) for out in outs]
            call(*arguments)
            values = tuple(out[16:-16].reshape(length, size) for out, size in zip(outs, sizes, strict=True))
            own, wanted = [each[:length] for each in full], [each[:length] for each in expected]
            if not (_agree(values, wanted) or _agree_but_for_rounding(chain, kernel, form, own, values, wanted)):
                faults.append(f"{title}, count {length}")
            if any((out[:16] != _UNTOUCHED).any() or (out[-16:] != _UNTOUCHED).any() for out in outs):
                faults.append(f"{title}, count {length}: written beyond the ends")
    return faults


def _laid_out(stack: Array, kind: str) -> tuple[Array, int, int]:
    """(memory with NaN around and between, place of the first configuration, step), in numbers."""
    length, size = stack.shape
    if kind == "shared":
        memory = np.full(size + 32, np.nan, stack.dtype)
        memory[16 : 16 + size] = stack[0] if length else 0.0
        return memory, 16, 0
    step = size + 5 if kind == "spread" else size
    memory = np.full(max(length, 1) * step + 32, np.nan, stack.dtype)
    order = range(length - 1, -1, -1) if kind == "backwards" else range(length)
    for place, configuration in enumerate(order):
        memory[16 + place * step : 16 + place * step + size] = stack[configuration]
    if kind == "backwards":
        return memory, 16 + max(length - 1, 0) * step, -step
    return memory, 16, step


def _agree_but_for_rounding(
    chain: Chain,
    kernel: Kernel,
    form: _Form,
    stacks: list[Any],
    values: tuple[Any, ...],
    expected: list[Any] | tuple[Any, ...],
) -> bool:
    """Whether values agree where their contributions do not cancel, and elsewhere up to what rounding explains."""
    errors = rounding_errors(chain, kernel, stacks, scalar_of(values[0]))
    return errors is not None and _agree(
        tuple(
            each + beyond_rounding(np.asarray(value) - each, error)
            for value, each, error in zip(values, map(np.asarray, expected), form(errors), strict=True)
        ),
        expected,
    )


def _agree(values: tuple[Any, ...], expected: list[Any] | tuple[Any, ...]) -> bool:
    return all(
        np.shape(value) == np.shape(reference) and relative_error(value, np.asarray(reference)) <= bound_of(reference)
        for value, reference in zip(values, expected, strict=True)
    )
