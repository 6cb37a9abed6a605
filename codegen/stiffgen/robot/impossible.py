# SPDX-License-Identifier: MIT
"""Inertia tensors that no rigid body has: the fault in numbers, the nearest possible tensor, and their effect.

The option ``--accept-inertia`` accepts such a tensor. It is used as it is where the mass matrix stays positive definite
over the joint range; else the nearest possible tensor takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stiffgen.robot.chain import Chain
from stiffgen.robot.geometry import FloatArray, exact, principal_moments, with_moments

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
    """Return whether the mass matrix of a chain is positive definite where that with the nearest tensors is."""
    random = np.random.default_rng(46)
    lower = np.array([max(each.lower, -math.pi) for each in chain.coordinates])
    upper = np.maximum(lower, [min(each.upper, math.pi) for each in chain.coordinates])
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
    poses: list[tuple[FloatArray, FloatArray]] = []
    twists: list[FloatArray] = []  # of unit rates, of each joint's origin, linear first, in base axes
    for joint in chain.joints:
        R, p, J = np.eye(3), np.zeros(3), np.zeros((6, chain.dof))
        if joint.parent >= 0:
            (R, p), J = poses[joint.parent], twists[joint.parent].copy()
        offset = R @ np.array(joint.translation)
        J[:3] += np.cross(J[3:].T, offset).T
        R, p, axis = R @ np.array(joint.rotation), p + offset, np.array(joint.axis)
        own = joint.coordinate - chain.base_joints
        position = joint.offset + (joint.multiplier * q[own] if own >= 0 else 0.0)
        if joint.prismatic:
            slide = R @ axis * position
            J[:3] += np.cross(J[3:].T, slide).T
            p = p + slide
            J[:3, joint.coordinate] += joint.multiplier * (R @ axis)
        else:
            cross = np.cross(np.eye(3), axis)
            J[3:, joint.coordinate] += joint.multiplier * (R @ axis)
            R = R @ (np.eye(3) + np.sin(position) * cross + (1 - np.cos(position)) * cross @ cross)
        poses.append((R, p))
        twists.append(J)
        matrix += J.T @ _spatial_inertia(joint.body.mass, joint.body.moment, joint.body.tensor, R) @ J
    return matrix


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
