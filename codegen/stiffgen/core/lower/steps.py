# SPDX-License-Identifier: MIT
"""Lowering of each kind of step; :data:`RULES` is the table, to which families add the rules of their own steps.

A rule declares the arrays that its step writes, notes in their records what later steps and printers must know, and
appends items. What differs between variants is read from the variant's record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module

import casadi as ca

from stiffgen.core.family import families
from stiffgen.core.lower.form import (
    Access,
    Call,
    Count,
    Declaration,
    Declared,
    Entry,
    Function,
    Helpers,
    Invoke,
    InvokeKernel,
    Layout,
    Local,
    Loop,
    LoopForm,
    Pointer,
    SparseChange,
    Storage,
    Table,
    make_body,
)
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.lowering import LoweredKernels, Lowering, Rules
from stiffgen.core.lower.statements import named_sections, statements, upper_entry, upper_of_stack
from stiffgen.core.lower.variant import Variant
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import Section
from stiffgen.core.symbolic.program import Array, Operand, Over, as_operand, entries_of
from stiffgen.core.symbolic.steps import (
    CloseLoops,
    Congruence,
    Map,
    Shared,
    SparseSum,
    StraightLine,
    Sum,
    SumJoints,
)
from stiffgen.core.symbolic.symmetric_part import SymmetricPart, symmetric_entries

_COORDINATES = Table.COORDINATES, Table.MULTIPLIERS
_TOGETHER = "joints that move together share a coordinate"


def _straight_line(f: Lowering, step: StraightLine) -> None:
    """Append the statements, or a call of the function that they become where kernels share them.

    Where columns of joints are a result, the numbers of the local vectors are copied to it.
    """
    outputs = [_declared(f, array, is_column=number < step.columns) for number, array in enumerate(step.outputs)]
    if step.name:
        function = _shared_statements(f, step)
        f.add(Invoke(function, tuple(map(f.storage, step.arguments)), tuple(outputs), step.outputs))
    else:
        f.add(statements(f, step, outputs))
    f.note_overflow(step.outputs, step.arguments)
    for storage, array in zip(outputs, step.outputs, strict=True):
        if storage.array != array:
            vectors, result = Pointer(storage, plain=True), Pointer(f.storage(array))
            f.call("copy_rows", vectors, Count.ALLOCATED_NUMBERS, array.shape[0], result)


def _declared(f: Lowering, array: Array, *, is_column: bool) -> Storage:
    """Return the storage that statements fill for an output: a result itself, or a local, which is declared here."""
    storage = f.storage(array)
    if is_column and storage.is_result and f.variant.joint_lanes:
        storage = f.storage(Array("J", array.shape))  # vectors, which a result is not
    if is_column and not storage.is_result:
        f.declare(storage, "j")
    elif not storage.is_result:
        f.declare_flat(storage)
    return storage


def _congruence(f: Lowering, step: Congruence) -> None:
    """Call a helper with a row of J per lane, after the statements of the factors; else compute entry by entry."""
    if not f.variant.joint_lanes:
        _straight_line(f, step)
        return
    (rows, n), (factors,), (result,) = step.arguments[0].shape, step.factors.outputs, step.outputs
    J, output = f.storage(step.arguments[0]), f.storage(result)
    f.storage(factors).whole = True
    _straight_line(f, step.factors)
    if not output.is_result:
        f.declare_flat(output)
    in_vectors = J.layout is Layout.LANES  # rows of J are padded to whole vectors
    stride = Count.ALLOCATED_NUMBERS if in_vectors else n
    arguments = Pointer(J, plain=in_vectors), stride, rows, Pointer(f.storage(factors)), n, Pointer(output)
    # Per row of J: products with the entries of L below the diagonal, and with D^-1. Per pair of rows: n products.
    with_factors, with_rows = n * (n + 1) // 2 * rows, rows * (rows + 1) // 2 * n
    cost = Operations(add=with_factors - n * rows + with_rows, multiply=with_factors + with_rows)
    calls = Call("congruence", arguments), Call("mirror_lower", (Pointer(output), rows))
    f.add(Helpers(calls, step.heading, step, cost))


def _shared_statements(f: Lowering, step: StraightLine) -> Function:
    """Return the internal function of a straight-line step with a name; the first call lowers it.

    The function guards its arguments; results that overflow are left to its callers.
    """
    name = f.scope.prefix + step.name
    if name not in f.kernels.shared:
        columns = [Array("J", array.shape) for array in step.outputs[: step.columns]]
        outputs = (*columns, *step.outputs[step.columns :])
        names = frozenset(array.name for array in columns)
        function = Function(name, f.scope, step.arguments, outputs, meaning=step.meaning, columns=names)
        inner = Lowering(f.kernels, function)
        layout = Layout.LANES if f.variant.joint_lanes else Layout.SHAPED
        inner.storages.update((array.name, Storage(array, layout=layout)) for array in columns)
        inner.add(statements(inner, replace(step, outputs=outputs), [inner.storage(array) for array in outputs]))
        f.kernels.shared[name] = function
    return f.kernels.shared[name]


def _map(f: Lowering, step: Map, sections: Callable[..., tuple[Section, ...]] = lambda *_: ()) -> None:
    """Append a map as one loop; ``sections`` names intermediate values, from the same operands as the expression.

    Vectors of joints fill the rows of a matrix over pairs, or a result with one number per joint: the body then writes
    to a local ``row``, whose numbers a helper stores, with NaN for infinity.
    """
    named = list[Section]()

    def expression(*values: ca.SX) -> ca.SX:
        named.extend(sections(*values))
        return step.expression(*values)

    over, out = step.over, step.output
    storage, form = f.storage(out.array), _form(step, lanes=f.variant.joint_lanes)
    fills_rows, to_row = form is LoopForm.ROWS, form in (LoopForm.ROWS, LoopForm.VECTOR)
    by_vectors = fills_rows or over.is_rows  # the loop takes all lanes of a vector of joints j at once
    inputs, values = f.apply(step.operands, expression, rows=by_vectors)
    _note_zeros(storage, out, values)
    if len(storage.zeros) == len(values):  # nothing is left to store
        return
    if not storage.is_result:
        f.declare(storage, out.at if len(out.array.shape) > 1 else "")
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = [
        ((Local("row", "j", out, k) if to_row else Access(storage, out, k, wide=True),), value)
        for k, value in enumerate(values)
        if k not in storage.zeros
    ]
    body = make_body(inputs, outputs, named_sections(named), wide_outputs=by_vectors or not f.variant.joint_lanes)
    is_first = fills_rows and not storage.filled  # a later loop must keep what earlier ones stored in a row
    storage.filled |= fills_rows
    if not to_row:
        f.note_overflow([out.array], f.function.inputs)
    f.add(Loop(step.comment, form, over, storage, out, body, step.mirror, is_first))


def _note_zeros(storage: Storage, out: Operand, values: Sequence[ca.SX]) -> None:
    """Note the entries, or rows of all joints, that are always zero: these are neither stored nor read.

    Results and arrays that are read whole or by joints have all entries stored.
    """
    is_column = out.at == "j"
    if not (storage.is_result or storage.whole) and (is_column or (out.at == "" and not storage.by_joints)):
        storage.zeros = {k for k, value in enumerate(values) if value.is_zero()}
        storage.zero_rows = is_column and len(out.array.shape) == 2


def _form(step: Map, *, lanes: bool) -> LoopForm:
    """Return the form of a map's loop; ``lanes``: with vectors of joints."""
    if step.over is Over.ONCE:
        return LoopForm.ONCE
    if step.over.is_paths:
        return LoopForm.BRANCH
    if step.over.is_pairs:
        return LoopForm.ROWS if lanes and step.output.count == 1 else LoopForm.PAIRS
    return LoopForm.VECTOR if lanes and len(step.output.array.shape) == 1 else LoopForm.JOINTS


def _sparse_sum(f: Lowering, step: SparseSum) -> None:
    """Append statements for the entries that the expression changes; where the others come from, depends.

    - Without a start they are set to zero.
    - A result, or a start that a loop over pairs filled, has them copied.
    - Otherwise the sum is not stored: readers find changed entries in locals, and the others in the start.
    """
    start, output = f.storage(step.start) if step.start else None, f.storage(step.output)
    if start and start.zeros:  # a copy would read entries that were never stored
        _map(f, step.whole(), lambda _, *values: step.sections(*values))
        return
    of_pairs = _is_filled_by_pairs(start)
    is_stored = start is None or of_pairs or output.is_result
    if is_stored and not output.is_result:
        f.declare(output, "ij" if of_pairs else "")
    elif of_pairs:
        f.note_overflow([step.output], f.function.inputs)
    inputs, values = _read_whole(f, step.reads)
    operands = values[len(step.reads) - len(step.operands) :]  # those behind the start
    changes = [k for k, value in enumerate(entries_of(step.expression(*operands))) if not value.is_zero()]
    if not is_stored:
        output.elsewhere = _entries_elsewhere(f, step, changes)
    outputs = _stores(step, output, changes, entries_of(step.whole().expression(*values)))
    defined, wide = 0 if is_stored else len(changes), not f.variant.joint_lanes
    body = make_body(inputs, outputs, named_sections(step.sections(*operands)), define=defined, wide_outputs=wide)
    f.add(SparseChange(step.comment, output, start, body, copies=start is not None and is_stored))


def _read_whole(f: Lowering, arrays: Sequence[Array]) -> tuple[list[tuple[ca.SX, Access]], list[ca.SX]]:
    """Return symbols of all entries of some arrays with their accesses, and the arrays as expressions."""
    inputs, values = list[tuple[ca.SX, Access]](), list[ca.SX]()
    for array in arrays:
        symbols = [ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
        inputs += [(symbol, f.access(Operand(array, ""), k)) for k, symbol in enumerate(symbols)]
        values.append(as_operand(array.shape, symbols))
    return inputs, values


def _is_filled_by_pairs(start: Storage | None) -> bool:
    return start is not None and start.layout is Layout.FLAT and not start.is_result


def _entries_elsewhere(f: Lowering, step: SparseSum, changes: Sequence[int]) -> tuple[Access | Local, ...]:
    """Return the places of a sum that is not stored: locals for entries that change, the start's for all others."""
    assert step.start is not None
    n, output, start = step.output.shape[0], step.output, Operand(step.start, "")
    places: list[Access | Local] = [f.access(start, upper_entry(k, n)) for k in range(n * n)]
    for k in changes:
        places[k] = Local(f"{output.name}{k // n}{k % n}", None, Operand(output, ""), k)
    return tuple(places)


def _stores(
    step: SparseSum, output: Storage, changes: Sequence[int], total: Sequence[ca.SX]
) -> list[tuple[tuple[Entry, ...], ca.SX]]:
    """Return the entries that change and, without a start, the zeros in between, in the order of the places.

    Neighbouring zeros share a statement: compilers make wide stores of it.
    """
    size, operand = step.output.size, Operand(step.output, "")
    places = output.elsewhere or tuple(Access(output, operand, k) for k in range(size))
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = []
    for before, k in zip([-1, *changes], [*changes, size], strict=True):
        if step.start is None and k - before > 1:
            outputs.append((places[before + 1 : k], ca.SX(0)))
        if k < size:
            outputs.append(((places[k],), total[k]))
    return outputs


def _symmetric_part(f: Lowering, step: SymmetricPart) -> None:
    """Append statements that fill the upper triangles of a local copy; callers of batches pass symmetric matrices."""
    if not f.variant.joint_lanes:
        return
    array, storage, operand = step.argument, f.storage(step.argument), Operand(step.argument, "")
    if storage.local is None:
        storage.local, storage.layout = Array(f"symmetric_{array.name}", array.shape), Layout.SHAPED
    f.function.declare(Declaration(Declared.ARRAY, storage.local, Layout.SHAPED))
    symbols = [ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
    inputs = [(symbol, Access(storage, operand, k, as_passed=True)) for k, symbol in enumerate(symbols)]
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = [
        ((Access(storage, operand, k),), value)
        for k, value in enumerate(symmetric_entries(array, symbols))
        if k == upper_of_stack(k, array.shape[-1])
    ]
    comment = f"symmetric part of {array.name}: its upper triangle" + "s" * (len(array.shape) > 2)
    f.add(Loop(comment, LoopForm.ONCE, Over.ONCE, storage, operand, make_body(inputs, outputs)))


def _sum_joints(f: Lowering, step: SumJoints) -> None:
    """Call the helper for the shape of the arrays: pairs or columns of joints, summed or spread."""
    source, output, m = f.storage(step.source), f.storage(step.output), len(f.chain.joints)
    if step.spread and not step.columns:
        f.declare_flat(output)
    elif not output.is_result:
        f.declare(output, "")
    if not step.spread:
        f.note_overflow([step.output], f.function.inputs)
    size = (step.output if step.spread else step.source).size  # of the array over joints
    per_joint, per_pair = size // m, size // (m * m)
    multipliers = m * m if step.of_pairs else 0  # products of the multipliers of two joints
    cost = Operations(add=0 if step.spread else size, multiply=size + multipliers)
    to_output = Count.JOINTS, *_COORDINATES, Pointer(output)
    if step.spread and step.of_pairs:
        calls = [Call("spread_pairs", (Pointer(source), per_pair, *to_output))]
    elif step.spread:
        calls = [Call("spread_columns", (per_joint, Pointer(source), *to_output))]
    elif step.of_pairs:
        calls = [Call("sum_pairs", (Pointer(source), per_pair, *to_output))]
        calls += [Call("mirror_upper", (Pointer(output), Count.COORDINATES))] if step.mirror else []
    else:
        in_vectors = source.layout is Layout.LANES
        stride = Count.ALLOCATED_NUMBERS if in_vectors else Count.JOINTS
        calls = [Call("sum_columns", (per_joint, Pointer(source, plain=in_vectors), stride, *to_output))]
    f.add(Helpers(tuple(calls), _TOGETHER, step, cost))


def _shared(f: Lowering, step: Shared) -> None:
    """Call the internal function of the steps; the first kernel that calls it lowers it."""
    name = f.scope.prefix + step.name
    if name not in f.kernels.shared:
        columns = frozenset(array.name for array in step.columns)
        function = Function(name, f.scope, step.parameters, (step.result,), meaning=step.meaning, columns=columns)
        inner = Lowering(f.kernels, function)
        inner.guards = not step.arguments_are_guarded
        inner.read_parameters(step.steps)
        f.kernels.shared[name] = inner.lower(step.steps)
    output = f.storage(step.output)
    if not output.is_result:
        f.declare(output, "")
    arguments = tuple(map(f.storage, step.arguments))
    f.add(Invoke(f.kernels.shared[name], arguments, (output,), (step.output,), blank=True))


def _sum(f: Lowering, step: Sum) -> None:
    """Call one kernel per term.

    The first term writes a sum directly; each later one writes to a local ``..._part``, which is added. Outputs in
    ``apart`` are no sums: each term writes its own slice.
    """
    has_sums = len(step.terms) > 1
    if has_sums:  # a single term is a kernel that has guarded its results
        f.note_overflow(step.outputs, f.function.inputs)
    outputs = [f.storage(array) for array in step.outputs]
    parts = [Storage(Array(f"{name}_part", (a.size,))) for name, a in zip(step.results, step.outputs, strict=True)]
    for part, array in zip(parts, step.outputs, strict=True):
        if has_sums and array.name not in step.apart:
            f.declare(part, "")
    results = [
        Array(name, array.shape[1:] if array.name in step.apart else array.shape)
        for name, array in zip(step.results, step.outputs, strict=True)
    ]
    for index, term in enumerate(step.terms):
        arguments = [
            (array, f.storage(part.array) if part.array else None, _first_entry(array, part.index))
            for array, part in term.arguments
        ]
        targets, totals = _targets(step, index, outputs, parts)
        zeros = max((array.size for array, source, _ in arguments if source is None), default=0)
        function = f.kernels.term(term, results)
        f.declare_zeros(zeros)
        f.add(InvokeKernel(term.function, function, tuple(arguments), targets, totals, zeros))


def _targets(
    step: Sum, index: int, outputs: Sequence[Storage], parts: Sequence[Storage]
) -> tuple[tuple[tuple[Storage, int | None], ...], tuple[Storage | None, ...]]:
    """Return where term number ``index`` writes each result, with the first entry, and the sums that get it then."""
    targets, totals = list[tuple[Storage, int | None]](), list[Storage | None]()
    for output, part in zip(outputs, parts, strict=True):
        is_apart = output.array.name in step.apart
        is_added = index > 0 and not is_apart
        first = output.array.size // len(step.terms) * index if is_apart else None
        targets.append((part if is_added else output, first))
        totals.append(output if is_added else None)
    return tuple(targets), tuple(totals)


def _first_entry(array: Array, index: int | None) -> int | None:
    """Return the first entry of a tip's slice of an argument; None for the whole argument."""
    return None if index is None else index * array.size


RULES: Rules = {
    StraightLine: _straight_line,
    CloseLoops: _straight_line,
    Congruence: _congruence,
    Map: _map,
    SparseSum: _sparse_sum,
    SymmetricPart: _symmetric_part,
    SumJoints: _sum_joints,
    Shared: _shared,
    Sum: _sum,
}
"""Lowering of each kind of step."""


@cache
def _rules() -> Rules:
    """Return the rules of the core's steps, and those that families have for steps of their own."""
    modules = (import_module(f"stiffgen.families.{family.lowering}") for family in families() if family.lowering)
    return dict(RULES) | {step: rule for module in modules for step, rule in module.RULES.items()}


def lowered(chain: Chain, variant: Variant) -> LoweredKernels:
    """Return the lowered form of a chain's kernels for a variant, empty: kernels are lowered as they are asked for."""
    return LoweredKernels(chain, variant, _rules())
