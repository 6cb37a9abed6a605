# SPDX-License-Identifier: MIT
"""Reverse mode: the vector-Jacobian product of a program, as another program.

A kernel computes results r from arguments x. With a cotangent c for every entry of r, its vector-Jacobian product is
x_bar = (dr/dx)^T c, the gradient of L = sum c r with respect to every argument. It is one additional kernel,
independent of the number of arguments. :func:`reverse` processes the steps of the kernel's program in reverse order. No
derivative is written by hand, and the printers treat the result like any program. With v_bar the gradient of L with
respect to v, the rules are

    Map over joints          t_j = f(x_j, y)             x_bar_j += (df/dx)^T t_bar_j       a Map
                                                         y_bar += sum_j (df/dy)^T t_bar_j   a Reduce
    Map over pairs           t_ij = f(x_i, y_j)          x_bar_i += sum_j (df/dx)^T t_bar_ij, y_bar_j likewise: Gathers
    SparseSum                A = K + B(F)                merged into the maps that read A: sums over K's entries
    SumJoints                t_c = sum_k m_k t_k         t_bar_k = m_k t_bar_c              a SumJoints with spread
    Sum over tips                                        a Sum of the products of the tips
    SymmetricPart            K = (A + A^T)/2             A_bar = (K_bar + K_bar^T)/2, at the end of the pass
    StraightLine             statements                  CasADi's reverse mode of the statements, as a StraightLine
    StraightLine of columns  J(q), pose(q)               q_bar_j = sum_i J_bar_i . dJ_i/dq_j + J_j . f

In the last rule, dJ_i/dq_j is the closed form :func:`kinematics.jacobian_column_derivative`, which is linear in J_j:
q_bar_j = J_j . sum_i y_i, with one y_i for the joints j beyond i and one for the joints j before i. Running sums (Scan)
therefore replace products over pairs. The hybrid column of a joint is the rate of the pose: f is the covector (p_bar,
sum of R_c x R_bar_c over the columns c of R).

On a floating base the first six joints in these sums are the base's; their columns belong to its body twist (v, w). The
base and all columns move as one body, so that dJ_i/dq_j has the form for a joint j before i, for all i. The gradient
with respect to ``base_pose`` is the covector of that twist (6): L changes by base_pose_bar . (v, w) t + O(t^2) as the
base moves to p + R v t, R exp([w] t). Where statements read the pose, the gradient (p_bar, R_bar) with respect to its
entries becomes (R^T p_bar, sum of r_c x (R^T R_bar)_c), where r_c are the columns of the identity.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import pieces
from stiffgen.core.symbolic.program import Array, Operand, Over, Program, Step, as_operand, entries_of
from stiffgen.core.symbolic.steps import ArgumentSlice, Map, Shared, StraightLine, Sum, Term
from stiffgen.core.symbolic.symmetric_part import SymmetricPart, symmetric_entries, with_symmetric_parts
from stiffgen.families.derivatives.gradients import Gradients, bar_name, cotangent_name, extents, gradient_shape
from stiffgen.families.derivatives.rules import rules, turn


def reverse(
    chain: Chain,
    program: Program,
    arguments: Sequence[Array],
    results: Sequence[Array],
    cotangents: Sequence[Array],
) -> Program:
    """Return the program of the vector-Jacobian product of ``program``.

    Args:
        chain: chain of the program.
        program: steps to differentiate.
        arguments: arrays that the program reads. For each of them the returned program writes an array with the
            argument's :func:`gradient_shape` and :func:`bar_name`.
        results: arrays that the program writes.
        cotangents: arrays with the shapes of the results, in the same order.

    Returns:
        Steps that read arguments and cotangents.

    """
    program = tuple(each for step in program for each in _apart(step) if not isinstance(each, SymmetricPart))
    if len(program) == 1 and isinstance(program[0], Sum):
        return (_sum(program[0]),)
    # A single contribution to a result is written directly into the result. Which arrays these are, is known at the end
    # of a run (``final``); the next run gives them these names.
    names: dict[str, str] = {}
    while True:
        run = _Reverse(chain, program, names)
        steps = run.steps_of(arguments, results, cotangents)
        if names == run.final:
            return with_symmetric_parts(steps, arguments)
        names = run.final


class _Reverse(Gradients):
    """Backward pass through a program."""

    def __init__(self, chain: Chain, program: Program, names: dict[str, str]) -> None:
        super().__init__(chain, program, names)
        self.forward = [self._with_columns(step) for step in program]

    def steps_of(self, arguments: Sequence[Array], results: Sequence[Array], cotangents: Sequence[Array]) -> Program:
        """Return the reverse program, preceded by the forward steps that it needs."""
        for result, cotangent in zip(results, cotangents, strict=True):
            self.bars[result.name] = [cotangent]
        for step in reversed(self.forward):
            if any(array.name in self.bars for array in step.writes):
                if type(step) not in rules():
                    raise NotImplementedError(f"{type(step).__name__} has no adjoint")
                rules()[type(step)](self, step)
        for argument in arguments:
            self._finish(argument)
        self._drop_unread({bar_name(argument.name) for argument in arguments})
        return self._needed() + tuple(self.steps)

    def _with_columns(self, step: Step) -> Step:
        """Replace a step that computes the pose by one that also computes the columns, which the derivative needs."""
        if isinstance(step, StraightLine) and step.moves and not step.columns:
            return pieces.columns_and_pose(self.chain, Array("J", (6, len(self.chain.joints))), step.outputs[0])
        return step

    def _drop_unread(self, results: set[str]) -> None:
        """Drop outputs of reverse steps that are neither results nor operands of a later step."""
        renamed = set(self.final.values()) - set(self.final)  # arrays that become results in the next run
        needed = results | renamed
        steps: list[Step] = []
        for step in reversed(self.steps):
            if any(array.name in needed for array in step.writes):
                steps.append(step.without_unread(needed))
                needed |= {array.name for array in step.reads}
        self.steps = steps[::-1]

    def _needed(self) -> Program:
        """Return the forward steps whose outputs the reverse pass reads."""
        needed = {array.name for step in self.steps for array in step.reads}
        steps: list[Step] = []
        for step in reversed(self.forward):
            if any(array.name in needed for array in step.writes):
                steps.append(step.without_unread(needed))
                needed |= {array.name for array in step.reads}
        return tuple(reversed(steps))

    def _finish(self, argument: Array) -> None:
        """Add the step that writes the gradient with respect to an argument of the kernel: the sum of contributions.

        A single contribution needs no step; it gets the result's name in the next run.
        """
        result = Array(bar_name(argument.name), gradient_shape(argument))
        contributions = self.bars.get(argument.name, [])
        if argument.is_base_pose:
            self._finish_base(argument, result)
            return
        motions = self.motions if argument.is_q else []  # of the base's twist and the joints; the joints' part counts
        if len(contributions) == 1 and not motions and not argument.symmetric_part:
            (only,) = contributions
            for name in self.final:
                if self.names.get(name, name) == only.name:
                    self.final[name] = result.name
            return
        operands = tuple(Operand(each, "") for each in (*motions, *contributions))

        def body(*values: ca.SX) -> ca.SX:
            of_motions, others = values[: len(motions)], values[len(motions) :]
            of_joints = [value[self.chain.base_coordinates :] for value in of_motions]
            total = sum((*of_joints, *others), ca.SX.zeros(*extents(argument.shape)))
            if not argument.symmetric_part:
                return total
            return as_operand(argument.shape, symmetric_entries(argument, entries_of(total)))

        self.steps.append(Map(result.name, Over.ONCE, Operand(result, ""), operands, body))

    def _finish_base(self, pose: Array, result: Array) -> None:
        """Add the step that writes the covector of the base's twist, in base link axes."""
        of_entries = self.bars.get(pose.name, [])  # gradients with respect to the pose's entries
        arrays = (*self.motions, pose, *of_entries) if of_entries else tuple(self.motions)
        operands = tuple(Operand(each, "") for each in arrays)

        def body(*values: ca.SX) -> ca.SX:
            of_motions, others = values[: len(self.motions)], values[len(self.motions) :]
            total = sum((value[: self.chain.base_coordinates] for value in of_motions), ca.SX.zeros(6))
            if others:  # the last formula of the module's head
                pose_value, *gradients = others
                in_base_axes = pose_value[:3, :3].T @ sum(gradients, ca.SX.zeros(4, 4))[:3, :]  # R^T [R_bar, p_bar]
                total += ca.vertcat(in_base_axes[:, 3], turn(ca.SX.eye(3), in_base_axes[:, :3]))
            return ca.densify(total)

        self.steps.append(Map(f"{result.name}: in the base's axes", Over.ONCE, Operand(result, ""), operands, body))


def _apart(step: Step) -> Program:
    """Return the steps that reverse mode differentiates in place of a step; the step itself if it names none."""
    return (isinstance(step, (Shared, StraightLine)) and step.apart) or (step,)


def _sum(step: Sum) -> Sum:
    """Return the sum of the products of all tips, each with the whole cotangent.

    Gradients with respect to arguments that all tips share are added up; of an argument with one value per tip, each
    product writes its own slice.
    """
    first = step.terms[0]
    cotangents = [
        Array(cotangent_name(output.name, len(step.outputs)), output.shape) for output in step.outputs
    ]  # fmt: skip
    terms = []
    for term in step.terms:
        arguments = [array for array, _ in term.arguments]
        results = [Array(name, output.shape) for name, output in zip(step.results, step.outputs, strict=True)]
        parameters = [Array(cotangent_name(each.name, len(results)), each.shape) for each in results]
        program = reverse(term.chain, term.program, arguments, results, parameters)
        pairs = zip(parameters, cotangents, strict=True)
        seeds = tuple((parameter, ArgumentSlice(cotangent, None)) for parameter, cotangent in pairs)
        terms.append(Term(f"{term.function}_vjp", term.chain, program, (*term.arguments, *seeds)))
    wholes = [(part.array or array, part.index) for array, part in first.arguments]
    outputs = tuple(Array(bar_name(array.name), gradient_shape(array)) for array, _ in wholes)
    apart = frozenset(output.name for output, (_, index) in zip(outputs, wholes, strict=True) if index is not None)
    return Sum(outputs, tuple(bar_name(array.name) for array, _ in first.arguments), tuple(terms), apart)
