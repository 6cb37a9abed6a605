# SPDX-License-Identifier: MIT
"""Gradient of the joint stiffness along a direction, in reverse mode."""

from __future__ import annotations

from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments, quantities
from stiffgen.core.symbolic.arguments import BASE_POSE, Argument, Q
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Array, Operand, Over, Program, Step
from stiffgen.core.symbolic.steps import Map, SumJoints
from stiffgen.core.symbolic.stiffness_kernels import joint_stiffness
from stiffgen.families.derivatives import adjoint
from stiffgen.families.derivatives.gradients import bar_name, gradient_shape


def stiffness_direction_gradient(
    chain: Chain,
    representation: Representation,
    result: Argument,
    wrench: Argument,
    task_stiffness: Argument,
    direction: Argument,
) -> Program:
    """Return the program of the gradient; on a floating base, its first six entries belong to the base's twist.

    The gradient of v^T Kq v is the vector-Jacobian product of Kq with the cotangent v v^T. Where joints mimic, the
    stiffness of the joints is differentiated in place of its sum, and v is spread over the joints.
    """
    m, v = len(chain.joints), direction.array(chain)
    stiffness = Argument("Kq", ("n", "n"), "", "", symmetric=True)
    forward = joint_stiffness(chain, representation, stiffness, wrench, task_stiffness)
    Kq, steps = stiffness.array(chain), list[Step]()
    if chain.coupled:
        sum_joints, v_of_joints = forward[-1], Array("v_of_joints", (m,))
        assert isinstance(sum_joints, SumJoints)
        forward, Kq = forward[:-1], sum_joints.source
        steps, v = [SumJoints(v, v_of_joints, spread=True)], v_of_joints
    cotangent = Array("vv", Kq.shape)
    operands = Operand(v, "i"), Operand(v, "j")
    comment = "cotangent v_i v_j for i<=j, mirrored"
    steps.append(Map(comment, Over.UPPER, Operand(cotangent, "ij"), operands, lambda a, b: a * b, mirror=True))
    # d(v^T Kq v)/dq, step by step backwards through the program of Kq
    variables = [argument.array(chain) for argument in (*((BASE_POSE,) if chain.floating else ()), Q)]
    product = adjoint.reverse(chain, forward, variables, [Kq], [cotangent])
    gradients = tuple(Operand(Array(bar_name(each.name), gradient_shape(each)), "") for each in variables)
    output = Operand(result.array(chain), "")
    return *steps, *product, Map("gradient", Over.ONCE, output, gradients, lambda *parts: ca.vertcat(*parts))


DIRECTION = Argument(
    "direction", ("n",), "1", "v, held", symbol="v", per_configuration=True, draw=quantities.Normal(), largest="none"
)


def direction_gradient_kernel(configuration: tuple[Argument, ...]) -> Kernel:
    """Return the kernel of the gradient of the hybrid joint stiffness along a direction."""
    F, K = arguments.wrench("hybrid"), arguments.task_stiffness("hybrid", symmetric_part=True)
    result = Argument(
        "stiffness_direction_gradient",
        ("n",),
        "N m/rad^2",
        "gradient of v^T Kq v with respect to q",
        floating_meaning="gradient of v^T Kq v: covector of the base link's twist in its own axes, then the joints'",
    )
    program = partial(stiffness_direction_gradient, wrench=F, task_stiffness=K, direction=DIRECTION, result=result)
    return Kernel(
        name="stiffness_direction_gradient",
        group="hybrid",
        arguments=(*configuration, F, K, DIRECTION),
        results=(result,),
        summary="Gradient of the joint stiffness along a direction; wrench, task stiffness and direction are held.",
        equation="d(v^T Kq v)/dq; with a unit eigenvector v of Kq, the gradient of its eigenvalue",
        program=partial(program, representation="hybrid"),
        batch=True,
        is_gradient=True,
    )
