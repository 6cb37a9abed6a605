# SPDX-License-Identifier: MIT
"""Lowering of each kind of step; :data:`RULES` is the table.

A rule declares the arrays that its step writes, notes in their records what later steps and printers must know, and
appends items. What differs between variants is read from the variant's record.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import casadi as ca

from stiffgen.lower.form import (
    Access,
    Call,
    ColumnSums,
    Count,
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
    TotalSums,
    make_body,
)
from stiffgen.lower.graph import Operations
from stiffgen.lower.lowering import LoweredKernels, Lowering, Rules
from stiffgen.lower.statements import named_sections, statements
from stiffgen.lower.variant import Variant
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kinematics import Section
from stiffgen.symbolic.program import Array, Operand, Over, as_operand, entries_of
from stiffgen.symbolic.steps import (
    CloseLoops,
    Gather,
    Map,
    Reduce,
    Scan,
    Shared,
    SparseSum,
    StraightLine,
    Sum,
    SumJoints,
    Weights,
)

_COORDINATES = Table.COORDINATES, Table.MULTIPLIERS
_TOGETHER = "joints that move together share a coordinate"


def _straight_line(f: Lowering, step: StraightLine) -> None:
    outputs = []
    for number, array in enumerate(step.outputs):
        storage = f.storage(array)
        if number < step.columns:
            if storage.is_result and f.variant.joint_lanes:  # columns are vectors; the public Jacobian is copied
                storage = f.storage(Array("J", array.shape))
            if not storage.is_result:
                f.declare(storage, "j")
        elif not storage.is_result:
            f.declare_flat(storage)
        outputs.append(storage)
    if step.name:
        function = _shared_statements(f, step)
        f.add(Invoke(function, tuple(map(f.storage, step.arguments)), tuple(outputs), step.outputs))
    else:
        f.add(statements(f, step, outputs))
    f.stored(step.outputs, step.arguments)
    for storage, array in zip(outputs, step.outputs, strict=True):
        if storage.array != array:
            f.call(
                "copy_rows",
                Pointer(storage, plain=True),
                Count.ALLOCATED_NUMBERS,
                array.shape[0],
                Pointer(f.storage(array)),
            )


def _shared_statements(f: Lowering, step: StraightLine) -> Function:
    """Return the internal function of a straight-line step with a name."""
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
    named = list[Section]()

    def expression(*values: ca.SX) -> ca.SX:
        named.extend(sections(*values))
        return step.expression(*values)

    lanes, over, out = f.variant.joint_lanes, step.over, step.output
    storage = f.storage(out.array)
    rows = lanes and over.is_pairs and not over.is_paths and out.count == 1
    vector = lanes and over.is_rows and len(out.array.shape) == 1
    inputs, values = f.apply(step.operands, expression, rows=rows or over.is_rows)
    if not (storage.is_result or storage.whole) and (out.at == "j" or (out.at == "" and not storage.by_joints)):
        # Entries, or rows of all joints, that are always zero are neither stored nor read.
        storage.zeros = {k for k, value in enumerate(values) if value.is_zero()}
        storage.zero_rows = out.at == "j" and len(out.array.shape) == 2
        if len(storage.zeros) == len(values):
            return
    if not storage.is_result:
        f.declare(storage, out.at if len(out.array.shape) > 1 else "")
    row = rows or vector
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = [
        ((Local("row", "j", out, k) if row else Access(storage, out, k, wide=True),), value)
        for k, value in enumerate(values)
        if k not in storage.zeros
    ]
    body = make_body(inputs, outputs, named_sections(named), wide_outputs=rows or over.is_rows or not lanes)
    first, storage.filled = rows and not storage.filled, storage.filled or rows
    if not row:
        f.stored([out.array], f.function.inputs)
    f.add(Loop(step.comment, _form(over, rows=rows, vector=vector), over, storage, out, body, step.mirror, first))


def _form(over: Over, *, rows: bool, vector: bool) -> LoopForm:
    if rows or vector:
        return LoopForm.ROWS if rows else LoopForm.VECTOR
    if over is Over.ONCE:
        return LoopForm.ONCE
    if over.is_rows:
        return LoopForm.JOINTS
    return LoopForm.BRANCH if over.is_paths else LoopForm.PAIRS


def _sparse_sum(f: Lowering, step: SparseSum) -> None:
    start, output = f.storage(step.start) if step.start else None, f.storage(step.output)
    if start and start.zeros:
        _map(
            f, step.whole(), lambda _, *values: step.sections(*values)
        )  # a loop would read entries that were never stored
        return
    pairs = start is not None and start.layout is Layout.FLAT and not start.is_result
    in_place = start is not None and not pairs and not output.is_result
    if not output.is_result and not in_place:
        f.declare(output, "ij" if pairs else "")
    elif pairs:
        f.stored([step.output], f.function.inputs)
    inputs, values = [], []
    for array in step.reads:
        symbols = [ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
        inputs += [(symbol, f.access(Operand(array, ""), k)) for k, symbol in enumerate(symbols)]
        values.append(as_operand(array.shape, symbols))
    n, operand = step.output.shape[0], Operand(step.output, "")
    of_change = values[len(step.reads) - len(step.operands) :]
    changed = entries_of(step.expression(*of_change))
    changes = [k for k, value in enumerate(changed) if not value.is_zero()]
    whole = entries_of(step.whole().expression(*values))
    places: list[Entry] = [Access(output, operand, k) for k in range(n * n)]
    if in_place and step.start:  # the entries that do not change are read where they are
        places = [f.access(Operand(step.start, ""), min(k, k % n * n + k // n)) for k in range(n * n)]
        for k in changes:
            places[k] = Local(f"{step.output.name}{k // n}{k % n}", None, operand, k)
        output.elsewhere = tuple(places)
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = []
    for before, k in zip([-1, *changes], [*changes, n * n], strict=True):
        # Zeros in between share a statement, in the order of the places: compilers make wide stores of it.
        if start is None and k - before > 1:
            outputs.append((tuple(places[before + 1 : k]), ca.SX(0)))
        if k < n * n:
            outputs.append(((places[k],), whole[k]))
    every = not f.variant.joint_lanes
    sections = named_sections(step.sections(*of_change))
    body = make_body(inputs, outputs, sections, define=len(changes) if in_place else 0, wide_outputs=every)
    f.add(SparseChange(step.comment, output, start, body, copies=start is not None and not in_place))


def _sum_joints(f: Lowering, step: SumJoints) -> None:
    source, output, m = f.storage(step.source), f.storage(step.output), len(f.chain.joints)
    if step.spread and not step.columns:
        f.declare_flat(output)
    elif not output.is_result:
        f.declare(output, "")
    if not step.spread:
        f.stored([step.output], f.function.inputs)
    rest = Count.JOINTS, *_COORDINATES, Pointer(output)
    joints_size = (step.output if step.spread else step.source).size
    cost = Operations(add=0 if step.spread else joints_size, multiply=joints_size + (m * m if step.of_pairs else 0))
    if step.spread:
        helper, count = (
            ("spread_pairs", joints_size // (m * m)) if step.of_pairs else ("spread_columns", joints_size // m)
        )
        calls = [Call(helper, (count, Pointer(source), *rest))]
        if step.of_pairs:
            calls = [Call(helper, (Pointer(source), count, *rest))]
    elif step.of_pairs:
        calls = [Call("sum_pairs", (Pointer(source), joints_size // (m * m), *rest))]
        calls += [Call("mirror_upper", (Pointer(output), Count.COORDINATES))] if step.mirror else []
    else:
        lanes = source.layout is Layout.LANES
        stride = Count.ALLOCATED_NUMBERS if lanes else Count.JOINTS
        rows = 1 if len(step.source.shape) == 1 else step.source.shape[0]
        calls = [Call("sum_columns", (rows, Pointer(source, plain=lanes), stride, *rest))]
    f.add(Helpers(tuple(calls), _TOGETHER, step, cost))


def _weights(f: Lowering, step: Weights) -> None:
    """Store the weights as rows of vectors with zeros between; without vectors, read them from the source."""
    m, lanes = len(f.chain.joints), f.variant.joint_lanes
    depth = step.source.size // (m * m)
    source, output, transposed = f.storage(step.source), f.storage(step.output), f.storage(step.transposed)
    paths = step.over.is_paths
    if not lanes and not step.mirror and not paths:
        output.layout, transposed.layout = Layout.WEIGHTS, Layout.WEIGHTS_TRANSPOSED
        output.companion = transposed.companion = source
        return
    folded = sum(i != j for i, j in step.over.indices(f.chain)) if step.mirror else 0
    stored = [output, transposed] if lanes else [output]
    for storage in stored:
        if lanes:
            storage.layout = Layout.WEIGHT_ROWS
            f.declare_as(storage)
        else:
            f.declare_flat(storage)
            storage.layout = Layout.WEIGHTS
    if not lanes:  # folded pairs are symmetric
        transposed.layout = Layout.WEIGHTS_TRANSPOSED if paths else Layout.WEIGHTS
        transposed.companion = output
    into = tuple(Pointer(storage, row=0 if lanes else None) for storage in stored)
    calls = _weight_calls(f, step, source, depth, into)
    comment = f"{step.output.name}_ij: what the pair {step.over} hands back"
    f.add(Helpers(tuple(calls), comment, step, Operations(add=depth * folded)))


def _weight_calls(f: Lowering, step: Weights, source: Storage, depth: int, into: tuple[Pointer, ...]) -> list[Call]:
    given, lanes, base = Pointer(source), f.variant.joint_lanes, f.chain.base_joints
    if step.over.is_paths:
        padded = (Count.ALLOCATED,) if lanes else ()
        pairs = int(step.over is Over.BEYOND), int(step.mirror)
        return [Call("weigh_branches", (given, Count.JOINTS, Table.PARENTS, *pairs, *padded, *into))]
    if not lanes:
        return [Call("fold_pairs", (given, Count.JOINTS, *into))]
    shape = Count.JOINTS, depth, Count.ALLOCATED
    if step.over is Over.BASE:
        return [Call("weigh_base", (given, *shape, base, *into))]
    relation = int(step.over.upper), int(step.over.diagonal), int(step.mirror)
    calls = [Call("weigh_triangle", (given, *shape, *relation, *into))]
    if step.without_base:
        calls.append(Call("clear_base", (*shape[1:], base, *into)))
    return calls


def _gather(f: Lowering, step: Gather) -> None:
    lanes, output = f.variant.joint_lanes, f.storage(step.output)
    pairs = sum(1 for _ in step.over.indices(f.chain, without_base=step.without_base))
    source = _weighted(f, step) if lanes and step.over is not Over.BASE else None
    if source is not None:
        count = source.array.shape[0]
        weights = next(f.storage(operand.array) for operand in step.operands if operand.at == "ij")
        f.declare(output, "j")
        arguments = (Pointer(source, row=0), count, Count.JOINTS, Count.ALLOCATED, Count.USED, Pointer(weights, row=0))
        call = Call("weighted_sums", (*arguments, Pointer(output, row=0)))
        cost = Operations(add=count, multiply=count).times(pairs)
        f.add(Helpers((call,), step.comment, step, cost, ordered=False))
        return
    inputs, values = f.apply(step.operands, step.expression, rows=True)
    zeros = {k for k, value in enumerate(values) if value.is_zero()}
    output.zeros, output.zero_rows = set() if output.whole else zeros, True
    f.declare(output, "j")
    if not lanes and (step.without_base or step.over is Over.BASE):
        raise NotImplementedError("maps over the pairs of a base's joints go back in vectors of joints only")
    stored = [value for value in values if not value.is_zero()]
    sums: list[tuple[tuple[Entry, ...], ca.SX]] = [((Local("sum", k),), value) for k, value in enumerate(stored)]
    body = make_body(inputs, sums, wide_outputs=True, accumulate=True)
    rows = tuple(k for k in range(step.output.shape[0]) if k not in zeros)
    cleared = tuple(sorted(zeros)) if output.whole else ()
    f.add(ColumnSums(step.comment, step.over, output, body, rows, cleared, pairs))


def _weighted(f: Lowering, step: Gather) -> Storage | None:
    """Return the columns of which a gather is the weighted sum and no more."""
    at = {operand.at: operand for operand in step.operands}
    if len(step.operands) != 2 or at.keys() != {"i", "ij"} or at["ij"].count != 1:
        return None
    columns = f.storage(at["i"].array)
    if columns.layout is not Layout.LANES or columns.zeros:
        return None
    symbols = {operand: ca.SX.sym("x", *operand.shape) for operand in step.operands}
    weighed = ca.densify(step.expression(*(symbols[operand] for operand in step.operands)))
    sums = ca.densify(symbols[at["i"]] * symbols[at["ij"]])
    return columns if sums.shape == weighed.shape and ca.is_equal(sums, weighed, 1) else None


def _reduce(f: Lowering, step: Reduce) -> None:
    """Sum expressions over the joints, into one or several arrays.

    Only entries that are not zero have an accumulator. Accumulators are numbered through all arrays, in their order.
    """
    inputs, values = f.apply(step.operands, step.expression, rows=True)
    stored = [value for value in values if not value.is_zero()]
    sums: list[tuple[tuple[Entry, ...], ca.SX]] = [((Local("sum", k),), value) for k, value in enumerate(stored)]
    body = make_body(inputs, sums, wide_outputs=True, accumulate=True)
    parts, offset = [], 0
    for array in step.outputs:
        storage = f.storage(array)
        zeros = {k for k in range(array.size) if values[offset + k].is_zero()}
        offset += array.size
        if not storage.is_result:
            f.declare_flat(storage)
            storage.zeros = set() if storage.whole else zeros
        summed = tuple(k for k in range(array.size) if k not in zeros)
        zeros_are_stored = storage.is_result or storage.whole  # who reads the whole array reads its zeros
        cleared = tuple(sorted(zeros)) if zeros_are_stored else ()
        parts.append((storage, summed, cleared))
    f.add(TotalSums(step.comment, step.over, body, tuple(parts)))


def _scan(f: Lowering, step: Scan) -> None:
    source, output, lanes = f.storage(step.source), f.storage(step.output), f.variant.joint_lanes
    f.declare(output, "j")
    output.zeros, output.zero_rows = source.zeros, True
    if output.whole and output.zeros:
        raise NotImplementedError(f"{step.output.name} has rows that are never stored, and is read as a whole")
    rows = [k for k in range(step.source.shape[0]) if k not in output.zeros]
    # Rows of vectors are filled up to the last vector that holds a joint; what lies beyond was never written.
    stride, length = (Count.ALLOCATED_NUMBERS, Count.USED_NUMBERS) if lanes else 2 * (Count.JOINTS,)
    calls = []
    for _, run in itertools.groupby(enumerate(rows), lambda pair: pair[1] - pair[0]):
        group = [row for _, row in run]
        given, into = (Pointer(storage, row=group[0], plain=lanes) for storage in (source, output))
        helper = "sums_beyond" if step.beyond else "sums_up_to"
        calls.append(Call(helper, (given, len(group), stride, length, into)))
        if step.base:
            calls.append(Call("sums_of_base", (given, len(group), stride, step.base, int(step.beyond), into)))
    f.add(Helpers(tuple(calls), step.comment, step, Operations(add=len(rows) * len(f.chain.joints))))


def _shared(f: Lowering, step: Shared) -> None:
    name = f.scope.prefix + step.name
    if name not in f.kernels.shared:
        columns = frozenset(array.name for array in step.columns)
        function = Function(name, f.scope, step.parameters, (step.result,), meaning=step.meaning, columns=columns)
        inner = Lowering(f.kernels, function)
        inner.guards = not step.is_guarded
        inner.read_parameters(step.steps)
        inner.lower(step.steps)
        inner.guard_results()
        inner.mirror_results()
        f.kernels.shared[name] = function
    output = f.storage(step.output)
    if not output.is_result:
        f.declare(output, "")
    arguments = tuple(map(f.storage, step.arguments))
    f.add(Invoke(f.kernels.shared[name], arguments, (output,), (step.output,), blank=True))


def _sum(f: Lowering, step: Sum) -> None:
    several = len(step.terms) > 1
    if several:  # the call has guarded a single term
        f.stored(step.outputs, f.function.inputs)
    outputs = [f.storage(array) for array in step.outputs]
    summed = []
    for name, array in zip(step.results, step.outputs, strict=True):
        summed.append(Storage(Array(f"{name}_part", (array.size,))))
        if several and array.name not in step.apart:
            f.declare(summed[-1], "")
    for index, term in enumerate(step.terms):
        arguments, into, added = [], [], []
        for array, part in term.arguments:
            first = None if part.index is None else part.index * array.size
            arguments.append((array, f.storage(part.array) if part.array else None, first))
        for output, part_sum in zip(outputs, summed, strict=True):
            apart = output.array.name in step.apart
            first = output.array.size // len(step.terms) * index if apart else None
            is_sum = index > 0 and not apart
            into.append((part_sum if is_sum else output, first))
            added.append(output if is_sum else None)
        zeros = max((array.size for array, source, _ in arguments if source is None), default=0)
        results = [Array(name, _result_shape(step, k)) for k, name in enumerate(step.results)]
        function = f.kernels.term(term, results)
        item = InvokeKernel(term.function, function, tuple(arguments), tuple(into), tuple(added), zeros)
        f.declare_zeros(zeros)
        f.add(item)


def _result_shape(step: Sum, k: int) -> tuple[int, ...]:
    shape = step.outputs[k].shape
    return shape[1:] if step.outputs[k].name in step.apart else shape


RULES: Rules = {
    StraightLine: _straight_line,
    CloseLoops: _straight_line,
    Map: _map,
    SparseSum: _sparse_sum,
    SumJoints: _sum_joints,
    Weights: _weights,
    Gather: _gather,
    Reduce: _reduce,
    Scan: _scan,
    Shared: _shared,
    Sum: _sum,
}
"""Lowering of each kind of step."""


def lowered(chain: Chain, variant: Variant) -> LoweredKernels:
    """Return the lowered form of a chain's kernels for a variant, empty: kernels are lowered as they are asked for."""
    return LoweredKernels(chain, variant, RULES)
