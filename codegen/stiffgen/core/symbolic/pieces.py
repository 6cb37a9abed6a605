# SPDX-License-Identifier: MIT
"""Pieces of programs that several families share: poses, Jacobian columns, pairs of joints, sums over coordinates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import kinematics, stiffness
from stiffgen.core.symbolic.arguments import BASE_POSE, Argument, configuration_arguments
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, SparseSum, StraightLine, SumJoints


def configuration_arrays(chain: Chain, *, seen_from_tip: bool = False) -> tuple[Array, ...]:
    """Return the arrays of the configuration arguments; ``seen_from_tip`` leaves out the base's pose."""
    floating = chain.base_joints > 0 and not seen_from_tip
    arguments = configuration_arguments(runtime_tool=chain.runtime_tool, floating=floating)
    return tuple(argument.array(chain) for argument in arguments)


def columns_of(chain: Chain, representation: Representation, name: str = "J") -> tuple[StraightLine, Array]:
    """Return the step that computes Jacobian columns, a function that kernels share, and their array."""
    array = Array(name, (6, len(chain.joints)))
    expressions = partial(kinematics.joint_jacobian, representation=representation)
    heading = "Jacobian columns: rows 0..2 linear, 3..5 angular"
    meaning = f"Jacobian columns of the moving joints, {representation} representation"
    arguments = configuration_arrays(chain, seen_from_tip=representation == "body")
    function = f"{representation}_columns"
    return StraightLine((array,), expressions, arguments, function, heading, meaning, 1, moves=representation), array


def over_joints(chain: Chain, result: Argument, steps: Callable[[Array], Program], *, mirror: bool = False) -> Program:
    """Return ``steps`` that write a result [j] or [i, j] for joints, summed into coordinates where joints mimic."""
    output = result.array(chain)
    if not chain.coupled:
        return steps(output)
    m = len(chain.joints)
    joints = Array(f"{output.name}_of_joints", (*(m for _ in output.shape[:2]), *output.shape[2:]))
    return (*steps(joints), SumJoints(joints, output, mirror=mirror))


def pairs_of(left: Array, right: Array, over: Over, output: Array, comment: str, *, mirror: bool = False) -> Map:
    """Return the dot products of columns i of one array and j of another over some pairs."""
    return Map(comment, over, Operand(output, "ij"), (Operand(left, "i"), Operand(right, "j")), ca.dot, mirror)


def tip_pose(chain: Chain, pose: Array) -> StraightLine:
    """Return the step that computes the pose of the tip, a function that kernels share."""
    heading, meaning = "pose of the tip", "Pose of the tip in the base frame"
    configuration, expressions = configuration_arrays(chain), kinematics.forward_kinematics
    return StraightLine((pose,), expressions, configuration, "tip_pose", heading, meaning, moves="hybrid")


def columns_and_pose(chain: Chain, J: Array, pose: Array) -> StraightLine:
    """Return the step that computes hybrid Jacobian columns and pose of the tip, in one pass over the joints."""
    heading = "Jacobian columns, and pose of the tip"
    meaning = "Hybrid Jacobian columns of the moving joints, and pose of the tip"
    expressions = kinematics.hybrid_jacobian_and_pose
    name = "hybrid_columns_and_pose"
    return StraightLine((J, pose), expressions, configuration_arrays(chain), name, heading, meaning, 1, moves="hybrid")


def pairs_on_the_way(
    chain: Chain, left: Array, right: Array, output: Array, formula: str, body: Callable[..., ca.SX]
) -> Program:
    """Return a symmetric output_ij = body(left_i, right_j) for every i on the way from the base to j, else 0."""
    operands = Operand(left, "i"), Operand(right, "j")
    if all(joint.parent == index - 1 for index, joint in enumerate(chain.joints)):
        return (Map(f"{formula} for i<=j, mirrored", Over.UPPER, Operand(output, "ij"), operands, body, mirror=True),)
    zeros = Map("joints of different branches: 0", Over.UPPER, Operand(output, "ij"), (), lambda: ca.SX(0), mirror=True)
    over = Over.ON_THE_WAY
    return zeros, Map(f"{formula} for {over}, mirrored", over, Operand(output, "ij"), operands, body, mirror=True)


def in_base_axes(chain: Chain, argument: Argument) -> tuple[Program, Array]:
    """Return the steps and the array of an argument in base axes: gravity, a wrench or one wrench per tip."""
    array = argument.array(chain)
    if not chain.floating:
        return (), array
    turned = Array(f"{array.symbol or array.name}_in_base", array.shape)
    operands = Operand(BASE_POSE.array(chain), ""), Operand(array, "")
    comment = f"{array.name} in base axes"
    return (Map(comment, Over.ONCE, Operand(turned, ""), operands, kinematics.in_base_axes),), turned


def with_base_connection(
    chain: Chain,
    output: Array,
    pairs: Callable[[Array], Program],
    operands: tuple[Operand, ...],
    generalised_force: Callable[..., ca.SX],
) -> Program:
    """Convert second derivatives along the base's joints into derivatives along exponentials of the base's twist.

    ``pairs`` returns steps for the base as six joints in series; the connection of the base accounts for the difference
    to a motion along one twist. ``generalised_force(*operands)`` is the gradient, per joint.
    """
    if not chain.base_joints:
        return pairs(output)
    m = len(chain.joints)
    serial, tau = Array("S", (m, m)), Array("tau", (m,))  # second derivatives; gradient
    force = Map("tau_j: generalised force of joint j", Over.JOINTS, Operand(tau, "j"), operands, generalised_force)
    comment = "connection of the base: from rotations in series to a rotation about one axis"
    connection = SparseSum(comment, output, serial, (tau,), stiffness.base_connection)
    return *pairs(serial), force, connection


def tangent(
    chain: Chain, J: Array, wrench: Array, task_stiffness: Array, representation: Representation, output: Array
) -> Program:
    """Return the steps of output = dJ^T/dq . F + J^T (K + Gamma F) J over the moving joints."""
    A, u = Array("A", (6, 6)), Array("u", J.shape)
    return (
        SparseSum(
            "A = K + Gamma F, reading the upper triangle of K",
            A,
            task_stiffness,
            (wrench,),
            partial(stiffness.gamma_F, representation),
            stiffness.halves_of_wrench,
        ),
        Map(
            "u_j = A J_j" + " + gradient of (dJ_i/dq_j) . F with respect to J_i" * (representation == "hybrid"),
            Over.JOINTS,
            Operand(u, "j"),
            (Operand(J, "j"), Operand(wrench, ""), Operand(A, "")),
            partial(stiffness.stiffness_covector, representation),
        ),
        *_pairs_of_tangent(chain, J, u, wrench, representation, output),
    )


def load_tangent(chain: Chain, J: Array, wrench: Array, representation: Representation, output: Array) -> Program:
    """Return the steps of output = dJ^T/dq . F + J^T (Gamma F) J over the moving joints."""
    u, formula = Array("u", J.shape), "(Gamma F) J_j + gradient of (dJ_i/dq_j) . F with respect to J_i"
    expression = partial(stiffness.load_covector, representation)
    operands = Operand(J, "j"), Operand(wrench, "")
    covectors = Map(f"u_j = {formula}", Over.JOINTS, Operand(u, "j"), operands, expression)
    return covectors, *_pairs_of_tangent(chain, J, u, wrench, representation, output)


def _pairs_of_tangent(
    chain: Chain, J: Array, u: Array, wrench: Array, representation: Representation, output: Array
) -> Program:
    """Return the steps Kq_ij = J_i . u_j for the half of the pairs in which u_j holds, mirrored."""
    half = Over.UPPER if stiffness.diagonal_is_outward(representation) else Over.LOWER
    return with_base_connection(
        chain,
        output,
        lambda into: (pairs_of(J, u, half, into, f"Kq_ij = J_i . u_j for {half}, mirrored", mirror=True),),
        (Operand(J, "j"), Operand(wrench, "")),
        ca.dot,
    )
