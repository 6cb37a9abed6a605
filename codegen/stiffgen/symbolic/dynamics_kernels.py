# SPDX-License-Identifier: MIT
"""Kernel table of a robot's dynamics: mass matrix, bias forces, gravity, and the torque at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from stiffgen.robot.chain import Tip
from stiffgen.symbolic import arguments, programs, static_torque
from stiffgen.symbolic.arguments import Argument, configuration_arguments
from stiffgen.symbolic.kernel import Kernel
from stiffgen.symbolic.program import Program

_MASS = Argument(
    "mass_matrix", ("n", "n"), "kg m^2", "symmetric, positive definite where every joint moves a mass", symmetric=True
)
_MASS_MATRIX = Kernel(
    "mass_matrix", None, (arguments.Q,), (_MASS,),
    "Joint-space mass matrix.",
    "M_ij = J_i . I^c_j J_j, composite bodies (Featherstone 2008)",
    partial(programs.mass_matrix, result=_MASS),
    "Links beyond the chain move with it: their joints stay at zero, except joints that mimic a coordinate of q. Rotor "
    "inertias are not included, since a URDF does not hold them.",
    batch=True,
    of_masses=True,
)  # fmt: skip


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
    inputs: tuple[Argument, ...], result: Argument, summary: str, equation: str, program: Callable[..., Program]
) -> Kernel:
    return Kernel(
        result.name, "gravity", inputs, (result,), summary, equation, partial(program, result=result),
        _MASS_MATRIX.note, batch=True, of_masses=True,
    )  # fmt: skip


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
        _STATIC_TORQUE.name, None, (*inputs, arguments.GRAVITY), (_STATIC_TORQUE,),
        "Derivative of the joint torques at rest under gravity and constant wrenches.",
        "d(dU/dq - J^T F)/dq, with J and F in hybrid representation",
        partial(static_torque.static_torque_derivatives, result=_STATIC_TORQUE, inputs=inputs),
        f"The torque dU/dq - J^T F holds the robot. {_MASS_MATRIX.note}",
        batch=True, of_masses=True,
    )  # fmt: skip


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
            "bias_forces", None, (*configuration, arguments.VELOCITY, arguments.GRAVITY), (_BIAS,),
            "Bias forces: Coriolis, centrifugal and gravity forces.",
            "C(q, dq) dq + dU/dq, recursive Newton-Euler algorithm (Luh, Walker, Paul 1980)",
            partial(programs.bias_forces, result=_BIAS),
            f"Zero gravity gives the Coriolis and centrifugal forces alone. {_MASS_MATRIX.note}",
            batch=True,
            of_masses=True,
        ),
        _gravity_kernel(
            falling, _GRAVITY_ENERGY, "Potential energy of gravity.", "U = -g . sum of m_k c_k",
            programs.gravity_energy,
        ),
        _gravity_kernel(
            falling, _GRAVITY_GRADIENT, "Gravity torque: gradient of the potential energy.", "dU/dq_j = -g . w_j",
            programs.gravity_gradient,
        ),
        _gravity_kernel(
            falling, _GRAVITY_STIFFNESS, "Joint stiffness of gravity: Hessian of the potential energy.",
            f"d2U/dq_i dq_j = a_i . (g x w_j){base}", programs.gravity_joint_stiffness,
        ),
        _static_torque(tips, runtime_tool=runtime_tool, floating=floating),
    )  # fmt: skip
