# SPDX-License-Identifier: MIT
"""Springs at the tip: energy, wrench, task stiffness, torque and joint stiffness of one energy."""

from __future__ import annotations

from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import quantities
from stiffgen.core.symbolic.arguments import POSE, Argument
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.pieces import columns_and_pose, over_joints, tangent, tip_pose
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, StraightLine
from stiffgen.families.springs import springs
from stiffgen.families.springs.springs import Spring


def spring_terms(chain: Chain, spring: Spring, results: tuple[Argument, ...], parts: str) -> Program:
    """Return the program of a spring's energy, wrench or task stiffness; ``parts`` is as in :func:`springs.terms`."""
    pose, outputs = POSE.array(chain), tuple(result.array(chain) for result in results)
    return (tip_pose(chain, pose), spring_step(chain, spring, pose, outputs, parts))


def spring_step(chain: Chain, spring: Spring, pose: Array, outputs: tuple[Array, ...], parts: str) -> StraightLine:
    """Return the step that computes the quantities of a spring that ``parts`` selects (:func:`springs.terms`)."""
    expressions = partial(springs.terms, spring=spring, parts=parts)
    parameters = tuple(argument.array(chain) for argument in spring.parameters)
    names = {"U": "energy U", "F": "wrench F = dU", "K": "covariant Hessian K of U", "k": "covariant Hessian K of U"}
    names["s"] = "sums s of absolute values in the rows of K"
    return StraightLine(outputs, expressions, (pose, *parameters), heading=", ".join(names[part] for part in parts))


def spring_joint_terms(
    chain: Chain,
    spring: Spring,
    energy: Argument | None = None,
    torque: Argument | None = None,
    joint_stiffness: Argument | None = None,
) -> Program:
    """Return the program of docs/theory.md (1): energy, torque, joint stiffness of a spring, or some, in one pass."""
    pose, m = POSE.array(chain), len(chain.joints)
    J, F, K = Array("J", (6, m)), Array("F", (6,)), Array("K", (6, 6))
    parts = "U" * bool(energy) + "F" + "k" * bool(joint_stiffness)  # letters of springs.terms()
    array_of = {"F": F, "k": K} | ({"U": energy.array(chain)} if energy else {})
    outputs = tuple(array_of[part] for part in parts)

    def torques(output: Array) -> Program:
        operands = Operand(J, "j"), Operand(F, "")
        return (Map("torque_j = -J_j . F", Over.JOINTS, Operand(output, "j"), operands, _minus_dot),)

    def stiffness(output: Array) -> Program:
        return tangent(chain, J, F, K, "hybrid", output)

    # once for the tip; then a loop over the joints for each result in joints
    program: Program = (columns_and_pose(chain, J, pose), spring_step(chain, spring, pose, outputs, parts))
    if torque:
        program += over_joints(chain, torque, torques)
    if joint_stiffness:
        program += over_joints(chain, joint_stiffness, stiffness, mirror=True)
    return program


def _minus_dot(column: ca.SX, wrench: ca.SX) -> ca.SX:
    return ca.SX(-ca.dot(column, wrench))


_ENERGY = Argument("energy", (), "J", "energy U of the spring, 0 at the equilibrium")


_SPRING_WRENCH = Argument.referred(
    "wrench", (6,), "N, N m",
    "F = dU, (force, moment) that balances the spring at the tip, in {reference} axes, moment about the tip's origin",
    blocks=quantities.WRENCH,
)  # fmt: skip


_SPRING_TASK_STIFFNESS = Argument.referred(
    "task_stiffness", (6, 6), "N/m, N, N m",
    "covariant Hessian of U on twists (linear, angular), {reference} axes at the tip's origin; bitwise symmetric",
    symmetric=True, blocks=quantities.STIFFNESS,
)  # fmt: skip


_SPRING_TORQUE = Argument("torque", ("n",), "N m or N", "-dU/dq: torque that the spring exerts on the joints")


_SPRING_JOINT_STIFFNESS = Argument(
    "joint_stiffness", ("n", "n"), "N m/rad", "d2U/dq2 = -d torque/dq, bitwise symmetric", symmetric=True
)


def spring_kernels(spring: Spring, configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels that follow from one energy; one of them returns torque and tangent in one call."""
    energy, torque, joint = _ENERGY, _SPRING_TORQUE, _SPRING_JOINT_STIFFNESS
    terms, joint_terms = spring_terms, spring_joint_terms
    hessian = "Kq = dJ^T/dq . F + J^T (K + Gamma F) J with F = dU and K the covariant Hessian"

    inputs = (*configuration, *spring.parameters)
    kernel = partial(Kernel, group=spring.name, arguments=inputs, note=spring.domain, batch=True)
    return (
        kernel(
            name="energy",
            results=(energy,),
            summary="Energy of the spring between the tip and the equilibrium.",
            equation=spring.equation,
            program=partial(terms, spring=spring, results=(energy,), parts="U"),
        ),
        kernel(
            name="wrench",
            results=(_SPRING_WRENCH,),
            summary="Wrench of the spring: gradient of its energy.",
            equation="F = dU",
            program=partial(terms, spring=spring, results=(_SPRING_WRENCH,), parts="F"),
        ),
        kernel(
            name="task_stiffness",
            results=(_SPRING_TASK_STIFFNESS,),
            summary="Task stiffness of the spring: covariant Hessian of its energy.",
            equation="K_ij = d2/dx_i dx_j U(p + v, exp([w]) R) at x = (v, w) = 0",
            program=partial(terms, spring=spring, results=(_SPRING_TASK_STIFFNESS,), parts="K"),
        ),
        kernel(
            name="torque",
            results=(torque,),
            summary="Joint torque of the spring.",
            equation="-dU/dq = -J^T F with F = dU",
            program=partial(joint_terms, spring=spring, torque=torque),
        ),
        kernel(
            name="joint_stiffness",
            results=(joint,),
            summary="Joint stiffness of the spring: the exact tangent of its torque.",
            equation=f"d2U/dq2 = {hessian} (Lachner, Nah, Hogan 2025)",
            program=partial(joint_terms, spring=spring, joint_stiffness=joint),
            part_of="linearization",
        ),
        kernel(
            name="linearization",
            results=(energy, torque, joint),
            summary="Energy, torque and joint stiffness of the spring in one call.",
            equation=f"U, -dU/dq = -J^T F, d2U/dq2 = {hessian}",
            program=partial(joint_terms, spring=spring, energy=energy, torque=torque, joint_stiffness=joint),
        ),
    )
