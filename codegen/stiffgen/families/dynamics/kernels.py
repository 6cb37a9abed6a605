# SPDX-License-Identifier: MIT
"""Mass matrix, bias forces, gravity, and the torque at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import BASE_POSE, GRAVITY, VELOCITY, Argument, Q, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.pieces import in_base_axes, over_joints, pairs_on_the_way, with_base_connection
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, StraightLine
from stiffgen.families.dynamics import expressions as dynamics
from stiffgen.families.dynamics import gravity, static_torque

MAX_UNROLLED_MASS_JOINTS = 12
"""Largest number of joints for which a mass matrix without loops has fewer statements than one with loops."""


def mass_matrix(chain: Chain, result: Argument) -> Program:
    """Return the program of M_ij = J_i . h_j, where h_j is the momentum of the composite body beyond joint j."""
    m = len(chain.joints)
    # Sums over prismatic joints can overflow, and only the results of loops are guarded against infinity.
    if m <= MAX_UNROLLED_MASS_JOINTS and not chain.coupled and not any(joint.prismatic for joint in chain.joints):
        heading = "M_ij = J_i . h_j: component of h_j along the axis of joint i, in the axes of link i"
        outputs, arguments = (result.array(chain),), (Q.array(chain),)
        return (StraightLine(outputs, dynamics.mass_matrix, arguments, heading=heading),)

    def steps(output: Array) -> Program:
        J, h = Array("J", (6, m)), Array("h", (6, m))
        heading = "Jacobian columns J, and momenta h at unit rates of the joints"
        recursion = StraightLine((J, h), dynamics.columns_and_momenta, (Q.array(chain),), heading=heading, columns=2)
        return recursion, *pairs_on_the_way(chain, J, h, output, formula="M_ij = J_i . h_j", body=ca.dot)

    return over_joints(chain, result, steps, mirror=True)


def bias_forces(chain: Chain, result: Argument, acceleration: Array | None = None) -> Program:
    """Return the program of the joint forces at constant rates or with an acceleration, summed into coordinates."""
    configuration = configuration_arguments(runtime_tool=False, floating=chain.floating)
    arguments = [argument.array(chain) for argument in (*configuration, VELOCITY, GRAVITY)]
    expressions = dynamics.bias_forces
    if acceleration:
        arguments, expressions = [*arguments, acceleration], dynamics.joint_forces

    def steps(output: Array) -> Program:
        heading = "joint forces: components along the joints' axes"
        return (StraightLine((output,), expressions, tuple(arguments), heading=heading),)

    return over_joints(chain, result, steps)


def _gravity_columns(chain: Chain) -> tuple[StraightLine, Array, Array]:
    """Return the step that the kernels of gravity share, with its arrays: columns (a_j, w_j), and the first moment."""
    columns, moment = Array("C", (6, len(chain.joints))), Array("first_moment", (3,))
    step = StraightLine(
        outputs=(columns, moment),
        expressions=gravity.axes_and_moment_rates,
        arguments=(Q.array(chain),),
        name="gravity_columns",
        heading="axes a of revolute joints (rows 0..2), moment rates w (rows 3..5); first moment of all bodies",
        meaning="Axes a_j of revolute joints, derivatives w_j of the first moment of all bodies with respect to q_j, "
        "and that first moment; in base axes",
        columns=1,
    )
    return step, columns, moment


def gravity_energy(chain: Chain, result: Argument) -> Program:
    """Return the program of the potential energy of all bodies."""
    recursion, _, moment = _gravity_columns(chain)
    arguments: tuple[Array, ...] = (moment, GRAVITY.array(chain))
    heading = "U = -g . first moment"
    if chain.floating:
        arguments = (*arguments, BASE_POSE.array(chain))
        heading = "U = -g . (R first moment + m p), R and p of the base"
    return recursion, StraightLine((result.array(chain),), gravity.potential_energy, arguments, heading=heading)


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
            formula = "Kq_ij = a_i . u_j"
            return pairs_on_the_way(chain, C, u, into, formula=formula, body=gravity.second_derivative)

        connected = with_base_connection(chain, output, pairs, operands, gravity.moment_rate)
        return recursion, *rotation, covectors, *connected

    return over_joints(chain, result, steps, mirror=True)


_MASS = Argument(
    "mass_matrix", ("n", "n"), "kg m^2", "symmetric, positive definite where every joint moves a mass", symmetric=True
)


_MASS_MATRIX = Kernel(
    name="mass_matrix",
    group=None,
    arguments=(arguments.Q,),
    results=(_MASS,),
    summary="Joint-space mass matrix.",
    equation="M_ij = J_i . I^c_j J_j, composite bodies (Featherstone 2008)",
    program=partial(mass_matrix, result=_MASS),
    note="Links beyond the chain move with it: their joints stay at zero, except joints that mimic a coordinate of q. "
    "Rotor inertias are not included, since a URDF does not hold them.",
    batch=True,
    of_masses=True,
)


_BIAS = Argument(
    "bias_forces", ("n",), "N m or N", "C(q, dq) dq + dU/dq; the sum with M ddq is the joint torque of the motion"
)


_GRAVITY_ENERGY = Argument.referred(
    "energy", (), "J",
    "potential energy U, 0 where the centre of mass of all moving links is level with the {reference}'s origin",
)  # fmt: skip


_GRAVITY_GRADIENT = Argument("gradient", ("n",), "N m or N", "dU/dq: torque that balances gravity")


_GRAVITY_STIFFNESS = Argument("joint_stiffness", ("n", "n"), "N m/rad", "d2U/dq2, bitwise symmetric", symmetric=True)


def _gravity_kernel(
    inputs: tuple[Argument, ...], result: Argument, *, summary: str, equation: str, program: Callable[..., Program]
) -> Kernel:
    """Return a kernel of the group ``gravity``, named as its result."""
    return Kernel(
        name=result.name,
        group="gravity",
        arguments=inputs,
        results=(result,),
        summary=summary,
        equation=equation,
        program=partial(program, result=result),
        note=_MASS_MATRIX.note,
        batch=True,
        of_masses=True,
    )


_STATIC_TORQUE = Argument(
    "static_torque_derivatives",
    ("n", "n"),
    "N m/rad",
    "column i is d(dU/dq - J^T F)/dq_i; not symmetric under a moment",
)


def _static_torque(tips: Sequence[Tip], *, runtime_tool: bool, floating: bool) -> Kernel:
    """Return the kernel of the derivative of the torque at rest; several ``tips`` have a wrench each."""
    configuration = configuration_arguments(runtime_tool=runtime_tool, floating=floating)
    inputs: tuple[Argument, ...] = (*configuration, arguments.wrench("hybrid"))
    if tips:
        names = [tip.name for tip in tips]
        inputs = tuple(each if each.of_configuration else each.of_all_tips(names) for each in inputs)
    return Kernel(
        name=_STATIC_TORQUE.name,
        group=None,
        arguments=(*inputs, arguments.GRAVITY),
        results=(_STATIC_TORQUE,),
        summary="Derivative of the joint torques at rest under gravity and constant wrenches.",
        equation="d(dU/dq - J^T F)/dq, with J and F in hybrid representation",
        program=partial(static_torque.static_torque_derivatives, result=_STATIC_TORQUE, inputs=inputs),
        note=f"The torque dU/dq - J^T F holds the robot. {_MASS_MATRIX.note}",
        batch=True,
        of_masses=True,
    )


def dynamics_kernels(
    tips: Sequence[Tip] = (), *, runtime_tool: bool = False, floating: bool = False
) -> tuple[Kernel, ...]:
    """Return the kernels of a robot's dynamics; ``tips`` are its tips, if several."""
    configuration = configuration_arguments(runtime_tool=False, floating=floating)
    falling = (*configuration, arguments.GRAVITY)
    base = "; minus Gamma dU/dq in the rows and columns of the base's twist" if floating else ""
    return (
        _MASS_MATRIX,
        Kernel(
            name="bias_forces",
            group=None,
            arguments=(*configuration, arguments.VELOCITY, arguments.GRAVITY),
            results=(_BIAS,),
            summary="Bias forces: Coriolis, centrifugal and gravity forces.",
            equation="C(q, dq) dq + dU/dq, recursive Newton-Euler algorithm (Luh, Walker, Paul 1980)",
            program=partial(bias_forces, result=_BIAS),
            note=f"Zero gravity gives the Coriolis and centrifugal forces alone. {_MASS_MATRIX.note}",
            batch=True,
            of_masses=True,
        ),
        _gravity_kernel(
            falling,
            _GRAVITY_ENERGY,
            summary="Potential energy of gravity.",
            equation="U = -g . sum of m_k c_k",
            program=gravity_energy,
        ),
        _gravity_kernel(
            falling,
            _GRAVITY_GRADIENT,
            summary="Gravity torque: gradient of the potential energy.",
            equation="dU/dq_j = -g . w_j",
            program=gravity_gradient,
        ),
        _gravity_kernel(
            falling,
            _GRAVITY_STIFFNESS,
            summary="Joint stiffness of gravity: Hessian of the potential energy.",
            equation=f"d2U/dq_i dq_j = a_i . (g x w_j){base}",
            program=gravity_joint_stiffness,
        ),
        _static_torque(tips, runtime_tool=runtime_tool, floating=floating),
    )
