# SPDX-License-Identifier: MIT
"""Oracles of the manipulability."""

from __future__ import annotations

from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.references import References
from stiffgen.families.manipulability.reference import Manipulability


def manipulability(r: References) -> Manipulability:
    """Return measure and gradient from the singular values of the columns of the joints on the way to the tip."""
    on_the_way = r.chain.without_side_joints().joints[r.chain.base_joints :]
    columns = sorted({joint.coordinate for joint in on_the_way})
    transposed_rates = r.derivative["body"][:, r.chain.base_joints :, columns]  # dJ^T/dq_i, (samples, n, columns, 6)
    return Manipulability.of(r.jacobian["body"][:, :, columns], derivative=transposed_rates.transpose(0, 1, 3, 2))


ORACLES = {
    "manipulability": (
        Oracle(
            "singular values",
            lambda r: r.of(manipulability).measure,
            errors=lambda r: r.of(manipulability).measure_error,
        ),
    ),
    "manipulability_gradient": (
        Oracle(
            "singular values",
            lambda r: r.of(manipulability).gradient,
            errors=lambda r: r.of(manipulability).gradient_error,
        ),
    ),
}
