# SPDX-License-Identifier: MIT
"""Record of small motions about a pose, with the readings of a force-torque sensor there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import RecordingError
from stiffgen.core.robot.geometry import FloatArray

FEWEST = 200
"""Fewest rows: 27 columns of a quadratic fit and the residuals' covariance need some ten rows each."""


@dataclass(frozen=True)
class PoseMotion:
    """Twists about a reference pose and readings, both in body representation.

    Attributes:
        time: (N,) time [s], ascending.
        twist: (N, 6) displacement from the reference pose, linear first, in its axes [m, rad].
        reading: (N, 6) readings of the sensor in its own axes, about its origin [N, N m].
        reference: (4, 4) reference pose in base axes: the mean of the poses.

    """

    time: FloatArray
    twist: FloatArray
    reading: FloatArray
    reference: FloatArray

    def __len__(self) -> int:
        return len(self.twist)


def motion(time: ArrayLike, poses: ArrayLike, readings: ArrayLike, *, in_base_axes: bool = False) -> PoseMotion:
    """Return the motions about the mean of recorded poses.

    Args:
        time: (N,) time [s].
        poses: (N, 4, 4) poses of the sensor's frame in base axes [m].
        readings: (N, 6) force and moment about the sensor's origin [N, N m], in the axes of the sensor's frame.
        in_base_axes: readings are in base axes.

    Raises:
        RecordingError: shapes do not fit, rows are too few or not finite, or time does not rise.

    """
    at, H, F = (np.asarray(each, dtype=float) for each in (time, poses, readings))
    if H.ndim != 3 or H.shape[1:] != (4, 4) or F.shape != (len(H), 6) or at.shape != (len(H),):
        raise RecordingError(f"time {at.shape}, poses {H.shape} and readings {F.shape} must be (N,), (N, 4, 4), (N, 6)")
    if len(H) < FEWEST:
        raise RecordingError(f"{len(H)} rows are too few for a stiffness; record at least {FEWEST}")
    if not all(np.isfinite(each).all() for each in (at, H, F)):
        raise RecordingError("times, poses and readings must be finite")
    if not (np.diff(at) > 0).all():
        raise RecordingError("the time must rise from row to row")
    R, p = H[:, :3, :3], H[:, :3, 3]
    U, _, Vt = np.linalg.svd(R.mean(axis=0))  # the rotation nearest to the mean matrix
    reference = np.eye(4)
    reference[:3, :3] = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    reference[:3, 3] = p.mean(axis=0)
    R0 = reference[:3, :3]
    # small motions (N, 6) [m], [rad] in the reference's axes
    twist = np.concatenate([(p - reference[:3, 3]) @ R0, rotation_vectors(R0.T @ R)], axis=1)
    if in_base_axes:
        F = np.concatenate([np.einsum("nji,nj->ni", R, F[:, k : k + 3]) for k in (0, 3)], axis=1)
    return PoseMotion(at, twist, F, reference)


def rotation_vectors(R: FloatArray) -> FloatArray:
    """Return the rotation vectors (N, 3) [rad] of rotations (N, 3, 3) by less than half a turn."""
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) / 2
    sine, cosine = np.linalg.norm(axis, axis=1), (np.trace(R, axis1=1, axis2=2) - 1) / 2
    angle = np.arctan2(sine, cosine)
    return np.asarray(axis * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-300), 1.0)[:, None])


def skew(a: FloatArray) -> FloatArray:
    """Return the matrix [a] of the cross product: [a] b = a x b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
