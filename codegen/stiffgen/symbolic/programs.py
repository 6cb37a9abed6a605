# SPDX-License-Identifier: MIT
"""Programs of all kernels: functions that return the steps of a kernel for one chain.

The kernel table (:mod:`stiffgen.symbolic.kernels`) refers to these functions. The contributions of one joint and of one
pair of joints are in :mod:`stiffgen.symbolic.kinematics`, :mod:`stiffgen.symbolic.stiffness` and
:mod:`stiffgen.symbolic.dynamics`; potentials of q, with their program, in :mod:`stiffgen.symbolic.joint_potentials`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic import contacts, dynamics, gravity, kinematics, springs, stiffness
from stiffgen.symbolic.arguments import BASE_POSE, GRAVITY, POSE, VELOCITY, Argument, Q, configuration_arguments
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.program import Array, Operand, Over, Program
from stiffgen.symbolic.springs import Spring
from stiffgen.symbolic.steps import Map, SparseSum, StraightLine, SumJoints


def _configuration(chain: Chain, *, seen_from_tip: bool = False) -> tuple[Array, ...]:
    floating = chain.floating and not seen_from_tip
    arguments = configuration_arguments(runtime_tool=chain.runtime_tool, floating=floating)
    return tuple(argument.array(chain) for argument in arguments)


def _columns(chain: Chain, representation: Representation, name: str = "J") -> tuple[StraightLine, Array]:
    array = Array(name, (6, len(chain.joints)))
    expressions = partial(kinematics.joint_jacobian, representation=representation)
    heading = "Jacobian columns: rows 0..2 linear, 3..5 angular"
    meaning = f"Jacobian columns of the moving joints, {representation} representation"
    arguments = _configuration(chain, seen_from_tip=representation == "body")
    name = f"{representation}_columns"
    return StraightLine((array,), expressions, arguments, name, heading, meaning, 1, moves=representation), array


def over_joints(chain: Chain, result: Argument, steps: Callable[[Array], Program], *, mirror: bool = False) -> Program:
    """Return ``steps`` that write a result [j] or [i, j] for joints, summed into coordinates where joints mimic."""
    output = result.array(chain)
    if not chain.coupled:
        return steps(output)
    m = len(chain.joints)
    joints = Array(f"{output.name}_of_joints", (*(m for _ in output.shape[:2]), *output.shape[2:]))
    return (*steps(joints), SumJoints(joints, output, mirror=mirror))


def _pairs(left: Array, right: Array, over: Over, output: Array, comment: str, *, mirror: bool = False) -> Map:
    return Map(comment, over, Operand(output, "ij"), (Operand(left, "i"), Operand(right, "j")), ca.dot, mirror)


def _pose(chain: Chain, pose: Array) -> StraightLine:
    heading, meaning = "pose of the tip", "Pose of the tip in the base frame"
    return StraightLine(
        (pose,), kinematics.forward_kinematics, _configuration(chain), "tip_pose", heading, meaning, moves="hybrid"
    )


def columns_and_pose(chain: Chain, J: Array, pose: Array) -> StraightLine:
    """Return the step that computes hybrid Jacobian columns and pose of the tip, in one pass over the joints."""
    heading = "Jacobian columns, and pose of the tip"
    meaning = "Hybrid Jacobian columns of the moving joints, and pose of the tip"
    expressions = kinematics.hybrid_jacobian_and_pose
    name = "hybrid_columns_and_pose"
    return StraightLine((J, pose), expressions, _configuration(chain), name, heading, meaning, 1, moves="hybrid")


def forward_kinematics(chain: Chain) -> Program:
    """Return the program of the tip's pose."""
    pose = POSE.array(chain)
    return (_pose(chain, pose),)


def jacobian(chain: Chain, representation: Representation, result: Argument) -> Program:
    """Return the program of Jacobian columns, summed into coordinates."""
    output = result.array(chain)
    if not chain.coupled:
        return (_columns(chain, representation, output.name)[0],)
    recursion, J = _columns(chain, representation)
    return recursion, SumJoints(J, output, columns=True)


def jacobian_derivative(chain: Chain, representation: Representation, result: Argument) -> Program:
    """Return the program of dJ^T/dq from brackets of columns, one half of the pairs after the other."""

    def steps(output: Array) -> Program:
        recursion, J = _columns(chain, representation)
        diagonal_outward = stiffness.diagonal_is_outward(representation)

        def half(over: Over, outward: bool) -> Map:
            def derivative(moving: ca.SX, column: ca.SX) -> ca.SX:
                return kinematics.jacobian_column_derivative(representation, column, moving, moving_is_outward=outward)

            side = str(over) if over is Over.BASE else f"for the joints i {'beyond' if outward else 'before'} joint j"
            return Map(
                f"dJ_j/dq_i {side}",
                over,
                Operand(output, "ij"),
                (Operand(J, "i"), Operand(J, "j")),
                derivative,
            )

        outer = Over.LOWER if diagonal_outward else Over.STRICTLY_LOWER
        inner = Over.STRICTLY_UPPER if diagonal_outward else Over.UPPER
        return recursion, half(inner, False), half(outer, True), *((half(Over.BASE, False),) if chain.floating else ())

    return over_joints(chain, result, steps)


def _two_sided(
    chain: Chain,
    J: Array,
    output: Array,
    representation: Representation,
    covector: Callable[..., ca.SX],
    operands: tuple[Operand, ...],
    names: tuple[str, str, str],
) -> Program:
    """Return the steps output_ij = J_i . u_j, with separate covectors u_j for joints j beyond and before i."""
    symbol, left_hand_side, formula = names
    diagonal_outward = stiffness.diagonal_is_outward(representation)
    beyond = Over.UPPER if diagonal_outward else Over.STRICTLY_UPPER
    before = Over.STRICTLY_LOWER if diagonal_outward else Over.LOWER
    maps: list[Map] = []
    for side, over, outward in (("beyond", beyond, True), ("before", before, False)):
        u = Array(f"{symbol}_{side}", J.shape)
        comment = f"{symbol}_j = {formula}, for the joints j {side} joint i"
        expression = partial(covector, representation, outward=outward)
        maps.append(Map(comment, Over.JOINTS, Operand(u, "j"), (Operand(J, "j"), *operands), expression))
        # A floating base moves as one body: each of its joints moves the tip as if it were the joint nearest the base.
        overs = (over, Over.BASE) if chain.floating and not outward else (over,)
        maps += [_pairs(J, u, each, output, f"{left_hand_side}_ij = J_i . {symbol}_j for {each}") for each in overs]
    return tuple(maps)


def kinematic_stiffness(chain: Chain, representation: Representation, result: Argument, wrench: Argument) -> Program:
    """Return the program of dJ^T/dq . F from covectors of the wrench, with one dot product per pair of joints."""

    def steps(output: Array) -> Program:
        recursion, J = _columns(chain, representation)
        operands = (Operand(wrench.array(chain), ""),)
        names = ("z", "Kkin", "gradient of (dJ_i/dq_j) . F with respect to J_i")
        covector = stiffness.kinematic_covector
        return (recursion, *_two_sided(chain, J, output, representation, covector, operands, names))

    return over_joints(chain, result, steps)


def joint_stiffness_uncorrected(
    chain: Chain, representation: Representation, result: Argument, wrench: Argument, task_stiffness: Argument
) -> Program:
    """Return the program of dJ^T/dq . F + J^T K J, all entries."""

    def steps(output: Array) -> Program:
        recursion, J = _columns(chain, representation)
        y = Array("y", J.shape)
        matrix = Operand(task_stiffness.array(chain), "")
        product = Map("y_j = K J_j", Over.JOINTS, Operand(y, "j"), (matrix, Operand(J, "j")), ca.mtimes)
        operands = (Operand(wrench.array(chain), ""), Operand(y, "j"))
        names = ("u", "Kq", "y_j + gradient of (dJ_i/dq_j) . F with respect to J_i")
        covector = stiffness.uncorrected_covector
        return (recursion, product, *_two_sided(chain, J, output, representation, covector, operands, names))

    return over_joints(chain, result, steps)


def _tangent(
    chain: Chain, J: Array, wrench: Array, task_stiffness: Array, representation: Representation, output: Array
) -> Program:
    """Return the steps of output = dJ^T/dq . F + J^T (K + Gamma F) J over the moving joints."""
    A, u = Array("A", (6, 6)), Array("u", J.shape)
    force = Operand(wrench, "")
    half = Over.UPPER if stiffness.diagonal_is_outward(representation) else Over.LOWER
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
            (Operand(J, "j"), force, Operand(A, "")),
            partial(stiffness.stiffness_covector, representation),
        ),
        *_with_base_connection(
            chain,
            output,
            lambda into: (_pairs(J, u, half, into, f"Kq_ij = J_i . u_j for {half}, mirrored", mirror=True),),
            (Operand(J, "j"), force),
            ca.dot,
        ),
    )


def joint_stiffness(
    chain: Chain, representation: Representation, result: Argument, wrench: Argument, task_stiffness: Argument
) -> Program:
    """Return the program of dJ^T/dq . F + J^T (K + Gamma F) J, one triangle, mirrored."""

    def steps(output: Array) -> Program:
        recursion, J = _columns(chain, representation)
        F, K = wrench.array(chain), task_stiffness.array(chain)
        return (recursion, *_tangent(chain, J, F, K, representation, output))

    return over_joints(chain, result, steps, mirror=True)


def joint_stiffness_total(
    chain: Chain, representation: Representation, result: Argument, inputs: tuple[Argument, ...]
) -> Program:
    """Return the program of the tips' joint stiffnesses, added up: one triangle, mirrored.

    ``inputs`` are the arguments of the kernel.
    """

    def steps(output: Array) -> Program:
        S, u = (Array(name, (6, len(chain.joints))) for name in ("S", "u"))
        expressions = partial(contacts.columns_and_covectors, representation=representation)
        arguments = tuple(argument.array(chain) for argument in inputs)
        heading = "columns S of the joints at one point; covectors u of the loads beyond each joint"
        step = StraightLine((S, u), expressions, arguments, heading=heading, columns=2)
        return step, *pairs_on_the_way(chain, S, u, output, "Kq_ij = S_i . u_j", ca.dot)

    return over_joints(chain, result, steps, mirror=True)


def spring_total(
    chain: Chain,
    spring: Spring,
    inputs: tuple[Argument, ...],
    results: Mapping[str, Argument],
) -> Program:
    """Return the program of the springs at all tips, in one pass over the tree.

    ``inputs`` are the arguments of the kernel; ``results`` holds results under the names "energy", "torque" and
    "joint_stiffness", or some of them.
    """
    energy, torque, joint_stiffness = (results.get(name) for name in ("energy", "torque", "joint_stiffness"))
    m, parts, outputs, headings = len(chain.joints), "", list[Array](), list[str]()
    S, u = Array("S", (6, m)), Array("u", (6, m))
    if joint_stiffness:
        parts, outputs = "S", [S, u]
        headings.append("columns S of the joints at one point; covectors u of the loads beyond each joint")
    if energy:
        parts, outputs = parts + "U", [*outputs, energy.array(chain)]
        headings.append("energy U")
    of_joints = None
    if torque:
        of_joints = Array(f"{torque.name}_of_joints", (m,)) if chain.coupled else torque.array(chain)
        parts, outputs = parts + "T", [*outputs, of_joints]
        headings.append("torques -S_j . W_j of the joints, W_j the sum of the wrenches beyond joint j")
    expressions = partial(contacts.spring_terms, spring=spring, parts=parts)
    arguments = tuple(argument.array(chain) for argument in inputs)
    program: Program = (
        StraightLine(
            tuple(outputs), expressions, arguments, heading="; ".join(headings), columns=2 if joint_stiffness else 0
        ),
    )
    if torque and of_joints and chain.coupled:
        program += (SumJoints(of_joints, torque.array(chain)),)
    if joint_stiffness:
        program += over_joints(
            chain,
            joint_stiffness,
            lambda output: pairs_on_the_way(chain, S, u, output, "Kq_ij = S_i . u_j", ca.dot),
            mirror=True,
        )
    return program


def connection_correction(chain: Chain, representation: Representation, result: Argument, wrench: Argument) -> Program:
    """Return the program of Gamma F."""
    return (
        SparseSum(
            "Gamma F",
            result.array(chain),
            None,
            (wrench.array(chain),),
            partial(stiffness.gamma_F, representation),
            stiffness.halves_of_wrench,
        ),
    )


MAX_UNROLLED_MASS_JOINTS = 12
"""Largest number of joints for which a mass matrix without loops has fewer statements than one with loops."""


def mass_matrix(chain: Chain, result: Argument) -> Program:
    """Return the program of M_ij = J_i . h_j, where h_j is the momentum of the composite body beyond joint j."""
    m = len(chain.joints)
    # Sums over prismatic joints can overflow, and only the results of loops are guarded against infinity.
    if m <= MAX_UNROLLED_MASS_JOINTS and not chain.coupled and not any(joint.prismatic for joint in chain.joints):
        heading = "M_ij = J_i . h_j: component of h_j along the axis of joint i, in the axes of link i"
        return (StraightLine((result.array(chain),), dynamics.mass_matrix, (Q.array(chain),), heading=heading),)

    def steps(output: Array) -> Program:
        J, h = Array("J", (6, m)), Array("h", (6, m))
        heading = "Jacobian columns J, and momenta h at unit rates of the joints"
        recursion = StraightLine((J, h), dynamics.columns_and_momenta, (Q.array(chain),), heading=heading, columns=2)
        return recursion, *pairs_on_the_way(chain, J, h, output, "M_ij = J_i . h_j", ca.dot)

    return over_joints(chain, result, steps, mirror=True)


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


def bias_forces(chain: Chain, result: Argument, acceleration: Array | None = None) -> Program:
    """Return the program of the joint forces at constant rates or with an acceleration, summed into coordinates."""
    arguments = (*configuration_arguments(runtime_tool=False, floating=chain.floating), VELOCITY, GRAVITY)
    arrays = [argument.array(chain) for argument in arguments]
    return over_joints(
        chain,
        result,
        lambda output: (
            StraightLine(
                (output,),
                dynamics.joint_forces if acceleration else dynamics.bias_forces,
                (*arrays, *((acceleration,) if acceleration else ())),
                heading="joint forces: components along the joints' axes",
            ),
        ),
    )


def _gravity_columns(chain: Chain) -> tuple[StraightLine, Array, Array]:
    columns, moment = Array("C", (6, len(chain.joints))), Array("first_moment", (3,))
    heading = "axes a of revolute joints (rows 0..2), moment rates w (rows 3..5); first moment of all bodies"
    meaning = (
        "Axes a_j of revolute joints, derivatives w_j of the first moment of all bodies with respect to q_j, and that "
        "first moment; in base axes"
    )
    step = StraightLine(
        (columns, moment), gravity.axes_and_moment_rates, (Q.array(chain),), "gravity_columns", heading, meaning, 1
    )
    return step, columns, moment


def gravity_energy(chain: Chain, result: Argument) -> Program:
    """Return the program of the potential energy of all bodies."""
    recursion, _, moment = _gravity_columns(chain)
    arguments = moment, *(a.array(chain) for a in (GRAVITY, *((BASE_POSE,) if chain.floating else ())))
    heading = "U = -g . (R first moment + m p), R and p of the base" if chain.floating else "U = -g . first moment"
    return recursion, StraightLine((result.array(chain),), gravity.potential_energy, arguments, heading=heading)


def in_base_axes(chain: Chain, argument: Argument) -> tuple[Program, Array]:
    """Return the steps and the array of an argument in base axes: gravity, a wrench or one wrench per tip."""
    given = argument.array(chain)
    if not chain.floating:
        return (), given
    turned = Array(f"{given.symbol or given.name}_in_base", given.shape)
    operands = Operand(BASE_POSE.array(chain), ""), Operand(given, "")
    comment = f"{given.name} in base axes"
    return (Map(comment, Over.ONCE, Operand(turned, ""), operands, gravity.in_base_axes),), turned


def gravity_gradient(chain: Chain, result: Argument) -> Program:
    """Return the program of dU/dq, joint by joint, summed into coordinates."""
    recursion, C, _ = _gravity_columns(chain)
    rotation, g = in_base_axes(chain, GRAVITY)

    def steps(output: Array) -> Program:
        operands = Operand(C, "j"), Operand(g, "")
        rates = Map("dU/dq_j = -g . w_j", Over.JOINTS, Operand(output, "j"), operands, gravity.moment_rate)
        return recursion, *rotation, rates

    return over_joints(chain, result, steps)


def gravity_joint_stiffness(chain: Chain, result: Argument) -> Program:
    """Return the program of d2U/dq2; on a floating base, of the covariant Hessian."""
    recursion, C, _ = _gravity_columns(chain)
    rotation, g = in_base_axes(chain, GRAVITY)
    u, operands = Array("u", (3, len(chain.joints))), (Operand(C, "j"), Operand(g, ""))
    covectors = Map("u_j = g x w_j", Over.JOINTS, Operand(u, "j"), operands, gravity.covector)

    def steps(output: Array) -> Program:
        def pairs(into: Array) -> Program:
            return pairs_on_the_way(chain, C, u, into, "Kq_ij = a_i . u_j", gravity.second_derivative)

        connected = _with_base_connection(chain, output, pairs, operands, gravity.moment_rate)
        return recursion, *rotation, covectors, *connected

    return over_joints(chain, result, steps, mirror=True)


def _with_base_connection(
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
    if not chain.floating:
        return pairs(output)
    m = len(chain.joints)
    serial, tau = Array("S", (m, m)), Array("tau", (m,))
    force = Map("tau_j: generalised force of joint j", Over.JOINTS, Operand(tau, "j"), operands, generalised_force)
    comment = "connection of the base: from rotations in series to a rotation about one axis"
    connection = SparseSum(comment, output, serial, (tau,), stiffness.base_connection)
    return *pairs(serial), force, connection


def spring_terms(chain: Chain, spring: Spring, results: tuple[Argument, ...], parts: str) -> Program:
    """Return the program of a spring's energy, wrench or task stiffness; ``parts`` is as in :func:`springs.terms`."""
    pose, outputs = POSE.array(chain), tuple(result.array(chain) for result in results)
    return (_pose(chain, pose), _spring_step(chain, spring, pose, outputs, parts))


def _spring_step(chain: Chain, spring: Spring, pose: Array, outputs: tuple[Array, ...], parts: str) -> StraightLine:
    expressions = partial(springs.terms, spring=spring, parts=parts)
    parameters = tuple(argument.array(chain) for argument in spring.parameters)
    names = {"U": "energy U", "F": "wrench F = dU", "K": "covariant Hessian K of U", "k": "covariant Hessian K of U"}
    return StraightLine(outputs, expressions, (pose, *parameters), heading=", ".join(names[part] for part in parts))


def spring_joint_terms(
    chain: Chain,
    spring: Spring,
    energy: Argument | None = None,
    torque: Argument | None = None,
    joint_stiffness: Argument | None = None,
) -> Program:
    """Return the program of energy, torque -J^T F and joint stiffness of a spring, or some of them, in one pass."""
    pose, m = POSE.array(chain), len(chain.joints)
    J, F, K = Array("J", (6, m)), Array("F", (6,)), Array("K", (6, 6))
    columns = columns_and_pose(chain, J, pose)
    outputs = [F, K] if joint_stiffness else [F]
    parts = "Fk" if joint_stiffness else "F"
    if energy:
        outputs, parts = [energy.array(chain), *outputs], "U" + parts
    program: Program = (columns, _spring_step(chain, spring, pose, tuple(outputs), parts))
    if torque:
        operands = Operand(J, "j"), Operand(F, "")

        def dot(column: ca.SX, wrench: ca.SX) -> ca.SX:
            return ca.SX(-ca.dot(column, wrench))

        program += over_joints(
            chain,
            torque,
            lambda output: (Map("torque_j = -J_j . F", Over.JOINTS, Operand(output, "j"), operands, dot),),
        )
    if joint_stiffness:
        program += over_joints(
            chain, joint_stiffness, lambda output: _tangent(chain, J, F, K, "hybrid", output), mirror=True
        )
    return program
