# SPDX-License-Identifier: MIT
"""Family record: dynamics in motor coordinates."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from stiffgen.core.family import Family
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import Argument, configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Program
from stiffgen.families.dynamics import kernels as dynamics
from stiffgen.families.loops import programs as motor_programs
from stiffgen.families.loops.kernels import (
    FORMULA,
    MOTOR_GRADIENT,
    MOTOR_STIFFNESS,
    MOTOR_VELOCITY,
    OF_TREE,
    ORDER,
    motor_kernel,
)


def _of_masses(chain: Chain) -> tuple[Kernel, ...]:
    """Return mass matrix, bias forces and gravity of the motors."""
    configuration = configuration_arguments(runtime_tool=False, floating=chain.floating)
    mass = Argument("mass_matrix", ("a", "a"), "kg m^2", "of the motors, bitwise symmetric", symmetric=True)
    bias = Argument("bias_forces", ("a",), "N m or N", "the sum with M dda is the motors' torque of the motion")
    tree_mass = Argument("mass_matrix_of_tree", ("n", "n"), "", "", symmetric=True)

    def mass_program(chain: Chain) -> Program:
        tree = dynamics.mass_matrix(chain, tree_mass)
        return motor_programs.mass_matrix(chain, tree, tree_mass.array(chain), mass)

    def bias_program(chain: Chain) -> Program:
        forces = Argument("forces", ("n",), "", "")
        tree = partial(dynamics.bias_forces, chain, forces)
        return motor_programs.bias_forces(chain, tree, forces.array(chain), MOTOR_VELOCITY, bias)

    kernels = (
        motor_kernel(
            "mass_matrix",
            inputs=(arguments.Q,),
            results=(mass,),
            summary="Mass matrix in motor coordinates.",
            equation="G^T M G",
            program=mass_program,
            note="Rotor inertias are not included.",
        ),
        motor_kernel(
            "bias_forces",
            inputs=(*configuration, MOTOR_VELOCITY, arguments.GRAVITY),
            results=(bias,),
            summary="Bias forces of the motors: Coriolis, centrifugal and gravity forces.",
            equation="G^T (M dG/dt da + h(q, G da))",
            program=bias_program,
        ),
        *_of_gravity((*configuration, arguments.GRAVITY)),
    )
    return tuple(replace(kernel, of_masses=True) for kernel in kernels)


def _of_gravity(inputs: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return gravity's torque and stiffness of the motors."""
    gradient = replace(
        MOTOR_GRADIENT, name="gradient", meaning=f"dU/da: torque of the motors that balances gravity, {ORDER}"
    )

    def gravity(chain: Chain) -> Program:
        tree = dynamics.gravity_gradient(chain, OF_TREE["gradient"])
        return motor_programs.reduction(chain, tree, OF_TREE["gradient"].array(chain), None, (gradient,), "G")

    def gravity_stiffness(chain: Chain) -> Program:
        """Return the program of gravity's stiffness for the motors, from the tree's gradient and Hessian."""
        hessian = OF_TREE["joint_stiffness"]
        tree = dynamics.gravity_gradient(chain, OF_TREE["gradient"])
        written = {array.name for step in tree for array in step.writes}
        for_hessian = dynamics.gravity_joint_stiffness(chain, hessian)  # without the steps that both programs share
        tree += tuple(step for step in for_hessian if not {array.name for array in step.writes} & written)
        return motor_programs.reduction(
            chain, tree, OF_TREE["gradient"].array(chain), hessian.array(chain), (MOTOR_STIFFNESS,), "K"
        )

    return (
        motor_kernel(
            "gravity_gradient",
            inputs=inputs,
            results=(gradient,),
            summary="Gravity torque of the motors.",
            equation="dU/da = G^T dU/dq",
            program=gravity,
        ),
        motor_kernel(
            "gravity_joint_stiffness",
            inputs=inputs,
            results=(MOTOR_STIFFNESS,),
            summary="Joint stiffness of gravity for the motors.",
            equation=FORMULA,
            program=gravity_stiffness,
        ),
    )


FAMILY = Family(kernels={"motors, masses": lambda of: _of_masses(of.chain)}, oracles="loops.oracles_of_dynamics")
