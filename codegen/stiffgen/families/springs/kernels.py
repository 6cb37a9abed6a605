# SPDX-License-Identifier: MIT
"""Springs at the tip: energy, wrench, task stiffness, torque and joint stiffness of one energy."""

from __future__ import annotations

from collections.abc import Callable
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
    columns = columns_and_pose(chain, J, pose)
    outputs = [F, K] if joint_stiffness else [F]
    parts = "Fk" if joint_stiffness else "F"
    if energy:
        outputs, parts = [energy.array(chain), *outputs], "U" + parts
    # once for the tip; then a loop over the joints for each result in joints
    program: Program = (columns, spring_step(chain, spring, pose, tuple(outputs), parts))
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
            chain, joint_stiffness, lambda output: tangent(chain, J, F, K, "hybrid", output), mirror=True
        )
    return program


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

    def kernel(
        name: str,
        results: tuple[Argument, ...],
        summary: str,
        equation: str,
        program: Callable[[Chain], Program],
        part_of: str = "",
    ) -> Kernel:
        arguments = (*configuration, *spring.parameters)
        return Kernel(
            name,
            spring.name,
            arguments,
            results,
            summary,
            equation,
            program,
            spring.domain,
            batch=True,
            part_of=part_of,
        )

    return (
        kernel(
            "energy", (energy,), "Energy of the spring between the tip and the equilibrium.", spring.equation,
            partial(terms, spring=spring, results=(energy,), parts="U"),
        ),
        kernel(
            "wrench", (_SPRING_WRENCH,), "Wrench of the spring: gradient of its energy.", "F = dU",
            partial(terms, spring=spring, results=(_SPRING_WRENCH,), parts="F"),
        ),
        kernel(
            "task_stiffness", (_SPRING_TASK_STIFFNESS,),
            "Task stiffness of the spring: covariant Hessian of its energy.",
            "K_ij = d2/dx_i dx_j U(p + v, exp([w]) R) at x = (v, w) = 0",
            partial(terms, spring=spring, results=(_SPRING_TASK_STIFFNESS,), parts="K"),
        ),
        kernel(
            "torque", (torque,), "Joint torque of the spring.", "-dU/dq = -J^T F with F = dU",
            partial(joint_terms, spring=spring, torque=torque),
        ),
        kernel(
            "joint_stiffness", (joint,), "Joint stiffness of the spring: the exact tangent of its torque.",
            f"d2U/dq2 = {hessian} (Lachner, Nah, Hogan 2025)",
            partial(joint_terms, spring=spring, joint_stiffness=joint),
            part_of="linearization",
        ),
        kernel(
            "linearization", (energy, torque, joint),
            "Energy, torque and joint stiffness of the spring in one call.",
            f"U, -dU/dq = -J^T F, d2U/dq2 = {hessian}",
            partial(joint_terms, spring=spring, energy=energy, torque=torque, joint_stiffness=joint),
        ),
    )  # fmt: skip
