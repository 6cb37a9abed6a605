# SPDX-License-Identifier: MIT
"""Family record: potentials of the joints in motor coordinates."""

from __future__ import annotations

from dataclasses import replace

from stiffgen.core.family import Family
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Program
from stiffgen.families.joints import kernels as joint_potentials
from stiffgen.families.joints.kernels import JOINT_POTENTIALS, JointPotential
from stiffgen.families.loops.kernels import MOTOR_STIFFNESS, MOTOR_TORQUE, OF_TREE, from_torque, motor_kernel


def _joint_potential(potential: JointPotential) -> tuple[Kernel, ...]:
    """Return torque and stiffness of the motors of a potential of the joints, passive ones included."""
    inputs = (arguments.Q, *potential.parameters)

    def torque(chain: Chain) -> Program:
        tree = joint_potentials.program(chain, potential, "torque", OF_TREE["torque"])
        return from_torque(chain, tree, None, (MOTOR_TORQUE,), "T")

    def stiffness(chain: Chain) -> Program:
        hessian = OF_TREE["joint_stiffness"]
        tree = joint_potentials.program(chain, potential, "torque", OF_TREE["torque"])
        tree += joint_potentials.program(chain, potential, "joint_stiffness", hessian)
        return from_torque(chain, tree, hessian, (MOTOR_STIFFNESS,), "K")

    return (
        motor_kernel(
            f"{potential.name}_torque",
            inputs=inputs,
            results=(MOTOR_TORQUE,),
            summary=f"Torque on the motors of {potential.title}.",
            equation=f"-dU/da, {potential.equation}",
            program=torque,
            note=potential.domain,
        ),
        motor_kernel(
            f"{potential.name}_joint_stiffness",
            inputs=inputs,
            results=(MOTOR_STIFFNESS,),
            summary=f"Stiffness for the motors of {potential.title}.",
            equation=f"d2U/da2, {potential.equation}",
            program=stiffness,
            note=potential.domain,
        ),
    )


FAMILY = Family(
    kernels={
        "motors, joints": lambda of: (
            replace(each, of_coordinates=True) for potential in JOINT_POTENTIALS for each in _joint_potential(potential)
        )
    },
    oracles="loops.oracles_of_joints",
)
