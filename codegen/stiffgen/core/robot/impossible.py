# SPDX-License-Identifier: MIT
"""Inertia tensors that no rigid body has: the fault in numbers, the nearest possible tensor, and their effect.

The option ``--accept-inertia`` accepts such a tensor. It is used as it is where the mass matrix stays positive definite
over the joint range; else the nearest possible tensor takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray, exact, principal_moments, with_moments

Tensor = tuple[float, float, float, float, float, float]
_STATES = 200
_LEAST = 1e-6
"""Least eigenvalue of a mass matrix, relative to that with the nearest possible tensors."""


def fault_of(tensor: Sequence[float]) -> str:
    """Return in words, with numbers, why no rigid body has a tensor (ixx, ixy, ixz, iyy, iyz, izz)."""
    low, middle, high = (float(moment) for moment in principal_moments(tensor)[0])
    if low < -0.01 * abs(high):
        return f"its least principal moment is negative, {low:.3g} kg m^2"
    excess = 100 * (high - low - middle) / high
    return f"its largest principal moment, {high:.3g} kg m^2, is above the sum of the other two by {excess:.1f} % of it"


def nearest_possible(tensor: Sequence[float]) -> Tensor:
    """Return the tensor of a rigid body that is nearest to a tensor, by the distance of their second moments.

    The second moments along the principal axes are half the trace minus the principal moments; the negative ones
    become zero.
    """
    moments, axes = principal_moments(tensor)
    half = sum(moments) / 2
    second = [max(half - moment, exact(0.0)) for moment in moments]
    return with_moments([sum(second) - each for each in second], axes)


def is_usable(chain: Chain, nearest: Chain) -> bool:
    """Return whether the mass matrix of a chain is positive definite where that with the nearest tensors is.

    Compared are the least eigenvalues at zero, at both ends of the ranges, and at random postures.
    """
    random = np.random.default_rng(46)
    lower, upper = np.array([each.range_within(math.pi) for each in chain.coordinates]).T
    ends = [np.clip(np.zeros(len(lower)), lower, upper), lower, upper]
    q = np.vstack([*ends, random.uniform(lower, upper, (_STATES, len(lower)))])
    least, possible = (np.linalg.eigvalsh(mass_matrix(each, q))[:, 0] for each in (chain, nearest))
    return bool(np.all((least > _LEAST * possible) | (possible <= 0)))


def mass_matrix(chain: Chain, q: FloatArray) -> FloatArray:
    """Return the mass matrices (N, n, n) of a chain at postures (N, n) from the bodies of its joints."""
    matrix = np.zeros((len(q), chain.dof, chain.dof))
    for joint, (rotation, motion) in zip(chain.joints, unit_motions(chain, q), strict=True):
        body = joint.body
        inertia = _spatial_inertia(body.mass, body.moment, body.tensor, rotation)
        matrix += np.swapaxes(motion, 1, 2) @ inertia @ motion
    return matrix


def unit_motions(chain: Chain, q: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield for each joint, at postures q (N, n) [rad], [m], how its frame turns and moves, in base axes.

    These are the rotations (N, 3, 3) of the frame and the twists (N, 6, n) of its origin at unit rates of the
    coordinates, the linear part first. Joints of a floating base are at zero.
    """
    frames: list[tuple[FloatArray, FloatArray]] = []
    for joint in chain.joints:
        R, J = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 6, chain.dof))
        if joint.parent >= 0:
            R, J = frames[joint.parent]
            J = J.copy()
        own = joint.coordinate - chain.base_joints  # below 0 for a joint of a floating base
        position = joint.offset + (joint.multiplier * q[:, own] if own >= 0 else np.zeros(len(q)))
        offset, axis = R @ np.array(joint.translation), np.array(joint.axis)
        R = R @ np.array(joint.rotation)
        if joint.prismatic:
            offset = offset + (R @ axis) * position[:, None]
        J[:, :3] += np.cross(J[:, 3:], offset[:, :, None], axis=1)  # moved with the parent: v + w x offset
        own_rows = slice(0, 3) if joint.prismatic else slice(3, 6)  # its own motion is linear, or angular
        J[:, own_rows, joint.coordinate] += joint.multiplier * (R @ axis)
        if not joint.prismatic:
            R = R @ _turned(axis, position)
        frames.append((R, J))
        yield R, J


def _turned(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) about a unit axis by angles (N,) [rad], by Rodrigues' formula."""
    cross = np.cross(np.eye(3), axis)  # cross @ v is axis x v
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + (1 - cosine) * cross @ cross


def _spatial_inertia(mass: float, moment: Sequence[float], tensor: Tensor, rotation: FloatArray) -> FloatArray:
    """Return the inertias (N, 6, 6) of a body about its frame's origin, linear first, at rotations (N, 3, 3)."""
    xx, xy, xz, yy, yz, zz = tensor
    first = rotation @ np.array(moment)
    skew = np.cross(np.eye(3), first[:, None, :])  # skew @ w is first x w
    result = np.zeros((len(rotation), 6, 6))
    result[:, :3, :3] = mass * np.eye(3)
    result[:, 3:, :3], result[:, :3, 3:] = skew, -skew
    turned_back = np.swapaxes(rotation, 1, 2)
    result[:, 3:, 3:] = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turned_back
    return result
