# SPDX-License-Identifier: MIT
"""Reverse mode: the vector-Jacobian product of a program, as another program.

A kernel computes results r from arguments x. With a cotangent c for every entry of r, its vector-Jacobian product is
x_bar = (dr/dx)^T c, the gradient of L = sum c r by every argument: one more kernel, whatever the number of arguments.
It is made by going backwards through the steps of the kernel's program (:func:`reverse`); nothing is differentiated by
hand, and the printers print what they print of any program. With v_bar for the gradient of L by v,

    Map over joints          t_j = f(x_j, y)             x_bar_j += (df/dx)^T t_bar_j       a Map
                                                         y_bar += sum_j (df/dy)^T t_bar_j   a Reduce
    Map over pairs           t_ij = f(x_i, y_j)          x_bar_i += sum_j (df/dx)^T t_bar_ij, y_bar_j likewise: Gathers
    SparseSum                A = K + B(F)                goes into the maps that read A: sums of K's entries, not of A's
    SumJoints                t_c = sum_k m_k t_k         t_bar_k = m_k t_bar_c              a Spread
    Sum over tips                                        a Sum of the tips' own products
    StraightLine             statements                  CasADi's reverse mode of the statements, one more step
    StraightLine of columns  J(q), pose(q)               q_bar_j = sum_i J_bar_i . dJ_i/dq_j + J_j . f

For the last, dJ_i/dq_j is the table's own closed form (:func:`kinematics.jacobian_column_derivative`). It is linear in
J_j: q_bar_j = J_j . sum_i y_i with one y_i for the joints j beyond i and one for those before, so that running sums
(Scan) do, and no product over pairs is left. The pose moves with the hybrid column of a joint: f is the covector
(p_bar, sum of R_c x R_bar_c over the columns c of R).

On a floating base the first six joints of these sums are the base's own, columns of its body twist (v, w). It moves as
one, and every column with it, so that dJ_i/dq_j is for all i what it is for a j before i. The gradient by ``base_pose``
is the covector of that twist, six numbers: L changes by base_pose_bar . (v, w) t + O(t^2) as the base moves to
p + R v t, R exp([w] t). Where statements read the pose, its entries' gradient (p_bar, R_bar) is turned into
(R^T p_bar, sum of r_c x (R^T R_bar)_c), r_c the columns of the identity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic import kinematics, programs
from stiffgen.symbolic.arguments import BASE_POSE, Q
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.kinematics import Expressions
from stiffgen.symbolic.program import (
    ArgumentSlice,
    Array,
    Gather,
    Map,
    Operand,
    Over,
    Program,
    Reduce,
    Scan,
    Shared,
    SparseSum,
    Spread,
    Step,
    StraightLine,
    Sum,
    SumJoints,
    Term,
    Weights,
    operand_shape,
    pruned,
    reads,
    writes,
)

_FLIPPED: dict[Over, Over] = {
    "i<=j": "i>=j", "i>=j": "i<=j", "i<j": "i>j", "i>j": "i<j", "i on the way to j": "all",
    programs.BASE: programs.BASE,
}  # fmt: skip


def cotangent_name(result: str, count: int) -> str:
    """Name of the cotangent of a result, of a function with so many results."""
    return "cotangent" if count == 1 else f"{result}_cotangent"


def bar_name(argument: str) -> str:
    """Name of the gradient by an argument."""
    return f"{argument}_bar"


def gradient_shape(argument: Array) -> tuple[int, ...]:
    """Shape of the gradient by an argument: its own, but of a floating base's pose that of a twist."""
    return (6,) if argument.name == BASE_POSE.name else argument.shape


def reverse(
    chain: Chain,
    program: Program,
    arguments: Sequence[Array],
    results: Sequence[Array],
    cotangents: Sequence[Array],
) -> Program:
    """The program of the vector-Jacobian product of ``program``.

    Args:
        chain: the robot that the program was made for.
        program: what is differentiated.
        arguments: what it takes; for each the result writes an array of its :func:`gradient_shape` under its
            :func:`bar_name`.
        results: what it writes.
        cotangents: arrays of the shapes of the results, in their order.

    Returns:
        Steps that read arguments and cotangents.

    """
    if len(program) == 1 and isinstance(program[0], Sum):
        return (_sum(program[0]),)
    names: dict[str, str] = {}
    while True:
        run = _Reverse(chain, program, names)
        steps = run.steps_of(arguments, results, cotangents)
        if names == run.final:
            return steps
        names = run.final  # the only contribution to a result is written where the result belongs


class _Reverse:
    """One way back through a program. ``bars``: for each array the arrays whose sum is the gradient by it."""

    def __init__(self, chain: Chain, program: Program, names: dict[str, str]) -> None:
        self.chain = chain
        self.forward = [self._with_columns(step) for step in program]
        self.written = {array.name for step in program for array in writes(step)}
        self.names = names
        self.final: dict[str, str] = {}
        self.bars: dict[str, list[Array]] = {}
        self.steps: list[Step] = []
        self.count = 0
        self.zeros: dict[str, set[int]] = {}  # entries of columns of joints that are always zero
        for step in program:
            if isinstance(step, Map) and step.over == "j":
                self.zeros[step.output.array.name] = _zeros(step, self.zeros)
        self.sparse = {step.output.name: step for step in program if isinstance(step, SparseSum)}
        self.mirrored = {step.output.array.name for step in program if isinstance(step, Map) and step.mirror}
        self.of_base: set[str] = set()  # whose pairs of the base's joints a later map has overwritten
        self.motions: list[Array] = []  # covectors of a floating base's twist and the joints' rates

    def steps_of(self, arguments: Sequence[Array], results: Sequence[Array], cotangents: Sequence[Array]) -> Program:
        for result, cotangent in zip(results, cotangents, strict=True):
            self.bars[result.name] = [cotangent]
        for step in reversed(self.forward):
            if any(array.name in self.bars for array in writes(step)):
                self._step(step)
        for argument in arguments:
            self._finish(argument)
        self._drop_unread()
        return self._needed() + tuple(self.steps)

    def _with_columns(self, step: Step) -> Step:
        """The pose alone says nothing of its change: it is computed together with the columns."""
        if isinstance(step, StraightLine) and step.moves and not step.columns:
            return programs.columns_and_pose(self.chain, Array("J", (6, len(self.chain.joints))), step.outputs[0])
        return step

    def _drop_unread(self) -> None:
        """Leave out what nothing reads on the way back."""
        results = set(self.final.values()) - set(self.final)
        kept: list[Step] = []
        needed: set[str] = set()
        for step in reversed(self.steps):
            written = {array.name for array in writes(step)}
            is_result = any(name.endswith("_bar") for name in written) or written & results
            if is_result or written & needed:
                kept.append(step)
                needed |= {array.name for array in reads(step)}
        self.steps = kept[::-1]

    def _needed(self) -> Program:
        """The steps of the program whose values are read on the way back."""
        needed = {array.name for step in self.steps for array in reads(step)}
        kept: list[Step] = []
        for step in reversed(self.forward):
            if any(array.name in needed for array in writes(step)):
                kept.append(_trimmed(step, needed))
                needed |= {array.name for array in reads(step)}
        return tuple(reversed(kept))

    def _new(self, of: Array) -> Array:
        """A further contribution to the gradient by an array."""
        self.count += 1
        name = f"bar{self.count}_{of.name}"
        array = Array(self.names.get(name, name), of.shape)
        self.bars.setdefault(of.name, []).append(array)
        self.final[name] = name
        return array

    def _finish(self, argument: Array) -> None:
        """Write the gradient by an argument of the kernel."""
        result = Array(bar_name(argument.name), gradient_shape(argument))
        contributions = self.bars.get(argument.name, [])
        if argument.name == BASE_POSE.name:
            self._finish_base(argument, result)
            return
        motions = self.motions if argument.name == Q.name else []
        if len(contributions) == 1 and not motions:
            (only,) = contributions
            self.final = {name: result.name if self._is(name, only) else final for name, final in self.final.items()}
            return
        operands = tuple(Operand(each, "") for each in (*motions, *contributions))

        def body(*values: ca.SX) -> ca.SX:
            joints = [value[self.chain.base_joints :] for value in values[: len(motions)]]
            return sum((*joints, *values[len(motions) :]), ca.SX.zeros(*_extents(argument.shape)))

        self.steps.append(Map(f"{result.name}", "", Operand(result, ""), operands, body))

    def _finish_base(self, pose: Array, result: Array) -> None:
        """The covector of the base's twist in its own axes, of motions and of gradients by the pose's entries."""
        entries = self.bars.get(pose.name, [])
        given = [Operand(each, "") for each in (*self.motions, *((pose, *entries) if entries else ()))]

        def body(*values: ca.SX) -> ca.SX:
            total = sum((value[: self.chain.base_joints] for value in values[: len(self.motions)]), ca.SX.zeros(6))
            if entries:
                place, *gradients = values[len(self.motions) :]
                bar = place[:3, :3].T @ sum(gradients, ca.SX.zeros(4, 4))[:3, :]
                total += ca.vertcat(bar[:, 3], _turn(ca.SX.eye(3), bar[:, :3]))
            return ca.densify(total)

        self.steps.append(Map(f"{result.name}: in the base's axes", "", Operand(result, ""), tuple(given), body))

    def _is(self, name: str, array: Array) -> bool:
        return self.names.get(name, name) == array.name

    def _step(self, step: Step) -> None:
        if isinstance(step, Map):
            if step.over in ("", "j", "coordinate"):
                self._map(step)
            else:
                self._pairs(step)
        elif isinstance(step, SparseSum):
            self._sparse_sum(step)
        elif isinstance(step, SumJoints):
            output = self._new(step.source)
            self.steps.append(Spread(self._only(step.output), output, step.columns))
        elif isinstance(step, StraightLine):
            if step.moves:
                self._moving(step)
            else:
                self._block(step, step.arguments)
        else:
            raise NotImplementedError(f"{type(step).__name__} has no adjoint")

    def _only(self, array: Array) -> Array:
        (bar,) = self.bars[array.name]
        return bar

    def _sparse_sum(self, step: SparseSum) -> None:
        """As a map; a start that is symmetric anyway gets what the sum gets, both triangles."""
        if step.start is None or step.start.name not in self.mirrored:
            self._map(step.whole())
            return
        self.bars.setdefault(step.start.name, []).extend(self.bars[step.output.name])
        operands = tuple(Operand(each, "") for each in step.operands)
        self._map(Map(step.comment, "", Operand(step.output, ""), operands, step.expression))

    def _map(self, step: Map) -> None:
        """Over joints, or once: a map for each operand of a joint, one sum over the joints for all others."""
        bars = tuple(Operand(bar, step.output.at) for bar in self.bars[step.output.array.name])
        whole: dict[str, tuple[Array, ca.SX]] = {}
        values = self._values(step)
        seeds = [_symbols(operand, f"c{k}_") for k, operand in enumerate(bars)]
        given = tuple(zip((*step.operands, *bars), (*values, *seeds), strict=True))
        seed = sum((_column(each) for each in seeds), ca.SX(0))
        loss = ca.dot(_column(step.expression(*self._known(step, values))), seed)
        for operand, value in zip(step.operands, values, strict=True):
            gradient = ca.densify(ca.gradient(loss, value))
            if gradient.is_zero():
                continue
            if operand.at == "j" or not step.over:
                alike = len(bars) == 1 and bars[0].array.shape == operand.array.shape
                alone = alike and operand.array.name in self.written and gradient.numel() == seed.numel()
                if alone and ca.is_equal(_column(gradient), seed, 1):
                    self.bars.setdefault(operand.array.name, []).append(bars[0].array)  # handed on as it is
                    continue
                self._append_map(step, operand, gradient, given)
                continue
            for array, part in self._through_sums(operand.array, gradient):
                before = whole.get(array.name, (array, ca.SX.zeros(array.size)))[1]
                whole[array.name] = array, before + part
        if whole:
            sums = tuple(self._new(array) for array, _ in whole.values())
            operands, body = pruned(given, ca.vertcat(*(part for _, part in whole.values())))
            comment = ", ".join(f"gradient by {_shown(array)}" for array, _ in whole.values())
            of = "coordinates" if step.over == "coordinate" else "joints"
            self.steps.append(Reduce(f"sums over the {of}: {comment}", sums, operands, body, step.over))

    def _append_map(
        self, step: Map, operand: Operand, gradient: ca.SX, given: tuple[tuple[Operand, ca.SX], ...]
    ) -> None:
        comment = f"gradient by {_shown(operand.array)}, through {_shown(step.output.array)}"
        total = _column(gradient)
        if operand.at == "j" and operand.array.name in self.written and operand.array.name in self.bars:
            # What other steps hand back is added here: one array, not one each.
            others = [Operand(each, "j") for each in self.bars.pop(operand.array.name)]
            seeds = [_symbols(each, f"b{k}_") for k, each in enumerate(others)]
            given = (*given, *zip(others, seeds, strict=True))
            total = sum(seeds, total)
            comment += ", and what others hand back"
        operands, body = pruned(given, total)
        output = Operand(self._new(operand.array), operand.at)
        self.steps.append(Map(comment, step.over, output, operands, body))

    def _through_sums(self, array: Array, gradient: ca.SX) -> list[tuple[Array, ca.SX]]:
        """Gradients (columns) by what a sparse sum reads, or by the array itself if it is no sparse sum's."""
        step = self.sparse.get(array.name)
        if step is None:
            return [(array, _column(gradient))]
        symbols = [ca.SX.sym(each.name, *_extents(each.shape)) for each in step.reads]
        loss = ca.dot(_column(step.whole().expression(*symbols)), _column(gradient))
        parts = []
        for each, symbol in zip(step.reads, symbols, strict=True):
            parts.append((each, _column(ca.densify(ca.gradient(loss, symbol)))))
        return parts

    def _pairs(self, step: Map) -> None:
        """Over pairs: for either joint the sum over the other one, weighted with what the pair hands back."""
        if not step.operands:
            return
        bar = self._only(step.output.array)
        but_of_base = step.output.array.name in self.of_base
        if step.over == programs.BASE:
            self.of_base.add(step.output.array.name)
        m = len(self.chain.joints)
        shape = (m, m, *step.output.array.shape[2:])
        weights, transposed = (self._local(name, shape) for name in ("W", "WT"))
        self.steps.append(Weights(bar, weights, transposed, step.over, step.mirror, but_of_base))
        values = self._values(step)
        pair = Operand(weights, "ij")
        seed = _symbols(pair, "c_")
        loss = ca.dot(_column(step.expression(*self._known(step, values))), _column(seed))
        for operand, value in zip(step.operands, values, strict=True):
            if operand.at not in ("i", "j"):
                raise NotImplementedError("a map over pairs has operands of its joints only")
            flip = operand.at == "i"
            all_operands = [_flipped(each) if flip else each for each in step.operands]
            weighted = Operand(transposed if flip else weights, "ij")
            given = tuple(zip((*all_operands, weighted), (*values, seed), strict=True))
            gradient = ca.densify(ca.gradient(loss, value))
            if gradient.is_zero():
                continue
            operands, body = pruned(given, gradient)
            over = _FLIPPED[step.over] if flip else step.over
            summed = "j" if flip else "i"
            comment = f"gradient by {_shown(operand.array)}_{operand.at}: sum over the joints {summed} of its pairs"
            self.steps.append(Gather(comment, over, self._new(operand.array), operands, body, but_of_base))

    def _values(self, step: Map) -> list[ca.SX]:
        return [_symbols(operand, f"x{k}_") for k, operand in enumerate(step.operands)]

    def _known(self, step: Map, values: list[ca.SX]) -> list[ca.SX]:
        """The same with zeros where an operand is always zero: nothing flows through these."""
        return [_cleared(value, self.zeros.get(o.array.name)) for o, value in zip(step.operands, values, strict=True)]

    def _local(self, name: str, shape: tuple[int, ...]) -> Array:
        self.count += 1
        return Array(f"{name}{self.count}", shape)

    def _block(self, step: StraightLine, by: tuple[Array, ...]) -> None:
        """CasADi's reverse mode of the statements; that of columns which several kernels share is shared, too."""
        outputs = tuple(self._new(array) for array in by)
        bars = [(output, bar) for output in step.outputs for bar in self.bars.get(output.name, ())]
        shared = not step.moves and step.name and {output for output, _ in bars} == set(step.outputs[: step.columns])
        if not shared:
            self.steps.append(_statements(step, by, bars, outputs))
            return
        (columns,), (result,) = step.outputs[: step.columns], outputs
        bar, q_bar = Array(bar_name(columns.name), columns.shape), Array(bar_name(Q.name), result.shape)
        meaning = f"Gradient by q of what depends on the columns {_shown(columns)}, {bar.name} its gradient by them"
        steps = (_statements(step, by, [(columns, bar)], (q_bar,)),)
        given = (*step.arguments, self._one(columns))
        arguments = (*step.arguments, bar)
        self.steps.append(Shared(f"{step.name}_vjp", meaning, arguments, q_bar, steps, given, result))

    def _one(self, columns: Array) -> Array:
        """The gradient by columns of joints as one array of such columns."""
        bars = self.bars[columns.name]
        made = {array.name for step in self.steps if isinstance(step, (Map, Gather)) for array in writes(step)}
        if len(bars) == 1 and bars[0].name in made:
            return bars[0]
        total = self._local(bar_name(columns.name), columns.shape)
        operands = tuple(Operand(bar, "j") for bar in bars)
        comment = f"gradient by {_shown(columns)}"
        self.steps.append(Map(comment, "j", Operand(total, "j"), operands, lambda *values: sum(values, ca.SX(0))))
        return total

    def _moving(self, step: StraightLine) -> None:
        """Columns and pose: closed forms of their derivatives by q; a tool's pose by the statements."""
        assert step.moves is not None
        others = tuple(each for each in step.arguments if each.name not in (BASE_POSE.name, Q.name))
        J, m = step.outputs[0], len(self.chain.joints)
        covectors = [self._covector(pose) for pose in step.outputs[1:] if pose.name in self.bars]
        if self.chain.floating:
            output = self._local("motion_bar", (self.chain.dof,))
            self.motions.append(output)
        else:
            (q,) = (each for each in step.arguments if each.name == Q.name)
            output = self._new(q)
        of_joints = self._local("q_bar_of_joints", (m,)) if self.chain.coupled else output
        if J.name in self.bars:
            self._columns(step.moves, J, covectors, of_joints)
        else:
            operands = tuple(Operand(each, "") for each in covectors)
            self.steps.append(_dots(J, operands, of_joints, based=self.chain.floating))
        if self.chain.coupled:
            self.steps.append(SumJoints(of_joints, output))
        if others:
            self._block(step, others)

    def _columns(self, moves: Representation, J: Array, covectors: list[Array], output: Array) -> None:
        """What depends on columns, and on the pose where there is a covector: the same steps in every kernel."""
        columns, bar = Array("J", J.shape), Array("J_bar", J.shape)
        forces = tuple(Array(f"f{k}", each.shape) for k, each in enumerate(covectors))
        q_bar = Array(bar_name(Q.name), output.shape)
        steps, sums = _column_sums(moves, columns, bar, self.chain.base_joints)
        operands = (*(Operand(each, "j") for each in sums), *(Operand(each, "") for each in forces))
        steps.append(_dots(columns, operands, q_bar, based=self.chain.floating))
        name = f"{moves}_columns_{'and_pose_' if forces else ''}vjp"
        meaning = "Gradient by q of what depends on Jacobian columns J, J_bar its gradient by them" + (
            ", and on the pose, f0 the covector of its gradient by that" if forces else ""
        ) + f"; {moves} representation"  # fmt: skip
        arguments = (columns, bar, *forces)
        given = (J, self._one(J), *covectors)
        self.steps.append(Shared(name, meaning, arguments, q_bar, tuple(steps), given, output))

    def _covector(self, pose: Array) -> Array:
        """(p_bar, sum of R_c x R_bar_c): the hybrid wrench of the pose's gradient."""
        bars = self.bars[pose.name]
        covector = self._local("f", (6,))
        operands = (Operand(pose, ""), *(Operand(bar, "") for bar in bars))

        def body(value: ca.SX, *gradients: ca.SX) -> ca.SX:
            bar = sum(gradients, ca.SX.zeros(4, 4))
            return ca.densify(ca.vertcat(bar[:3, 3], _turn(value[:3, :3], bar[:3, :3])))

        self.steps.append(Map("covector of the pose's gradient", "", Operand(covector, ""), operands, body))
        return covector


def _turn(rotation: ca.SX, gradient: ca.SX) -> ca.SX:
    """Gradient by a small turn w of a rotation R, R + [w] R, from that by its entries."""
    return sum((ca.cross(rotation[:, c], gradient[:, c]) for c in range(3)), ca.SX.zeros(3))


def _dots(J: Array, covectors: tuple[Operand, ...], output: Array, *, based: bool) -> Map:
    """The rates that covectors have along the columns."""

    def dot(column: ca.SX, *values: ca.SX) -> ca.SX:
        return ca.SX(ca.dot(column, sum(values, ca.SX(0))))

    comment = "gradient by q: q_bar_j = J_j . sums" + ("; the base's twist first" if based else "")
    return Map(comment, "j", Operand(output, "j"), (Operand(J, "j"), *covectors), dot)


def _column_sums(moves: Representation, J: Array, bar: Array, base: int) -> tuple[list[Step], list[Array]]:
    """For every joint j the sums of y_i, dJ_i/dq_j . J_bar_i = J_j . y_i: the steps, and the arrays of sums."""
    column, by, seed = ca.SX.sym("column", 6), ca.SX.sym("by", 6), ca.SX.sym("c", 6)
    given = (Operand(J, "j"), column), (Operand(bar, "j"), seed)
    steps: list[Step] = []
    sums = []
    for outward, side in ((True, "beyond"), (False, "before")):
        rate = kinematics.jacobian_column_derivative(moves, column, by, by_is_outward=outward)
        gradient = ca.densify(ca.gradient(ca.dot(rate, seed), by))
        if gradient.is_zero():
            continue
        y, total = Array(f"y_{side}", J.shape), Array(f"sum_{side}", J.shape)
        operands, body = pruned(given, gradient)
        comment = f"y_i = gradient of J_bar_i . dJ_i/dq_j by J_j, for the joints j {side} joint i"
        steps.append(Map(comment, "j", Operand(y, "j"), operands, body))
        comment = "sums of y_i over i" + (" <= j" if outward else " > j")
        steps.append(Scan(comment, y, total, beyond=not outward, base=base))
        sums.append(total)
    return steps, sums


def _statements(
    step: StraightLine, by: tuple[Array, ...], bars: Sequence[tuple[Array, Array]], outputs: tuple[Array, ...]
) -> StraightLine:
    """CasADi's reverse mode of a block's statements: gradients by some arguments; ``bars``: outputs and their own."""
    differentiated = [argument in by for argument in step.arguments]
    given = len(step.arguments)

    def expressions(chain: Chain, *values: ca.SX) -> Expressions:
        symbols = [ca.SX.sym(a.name, *_extents(a.shape)) for a in step.arguments]
        forward = step.expressions(chain, *symbols)
        sums = {output.name: ca.SX.zeros(output.size) for output in step.outputs}
        for (output, _), value in zip(bars, values[given:], strict=True):
            sums[output.name] += _column(value)
        seed = ca.vertcat(*(sums[output.name] for output in step.outputs))
        of = ca.vertcat(*(ca.vec(s) for s, wanted in zip(symbols, differentiated, strict=True) if wanted))
        gradient = ca.densify(ca.jtimes(_column(forward.result), of, seed, True))
        entries = []
        start = 0
        for symbol, wanted in zip(symbols, differentiated, strict=True):
            if wanted:
                size = symbol.numel()
                entries.append(_column(ca.reshape(gradient[start : start + size], *symbol.shape)))
                start += size
        place = ca.vertcat(*map(ca.vec, symbols))
        at = ca.vertcat(*map(ca.vec, values[:given]))
        return Expressions(ca.densify(ca.substitute(ca.vertcat(*entries), place, at)), ())

    heading = "gradients by " + ", ".join(_shown(array) for array in by)
    arguments = (*step.arguments, *(bar for _, bar in bars))
    return StraightLine(outputs, expressions, arguments, heading=heading)


def _sum(step: Sum) -> Sum:
    """Of a sum over tips: each tip's own product, with the whole cotangent."""
    first = step.terms[0]
    cotangents = [
        Array(cotangent_name(output.name, len(step.outputs)), output.shape) for output in step.outputs
    ]  # fmt: skip
    terms = []
    for term in step.terms:
        own = [array for array, _ in term.arguments]
        results = [Array(name, output.shape) for name, output in zip(step.results, step.outputs, strict=True)]
        inner = [Array(cotangent_name(each.name, len(results)), each.shape) for each in results]
        program = reverse(term.chain, term.program, own, results, inner)
        given = tuple((array, ArgumentSlice(outer, None)) for array, outer in zip(inner, cotangents, strict=True))
        terms.append(Term(f"{term.function}_vjp", term.chain, program, (*term.arguments, *given)))
    given_whole = [(part.array or array, part.index) for array, part in first.arguments]
    outputs = tuple(Array(bar_name(array.name), gradient_shape(array)) for array, _ in given_whole)
    apart = frozenset(output.name for output, (_, index) in zip(outputs, given_whole, strict=True) if index is not None)
    return Sum(outputs, tuple(bar_name(array.name) for array, _ in first.arguments), tuple(terms), apart)


def _trimmed(step: Step, needed: set[str]) -> Step:
    """A step without the outputs of its statements that nothing reads; blocks with a name are shared as they are."""
    if not isinstance(step, StraightLine) or step.name or all(output.name in needed for output in step.outputs):
        return step
    kept: list[Array] = []
    rows: list[int] = []
    start = 0
    for output in step.outputs:
        if output.name in needed:
            kept.append(output)
            rows += range(start, start + output.size)
        start += output.size

    def expressions(chain: Chain, *values: ca.SX) -> Expressions:
        whole = step.expressions(chain, *values)
        return Expressions(_column(whole.result)[rows], whole.sections)

    columns = sum(output in kept for output in step.outputs[: step.columns])
    return replace(step, outputs=tuple(kept), expressions=expressions, columns=columns)


def _zeros(step: Map, before: dict[str, set[int]]) -> set[int]:
    """Entries of a map's output that are zero whatever it reads."""
    values = [
        _cleared(_symbols(operand, f"x{k}_"), before.get(operand.array.name) if operand.at else None)
        for k, operand in enumerate(step.operands)
    ]
    result = _column(step.expression(*values))
    return {k for k in range(result.numel()) if result[k].is_zero()}


def _cleared(value: ca.SX, zeros: set[int] | None) -> ca.SX:
    if not zeros:
        return value
    return ca.vertcat(*(ca.SX(0) if k in zeros else value[k] for k in range(value.numel())))


def _flipped(operand: Operand) -> Operand:
    return Operand(operand.array, "i" if operand.at == "j" else "j")


def _shown(array: Array) -> str:
    """An array in comments."""
    return array.symbol or array.name


def _extents(shape: tuple[int, ...]) -> tuple[int, ...]:
    """A shape as CasADi takes it."""
    return shape if len(shape) == 2 else (_size(shape),)


def _size(shape: tuple[int, ...]) -> int:
    return Array("", shape).size


def _symbols(operand: Operand, name: str) -> ca.SX:
    return ca.SX.sym(name, *_extents(operand_shape(operand)))


def _column(value: ca.SX) -> ca.SX:
    """Entries row by row, below each other."""
    return ca.vec(ca.densify(value).T)
