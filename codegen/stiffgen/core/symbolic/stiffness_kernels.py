# SPDX-License-Identifier: MIT
"""Joint stiffness, its parts, and its gradient along a direction."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import arguments, quantities, stiffness
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.pieces import columns_of, over_joints, pairs_of, tangent
from stiffgen.core.symbolic.program import Array, Operand, Over, Program
from stiffgen.core.symbolic.steps import Map, SparseSum


def _two_sided(
    chain: Chain,
    J: Array,
    output: Array,
    representation: Representation,
    covector: Callable[..., ca.SX],
    operands: tuple[Operand, ...],
    *,
    symbol: str,
    matrix: str,
    formula: str,
) -> Program:
    """Return the steps output_ij = J_i . u_j, with separate covectors u_j for joints j beyond and before i.

    For comments, ``symbol`` and ``matrix`` are the letters of covectors and output, ``formula`` is that of u_j.
    """
    beyond, before = Over.STRICTLY_UPPER, Over.LOWER
    if stiffness.diagonal_is_outward(representation):
        beyond, before = Over.UPPER, Over.STRICTLY_LOWER
    maps: list[Map] = []
    for side, over, outward in (("beyond", beyond, True), ("before", before, False)):
        u = Array(f"{symbol}_{side}", J.shape)
        comment = f"{symbol}_j = {formula}, for the joints j {side} joint i"
        expression = partial(covector, representation, outward=outward)
        maps.append(Map(comment, Over.JOINTS, Operand(u, "j"), (Operand(J, "j"), *operands), expression))
        # A floating base moves as one body: each of its joints moves the tip as if it were the joint nearest the base.
        overs = (over, Over.BASE) if chain.floating and not outward else (over,)
        maps += [pairs_of(J, u, each, output, f"{matrix}_ij = J_i . {symbol}_j for {each}") for each in overs]
    return tuple(maps)


def kinematic_stiffness(chain: Chain, representation: Representation, result: Argument, wrench: Argument) -> Program:
    """Return the program of dJ^T/dq . F from covectors of the wrench, with one dot product per pair of joints."""

    def steps(output: Array) -> Program:
        recursion, J = columns_of(chain, representation)
        operands, formula = (Operand(wrench.array(chain), ""),), "gradient of (dJ_i/dq_j) . F with respect to J_i"
        pairs = _two_sided(
            chain, J, output, representation, stiffness.kinematic_covector, operands,
            symbol="z", matrix="Kkin", formula=formula,
        )  # fmt: skip
        return recursion, *pairs

    return over_joints(chain, result, steps)


def joint_stiffness_uncorrected(
    chain: Chain, representation: Representation, result: Argument, wrench: Argument, task_stiffness: Argument
) -> Program:
    """Return the program of docs/theory.md (2), dJ^T/dq . F + J^T K J, all entries."""

    def steps(output: Array) -> Program:
        """Return the program: y_j = K J_j, then Kq_ij over all pairs."""
        recursion, J = columns_of(chain, representation)
        y = Array("y", J.shape)
        matrix = Operand(task_stiffness.array(chain), "")
        product = Map("y_j = K J_j", Over.JOINTS, Operand(y, "j"), (matrix, Operand(J, "j")), ca.mtimes)
        operands = Operand(wrench.array(chain), ""), Operand(y, "j")
        formula = "y_j + gradient of (dJ_i/dq_j) . F with respect to J_i"
        pairs = _two_sided(
            chain, J, output, representation, stiffness.uncorrected_covector, operands,
            symbol="u", matrix="Kq", formula=formula,
        )  # fmt: skip
        return recursion, product, *pairs

    return over_joints(chain, result, steps)


def joint_stiffness(
    chain: Chain, representation: Representation, result: Argument, wrench: Argument, task_stiffness: Argument
) -> Program:
    """Return the program of docs/theory.md (3), dJ^T/dq . F + J^T (K + Gamma F) J: one triangle, mirrored."""

    def steps(output: Array) -> Program:
        recursion, J = columns_of(chain, representation)
        F, K = wrench.array(chain), task_stiffness.array(chain)
        return (recursion, *tangent(chain, J, F, K, representation, output))

    return over_joints(chain, result, steps, mirror=True)


def connection_correction(chain: Chain, representation: Representation, result: Argument, wrench: Argument) -> Program:
    """Return the program of Gamma F, in hybrid form docs/theory.md (4)."""
    output, operands = result.array(chain), (wrench.array(chain),)
    expression = partial(stiffness.gamma_F, representation)
    return (SparseSum("Gamma F", output, None, operands, expression, stiffness.halves_of_wrench),)


_SPATIAL_NOTE = (
    "The spatial connection differs from the body and hybrid one: the same task stiffness and wrench, moved to the "
    "{reference}'s origin, give a different joint stiffness."
)


def stiffness_kernels(rep: Representation, configuration: tuple[Argument, ...], reference: str) -> tuple[Kernel, ...]:
    """Return the kernels of the stiffness in one representation; ``reference`` names the frame of the moments."""
    wrench = arguments.wrench(rep)
    upper = arguments.task_stiffness(rep, symmetric_part=True)
    full = arguments.task_stiffness(rep, symmetric_part=False)
    spatial = _SPATIAL_NOTE.format(reference=reference) if rep == "spatial" else ""
    kinematic = Argument("kinematic_stiffness", ("n", "n"), "N m/rad", "column i is dJ^T/dq_i F; not symmetric")
    correction = Argument(
        "connection_correction", (6, 6), "N, N m", "(Gamma F)_ij = sum_k Gamma^k_ij F_k, added to the task stiffness",
        blocks=quantities.STIFFNESS,
    )  # fmt: skip
    joint = Argument("joint_stiffness", ("n", "n"), "N m/rad", "bitwise symmetric", symmetric=True)
    uncorrected = Argument("joint_stiffness_uncorrected", ("n", "n"), "N m/rad", "not symmetric under a moment")
    return (
        Kernel(
            name="kinematic_stiffness", group=rep, arguments=(*configuration, wrench), results=(kinematic,),
            summary="Kinematic stiffness: derivative of the joint torques of a constant wrench with respect to q.",
            equation="Kkin = dJ^T/dq . F (Lachner, Nah, Hogan 2025, central equation, first term)",
            program=partial(kinematic_stiffness, representation=rep, result=kinematic, wrench=wrench),
        ),
        Kernel(
            name="connection_correction", group=rep, arguments=(wrench,), results=(correction,),
            summary="Christoffel-symbol correction of the task stiffness.",
            equation="Gamma F (Lachner, Nah, Hogan 2025, central equation and appendix)",
            program=partial(connection_correction, representation=rep, result=correction, wrench=wrench),
            note=spatial,
        ),
        Kernel(
            name="joint_stiffness", group=rep, arguments=(*configuration, wrench, upper), results=(joint,),
            summary="Symmetric joint stiffness with the correction by the connection.",
            equation="Kq = dJ^T/dq . F + J^T (K + Gamma F) J (Lachner, Nah, Hogan 2025, central equation)",
            program=partial(joint_stiffness, representation=rep, result=joint, wrench=wrench, task_stiffness=upper),
            note=spatial,
            batch=True,
        ),
        Kernel(
            name="joint_stiffness_uncorrected", group=rep, arguments=(*configuration, wrench, full),
            results=(uncorrected,),
            summary="Conventional joint stiffness, without the correction; for comparison.",
            equation="dJ^T/dq . F + J^T K J",
            program=partial(
                joint_stiffness_uncorrected, representation=rep, result=uncorrected, wrench=wrench, task_stiffness=full
            ),
        ),
    )  # fmt: skip
