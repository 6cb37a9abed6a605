# SPDX-License-Identifier: MIT
"""Reverse mode: the vector-Jacobian product of a program, as another program.

A kernel computes results r from arguments x. With a cotangent c for every entry of r, its vector-Jacobian product is
x_bar = (dr/dx)^T c, the gradient of L = sum c r with respect to every argument: one more kernel, whatever the number of
arguments. :func:`reverse` goes backwards through the steps of the kernel's program; nothing is differentiated by hand,
and the printers print the result like any program. With v_bar for the gradient of L with respect to v,

    Map over joints          t_j = f(x_j, y)             x_bar_j += (df/dx)^T t_bar_j       a Map
                                                         y_bar += sum_j (df/dy)^T t_bar_j   a Reduce
    Map over pairs           t_ij = f(x_i, y_j)          x_bar_i += sum_j (df/dx)^T t_bar_ij, y_bar_j likewise: Gathers
    SparseSum                A = K + B(F)                goes into the maps that read A: sums of K's entries, not of A's
    SumJoints                t_c = sum_k m_k t_k         t_bar_k = m_k t_bar_c              a SumJoints that spreads
    Sum over tips                                        a Sum of the tips' own products
    StraightLine             statements                  CasADi's reverse mode of the statements, one more step
    StraightLine of columns  J(q), pose(q)               q_bar_j = sum_i J_bar_i . dJ_i/dq_j + J_j . f

For the last line, dJ_i/dq_j is the closed form :func:`kinematics.jacobian_column_derivative`. The form is linear in
J_j: q_bar_j = J_j . sum_i y_i with one y_i for the joints j beyond i and one for the joints before, so that running
sums (Scan) suffice and no product over pairs is left. The pose moves with the hybrid column of a joint: f is the
covector (p_bar, sum of R_c x R_bar_c over the columns c of R).

On a floating base the first six joints of these sums are the base's, columns of its body twist (v, w). The base moves
as one, and every column with it, so that dJ_i/dq_j is for all i what it is for a j before i. The gradient with respect
to ``base_pose`` is the covector of that twist, six numbers: L changes by base_pose_bar . (v, w) t + O(t^2) as the base
moves to p + R v t, R exp([w] t). Where statements read the pose, the gradient (p_bar, R_bar) of its entries becomes
(R^T p_bar, sum of r_c x (R^T R_bar)_c), r_c the columns of the identity.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic import programs
from stiffgen.symbolic.adjoint_steps import RULES, turn
from stiffgen.symbolic.arguments import BASE_POSE, Q
from stiffgen.symbolic.gradients import Gradients, bar_name, cotangent_name, extents, gradient_shape
from stiffgen.symbolic.program import Array, Operand, Over, Program, Step
from stiffgen.symbolic.steps import ArgumentSlice, Map, StraightLine, Sum, Term


def reverse(
    chain: Chain,
    program: Program,
    arguments: Sequence[Array],
    results: Sequence[Array],
    cotangents: Sequence[Array],
) -> Program:
    """Return the program of the vector-Jacobian product of ``program``.

    Args:
        chain: the robot that the program was made for.
        program: steps to differentiate.
        arguments: arrays that the program reads. For each the returned program writes an array of its
            :func:`gradient_shape` under its :func:`bar_name`.
        results: arrays that the program writes.
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


class _Reverse(Gradients):
    """One pass backwards through a program."""

    def __init__(self, chain: Chain, program: Program, names: dict[str, str]) -> None:
        super().__init__(chain, program, names)
        self.forward = [self._with_columns(step) for step in program]

    def steps_of(self, arguments: Sequence[Array], results: Sequence[Array], cotangents: Sequence[Array]) -> Program:
        """Return the reverse program, preceded by the forward steps whose values it reads."""
        for result, cotangent in zip(results, cotangents, strict=True):
            self.bars[result.name] = [cotangent]
        for step in reversed(self.forward):
            if any(array.name in self.bars for array in step.writes):
                if type(step) not in RULES:
                    raise NotImplementedError(f"{type(step).__name__} has no adjoint")
                RULES[type(step)](self, step)
        for argument in arguments:
            self._finish(argument)
        self._drop_unread({bar_name(argument.name) for argument in arguments})
        return self._needed() + tuple(self.steps)

    def _with_columns(self, step: Step) -> Step:
        """Compute the pose together with the columns: the pose alone does not give its derivative."""
        if isinstance(step, StraightLine) and step.moves and not step.columns:
            return programs.columns_and_pose(self.chain, Array("J", (6, len(self.chain.joints))), step.outputs[0])
        return step

    def _drop_unread(self, results: set[str]) -> None:
        """Drop reverse steps that write neither a result nor what a later step reads."""
        results = results | (set(self.final.values()) - set(self.final))
        kept: list[Step] = []
        needed: set[str] = set()
        for step in reversed(self.steps):
            written = {array.name for array in step.writes}
            if written & (results | needed):
                kept.append(step)
                needed |= {array.name for array in step.reads}
        self.steps = kept[::-1]

    def _needed(self) -> Program:
        """Return the steps whose values the reverse pass reads."""
        needed = {array.name for step in self.steps for array in step.reads}
        kept: list[Step] = []
        for step in reversed(self.forward):
            if any(array.name in needed for array in step.writes):
                kept.append(step.without_unread(needed))
                needed |= {array.name for array in step.reads}
        return tuple(reversed(kept))

    def _finish(self, argument: Array) -> None:
        """Write the gradient with respect to an argument of the kernel."""
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
            return sum((*joints, *values[len(motions) :]), ca.SX.zeros(*extents(argument.shape)))

        self.steps.append(Map(result.name, Over.ONCE, Operand(result, ""), operands, body))

    def _finish_base(self, pose: Array, result: Array) -> None:
        """Return the covector of the base's twist in its own axes, from motions and gradients of the pose."""
        entries = self.bars.get(pose.name, [])
        operands = tuple(Operand(each, "") for each in (*self.motions, *((pose, *entries) if entries else ())))

        def body(*values: ca.SX) -> ca.SX:
            total = sum((value[: self.chain.base_joints] for value in values[: len(self.motions)]), ca.SX.zeros(6))
            if entries:
                place, *gradients = values[len(self.motions) :]
                bar = place[:3, :3].T @ sum(gradients, ca.SX.zeros(4, 4))[:3, :]
                total += ca.vertcat(bar[:, 3], turn(ca.SX.eye(3), bar[:, :3]))
            return ca.densify(total)

        self.steps.append(Map(f"{result.name}: in the base's axes", Over.ONCE, Operand(result, ""), operands, body))

    def _is(self, name: str, array: Array) -> bool:
        return self.names.get(name, name) == array.name


def _sum(step: Sum) -> Sum:
    """Return the sum over tips of the tips' products, each with the whole cotangent."""
    first = step.terms[0]
    cotangents = [
        Array(cotangent_name(output.name, len(step.outputs)), output.shape) for output in step.outputs
    ]  # fmt: skip
    terms = []
    for term in step.terms:
        arguments = [array for array, _ in term.arguments]
        results = [Array(name, output.shape) for name, output in zip(step.results, step.outputs, strict=True)]
        inner = [Array(cotangent_name(each.name, len(results)), each.shape) for each in results]
        program = reverse(term.chain, term.program, arguments, results, inner)
        seeds = tuple((array, ArgumentSlice(outer, None)) for array, outer in zip(inner, cotangents, strict=True))
        terms.append(Term(f"{term.function}_vjp", term.chain, program, (*term.arguments, *seeds)))
    wholes = [(part.array or array, part.index) for array, part in first.arguments]
    outputs = tuple(Array(bar_name(array.name), gradient_shape(array)) for array, _ in wholes)
    apart = frozenset(output.name for output, (_, index) in zip(outputs, wholes, strict=True) if index is not None)
    return Sum(outputs, tuple(bar_name(array.name) for array, _ in first.arguments), tuple(terms), apart)
