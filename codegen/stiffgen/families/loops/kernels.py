# SPDX-License-Identifier: MIT
"""Kernels in motor coordinates, for robots with closed loops: the group ``motors``, and ``close``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments, pose
from stiffgen.core.symbolic import stiffness_kernels as stiffness
from stiffgen.core.symbolic.arguments import Argument, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Program
from stiffgen.core.symbolic.quantities import Normal, at_start, near_start, symmetric
from stiffgen.families.dynamics import kernels as dynamics
from stiffgen.families.joints import kernels as joint_potentials
from stiffgen.families.joints.kernels import JOINT_POTENTIALS, JointPotential
from stiffgen.families.loops import programs as motor_programs
from stiffgen.families.loops.closure import Closure
from stiffgen.families.springs import kernels as springs
from stiffgen.families.springs.springs import Spring

GROUP = "motors"
CLOSED = "q must close the loops (function close); NaN where the passive joints do not follow from the motors."
_MOTORS = "entries in the order of q"
_MULTIPLIERS = Argument(
    "multipliers", ("equations",), "N, N m", "forces (moments) that hold the loops closed: lambda, one per equation"
)
GRADIENT = Argument(
    "gradient", ("n",), "N m or N", "dU/dq of all joints", symbol="gq", per_configuration=True,
    draw=Normal(), largest="none",
)  # fmt: skip
HESSIAN = Argument(
    "hessian", ("n", "n"), "N m/rad", "d2U/dq2 of all joints; only the upper triangle is read", symbol="Hq",
    triangle=True, per_configuration=True, draw=symmetric, largest="none",
)  # fmt: skip
MOTOR_VELOCITY = Argument(
    "motor_velocity", ("a",), "rad/s or m/s", f"rates of the motors, {_MOTORS}", symbol="da",
    per_configuration=True, draw=Normal(), largest="none",
    floating_meaning=f"twist of the base link (linear, angular) in its own axes, then rates of the motors, {_MOTORS}",
)  # fmt: skip
ACTUATED = Argument(
    "actuated", ("actuated",), "rad or m", f"positions of the motors, {_MOTORS}", symbol="a", per_configuration=True,
    draw=near_start, largest="none", turns=True,
)  # fmt: skip
START = Argument(
    "start", ("q",), "rad or m", "closed joint positions from which the motors move to theirs",
    symbol="start", per_configuration=True, draw=at_start, largest="none", turns=True,
)  # fmt: skip
_TORQUE = Argument("torque", ("a",), "N m or N", f"-dU/da of the motors, {_MOTORS}")
_OF_MOTORS = Argument("motor_gradient", ("a",), "N m or N", f"dU/da of the motors, {_MOTORS}")
_STIFFNESS = Argument(
    "joint_stiffness", ("a", "a"), "N m/rad", "d2U/da2 of the motors, bitwise symmetric", symmetric=True
)
_FORMULA = "d2U/da2 = G^T (d2U/dq2 - sum_k lambda_k d2c_k/dq2) G, lambda = C_p^-T dU/dp"
_TREE = {
    name: Argument(f"{name}_of_tree", shape, "", "", symmetric=len(shape) == 2)
    for name, shape in (("gradient", ("n",)), ("torque", ("n",)), ("joint_stiffness", ("n", "n")))
}


def motor_kernels(chain: Chain, springs: tuple[Spring, ...]) -> tuple[Kernel, ...]:
    """Return the kernels in motor coordinates; none for a robot without closed loops."""
    if not chain.loops:
        return ()
    kernels = [*_of_loops(), *(each for potential in JOINT_POTENTIALS for each in _joint_potential(potential))]
    for tip in chain.tips:
        of_tip = [*_of_wrench(chain), *(each for spring in springs for each in _of_spring(chain, spring))]
        kernels += [replace(kernel, tip=tip if len(chain.tips) > 1 else None) for kernel in of_tip]
    if chain.masses:
        kernels += _of_masses(chain)
    return tuple(kernels)


def _kernel(
    name: str,
    inputs: tuple[Argument, ...],
    results: tuple[Argument, ...],
    summary: str,
    equation: str,
    program: Callable[[Chain], Program],
    note: str = "",
) -> Kernel:
    """Return a kernel of the group ``motors``, with the note that q must close the loops."""
    note = " ".join(filter(None, (note, CLOSED)))
    return Kernel(name, GROUP, inputs, results, summary, equation, program, note, batch=True)


def _of_loops() -> tuple[Kernel, ...]:
    """Return the kernels that follow from the loops alone. a: coordinates of the motors; p: of the passive joints."""
    closed = Argument("closed", ("q",), "rad or m", "joint positions that close the loops; NaN if they do not")
    residual = Argument("residual", ("equations",), "m, rad", "c(q) of the independent equations, 0 if closed")
    jacobian = Argument("jacobian", ("n", "a"), "rad or m per rad or m", "G = dq/da, rows of the motors are those of 1")
    condition = Argument("condition", (), "1", "largest condition number of the passive joints' equations, 1 at best")

    def closure_kernel(result: Argument, summary: str, equation: str, value: Callable[[Closure], ca.SX]) -> Kernel:
        program = partial(motor_programs.of_closure, result=result, value=value, heading=equation)
        return _kernel(result.name, (arguments.Q,), (result,), summary, equation, program)

    close = Kernel(
        "close", None, (ACTUATED, START), (closed,), "Joint positions of closed loops from those of the motors.",
        f"Newton's method for the passive joints, {motor_programs.STEPS} steps of at most "
        f"{motor_programs.LARGEST_STEP} (rad, m)",
        partial(motor_programs.close, actuated=ACTUATED, start=START, result=closed),
        f"NaN unless the last step is at most {motor_programs.LAST_STEP:g} (rad, m). A linkage has several branches: "
        "the start decides. Take the last configuration in a control loop.",
        batch=True,
    )  # fmt: skip
    return (
        close,
        replace(  # its note stands alone: the residual is right where loops are open, too
            closure_kernel(residual, "Equations of the closed loops.", "c(q)", Closure.residual),
            note="One per independent equation: distances of the two ends, rotations between them for welds.",
        ),
        closure_kernel(
            jacobian, "Rates of all joints at unit rates of the motors.", "G = [1; -C_p^-1 C_a], C = dc/dq",
            Closure.motion,
        ),
        closure_kernel(
            condition, "Condition number of the closed loops: how near the motors are to a singularity.",
            "|C| |C_p^-1| - (size - 1), norms of Frobenius, lengths in units of the hinges' levers", Closure.condition,
        ),
        _kernel(
            "multipliers", (arguments.Q, GRADIENT), (_MULTIPLIERS,),
            "Forces that hold the closed loops together under a load of the joints.", "lambda = C_p^-T dU/dp",
            partial(motor_programs.multipliers, result=_MULTIPLIERS, gradient=GRADIENT),
        ),
        _kernel(
            "from_joints", (arguments.Q, GRADIENT, HESSIAN), (_OF_MOTORS, _STIFFNESS),
            "Gradient and stiffness of the motors from those of any energy of the joints.",
            f"dU/da = G^T dU/dq; {_FORMULA}",
            lambda chain: motor_programs.reduction(
                chain, (), GRADIENT.array(chain), HESSIAN.array(chain), (_OF_MOTORS, _STIFFNESS), "GK"
            ),
        ),
    )  # fmt: skip


def _of_wrench(chain: Chain) -> tuple[Kernel, ...]:
    """Return the counterparts of J^T F and of ``hybrid.joint_stiffness``."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)
    wrench, task = arguments.wrench("hybrid"), arguments.task_stiffness("hybrid", triangle=True)
    columns = Argument("J", (6, "n"), "", "")

    def torque_program(chain: Chain) -> Program:
        gradient = _TREE["gradient"].array(chain)
        tree = (
            *pose.jacobian(chain, "hybrid", columns)[:1],
            *motor_programs.wrench_gradient(chain, wrench.array(chain), gradient),
        )
        return motor_programs.reduction(chain, tree, gradient, None, (_TORQUE,), "T")

    def stiffness_program(chain: Chain) -> Program:
        gradient, hessian = _TREE["gradient"].array(chain), _TREE["joint_stiffness"]
        tree = stiffness.joint_stiffness(chain, "hybrid", hessian, wrench, task)
        tree += motor_programs.wrench_gradient(chain, wrench.array(chain), gradient)
        return motor_programs.reduction(chain, tree, gradient, hessian.array(chain), (_STIFFNESS,), "K")

    return (
        _kernel(
            "torque", (*configuration, wrench), (_TORQUE,),
            "Torque that a spring with this wrench exerts on the motors.", "-dU/da = -G^T J^T F", torque_program,
        ),
        _kernel(
            "joint_stiffness", (*configuration, wrench, task), (_STIFFNESS,),
            "Joint stiffness of the motors under a wrench and a task stiffness.",
            f"{_FORMULA}, d2U/dq2 = dJ^T/dq . F + J^T (K + Gamma F) J", stiffness_program,
        ),
    )  # fmt: skip


def _of_spring(chain: Chain, spring: Spring) -> tuple[Kernel, ...]:
    """Return torque and stiffness of the motors of a spring."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)
    inputs = (*configuration, *spring.parameters)

    def torque(chain: Chain) -> Program:
        tree = springs.spring_joint_terms(chain, spring, torque=_TREE["torque"])
        return _from_torque(chain, tree, None, (_TORQUE,), "T")

    def stiffness(chain: Chain) -> Program:
        hessian = _TREE["joint_stiffness"]
        tree = springs.spring_joint_terms(chain, spring, torque=_TREE["torque"], joint_stiffness=hessian)
        return _from_torque(chain, tree, hessian, (_STIFFNESS,), "K")

    return (
        _kernel(
            f"{spring.name}_torque", inputs, (_TORQUE,), "Torque of the spring on the motors.",
            f"-dU/da = -G^T J^T F with F = dU; {spring.equation}", torque, spring.domain,
        ),
        _kernel(
            f"{spring.name}_joint_stiffness", inputs, (_STIFFNESS,),
            "Stiffness of the spring for the motors: the exact tangent of their torque.",
            f"{_FORMULA}; {spring.equation}", stiffness, spring.domain,
        ),
    )  # fmt: skip


def _from_torque(
    chain: Chain, tree: Program, hessian: Argument | None, results: tuple[Argument, ...], parts: str
) -> Program:
    """Return the reduction of a program that writes -dU/dq as torque of the tree."""
    torque = _TREE["torque"].array(chain)
    of_tree = hessian.array(chain) if hessian else None
    return motor_programs.reduction(chain, tree, torque, of_tree, results, parts, sign=-1)


def _joint_potential(potential: JointPotential) -> tuple[Kernel, ...]:
    """Return torque and stiffness of the motors of a potential of the joints, passive ones included."""
    inputs = (arguments.Q, *potential.parameters)

    def torque(chain: Chain) -> Program:
        tree = joint_potentials.program(chain, potential, "torque", _TREE["torque"])
        return _from_torque(chain, tree, None, (_TORQUE,), "T")

    def stiffness(chain: Chain) -> Program:
        hessian = _TREE["joint_stiffness"]
        tree = joint_potentials.program(chain, potential, "torque", _TREE["torque"])
        tree += joint_potentials.program(chain, potential, "joint_stiffness", hessian)
        return _from_torque(chain, tree, hessian, (_STIFFNESS,), "K")

    return (
        _kernel(
            f"{potential.name}_torque", inputs, (_TORQUE,), f"Torque on the motors of {potential.title}.",
            f"-dU/da, {potential.equation}", torque, potential.domain,
        ),
        _kernel(
            f"{potential.name}_joint_stiffness", inputs, (_STIFFNESS,),
            f"Stiffness for the motors of {potential.title}.", f"d2U/da2, {potential.equation}", stiffness,
            potential.domain,
        ),
    )  # fmt: skip


def _of_masses(chain: Chain) -> tuple[Kernel, ...]:
    """Return mass matrix, bias forces and gravity of the motors."""
    configuration = configuration_arguments(runtime_tool=False, floating=chain.floating)
    falling = (*configuration, arguments.GRAVITY)
    mass = Argument("mass_matrix", ("a", "a"), "kg m^2", "of the motors, bitwise symmetric", symmetric=True)
    bias = Argument("bias_forces", ("a",), "N m or N", "the sum with M dda is the motors' torque of the motion")
    gradient = replace(
        _OF_MOTORS, name="gradient", meaning=f"dU/da: torque of the motors that balances gravity, {_MOTORS}"
    )
    tree_mass = Argument("mass_matrix_of_tree", ("n", "n"), "", "", symmetric=True)

    def mass_program(chain: Chain) -> Program:
        tree = dynamics.mass_matrix(chain, tree_mass)
        return motor_programs.mass_matrix(chain, tree, tree_mass.array(chain), mass)

    def bias_program(chain: Chain) -> Program:
        forces = Argument("forces", ("n",), "", "")
        tree = partial(dynamics.bias_forces, chain, forces)
        return motor_programs.bias_forces(chain, tree, forces.array(chain), MOTOR_VELOCITY, bias)

    def gravity(chain: Chain) -> Program:
        tree = dynamics.gravity_gradient(chain, _TREE["gradient"])
        return motor_programs.reduction(chain, tree, _TREE["gradient"].array(chain), None, (gradient,), "G")

    def gravity_stiffness(chain: Chain) -> Program:
        hessian = _TREE["joint_stiffness"]
        tree = dynamics.gravity_gradient(chain, _TREE["gradient"])
        written = {array.name for step in tree for array in step.writes}
        for_hessian = dynamics.gravity_joint_stiffness(chain, hessian)  # without the steps that both programs share
        tree += tuple(step for step in for_hessian if not {array.name for array in step.writes} & written)
        return motor_programs.reduction(
            chain, tree, _TREE["gradient"].array(chain), hessian.array(chain), (_STIFFNESS,), "K"
        )

    kernels = (
        _kernel(
            "mass_matrix", (arguments.Q,), (mass,), "Mass matrix in motor coordinates.", "G^T M G", mass_program,
            "Rotor inertias are not included.",
        ),
        _kernel(
            "bias_forces", (*configuration, MOTOR_VELOCITY, arguments.GRAVITY), (bias,),
            "Bias forces of the motors: Coriolis, centrifugal and gravity forces.",
            "G^T (M dG/dt da + h(q, G da))", bias_program,
        ),
        _kernel(
            "gravity_gradient", falling, (gradient,), "Gravity torque of the motors.", "dU/da = G^T dU/dq", gravity,
        ),
        _kernel(
            "gravity_joint_stiffness", falling, (_STIFFNESS,), "Joint stiffness of gravity for the motors.", _FORMULA,
            gravity_stiffness,
        ),
    )  # fmt: skip
    return tuple(replace(kernel, of_masses=True) for kernel in kernels)
