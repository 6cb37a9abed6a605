# SPDX-License-Identifier: MIT
"""Pose of the tip, its Jacobian, and the Jacobian's derivative."""

from __future__ import annotations

from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import kinematics, quantities, stiffness
from stiffgen.core.symbolic.arguments import POSE, Argument
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.pieces import columns_of, over_joints, tip_pose
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, SumJoints


def forward_kinematics(chain: Chain) -> Program:
    """Return the program of the tip's pose."""
    pose = POSE.array(chain)
    return (tip_pose(chain, pose),)


def jacobian(chain: Chain, representation: Representation, result: Argument) -> Program:
    """Return the program of Jacobian columns, summed into coordinates."""
    output = result.array(chain)
    if not chain.coupled:
        return (columns_of(chain, representation, output.name)[0],)
    recursion, J = columns_of(chain, representation)
    return recursion, SumJoints(J, output, columns=True)


def jacobian_derivative(chain: Chain, representation: Representation, result: Argument) -> Program:
    """Return the program of dJ^T/dq from brackets of columns, one half of the pairs after the other."""

    def steps(output: Array) -> Program:
        """Return the program: pose recursion, then dJ_j/dq_i in two halves, which differ in formula."""
        recursion, J = columns_of(chain, representation)

        def half(over: Over, side: str, *, outward: bool) -> Map:
            """Return the map over half of the pairs (i, j): joint i moves, ``outward`` of the joint j of the column."""

            def derivative(moving: ca.SX, column: ca.SX) -> ca.SX:
                return kinematics.jacobian_column_derivative(representation, column, moving, moving_is_outward=outward)

            operands = Operand(J, "i"), Operand(J, "j")
            return Map(f"dJ_j/dq_i {side}", over, Operand(output, "ij"), operands, derivative)

        before, beyond = Over.UPPER, Over.STRICTLY_LOWER
        if stiffness.diagonal_is_outward(representation):
            before, beyond = Over.STRICTLY_UPPER, Over.LOWER
        halves = (
            half(before, "for the joints i before joint j", outward=False),
            half(beyond, "for the joints i beyond joint j", outward=True),
        )
        # A floating base moves as one body: each of its joints moves the tip as if it were the joint nearest the base.
        of_base = (half(Over.BASE, str(Over.BASE), outward=False),) if chain.floating else ()
        return recursion, *halves, *of_base

    return over_joints(chain, result, steps)


def pose_kernels(configuration: tuple[Argument, ...], reference: str) -> list[Kernel]:
    """Return the kernels of the tip's pose in the frame that ``reference`` names."""
    summary, equation = f"Pose of the tip in the {reference} frame.", "product of joint poses"
    return [Kernel("forward_kinematics", None, configuration, (POSE,), summary, equation, forward_kinematics)]


_TWIST_FRAME = {
    "body": "velocity of the tip's origin and angular velocity, both in tip axes (Pinocchio: LOCAL)",
    "spatial": "velocity of the point passing the {reference}'s origin and angular velocity, both in {reference} axes "
    "(Pinocchio: WORLD)",
    "hybrid": "velocity of the tip's origin and angular velocity, both in {reference} axes "
    "(Pinocchio: LOCAL_WORLD_ALIGNED)",
}


def jacobian_kernels(rep: Representation, configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of the Jacobian and of its derivative in one representation."""
    columns = Argument.referred(
        "jacobian", (6, "n"), "m, rad per rad or m", f"column i: twist of joint i, {_TWIST_FRAME[rep]}",
        blocks=quantities.TWISTS,
    )  # fmt: skip
    derivative = Argument(
        "jacobian_transpose_derivative", ("n", "n", 6), "per rad or m",
        "block i is dJ^T/dq_i: entry [i, b, k] = dJ[k, b]/dq_i",
    )  # fmt: skip
    return (
        Kernel(
            name="jacobian", group=rep, arguments=configuration, results=(columns,),
            summary=f"Jacobian in {rep} representation.",
            equation="xi = J dq/dt, twist linear first",
            program=partial(jacobian, representation=rep, result=columns),
            batch=True,
        ),
        Kernel(
            name="jacobian_transpose_derivative", group=rep, arguments=configuration, results=(derivative,),
            summary="Derivative of the transposed Jacobian with respect to each joint position.",
            equation="dJ^T/dq, in closed form from Lie brackets",
            program=partial(jacobian_derivative, representation=rep, result=derivative),
        ),
    )  # fmt: skip
