# SPDX-License-Identifier: MIT
"""Oracles of the tip's compliance: linear systems of the differentiated Jacobians, solved with exchange of rows.

NumPy inverts with an exchange of rows, in double precision alone. Corrections with residuals in long numbers make the
solution as good as these are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.references import WRENCH, References, load_stiffness
from stiffgen.core.verify.kernels.samples import symmetric
from stiffgen.families.compliance.kernels import JOINT_QUANTITIES, increment, joint_stiffness

_CORRECTIONS = 3
KTH = joint_stiffness("n")
NAMES = "loaded_hessian", "tip_compliance", "tip_stiffness", "deflection", "stability"


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solutions of stacks of linear systems, corrected by residuals."""
    inverse = np.linalg.inv(matrix.astype(float))
    solution = inverse @ right
    for _ in range(_CORRECTIONS):
        solution = solution + inverse @ (right - matrix @ solution)
    return solution


def results(H: FloatArray, J: FloatArray, increments: FloatArray) -> dict[str, Callable[[], FloatArray]]:
    """Return functions of the results by name; each computes its result when it is called.

    ``H`` is the loaded Hessian (states, n, n), ``J`` the Jacobian (states, 6, n), and the increments of the wrench are
    (states, 6), with 6 rows for each tip. The stability is the smallest eigenvalue of H: a posture at rest is stable
    if it is positive.
    """
    J_T = np.swapaxes(J, 1, 2)
    states, rows, _ = J.shape

    def compliance() -> FloatArray:  # C = J H^-1 J^T
        return np.asarray(J @ solved(H, J_T))

    def stiffness() -> FloatArray:  # C^-1
        return solved(compliance(), np.broadcast_to(np.eye(rows), (states, rows, rows)))

    def deflection() -> FloatArray:  # H^-1 J^T dF, with dF as a column
        return solved(H, J_T @ increments[..., None])[..., 0]

    return {
        "loaded_hessian": lambda: H,
        "tip_compliance": compliance,
        "tip_stiffness": stiffness,
        "deflection": deflection,
        "stability": lambda: np.linalg.eigvalsh(H.astype(float))[:, 0],  # in ascending order
    }


def load(r: References, representation: Representation) -> FloatArray:
    """Return the stiffness of the samples' wrenches: of a spatial one, that of the same wrench at the tip."""
    if representation != "spatial":
        return load_stiffness(r, representation)
    wrench = np.array(r.samples[WRENCH], dtype=r.pose.dtype)
    wrench[:, 3:] -= np.cross(r.pose[:, :3, 3], wrench[:, :3])
    return load_stiffness(r, "hybrid", wrench)


def _of_tip(r: References, representation: Representation, name: str) -> FloatArray:
    H = symmetric(r.samples[KTH]) - load(r, representation)
    return results(H, r.jacobian[representation], r.samples[increment(representation)])[name]()


def _of_tips(r: References, representation: Representation, name: str) -> FloatArray:
    H = symmetric(r.samples[KTH]) - sum(load(each, representation) for each in r.tips)
    J = np.concatenate([each.jacobian[representation] for each in r.tips], axis=1)
    increments = r.samples[increment(representation).of_all_tips([tip.name for tip in r.chain.tips])]
    return results(H, J, increments.reshape(len(J), -1))[name]()


COMPLIANCE_ORACLES = {
    f"{rep}_{name}{suffix}": (Oracle("exchange of rows", partial(values, representation=rep, name=name)),)
    for values, suffix in ((_of_tip, ""), (_of_tips, "_total"))
    for rep in REPRESENTATIONS
    for name in NAMES
    if rep != "spatial" or name not in JOINT_QUANTITIES
}
