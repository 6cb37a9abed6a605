# SPDX-License-Identifier: MIT
"""Lowering of the steps of reverse programs; :data:`RULES` is the table (see ``core.lower.steps``)."""

from __future__ import annotations

import itertools

import casadi as ca

from stiffgen.core.lower.form import (
    Call,
    ColumnSums,
    Count,
    Entry,
    Helpers,
    Layout,
    Local,
    Pointer,
    Storage,
    Table,
    TotalSums,
    make_body,
)
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.lowering import Lowering, Rules
from stiffgen.core.symbolic.program import Over
from stiffgen.families.derivatives.steps import Gather, Reduce, Scan, Weights


def _weights(f: Lowering, step: Weights) -> None:
    """Store the weights as rows of vectors with zeros between; without vectors, read them from the source.

    Without vectors, weights that are added up (``mirror``) or lie on paths need an array of their own, which serves as
    output and transpose.
    """
    source, output, transposed = f.storage(step.source), f.storage(step.output), f.storage(step.transposed)
    targets: tuple[Pointer, ...]
    if f.variant.joint_lanes:
        for storage in (output, transposed):
            storage.layout = Layout.WEIGHT_ROWS
            f.declare_as(storage)
        targets = Pointer(output, row=0), Pointer(transposed, row=0)
    elif step.mirror or step.over.is_paths:
        f.declare_flat(output)
        output.layout = Layout.WEIGHTS  # declared as numbers in a row, read as weights of pairs
        # Weights that are added up are symmetric.
        transposed.layout = Layout.WEIGHTS_TRANSPOSED if step.over.is_paths else Layout.WEIGHTS
        transposed.companion = output
        targets = (Pointer(output),)
    else:
        output.layout, transposed.layout = Layout.WEIGHTS, Layout.WEIGHTS_TRANSPOSED
        output.companion = transposed.companion = source
        return
    depth = step.source.size // len(f.chain.joints) ** 2  # numbers per pair
    calls = _weight_calls(f, step, Pointer(source), depth, targets)
    added = sum(i != j for i, j in step.over.indices(f.chain)) if step.mirror else 0  # pairs
    comment = f"{step.output.name}_ij: what the pair {step.over} hands back"
    f.add(Helpers(tuple(calls), comment, step, Operations(add=depth * added)))


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
        _weighted_sums(f, step, columns, pairs)
        return
    if not lanes and (step.without_base or step.over is Over.BASE):
        raise NotImplementedError("maps over the pairs of a base's joints go back in vectors of joints only")
    inputs, values = f.apply(step.operands, step.expression, rows=True)
    zeros = {k for k, value in enumerate(values) if value.is_zero()}  # rows of the output
    rows = tuple(k for k in range(step.output.shape[0]) if k not in zeros)
    sums: list[tuple[tuple[Entry, ...], ca.SX]] = [((Local("sum", k),), values[row]) for k, row in enumerate(rows)]
    body = make_body(inputs, sums, wide_outputs=True, accumulate=True)
    # A function that reads the whole array reads its zeros, too: these are stored, and no reader leaves them out.
    cleared = tuple(sorted(zeros)) if output.whole else ()
    output.zeros, output.zero_rows = zeros.difference(cleared), True
    f.declare(output, "j")
    f.add(ColumnSums(step.comment, step.over, output, body, rows, cleared, pairs))


def _weighted_sums(f: Lowering, step: Gather, columns: Storage, pairs: int) -> None:
    """Call the helper that sums columns, each weighted with a number of the pair."""
    count, output = columns.array.shape[0], f.storage(step.output)
    weights = next(f.storage(operand.array) for operand in step.operands if operand.at == "ij")
    f.declare(output, "j")
    arguments = (Pointer(columns, row=0), count, Count.JOINTS, Count.ALLOCATED, Count.USED, Pointer(weights, row=0))
    call = Call("weighted_sums", (*arguments, Pointer(output, row=0)))
    cost = Operations(add=count, multiply=count).times(pairs)
    f.add(Helpers((call,), step.comment, step, cost, ordered=False))


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


RULES: Rules = {Weights: _weights, Gather: _gather, Reduce: _reduce, Scan: _scan}
"""Lowering of each kind of step."""
