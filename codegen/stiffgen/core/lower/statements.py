# SPDX-License-Identifier: MIT
"""Lowering of straight-line steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from stiffgen.core.lower.form import Access, Entry, Local, Place, Statements, Storage, make_body
from stiffgen.core.lower.lowering import Lowering
from stiffgen.core.names import c_comment
from stiffgen.core.symbolic.kinematics import Expressions, Kind, Section
from stiffgen.core.symbolic.program import Operand, as_operand, entries_of
from stiffgen.core.symbolic.steps import StraightLine

_Inputs = list[tuple[ca.SX, Access]]


def statements(f: Lowering, step: StraightLine, storages: Sequence[Storage]) -> Statements:
    """Return the statements of a straight-line step that fill ``storages``.

    Entries of local outputs that are always zero are not stored, which their records note. Outside of braces the
    statements add the locals that they define to ``f.guarded``, so that later statements do not define them again.
    """
    inputs, values, spans = _inputs(f, step)
    expressions = step.expressions(f.chain, *values)
    outputs, kinds = _outputs(f, step, storages, expressions)
    rows = tuple(storages[: step.columns]) if f.variant.joint_lanes else ()
    defined = set() if f.braces else f.guarded
    poison = "poison_of_gradients" if "poison" in defined else "poison"
    body = make_body(
        inputs,
        outputs,
        named_sections(expressions.sections),
        kinds,
        poison=poison,
        heading=step.heading,
        define=sum(storage.array.size for storage in rows),
        wide_outputs=not f.variant.joint_lanes,
    )
    reads = body.reads  # numbers of the inputs that the expressions need
    guards = [access for k, (_, access) in enumerate(inputs) if access.guard and k in reads]
    new = tuple(access for access in guards if access.guard not in defined)
    defined |= {body.poison, *(access.guard for access in new)}
    unused = tuple(first for span, first in spans if reads.isdisjoint(span))  # inputs that no expression reads
    return Statements(body, tuple(step.outputs), new, unused, rows, f.braces)


def _inputs(f: Lowering, step: StraightLine) -> tuple[_Inputs, list[ca.SX], list[tuple[range, Entry]]]:
    """Return the inputs, the symbols for them, and per array the range of its inputs with its first entry.

    What enters linearly is guarded: a sliding joint's coordinate, a pose, a stiffness. Sines turn infinity into NaN,
    and what earlier steps wrote comes from guarded numbers.
    """
    sliding = _sliding(f)
    inputs: _Inputs = []
    values, spans = list[ca.SX](), list[tuple[range, Entry]]()
    for array in step.arguments:
        storage, operand, start = f.storage(array), Operand(array, ""), len(inputs)
        is_argument = storage.place is Place.ARGUMENT and array.name not in f.function.columns
        zeros, symbols = _symbols(storage, is_argument=is_argument)
        accesses = [
            _argument(f, step, operand, k, sliding) if is_argument else f.access(operand, k) for k in range(array.size)
        ]
        inputs += [(symbols[k], accesses[k]) for k in range(array.size) if k not in zeros]
        values.append(as_operand(array.shape, symbols))
        if is_argument or len(inputs) > start:
            spans.append((range(start, len(inputs)), replace(accesses[0], guard="")))
    return inputs, values, spans


def _symbols(storage: Storage, *, is_argument: bool) -> tuple[set[int], list[ca.SX]]:
    """Return the entries of an array that are no inputs, and the symbols of all entries.

    Of the symmetric part of an argument only the upper triangle is filled; its mirror images have the same symbols.
    """
    array = storage.array
    zeros = set() if is_argument else storage.known_zeros()
    symbols = [ca.SX(0) if k in zeros else ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
    if is_argument and array.symmetric_part:
        uppers = [upper_of_stack(k, array.shape[-1]) for k in range(array.size)]
        symbols = [symbols[upper] for upper in uppers]
        zeros = {k for k, upper in enumerate(uppers) if upper != k}
    return zeros, symbols


def _sliding(f: Lowering) -> set[int]:
    """Return the entries of q whose joints slide, on the chain or in its closed loops."""
    base, first = f.chain.base_joints, f.chain.base_coordinates
    in_loops = (joint for loop in f.chain.loops for end in (loop.first, loop.second) for joint in end.joints)
    return {joint.coordinate - first for joint in (*f.chain.joints[base:], *in_loops) if joint.prismatic}


def _argument(f: Lowering, step: StraightLine, operand: Operand, k: int, sliding: set[int]) -> Access:
    """Return the access to an argument's entry, guarded unless it is the angle of a joint or enters linearly."""
    array = operand.array
    guard = ""
    if f.guards and not step.is_linear and (not array.is_q or k in sliding):
        between = "_" if max(array.shape, default=0) > 10 else ""  # 1, 11 and 11, 1
        guard = array.symbol + between.join(map(str, indices(array.shape, k)))
    storage = f.storage(array)
    is_copy = array.symmetric_part and storage.local is not None and f.variant.joint_lanes
    return Access(storage, operand, k, not f.variant.joint_lanes, as_passed=not is_copy, guard=guard)


def _outputs(
    f: Lowering, step: StraightLine, storages: Sequence[Storage], expressions: Expressions
) -> tuple[list[tuple[tuple[Entry, ...], ca.SX]], list[Kind]]:
    """Return places, expression and kind of each output that is stored.

    A symmetric result has one expression for both triangles, that of the upper one. With vectors of joints, entries of
    columns become locals, from which the vectors are filled.
    """
    entries, m = entries_of(expressions.result), len(f.chain.joints)
    kinds = expressions.kinds or (Kind.NUMBER,) * len(entries)
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = []
    stored_kinds: list[Kind] = []
    start = 0
    for number, (array, storage) in enumerate(zip(step.outputs, storages, strict=True)):
        is_column, operand, zeros = number < step.columns, Operand(array, ""), set[int]()
        values = entries[start : start + array.size]
        if not is_column:
            zeros = _note_unstored_zeros(storage, values)
        is_mirrored = array.symmetric and storage.is_result
        n = array.shape[0] if is_mirrored else 0
        for k, value in enumerate(values):
            if k in zeros or (is_mirrored and k != upper_entry(k, n)):
                continue
            places: list[Entry] = [Access(storage, operand, k)]
            if is_column and f.variant.joint_lanes:
                places = [Local(f"{storage.array.name}{k // m}_{k % m}", None, operand, k)]
            elif is_mirrored and lower_entry(k, n) != k:
                places.append(Access(storage, operand, lower_entry(k, n)))
            outputs.append((tuple(places), value))
            stored_kinds.append(kinds[start + k])
        start += array.size
    return outputs, stored_kinds


def _note_unstored_zeros(storage: Storage, values: Sequence[ca.SX]) -> set[int]:
    """Note and return the entries that are always zero; who reads a whole array, or by joints, reads its zeros, too."""
    if storage.is_result or storage.whole or storage.by_joints:
        return set()
    storage.zeros, storage.zero_rows = {k for k, value in enumerate(values) if value.is_zero()}, False
    return storage.zeros


def named_sections(sections: Sequence[Section]) -> list[tuple[str, list[tuple[str, ca.SX, Kind]], bool]]:
    """Return sections entry by entry: title, members (name, expression, kind), and whether only shared ones are named.

    A number keeps its name; entries of a column have the row as suffix, those of a matrix row and column.
    """
    named = []
    for section in sections:
        members = []
        for name, value in section.values.items():
            kind = section.kinds.get(name, Kind.NUMBER)
            rows, columns = value.shape
            ends = [f"{r}{c}" if columns > 1 else str(r) for r in range(rows) for c in range(columns)]
            if rows * columns == 1:
                ends = [""]
            members += [(name + end, entry, kind) for end, entry in zip(ends, entries_of(value), strict=True)]
        named.append((c_comment(section.title), members, section.shared))
    return named


def indices(shape: tuple[int, ...], k: int) -> list[int]:
    """Return the indices of the k-th entry of an array of a shape."""
    reversed_indices = []
    for extent in reversed(shape):
        k, index = divmod(k, extent)
        reversed_indices.append(index)
    return reversed_indices[::-1]


def upper_entry(k: int, n: int) -> int:
    """Return the entry in the upper triangle that equals entry k of a symmetric n x n matrix, both row-major."""
    row, column = divmod(k, n)
    return min(row, column) * n + max(row, column)


def upper_of_stack(k: int, n: int) -> int:
    """Return :func:`upper_entry` of an entry of a stack of symmetric n x n matrices."""
    return k - k % n**2 + upper_entry(k % n**2, n)


def lower_entry(k: int, n: int) -> int:
    """Return the entry in the lower triangle that equals entry k of a symmetric n x n matrix, both row-major."""
    row, column = divmod(k, n)
    return max(row, column) * n + min(row, column)
