# SPDX-License-Identifier: MIT
"""Joint potentials, differentiated by hand."""

from __future__ import annotations

import numpy as np

from stiffgen.core.robot.geometry import FloatArray


def by_hand(group: str, q: FloatArray, *parameters: FloatArray) -> dict[str, FloatArray]:
    """Return energy (P), torque (P, n) and joint stiffness (P, n, n) of a joint potential, differentiated by hand."""
    if group == "posture":
        posture, k = parameters
        away = q - posture
        energy, torque, slope = k * away**2 / 2, -k * away, k
    else:
        lower, upper, zone, k = parameters
        w = zone[:, None]
        # Depths beyond the zones' edges; with a short range a joint is in both zones.
        above, below = np.maximum(0.0, q - upper + w), np.maximum(0.0, lower + w - q)
        # a stiffness that grows from 0 at the zone's edge to k at the limit
        energy = k / (6 * w) * (above**3 + below**3)
        torque = k / (2 * w) * (below**2 - above**2)
        slope = k / w * (above + below)
    return {"energy": energy.sum(axis=1), "torque": torque, "joint_stiffness": slope[:, :, None] * np.eye(q.shape[1])}
