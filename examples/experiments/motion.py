# SPDX-License-Identifier: MIT
"""Provide the equilibrium's motion: an approach at minimum jerk, then a recorded zero-force trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

Array = NDArray[np.float64]

SAMPLE_TIME = 0.005
"""[s] between the recorded samples."""
APPROACH_TIME = 5.0
"""[s] of the minimum-jerk move from the start configuration to the trajectory's start."""
SMOOTHING = {"window_length": 11, "polyorder": 3, "axis": 0}
"""Savitzky-Golay filter of the paper's trajectories."""


@dataclass(frozen=True)
class Motion:
    """Zero-force joint trajectory on a grid of times.

    Attributes:
        time: (N,) [s].
        q0, dq0: (N, n) positions [rad] and velocities [rad/s].
        pressing: (N,) whether the recorded trajectory runs; before it the approach.

    """

    time: Array
    q0: Array
    dq0: Array
    pressing: NDArray[np.bool_]


def minimum_jerk(s: ArrayLike) -> Array:
    """Return the position from 0 to 1 over the time share s, clipped to 0 ... 1 (Flash and Hogan 1985)."""
    share = np.clip(np.asarray(s, dtype=float), 0.0, 1.0)
    return np.asarray(share**3 * (10 - 15 * share + 6 * share**2))


def approach_and_follow(record: Array, start: Array, sample_time: float) -> Motion:
    """Return the approach from a start configuration (n,) [rad], then a record (N, n) [rad], at any sample time [s].

    A record has four decimals, which is coarse for a velocity; so dq0 is its Savitzky-Golay derivative.
    """
    knots = SAMPLE_TIME * np.arange(len(record))
    count = round((APPROACH_TIME + knots[-1]) / sample_time) + 1
    time = sample_time * np.arange(count)
    pressing = time >= APPROACH_TIME - 1e-9
    s = time[~pressing] / APPROACH_TIME
    way = record[0] - start
    rate = 30 * s**2 * (1 - s) ** 2 / APPROACH_TIME
    at = np.minimum(time[pressing] - APPROACH_TIME, knots[-1])
    velocity = savgol_filter(record, deriv=1, delta=SAMPLE_TIME, **SMOOTHING)
    q0 = np.concatenate([start + minimum_jerk(s)[:, None] * way, CubicSpline(knots, record)(at)])
    dq0 = np.concatenate([rate[:, None] * way, CubicSpline(knots, velocity)(at)])
    return Motion(time, q0, dq0, pressing)


def damped_inverse(J: Array, mass_matrix: Array, damping: float) -> Array:
    """Return the inertia-weighted damped pseudo-inverse W J^T (J W J^T + k I)^-1 (..., n, 6), W = M^-1.

    Args:
        J: Jacobians (..., 6, n).
        mass_matrix: M (..., n, n) [kg m^2].
        damping: k.

    """
    W = np.linalg.inv(mass_matrix)
    transposed = np.swapaxes(J, -1, -2)
    return np.asarray(W @ transposed @ np.linalg.inv(J @ W @ transposed + damping * np.eye(6)))
