# SPDX-License-Identifier: MIT
"""Reverse rules: functions that append the steps for the gradients of one step (see ``adjoint``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca

from stiffgen.core.family import families
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import kinematics
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.kinematics import Expressions
from stiffgen.core.symbolic.program import Array, Operand, Over, Step, pruned
from stiffgen.core.symbolic.steps import Congruence, Map, Shared, SparseSum, StraightLine, SumJoints
from stiffgen.families.derivatives.gradients import Gradients, bar_name, column, extents, shown, symbols
from stiffgen.families.derivatives.steps import Gather, Reduce, Scan, Weights


def _any_map(run: Gradients, step: Map) -> None:
    (_pairs if step.over.is_pairs else _map)(run, step)


def _sum_joints(run: Gradients, step: SumJoints) -> None:
    """Spread the gradient over the joints."""
    output = run.new(step.source)
    run.steps.append(SumJoints(run.only(step.output), output, step.columns, spread=True))


def _any_straight_line(run: Gradients, step: StraightLine) -> None:
    if step.moves:
        _moving(run, step)
    else:
        _straight_line(run, step, step.arguments)


def _sparse_sum(run: Gradients, step: SparseSum) -> None:
    """Differentiate as a map; a symmetric start receives the full gradient, both triangles."""
    if step.start is None or step.start.name not in run.mirrored:
        _map(run, step.whole())
        return
    run.bars.setdefault(step.start.name, []).extend(run.bars[step.output.name])
    operands = tuple(Operand(each, "") for each in step.operands)
    _map(run, Map(step.comment, Over.ONCE, Operand(step.output, ""), operands, step.expression))


def _map(run: Gradients, step: Map) -> None:
    """Append one map per operand with one column per joint, and one sum over joints for all other operands.

    The gradients are those of the loss, the dot product of the map's expression with the gradient of its output.
    """
    bars = tuple(Operand(bar, step.output.at) for bar in run.bars[step.output.array.name])  # contributions
    values = [symbols(operand, f"x{k}_") for k, operand in enumerate(step.operands)]
    seeds = [symbols(operand, f"c{k}_") for k, operand in enumerate(bars)]
    symbols_of = tuple(zip((*step.operands, *bars), (*values, *seeds), strict=True))
    seed = sum((column(each) for each in seeds), ca.SX(0))  # gradient of the output
    loss = ca.dot(column(step.expression(*run.known(step, values))), seed)
    sums: dict[str, tuple[Array, ca.SX]] = {}  # gradients with respect to whole arrays, as terms of one joint
    for operand, value in zip(step.operands, values, strict=True):
        gradient = ca.densify(ca.gradient(loss, value))
        has_own_gradient = operand.at == "j" or step.over is Over.ONCE  # in every evaluation, none to be summed
        if gradient.is_zero():
            continue
        if has_own_gradient and _passes(run, operand, bars, gradient, seed):
            run.bars.setdefault(operand.array.name, []).append(bars[0].array)  # unchanged gradient: no step
        elif has_own_gradient:
            _append_map(run, step, operand, gradient, symbols_of)
        else:
            for array, term in _through_sums(run, operand.array, gradient):
                _, total = sums.get(array.name, (array, ca.SX.zeros(array.size)))
                sums[array.name] = array, total + term
    if sums:
        _append_sums(run, step, list(sums.values()), symbols_of)


def _append_sums(
    run: Gradients,
    step: Map,
    sums: Sequence[tuple[Array, ca.SX]],
    symbols_of: tuple[tuple[Operand, ca.SX], ...],
) -> None:
    """Append one sum over joints of the gradients with respect to whole arrays, given as terms of one joint."""
    outputs = tuple(run.new(array) for array, _ in sums)
    operands, body = pruned(symbols_of, ca.vertcat(*(term for _, term in sums)))
    comment = "gradient with respect to " + ", ".join(shown(array) for array, _ in sums)
    of = "coordinates" if step.over is Over.COORDINATES else "joints"
    run.steps.append(Reduce(f"sums over the {of}: {comment}", outputs, operands, body, step.over))


def _passes(run: Gradients, operand: Operand, bars: Sequence[Operand], gradient: ca.SX, seed: ca.SX) -> bool:
    """Return whether the gradient with respect to an array that a step wrote is the output's gradient unchanged."""
    if len(bars) != 1 or bars[0].array.shape != operand.array.shape or operand.array.name not in run.written:
        return False
    return gradient.numel() == seed.numel() and bool(ca.is_equal(column(gradient), seed, 1))


def _append_map(
    run: Gradients, step: Map, operand: Operand, gradient: ca.SX, symbols_of: tuple[tuple[Operand, ca.SX], ...]
) -> None:
    """Append the map that computes the gradient with respect to one operand; ``symbols_of`` pairs arrays and symbols.

    For columns that a forward step writes, the map also adds what other steps have contributed so far, so that one
    array holds the sum. Contributions to a kernel's argument are added up at the end (``_finish``).
    """
    comment = f"gradient with respect to {shown(operand.array)}, through {shown(step.output.array)}"
    total = column(gradient)
    if operand.at == "j" and operand.array.name in run.written and operand.array.name in run.bars:
        earlier = [Operand(each, "j") for each in run.bars.pop(operand.array.name)]  # run.new adds the sum alone
        seeds = [symbols(each, f"b{k}_") for k, each in enumerate(earlier)]
        symbols_of = (*symbols_of, *zip(earlier, seeds, strict=True))
        total = sum(seeds, total)
        comment += ", plus contributions of other steps"
    operands, body = pruned(symbols_of, total)
    output = Operand(run.new(operand.array), operand.at)
    run.steps.append(Map(comment, step.over, output, operands, body))


def _through_sums(run: Gradients, array: Array, gradient: ca.SX) -> list[tuple[Array, ca.SX]]:
    """Return the gradient with respect to an array as pairs of array and column.

    If a sparse sum writes the array, the pairs are those of its operands instead.
    """
    step = run.sparse.get(array.name)
    if step is None:
        return [(array, column(gradient))]
    symbols = [ca.SX.sym(each.name, *extents(each.shape)) for each in step.reads]
    loss = ca.dot(column(step.whole().expression(*symbols)), column(gradient))
    parts = []
    for each, symbol in zip(step.reads, symbols, strict=True):
        parts.append((each, column(ca.densify(ca.gradient(loss, symbol)))))
    return parts


def _pairs(run: Gradients, step: Map) -> None:
    """Append the reverse steps of a map over pairs (i, j) of joints.

    Each operand belongs to one joint of the pair. Its gradient is a sum over the other joint, weighted with the
    gradient of the pair's result.
    """
    if not step.operands:
        return
    bar = run.only(step.output.array)
    # Steps come in reverse: a map that overwrites the pairs of base joints comes before the map that it overwrites.
    without_base = step.output.array.name in run.of_base
    if step.over is Over.BASE:
        run.of_base.add(step.output.array.name)
    m = len(run.chain.joints)
    shape = (m, m, *step.output.array.shape[2:])
    weights, transposed = (run.local(name, shape) for name in ("W", "WT"))
    run.steps.append(Weights(bar, weights, transposed, step.over, step.mirror, without_base))
    values = [symbols(operand, f"x{k}_") for k, operand in enumerate(step.operands)]
    seed = symbols(Operand(weights, "ij"), "c_")  # gradient of the pair's result
    loss = ca.dot(column(step.expression(*run.known(step, values))), column(seed))
    for operand, value in zip(step.operands, values, strict=True):
        if operand.at not in ("i", "j"):
            raise NotImplementedError("a map over pairs has operands of its joints only")
        gradient = ca.densify(ca.gradient(loss, value))
        if gradient.is_zero():
            continue
        # A Gather sums over i for every j: for an operand at i the two change places.
        all_operands, over, summed, pair = list(step.operands), step.over, "i", Operand(weights, "ij")
        if operand.at == "i":
            all_operands, over = [each.flipped for each in step.operands], step.over.flipped
            summed, pair = "j", Operand(transposed, "ij")
        operands, body = pruned(tuple(zip((*all_operands, pair), (*values, seed), strict=True)), gradient)
        comment = f"gradient with respect to {shown(operand.array)}_{operand.at}: sum over joints {summed} of its pairs"
        run.steps.append(Gather(comment, over, run.new(operand.array), operands, body, without_base))


def _straight_line(run: Gradients, step: StraightLine, variables: tuple[Array, ...]) -> None:
    """Append CasADi's reverse mode of the statements with respect to ``variables``.

    Columns that several kernels share have a shared product, if nothing but the columns has a gradient.
    """
    variables = _dependencies(run, step, variables)
    if not variables:
        return
    variables = tuple(sorted(variables, key=lambda array: array.name not in run.columns))  # columns are stored first
    outputs = tuple(run.new(array) for array in variables)
    bars = [(output, bar) for output in step.outputs for bar in run.bars.get(output.name, ())]
    only_columns = {output for output, _ in bars} == set(step.outputs[: step.columns])
    if not (step.name and only_columns) or step.moves:
        count = sum(array.name in run.columns for array in variables)
        run.steps.append(replace(_statements(step, variables, bars, outputs), columns=count))
        return
    (columns,), (result,) = step.outputs[: step.columns], outputs
    bar, q_bar = Array(bar_name(columns.name), columns.shape), Array(bar_name(Q.name), result.shape)
    shared = Shared(
        name=f"{step.name}_vjp",
        meaning=f"Gradient with respect to q, from the gradient {bar.name} with respect to the columns "
        f"{shown(columns)}",
        parameters=(*step.arguments, bar),
        result=q_bar,
        steps=(_statements(step, variables, [(columns, bar)], (q_bar,)),),
        arguments=(*step.arguments, run.one(columns)),
        output=result,
        columns=(bar,),
    )
    run.steps.append(shared)


def _dependencies(run: Gradients, step: StraightLine, variables: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the variables on which a step depends: none for the forces of bodies without mass."""
    symbols = [ca.SX.sym(a.name, *extents(a.shape)) for a in step.arguments]
    result = step.expressions(run.chain, *symbols).result
    named = dict(zip((array.name for array in step.arguments), symbols, strict=True))
    return tuple(array for array in variables if ca.depends_on(result, ca.vec(named[array.name])))


def _moving(run: Gradients, step: StraightLine) -> None:
    """Append the gradient with respect to the motion of a step's columns J and poses, in closed form.

    A pose contributes the wrench of its gradient to all columns (:func:`_covector`); J_bar contributes sums over the
    joints beyond and before each joint (:func:`_columns`). What is known per joint is summed into coordinates. CasADi
    differentiates a tool pose. The first output is J, since ``_with_columns`` has replaced steps of the pose alone.
    """
    assert step.moves is not None
    J, *poses = step.outputs
    covectors = [_covector(run, pose) for pose in poses if pose.name in run.bars]
    output = _gradient_of_motion(run, step)
    of_joints = run.local("q_bar_of_joints", (len(run.chain.joints),)) if run.chain.coupled else output
    if J.name in run.bars:
        _columns(run, step.moves, J, covectors, of_joints)
    else:
        operands = tuple(Operand(each, "") for each in covectors)
        run.steps.append(_dots(J, operands, of_joints, floating=run.chain.floating))
    if run.chain.coupled:
        run.steps.append(SumJoints(of_joints, output))
    others = tuple(each for each in step.arguments if not (each.is_q or each.is_base_pose))
    if others:
        _straight_line(run, step, others)


def _gradient_of_motion(run: Gradients, step: StraightLine) -> Array:
    """Return the array of the gradient with respect to q or, on a floating base, to its twist and the joints' rates."""
    if not run.chain.floating:
        (q,) = (each for each in step.arguments if each.is_q)
        return run.new(q)
    output = run.local("motion_bar", (run.chain.dof,))
    run.motions.append(output)
    return output


def _columns(run: Gradients, moves: Representation, J: Array, covectors: list[Array], output: Array) -> None:
    """Append the gradient with respect to q of columns, and of the pose if there is a covector; shared by kernels."""
    columns, bar = Array("J", J.shape), Array("J_bar", J.shape)
    forces = tuple(Array(f"f{k}", each.shape) for k, each in enumerate(covectors))
    q_bar = Array(bar_name(Q.name), output.shape)
    steps, sums = _column_sums(moves, columns, bar, run.chain.base_joints)
    operands = (*(Operand(each, "j") for each in sums), *(Operand(each, "") for each in forces))
    steps.append(_dots(columns, operands, q_bar, floating=run.chain.floating))
    and_pose, and_covector = "", ""
    if forces:
        and_pose, and_covector = "and_pose_", " and the covector f0 of the gradient with respect to the pose"
    shared = Shared(
        name=f"{moves}_columns_{and_pose}vjp",
        meaning="Gradient with respect to q, from the gradient J_bar with respect to Jacobian columns J"
        f"{and_covector}; {moves} representation",
        parameters=(columns, bar, *forces),
        result=q_bar,
        steps=tuple(steps),
        arguments=(J, run.one(J), *covectors),
        output=output,
        columns=(columns, bar),
    )
    run.steps.append(shared)


def _covector(run: Gradients, pose: Array) -> Array:
    """Append the hybrid wrench of the pose's gradient, (p_bar, sum of R_c x R_bar_c), and return its array."""
    bars = run.bars[pose.name]
    covector = run.local("f", (6,))
    operands = (Operand(pose, ""), *(Operand(bar, "") for bar in bars))

    def body(value: ca.SX, *gradients: ca.SX) -> ca.SX:
        bar = sum(gradients, ca.SX.zeros(4, 4))
        return ca.densify(ca.vertcat(bar[:3, 3], turn(value[:3, :3], bar[:3, :3])))

    run.steps.append(Map("covector of the pose's gradient", Over.ONCE, Operand(covector, ""), operands, body))
    return covector


def turn(rotation: ca.SX, gradient: ca.SX) -> ca.SX:
    """Return the gradient with respect to a small rotation w (R becomes R + [w] R) from that of the entries of R."""
    return sum((ca.cross(rotation[:, c], gradient[:, c]) for c in range(3)), ca.SX.zeros(3))


def _dots(J: Array, covectors: tuple[Operand, ...], output: Array, *, floating: bool) -> Map:
    """Return the map of the products of every column with the sum of the covectors."""

    def dot(column: ca.SX, *values: ca.SX) -> ca.SX:
        return ca.SX(ca.dot(column, sum(values, ca.SX(0))))

    comment = "gradient with respect to q: q_bar_j = J_j . sums" + ("; the base's twist first" if floating else "")
    return Map(comment, Over.JOINTS, Operand(output, "j"), (Operand(J, "j"), *covectors), dot)


def _column_sums(moves: Representation, J: Array, bar: Array, base: int) -> tuple[list[Step], list[Array]]:
    """Return the steps and arrays of the sums of y_i for every joint j, where dJ_i/dq_j . J_bar_i = J_j . y_i.

    dJ_i/dq_j is linear in J_j, so that y_i needs J_i and J_bar_i alone; it is another one for j before and beyond i.
    """
    column, moving, seed = ca.SX.sym("column", 6), ca.SX.sym("moving", 6), ca.SX.sym("c", 6)
    symbols_of = (Operand(J, "j"), column), (Operand(bar, "j"), seed)
    steps: list[Step] = []
    sums = []
    for outward, side in ((True, "beyond"), (False, "before")):
        rate = kinematics.jacobian_column_derivative(moves, column, moving, moving_is_outward=outward)
        gradient = ca.densify(ca.gradient(ca.dot(rate, seed), moving))
        if gradient.is_zero():
            continue
        y, total = Array(f"y_{side}", J.shape), Array(f"sum_{side}", J.shape)
        operands, body = pruned(symbols_of, gradient)
        comment = f"y_i = gradient of J_bar_i . dJ_i/dq_j with respect to J_j, for the joints j {side} joint i"
        steps.append(Map(comment, Over.JOINTS, Operand(y, "j"), operands, body))
        comment = "sums of y_i over i" + (" <= j" if outward else " > j")
        steps.append(Scan(comment, y, total, beyond=not outward, base=base))
        sums.append(total)
    return steps, sums


def _statements(
    step: StraightLine, variables: tuple[Array, ...], bars: Sequence[tuple[Array, Array]], outputs: tuple[Array, ...]
) -> StraightLine:
    """Return CasADi's reverse mode of a step with respect to ``variables``; ``bars`` pairs outputs with gradients."""
    count = len(step.arguments)

    def expressions(chain: Chain, *values: ca.SX) -> Expressions:
        """Return the gradients as columns, stacked; ``values`` are the step's arguments, then the gradients."""
        arguments, gradients = values[:count], values[count:]
        symbols = [ca.SX.sym(a.name, *extents(a.shape)) for a in step.arguments]
        named = dict(zip((argument.name for argument in step.arguments), symbols, strict=True))
        of_variables = [named[array.name] for array in variables]
        result = column(step.expressions(chain, *symbols).result)  # all outputs, stacked
        sums = {output.name: ca.SX.zeros(output.size) for output in step.outputs}
        for (output, _), gradient in zip(bars, gradients, strict=True):
            sums[output.name] += column(gradient)
        seed = ca.vertcat(*(sums[output.name] for output in step.outputs))
        transposed = True
        product = ca.densify(ca.jtimes(result, ca.vertcat(*map(ca.vec, of_variables)), seed, transposed))
        entries = []
        start = 0
        for symbol in of_variables:
            size = symbol.numel()
            entries.append(column(ca.reshape(product[start : start + size], *symbol.shape)))
            start += size
        # The symbols' entries column by column, as those of the arguments.
        all_symbols, all_arguments = (ca.vertcat(*map(ca.vec, each)) for each in (symbols, arguments))
        return Expressions(ca.densify(ca.substitute(ca.vertcat(*entries), all_symbols, all_arguments)), ())

    heading = "gradients with respect to " + ", ".join(shown(array) for array in variables)
    arguments = (*step.arguments, *(bar for _, bar in bars))
    return StraightLine(outputs, expressions, arguments, heading=heading)


RULES: dict[type[Step], Callable[[Gradients, Any], None]] = {
    Map: _any_map,
    SparseSum: _sparse_sum,
    SumJoints: _sum_joints,
    StraightLine: _any_straight_line,
    Congruence: _any_straight_line,
}
"""Reverse rule per type of step. Types that occur only in reverse programs have no rule."""


@cache
def rules() -> dict[type[Step], Callable[[Gradients, Any], None]]:
    """Return the rules of the core's steps, and those that families have for steps of their own."""
    return RULES | {step: rule for family in families() for step, rule in family.rules.items()}
