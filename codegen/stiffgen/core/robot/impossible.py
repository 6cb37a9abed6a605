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
    states = [np.clip(np.zeros(len(lower)), lower, upper), lower, upper]
    states += [random.uniform(lower, upper) for _ in range(_STATES)]
    for q in states:
        least, possible = (float(np.linalg.eigvalsh(mass_matrix(each, q))[0]) for each in (chain, nearest))
        if not least > _LEAST * possible and possible > 0:
            return False
    return True


def mass_matrix(chain: Chain, q: FloatArray) -> FloatArray:
    """Return the mass matrix of a chain from the bodies of its joints."""
    matrix = np.zeros((chain.dof, chain.dof))
    for joint, (rotation, motion) in zip(chain.joints, unit_motions(chain, q), strict=True):
        body = joint.body
        matrix += motion.T @ _spatial_inertia(body.mass, body.moment, body.tensor, rotation) @ motion
    return matrix


def unit_motions(chain: Chain, q: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield for each joint the rotation of its frame, and the twists (6, n) of its origin at unit rates, in base axes.

    The linear part comes first.
    """
    frames: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for joint in chain.joints:
        R, p, J = np.eye(3), np.zeros(3), np.zeros((6, chain.dof))
        if joint.parent >= 0:
            R, p, J = frames[joint.parent]
            J = J.copy()
        own = joint.coordinate - chain.base_joints  # below 0 for a joint of a floating base, which is at zero
        position = joint.offset + (joint.multiplier * q[own] if own >= 0 else 0.0)
        offset, axis = R @ np.array(joint.translation), np.array(joint.axis)
        R = R @ np.array(joint.rotation)
        if joint.prismatic:
            offset = offset + R @ axis * position
        J[:3] += np.cross(J[3:].T, offset).T  # velocity of this joint's origin, moved with the parent: v + w x offset
        own_rows = slice(0, 3) if joint.prismatic else slice(3, 6)  # its own motion is linear, or angular
        J[own_rows, joint.coordinate] += joint.multiplier * (R @ axis)
        if not joint.prismatic:
            cross = np.cross(np.eye(3), axis)
            R = R @ (np.eye(3) + np.sin(position) * cross + (1 - np.cos(position)) * cross @ cross)
        frames.append((R, p + offset, J))
        yield R, J


def _spatial_inertia(mass: float, moment: Sequence[float], tensor: Tensor, rotation: FloatArray) -> FloatArray:
    """Return the 6x6 inertia of a body about its frame's origin, in base axes, linear first."""
    xx, xy, xz, yy, yz, zz = tensor
    first = rotation @ np.array(moment)
    skew = np.cross(np.eye(3), first)  # skew @ w is first x w
    result = np.zeros((6, 6))
    result[:3, :3] = mass * np.eye(3)
    result[3:, :3], result[:3, 3:] = skew, -skew
    result[3:, 3:] = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
    return result
