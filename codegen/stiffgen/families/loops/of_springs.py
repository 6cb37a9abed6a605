# SPDX-License-Identifier: MIT
"""Family record: springs in motor coordinates."""

from __future__ import annotations

from stiffgen.core.family import Family
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import configuration_arguments
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.program import Program
from stiffgen.families.loops.kernels import FORMULA, MOTOR_STIFFNESS, MOTOR_TORQUE, OF_TREE, from_torque, motor_kernel
from stiffgen.families.springs import kernels as springs
from stiffgen.families.springs.springs import Spring


def _of_spring(chain: Chain, spring: Spring) -> tuple[Kernel, ...]:
    """Return torque and stiffness of the motors of a spring."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)
    inputs = (*configuration, *spring.parameters)

    def torque(chain: Chain) -> Program:
        tree = springs.spring_joint_terms(chain, spring, torque=OF_TREE["torque"])
        return from_torque(chain, tree, None, (MOTOR_TORQUE,), "T")

    def stiffness(chain: Chain) -> Program:
        hessian = OF_TREE["joint_stiffness"]
        tree = springs.spring_joint_terms(chain, spring, torque=OF_TREE["torque"], joint_stiffness=hessian)
        return from_torque(chain, tree, hessian, (MOTOR_STIFFNESS,), "K")

    return (
        motor_kernel(
            f"{spring.name}_torque",
            inputs=inputs,
            results=(MOTOR_TORQUE,),
            summary="Torque of the spring on the motors.",
            equation=f"-dU/da = -G^T J^T F with F = dU; {spring.equation}",
            program=torque,
            note=spring.domain,
        ),
        motor_kernel(
            f"{spring.name}_joint_stiffness",
            inputs=inputs,
            results=(MOTOR_STIFFNESS,),
            summary="Stiffness of the spring for the motors: the exact tangent of their torque.",
            equation=f"{FORMULA}; {spring.equation}",
            program=stiffness,
            note=spring.domain,
        ),
    )


FAMILY = Family(
    kernels={"motors, tip": lambda of: (each for spring in of.springs for each in _of_spring(of.chain, spring))},
    oracles="loops.oracles_of_springs",
)
