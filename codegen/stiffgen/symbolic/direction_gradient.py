# SPDX-License-Identifier: MIT
"""Gradient of the joint stiffness along a direction, v^T Kq v, with respect to the coordinates; v is held.

For a unit eigenvector v of a simple eigenvalue, the result is the gradient of the eigenvalue. Where the smallest
eigenvalue is multiple, each of its v gives an element of the generalised gradient (Clarke 1983). The program is the
reverse mode of Kq (:mod:`stiffgen.symbolic.adjoint`) with the cotangent v v^T.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic import adjoint, programs
from stiffgen.symbolic.arguments import BASE_POSE, Argument, Q
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.gradients import bar_name, gradient_shape
from stiffgen.symbolic.program import Array, Operand, Over, Program, Step
from stiffgen.symbolic.steps import Map, SumJoints


def stiffness_direction_gradient(
    chain: Chain,
    representation: Representation,
    result: Argument,
    wrench: Argument,
    task_stiffness: Argument,
    direction: Argument,
) -> Program:
    """Return the program of the gradient; on a floating base, its first six entries belong to the base's twist."""
    m, v = len(chain.joints), direction.array(chain)
    stiffness = Argument("Kq", ("n", "n"), "", "", symmetric=True)
    forward = programs.joint_stiffness(chain, representation, stiffness, wrench, task_stiffness)
    of_joints, before = stiffness.array(chain), list[Step]()
    if chain.coupled:
        total, spread = forward[-1], Array("v_of_joints", (m,))
        assert isinstance(total, SumJoints)
        forward, of_joints = forward[:-1], total.source
        before, v = [SumJoints(v, spread, spread=True)], spread
    weights = Array("vv", of_joints.shape)
    operands = Operand(v, "i"), Operand(v, "j")
    comment = "cotangent v_i v_j for i<=j, mirrored"
    before.append(Map(comment, Over.UPPER, Operand(weights, "ij"), operands, lambda a, b: a * b, mirror=True))
    places = [argument.array(chain) for argument in (*((BASE_POSE,) if chain.floating else ()), Q)]
    product = adjoint.reverse(chain, forward, places, [of_joints], [weights])
    gradients = tuple(Operand(Array(bar_name(each.name), gradient_shape(each)), "") for each in places)
    output = Operand(result.array(chain), "")
    return *before, *product, Map("gradient", Over.ONCE, output, gradients, lambda *parts: ca.vertcat(*parts))
