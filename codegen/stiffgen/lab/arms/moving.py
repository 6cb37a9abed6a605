# SPDX-License-Identifier: MIT
"""Conversion of a wrench and a task stiffness between representations, for one and the same spring.

In the joint stiffness Kq = dJ^T/dq . F + J^T (K + Gamma F) J, the Jacobian, F, K and Gamma must have the same
representation. With the tip's pose (p, R) and [a] the cross-product matrix of a, the wrench and stiffness of one spring
convert as

    body and hybrid       F_h = T F_b        K_h = T K_b T^T               T = blkdiag(R, R)
    hybrid and spatial    F_s = X^-T F_h     K_s = X^-T K_h X^-1 + N       X = [[I, [p]], [0, I]]
                                             N = blkdiag(0, ([f][p] + [p][f])/2)

Body and hybrid representation share one connection, so that K converts as a tensor. The spatial connection differs: the
covariant Hessian of the same energy has the additional term N, which depends on the point p and is zero for zero force
f. With N, the joint stiffness is the same in all three representations.

In the paper's spatial form (Lachner, Nah, Hogan 2025) K converts as a tensor, without N (``as_tensor``). The resulting
joint stiffness is symmetric but belongs to a different spring; the difference is J_s^T N J_s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.measured import check_symmetric


def move_stiffness(
    pose: ArrayLike,
    wrench: ArrayLike,
    task_stiffness: ArrayLike,
    source: Representation,
    target: Representation,
    *,
    as_tensor: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Return wrench and task stiffness of the same spring in another representation.

    Leading dimensions broadcast.

    Args:
        pose: (4, 4), pose of the tip in the base frame [m].
        wrench: (6,), (force, moment) that the environment applies to the robot [N, N m], in ``source``.
        task_stiffness: (6, 6), symmetric, on twists (linear, angular) [N/m, N, N m], in ``source``;
            :func:`stiffgen.measured_stiffness` makes it of a measured matrix.
        source: representation of the arguments: "body", "spatial" or "hybrid".
        target: representation of the result.
        as_tensor: omit the point-dependent term of the spatial representation, as the paper does; the joint stiffness
            then differs.

    Returns:
        Wrench (6,) and task stiffness (6, 6) in ``target``.

    Raises:
        ValueError: a representation is unknown, or the shape of an argument is wrong.
        StiffgenError: the stiffness is not symmetric.

    """
    for representation in (source, target):
        if representation not in REPRESENTATIONS:
            raise ValueError(f"no representation '{representation}'; it must be one of {', '.join(REPRESENTATIONS)}")
    H, F, K = (np.asarray(each, dtype=float) for each in (pose, wrench, task_stiffness))
    for name, array, shape in (("pose", H, (4, 4)), ("wrench", F, (6,)), ("task_stiffness", K, (6, 6))):
        if array.shape[array.ndim - len(shape) :] != shape:
            raise ValueError(f"{name} must have the shape {shape}, not {array.shape}")
    check_symmetric("move_stiffness: task_stiffness", K)
    # every representation is converted by way of the hybrid one
    lead = np.broadcast_shapes(H.shape[:-2], F.shape[:-1], K.shape[:-2])
    F, K = np.broadcast_to(F, (*lead, 6)), np.broadcast_to(K, (*lead, 6, 6))
    rotation, point = H[..., :3, :3], H[..., :3, 3]
    if source != target:
        F, K = _to_hybrid(rotation, point, F, K, source, as_tensor=as_tensor)
        F, K = _from_hybrid(rotation, point, F, K, target, as_tensor=as_tensor)
    return np.array(F), np.array(K)


def _cross(v: FloatArray) -> FloatArray:
    """Return the cross-product matrices [v] (..., 3, 3) of vectors (..., 3)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], -2)


def _blocks(upper_left: Any, lower_left: Any, lower_right: Any) -> FloatArray:
    """Return matrices (..., 6, 6) of blocks (..., 3, 3); the upper right block is zero."""
    lead = np.broadcast_shapes(*(each.shape[:-2] for each in (upper_left, lower_left, lower_right)))
    matrix = np.zeros((*lead, 6, 6))
    matrix[..., :3, :3], matrix[..., 3:, :3], matrix[..., 3:, 3:] = upper_left, lower_left, lower_right
    return matrix


def _transformed(matrix: FloatArray, F: FloatArray, K: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return T F and T K T^T."""
    return np.einsum("...ij,...j->...i", matrix, F), matrix @ K @ np.swapaxes(matrix, -1, -2)


def _point_term(point: FloatArray, force: FloatArray) -> FloatArray:
    """Return N = blkdiag(0, ([f][p] + [p][f])/2)."""
    f, p = _cross(force), _cross(point)
    zero = np.zeros((3, 3))
    return _blocks(zero, zero, (f @ p + p @ f) / 2)


def _to_hybrid(
    rotation: FloatArray, point: FloatArray, F: FloatArray, K: FloatArray, source: Representation, *, as_tensor: bool
) -> tuple[FloatArray, FloatArray]:
    """Return F and K of ``source`` in hybrid representation; N is removed before the transformation by X^T."""
    if source == "body":
        return _transformed(_blocks(rotation, np.zeros((3, 3)), rotation), F, K)
    if source == "spatial":
        if not as_tensor:
            K = K - _point_term(point, F[..., :3])
        return _transformed(_blocks(np.eye(3), -_cross(point), np.eye(3)), F, K)
    return F, K


def _from_hybrid(
    rotation: FloatArray, point: FloatArray, F: FloatArray, K: FloatArray, target: Representation, *, as_tensor: bool
) -> tuple[FloatArray, FloatArray]:
    """Return hybrid F and K in ``target``; N is added after the transformation by X^-T, which keeps the force."""
    if target == "body":
        inverse = np.swapaxes(rotation, -1, -2)
        return _transformed(_blocks(inverse, np.zeros((3, 3)), inverse), F, K)
    if target == "spatial":
        F, K = _transformed(_blocks(np.eye(3), _cross(point), np.eye(3)), F, K)
        return F, K if as_tensor else K + _point_term(point, F[..., :3])
    return F, K
