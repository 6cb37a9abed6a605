# SPDX-License-Identifier: MIT
"""Springs in series: elastic gears behind a controller, and compliant parts between an arm's base and its tip.

Leading dimensions broadcast: stacks of configurations need no loop. All results are bitwise symmetric.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.measured import symmetric

_NEGATIVE = 1e-9
"""Share of the largest entry by which an eigenvalue of gears may be negative."""


def in_series(Kq: ArrayLike, Kc: ArrayLike) -> FloatArray:
    """Return the stiffness that a controller shows at the links, behind elastic gears.

    The controller renders Kq at the motors, and each gear is a spring from its motor to its link. The links then feel
    (Kq^-1 + Kc^-1)^-1, written without inverses as Kc - Kc (Kq + Kc)^-1 Kc: the Schur complement of the energy of
    motors and links. It is computed as that energy's value at the motors' equilibrium, so that neither soft nor stiff
    gears cost digits. Kq may be singular (a redundant arm without a posture spring), also indefinite, as long as
    Kq + Kc is positive definite.

    Args:
        Kq: (..., n, n) symmetric joint stiffness of the controller [N m/rad, N/m for sliding joints].
        Kc: stiffness of the gears in the same units: (n) of independent gears, where infinity is a rigid one, or
            (..., n, n), symmetric and positive semidefinite, of coupled ones.

    Returns:
        (..., n, n) symmetric joint stiffness at the links. NaN where Kq + Kc is not positive definite, because the
        motors have no stable equilibrium between controller and gears, and where an entry is not finite.

    Raises:
        StiffgenError: shapes do not fit, a matrix is not symmetric, or the gears have a negative or no stiffness (NaN).

    """
    A = symmetric("in_series: Kq", Kq)
    B, is_elastic = _gears(Kc, A.shape[-1])
    A, B = np.broadcast_arrays(A, B)
    is_finite: Any = np.isfinite(A + B).all(axis=(-1, -2), keepdims=True)
    A, B = np.where(is_finite, A, np.eye(A.shape[-1])), np.where(is_finite, B, 0.0)
    # The motors' equilibrium: A (links - twist) = B twist. Rigid gears have no twist.
    total = (A + B)[..., is_elastic, :][..., :, is_elastic]
    is_stable = is_finite & _is_positive_definite(total)[..., None, None]
    total = np.where(is_stable, total, np.eye(int(is_elastic.sum())))
    twist = np.zeros_like(A)  # of the gears, per motion of the links
    twist[..., is_elastic, :] = np.linalg.solve(total, A[..., is_elastic, :])
    motors = np.eye(A.shape[-1]) - twist
    energy = _congruence(motors, A) + _congruence(twist, B)
    return np.where(is_stable, energy, np.nan)


def _gears(Kc: ArrayLike, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the stiffness (..., n, n) of the elastic gears, and which gears are elastic (n).

    Raises:
        StiffgenError: the shape does not fit, or the stiffness is negative, NaN or not symmetric.

    """
    gears = np.asarray(Kc, dtype=float)
    if gears.shape == (n,):
        if not (gears >= 0).all():
            raise StiffgenError(f"in_series: Kc {gears.tolist()} must be positive; give infinity for a rigid gear")
        is_elastic = np.isfinite(gears)
        return np.diag(np.where(is_elastic, gears, 0.0)), is_elastic  # a rigid gear stores no energy
    if gears.shape[-2:] != (n, n):
        raise StiffgenError(f"in_series: Kc must be ({n}) or (..., {n}, {n}), as Kq is, not {gears.shape}")
    B = symmetric("in_series: Kc", gears)
    known = np.nan_to_num(B)
    smallest, size = np.linalg.eigvalsh(known)[..., 0], np.abs(known).max(axis=(-1, -2))
    if (smallest < -_NEGATIVE * size).any():
        raise StiffgenError(f"in_series: Kc has the negative eigenvalue {smallest.min():.6g}; gears are passive")
    return B, np.full(n, True)


def tip_compliance_in_series(
    compliance: ArrayLike,
    pose: ArrayLike,
    parts: Iterable[tuple[ArrayLike, ArrayLike]],
    representation: Representation = "hybrid",
) -> FloatArray:
    """Return an arm's compliance at the tip with those of compliant parts: a mount, a gripper, a tool.

    Each part is a spring with six degrees of freedom that carries the force at the tip. Its compliance is transported
    from its own frame to the tip, T C T^T with the twist's transformation T, and added. The sum is exact for an arm
    without a load. Under a load the parts turn with the arm, which changes the sum by about (force times lever) per
    (rotational stiffness of the part); a robot generated with ``--floating-base`` has the exact compliance on a mount.

    Args:
        compliance: (..., 6, 6) symmetric compliance of the arm at the tip [m/N, 1/N, rad/(N m)], as from
            ``robot.hybrid.tip_compliance``; zeros for the parts alone.
        pose: (..., 4, 4) pose of the tip in the base [m], as from ``robot.forward_kinematics``.
        parts: pairs (C, frame). C is the part's compliance (..., 6, 6) on wrenches (force, moment) at the origin of its
            frame, in the frame's axes; ``frame`` (..., 4, 4) is the frame's pose in the base [m]. It is constant for a
            mount, and ``pose @ offset`` for a gripper.
        representation: of ``compliance`` and of the result: "body", "spatial" or "hybrid".

    Returns:
        (..., 6, 6) symmetric compliance at the tip [m/N, 1/N, rad/(N m)].

    Raises:
        StiffgenError: shapes do not fit, a matrix is not symmetric, or the representation is unknown.

    """
    if representation not in REPRESENTATIONS:
        known = ", ".join(REPRESENTATIONS)
        raise StiffgenError(
            f"tip_compliance_in_series: no representation '{representation}'; it must be one of {known}"
        )
    where = "tip_compliance_in_series: "
    total, tip = symmetric(f"{where}compliance", compliance, 6), _pose(f"{where}pose", pose)
    for number, (part, frame) in enumerate(parts):
        C, placed = symmetric(f"{where}compliance of part {number}", part, 6), _pose(f"{where}frame {number}", frame)
        total = total + _congruence(np.swapaxes(_transport(placed, tip, representation), -1, -2), C)
    return total


def _transport(frame: FloatArray, tip: FloatArray, representation: Representation) -> FloatArray:
    """Return T (..., 6, 6) from body twists of a frame to twists of the tip, which moves with the frame.

    T = [[R, S], [0, R]] with the frame's axes R, seen in those of the representation. Column k of S is axis k x lever,
    with the lever from the frame's origin to the point whose velocity the representation has.
    """
    R = frame[..., :3, :3]
    point = np.zeros(3) if representation == "spatial" else tip[..., :3, 3]
    lever = (point - frame[..., :3, 3])[..., None, :]
    if representation == "body":
        to_tip_axes = np.swapaxes(tip[..., :3, :3], -1, -2)
        R, lever = to_tip_axes @ R, lever @ tip[..., :3, :3]
    S = np.swapaxes(np.cross(np.swapaxes(R, -1, -2), lever), -1, -2)
    R = np.broadcast_to(R, S.shape)
    upper, lower = np.concatenate([R, S], -1), np.concatenate([np.zeros_like(R), R], -1)
    return np.concatenate([upper, lower], -2)


def _congruence(X: FloatArray, A: FloatArray) -> FloatArray:
    """Return X^T A X, bitwise symmetric."""
    product = np.swapaxes(X, -1, -2) @ A @ X
    result: FloatArray = (product + np.swapaxes(product, -1, -2)) / 2
    return result


def _is_positive_definite(matrix: FloatArray) -> FloatArray:
    """Return for each matrix of a stack whether it is positive definite up to rounding; an empty one is."""
    n = matrix.shape[-1]
    if n == 0:
        return np.full(matrix.shape[:-2], True)
    values = np.linalg.eigvalsh(matrix)
    rounding = 1e-15 * n * np.abs(values).max(axis=-1)
    result: FloatArray = values[..., 0] > rounding
    return result


def _pose(name: str, values: ArrayLike) -> FloatArray:
    """Return a stack of poses; StiffgenError for another shape."""
    pose = np.asarray(values, dtype=float)
    if pose.shape[-2:] != (4, 4):
        raise StiffgenError(f"{name} must have the shape (..., 4, 4), not {pose.shape}")
    return pose
