# SPDX-License-Identifier: MIT
"""Positive tangents of springs: matrices that bound a spring's joint stiffness from above, for implicit steps.

A simulator that steps a spring implicitly solves (M + h D + h^2 P) a = torque - h P dq - D dq. The energy cannot grow
if P - Kq/2 stays positive along the step (a majorant: the step minimises an upper bound of the energy). Kq itself is
not positive at large deflections, and neither its positive part nor its absolute value bounds the Kq of the next
configuration. A symmetric matrix A lies between -D and D for the diagonal matrix D of its rows' sums of absolute
values (Gershgorin). Applied to both parts of Kq this gives P without eigenvalues, with -P <= Kq <= P. The rows of K
mix units, so that P depends on the units of length and angle, which are m and rad:

    P = J^T diag(sum_j |K_ij|) J + diag(sum_j |A_ij|),     A = dJ^T/dq . F + J^T (Gamma F) J the part of the load
"""

from __future__ import annotations

from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import pieces
from stiffgen.core.symbolic.arguments import POSE, Argument, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map
from stiffgen.core.symbolic.stiffness import symmetric_from_upper
from stiffgen.families.springs.kernels import spring_step
from stiffgen.families.springs.springs import Spring

WORD = "tangents"
"""Word of --kernels that adds the family."""

_POSITIVE = Argument(
    "positive_tangent", ("n", "n"), "N m/rad", "positive, at least the joint stiffness and its negative; bitwise "
    "symmetric", symmetric=True,
)  # fmt: skip
_LOAD = Argument("load", ("n", "n"), "N m/rad", "", symbol="A")
_TASK = Argument("of_the_task", ("n", "n"), "N m/rad", "", symbol="T")


def _total(task: ca.SX, load: ca.SX) -> ca.SX:
    """Return the symmetric ``task`` plus the diagonal matrix of the sums of absolute values in the rows of ``load``."""
    upper = symmetric_from_upper(load)
    sums = [sum(map(ca.fabs, ca.horzsplit(upper[row, :])), ca.SX(0)) for row in range(upper.shape[0])]
    return symmetric_from_upper(task) + ca.diag(ca.vertcat(*sums))


def positive_tangent(chain: Chain, spring: Spring) -> Program:
    """Return the program of P = T + diag(sum_j |A_ij|), both terms summed into coordinates first.

    T = J^T diag(s) J with the sums s_i = sum_j |K_ij|. A is docs/theory.md (3) without K: the part of the load F = dU.
    """
    pose, J = POSE.array(chain), Array("J", (6, len(chain.joints)))
    F, s = Array("F", (6,)), Array("s", (6,))
    comment = "P = T + diagonal matrix of the sums of absolute values in the rows of A"
    parts = Operand(_TASK.array(chain), ""), Operand(_LOAD.array(chain), "")
    return (
        pieces.columns_and_pose(chain, J, pose),
        spring_step(chain, spring, pose, (F, s), "Fs"),
        *pieces.over_joints(
            chain, _LOAD, lambda A: pieces.load_tangent(chain, J, F, "hybrid", A), mirror=True
        ),
        *pieces.over_joints(chain, _TASK, lambda T: (_weighted_products(J, s, T),), mirror=True),
        Map(comment, Over.ONCE, Operand(_POSITIVE.array(chain), ""), parts, _total),
    )  # fmt: skip


def _weighted_products(J: Array, s: Array, T: Array) -> Map:
    """Return the step T_ij = J_i . (s J_j), a symmetric matrix over pairs of joints."""
    operands = Operand(J, "i"), Operand(J, "j"), Operand(s, "")
    comment = "T_ij = J_i . (s J_j) for i<=j, mirrored"
    return Map(comment, Over.UPPER, Operand(T, "ij"), operands, lambda i, j, s: ca.SX(ca.dot(i, s * j)), mirror=True)


def tangent_kernels(chain: Chain, springs: tuple[Spring, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of a chain, one for each spring and tip."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)
    several = len(chain.tips) > 1
    return tuple(
        Kernel(
            name="positive_tangent",
            group=spring.name,
            arguments=(*configuration, *spring.parameters),
            results=(_POSITIVE,),
            summary="Positive tangent of the spring's torque, for implicit steps.",
            equation="P = J^T diag(sum_j |K_ij|) J + diag(sum_j |A_ij|), A = dJ^T/dq . F + J^T (Gamma F) J with F = dU "
            "and K the covariant Hessian; -P <= d2U/dq2 <= P",
            program=partial(positive_tangent, spring=spring),
            note=spring.domain,
            batch=True,
            is_gradient=True,  # absolute values have corners, and a step's matrix needs no derivative
            on_request=WORD,
            tip=tip if several else None,
        )
        for tip in chain.tips
        for spring in springs
    )
