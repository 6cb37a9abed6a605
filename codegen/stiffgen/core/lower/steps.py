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

from stiffgen.core.lower.form import (
    Access,
    Call,
    ColumnSums,
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
    TotalSums,
    make_body,
)
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.lowering import LoweredKernels, Lowering, Rules
from stiffgen.core.lower.statements import named_sections, statements, upper_entry
from stiffgen.core.lower.variant import Variant
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import Section
from stiffgen.core.symbolic.program import Array, Operand, Over, as_operand, entries_of
from stiffgen.core.symbolic.steps import (
    CloseLoops,
    Congruence,
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
from stiffgen.core.symbolic.symmetric_part import SymmetricPart, symmetric_entries

_COORDINATES = Table.COORDINATES, Table.MULTIPLIERS
_TOGETHER = "joints that move together share a coordinate"


def _straight_line(f: Lowering, step: StraightLine) -> None:
    """Append the statements, or a call of the function that they become where kernels share them.

    Columns of joints are filled in vectors. Where they are a result, a local array "J" takes them first, and their
    numbers are copied.
    """
    outputs = []
    for number, array in enumerate(step.outputs):
        storage = f.storage(array)
        if number < step.columns:
            if storage.is_result and f.variant.joint_lanes:
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
    f.note_overflow(step.outputs, step.arguments)
    for storage, array in zip(outputs, step.outputs, strict=True):
        if storage.array != array:
            vectors, result = Pointer(storage, plain=True), Pointer(f.storage(array))
            f.call("copy_rows", vectors, Count.ALLOCATED_NUMBERS, array.shape[0], result)


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
    in_vectors = J.layout is Layout.LANES
    stride = Count.ALLOCATED_NUMBERS if in_vectors else n
    arguments = Pointer(J, plain=in_vectors), stride, rows, Pointer(f.storage(factors)), n, Pointer(output)
    multiplied = n * (n + 1) // 2 * rows + rows * (rows + 1) // 2 * n
    cost = Operations(add=multiplied - n * rows, multiply=multiplied)
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

    lanes, over, out = f.variant.joint_lanes, step.over, step.output
    storage = f.storage(out.array)
    fills_rows = lanes and over.is_pairs and not over.is_paths and out.count == 1
    fills_vector = lanes and over.is_rows and len(out.array.shape) == 1
    inputs, values = f.apply(step.operands, expression, rows=fills_rows or over.is_rows)
    if not (storage.is_result or storage.whole) and (out.at == "j" or (out.at == "" and not storage.by_joints)):
        # Entries, or rows of all joints, that are always zero are neither stored nor read.
        storage.zeros = {k for k, value in enumerate(values) if value.is_zero()}
        storage.zero_rows = out.at == "j" and len(out.array.shape) == 2
        if len(storage.zeros) == len(values):
            return
    if not storage.is_result:
        f.declare(storage, out.at if len(out.array.shape) > 1 else "")
    to_row = fills_rows or fills_vector
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = [
        ((Local("row", "j", out, k) if to_row else Access(storage, out, k, wide=True),), value)
        for k, value in enumerate(values)
        if k not in storage.zeros
    ]
    body = make_body(inputs, outputs, named_sections(named), wide_outputs=fills_rows or over.is_rows or not lanes)
    is_first = fills_rows and not storage.filled
    storage.filled |= fills_rows
    if not to_row:
        f.note_overflow([out.array], f.function.inputs)
    form = _form(over, rows=fills_rows, vector=fills_vector)
    f.add(Loop(step.comment, form, over, storage, out, body, step.mirror, is_first))


def _form(over: Over, *, rows: bool, vector: bool) -> LoopForm:
    """Return the form of a map's loop; ``rows`` and ``vector`` are what vectors of joints fill."""
    if rows:
        return LoopForm.ROWS
    if vector:
        return LoopForm.VECTOR
    if over is Over.ONCE:
        return LoopForm.ONCE
    if over.is_rows:
        return LoopForm.JOINTS
    return LoopForm.BRANCH if over.is_paths else LoopForm.PAIRS


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
    of_pairs = start is not None and start.layout is Layout.FLAT and not start.is_result
    in_place = start is not None and not of_pairs and not output.is_result
    if not output.is_result and not in_place:
        f.declare(output, "ij" if of_pairs else "")
    elif of_pairs:
        f.note_overflow([step.output], f.function.inputs)
    inputs, values = [], []
    for array in step.reads:
        symbols = [ca.SX.sym(f"{array.name}{k}") for k in range(array.size)]
        inputs += [(symbol, f.access(Operand(array, ""), k)) for k, symbol in enumerate(symbols)]
        values.append(as_operand(array.shape, symbols))
    n, operand = step.output.shape[0], Operand(step.output, "")
    operand_values = values[len(step.reads) - len(step.operands) :]  # those behind the start
    change = entries_of(step.expression(*operand_values))
    changes = [k for k, value in enumerate(change) if not value.is_zero()]
    total = entries_of(step.whole().expression(*values))
    places: list[Entry] = [Access(output, operand, k) for k in range(n * n)]
    if in_place and step.start:
        places = [f.access(Operand(step.start, ""), upper_entry(k, n)) for k in range(n * n)]
        for k in changes:
            places[k] = Local(f"{step.output.name}{k // n}{k % n}", None, operand, k)
        output.elsewhere = tuple(places)
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = []
    for before, k in zip([-1, *changes], [*changes, n * n], strict=True):
        # Zeros in between share a statement, in the order of the places: compilers make wide stores of it.
        if start is None and k - before > 1:
            outputs.append((tuple(places[before + 1 : k]), ca.SX(0)))
        if k < n * n:
            outputs.append(((places[k],), total[k]))
    sections = named_sections(step.sections(*operand_values))
    defined, wide = len(changes) if in_place else 0, not f.variant.joint_lanes
    body = make_body(inputs, outputs, sections, define=defined, wide_outputs=wide)
    f.add(SparseChange(step.comment, output, start, body, copies=start is not None and not in_place))


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
    size = array.shape[-1] ** 2
    outputs: list[tuple[tuple[Entry, ...], ca.SX]] = [
        ((Access(storage, operand, k),), value)
        for k, value in enumerate(symmetric_entries(array, symbols))
        if k % size == upper_entry(k % size, array.shape[-1])
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
    rest = Count.JOINTS, *_COORDINATES, Pointer(output)
    joints_size = (step.output if step.spread else step.source).size
    depth = joints_size // (m * m)  # numbers per pair, where two indices run over joints
    cost = Operations(add=0 if step.spread else joints_size, multiply=joints_size + (m * m if step.of_pairs else 0))
    if step.spread and step.of_pairs:
        calls = [Call("spread_pairs", (Pointer(source), depth, *rest))]
    elif step.spread:
        calls = [Call("spread_columns", (joints_size // m, Pointer(source), *rest))]
    elif step.of_pairs:
        calls = [Call("sum_pairs", (Pointer(source), depth, *rest))]
        calls += [Call("mirror_upper", (Pointer(output), Count.COORDINATES))] if step.mirror else []
    else:
        in_vectors = source.layout is Layout.LANES
        stride = Count.ALLOCATED_NUMBERS if in_vectors else Count.JOINTS
        rows = 1 if len(step.source.shape) == 1 else step.source.shape[0]
        calls = [Call("sum_columns", (rows, Pointer(source, plain=in_vectors), stride, *rest))]
    f.add(Helpers(tuple(calls), _TOGETHER, step, cost))


def _weights(f: Lowering, step: Weights) -> None:
    """Store the weights as rows of vectors with zeros between; without vectors, read them from the source.

    Without vectors, weights that are added up (``mirror``) or lie on paths need an array of their own, which serves as
    output and transpose.
    """
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
            storage.layout = Layout.WEIGHTS  # declared as numbers in a row, read as weights of pairs
    if not lanes:  # folded pairs are symmetric
        transposed.layout = Layout.WEIGHTS_TRANSPOSED if paths else Layout.WEIGHTS
        transposed.companion = output
    targets = tuple(Pointer(storage, row=0 if lanes else None) for storage in stored)
    calls = _weight_calls(f, step, Pointer(source), depth, targets)
    comment = f"{step.output.name}_ij: what the pair {step.over} hands back"
    f.add(Helpers(tuple(calls), comment, step, Operations(add=depth * folded)))


def _weight_calls(f: Lowering, step: Weights, source: Pointer, depth: int, targets: tuple[Pointer, ...]) -> list[Call]:
    """Return the helpers that fill ``targets`` (array and transpose, or one for both) with ``depth`` numbers a pair."""
    lanes, base = f.variant.joint_lanes, f.chain.base_joints
    if step.over.is_paths:
        padded = (Count.ALLOCATED,) if lanes else ()
        flags = int(step.over is Over.BEYOND), int(step.mirror)
        return [Call("weigh_branches", (source, Count.JOINTS, Table.PARENTS, *flags, *padded, *targets))]
    if not lanes:
        return [Call("fold_pairs", (source, Count.JOINTS, *targets))]
    shape = Count.JOINTS, depth, Count.ALLOCATED
    if step.over is Over.BASE:
        return [Call("weigh_base", (source, *shape, base, *targets))]
    relation = int(step.over.upper), int(step.over.diagonal), int(step.mirror)
    calls = [Call("weigh_triangle", (source, *shape, *relation, *targets))]
    if step.without_base:
        calls.append(Call("clear_base", (*shape[1:], base, *targets)))
    return calls


def _gather(f: Lowering, step: Gather) -> None:
    """Sum over i for every joint j: by a helper where the terms are weight times column, else by a loop of its own."""
    lanes, output = f.variant.joint_lanes, f.storage(step.output)
    pairs = sum(1 for _ in step.over.indices(f.chain, without_base=step.without_base))
    columns = _weighted_columns(f, step) if lanes and step.over is not Over.BASE else None
    if columns is not None:
        count = columns.array.shape[0]
        weights = next(f.storage(operand.array) for operand in step.operands if operand.at == "ij")
        f.declare(output, "j")
        arguments = (Pointer(columns, row=0), count, Count.JOINTS, Count.ALLOCATED, Count.USED, Pointer(weights, row=0))
        call = Call("weighted_sums", (*arguments, Pointer(output, row=0)))
        cost = Operations(add=count, multiply=count).times(pairs)
        f.add(Helpers((call,), step.comment, step, cost, ordered=False))
        return
    if not lanes and (step.without_base or step.over is Over.BASE):
        raise NotImplementedError("maps over the pairs of a base's joints go back in vectors of joints only")
    inputs, values = f.apply(step.operands, step.expression, rows=True)
    zeros = {k for k, value in enumerate(values) if value.is_zero()}
    # A function that reads the whole array reads its zeros, too: these are stored.
    output.zeros, output.zero_rows = set() if output.whole else zeros, True
    f.declare(output, "j")
    stored = [value for value in values if not value.is_zero()]
    sums: list[tuple[tuple[Entry, ...], ca.SX]] = [((Local("sum", k),), value) for k, value in enumerate(stored)]
    body = make_body(inputs, sums, wide_outputs=True, accumulate=True)
    rows = tuple(k for k in range(step.output.shape[0]) if k not in zeros)
    cleared = tuple(sorted(zeros)) if output.whole else ()
    f.add(ColumnSums(step.comment, step.over, output, body, rows, cleared, pairs))


def _weighted_columns(f: Lowering, step: Gather) -> Storage | None:
    """Return the columns of which a gather is the weighted sum; None for any other gather."""
    by_place = {operand.at: operand for operand in step.operands}
    if len(step.operands) != 2 or by_place.keys() != {"i", "ij"} or by_place["ij"].count != 1:
        return None
    columns = f.storage(by_place["i"].array)
    if columns.layout is not Layout.LANES or columns.zeros:
        return None
    symbols = {operand: ca.SX.sym("x", *operand.shape) for operand in step.operands}
    term = ca.densify(step.expression(*(symbols[operand] for operand in step.operands)))
    product = ca.densify(symbols[by_place["i"]] * symbols[by_place["ij"]])
    return columns if product.shape == term.shape and ca.is_equal(product, term, 1) else None


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
    """Call a helper for each group of neighbouring rows that are not always zero, and one more for a floating base."""
    source, output, lanes = f.storage(step.source), f.storage(step.output), f.variant.joint_lanes
    f.declare(output, "j")
    output.zeros, output.zero_rows = source.zeros, True
    if output.whole and output.zeros:
        raise NotImplementedError(f"{step.output.name} has rows that are never stored, and is read as a whole")
    rows = [k for k in range(step.source.shape[0]) if k not in output.zeros]
    # Rows of vectors are filled up to the last vector that holds a joint; what lies beyond was never written.
    stride, length = (Count.ALLOCATED_NUMBERS, Count.USED_NUMBERS) if lanes else 2 * (Count.JOINTS,)
    calls = []
    # Neighbouring rows differ by as much as their places in the list.
    for _, neighbours in itertools.groupby(enumerate(rows), lambda place_and_row: place_and_row[1] - place_and_row[0]):
        group = [row for _, row in neighbours]
        columns, sums = (Pointer(storage, row=group[0], plain=lanes) for storage in (source, output))
        helper = "sums_beyond" if step.beyond else "sums_up_to"
        calls.append(Call(helper, (columns, len(group), stride, length, sums)))
        if step.base:
            calls.append(Call("sums_of_base", (columns, len(group), stride, step.base, int(step.beyond), sums)))
    f.add(Helpers(tuple(calls), step.comment, step, Operations(add=len(rows) * len(f.chain.joints))))


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
        arguments, targets, totals = [], [], []
        for array, argument in term.arguments:
            first = None if argument.index is None else argument.index * array.size
            arguments.append((array, f.storage(argument.array) if argument.array else None, first))
        for output, part in zip(outputs, parts, strict=True):
            is_apart = output.array.name in step.apart
            first = output.array.size // len(step.terms) * index if is_apart else None
            is_added = index > 0 and not is_apart
            targets.append((part if is_added else output, first))
            totals.append(output if is_added else None)
        zeros = max((array.size for array, source, _ in arguments if source is None), default=0)
        function = f.kernels.term(term, results)
        f.declare_zeros(zeros)
        f.add(InvokeKernel(term.function, function, tuple(arguments), tuple(targets), tuple(totals), zeros))


RULES: Rules = {
    StraightLine: _straight_line,
    CloseLoops: _straight_line,
    Congruence: _congruence,
    Map: _map,
    SparseSum: _sparse_sum,
    SymmetricPart: _symmetric_part,
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
