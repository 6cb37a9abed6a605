"""Gains for motors with a controller inside: a torque split into tau_ff, kp and kd. NAME_gains.h for NumPy arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _c


class Gains(NamedTuple):
    """Command for motors that apply tau_ff + kp (q_des - q) + kd (dq_des - dq), each (n) [N m, N m/rad, N m s/rad]."""

    tau_ff: NDArray[np.float64]
    kp: NDArray[np.float64]
    kd: NDArray[np.float64]


def joint_gains(
    *,
    q: ArrayLike,
    dq: ArrayLike,
    torque: ArrayLike,
    joint_stiffness: ArrayLike,
    damping: ArrayLike,
    kp_limit: ArrayLike,
    kd_limit: ArrayLike,
    q_des: ArrayLike | None = None,
    dq_des: ArrayLike = 0.0,
) -> Gains:
    """Split a torque at (q, dq) for motors with a controller inside.

    kp and kd are the diagonals of ``joint_stiffness`` and ``damping`` (n, n), at least 0 and at most their limits; what
    is not diagonal stays in tau_ff. ``q_des`` is q without one. Raises ValueError for numbers that are not finite.
    """
    n, matrix = (_c.MOTORS,), (_c.MOTORS, _c.MOTORS)
    wanted = q if q_des is None else q_des
    vectors = [(value, n) for value in (q, dq, wanted, dq_des, torque)]
    limits = ((kp_limit, n), (kd_limit, n))
    results = np.empty((3, _c.MOTORS))
    code = _c.joint_gains(_packed(*vectors, (joint_stiffness, matrix), (damping, matrix), *limits), results)
    if code:
        raise ValueError("joint_gains: every argument must be finite, and no limit below 0")
    return Gains(*results)


def late_work(
    *,
    q: ArrayLike,
    q_des: ArrayLike,
    tau_ff: ArrayLike,
    kp: ArrayLike,
    kd: ArrayLike,
    velocity_limit: ArrayLike,
    hold: float,
    dq_des: ArrayLike = 0.0,
) -> float:
    """Return the most work [J] that motors put out from q on if their next command comes after at most ``hold`` [s].

    No joint is faster than ``velocity_limit`` (n). NaN for numbers that are not finite, or below 0.
    """
    vectors = [(value, (_c.MOTORS,)) for value in (q, q_des, dq_des, tau_ff, kp, kd, velocity_limit)]
    return float(_c.late_work(_packed(*vectors), hold))


def _packed(*parts: tuple[ArrayLike, tuple[int, ...]]) -> NDArray[np.float64]:
    return np.concatenate([np.broadcast_to(np.asarray(value, float), shape).ravel() for value, shape in parts])
