# SPDX-License-Identifier: MIT
"""Compute poses and Jacobians as plain 4x4 products and their derivatives, for the references of kernels.

Rotations and axes of a chain are orthonormal up to the rounding of doubles. A derivative takes what is missing for a
motion, and where the true result is small or zero that is all of it. The references have constants with more digits,
which are orthonormal; `evaluate_longer` and `in_doubles` know them.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain, Joint
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.verify.kernels.rounding import long_constant


def joint_poses(chain: Chain, q: ca.SX, base_pose: ca.SX | None = None) -> list[ca.SX]:
    """Return the pose of every joint's frame in the base, or in the world of ``base_pose``, by 4x4 products."""
    base_joints = chain.base_joints
    base = ca.SX.eye(4) if base_pose is None else base_pose
    joints: list[ca.SX] = base_joints * [base]
    for joint in chain.joints[base_joints:]:
        pose = joints[joint.parent] if joint.parent >= 0 else base
        joints.append(moved_pose(pose, joint, q[joint.coordinate - base_joints]))
    return joints


def moved_pose(pose: ca.SX, joint: Joint, coordinate: ca.SX) -> ca.SX:
    """Return the pose (4x4) of a joint's frame from the pose before it and the joint's coordinate [rad or m]."""
    position = joint.multiplier * coordinate + joint.offset
    axis = _unit(joint.axis)
    motion = ca.SX.eye(4)
    if joint.prismatic:
        motion[:3, 3] = axis * position
    else:
        cross = ca.skew(axis)
        motion[:3, :3] = ca.DM.eye(3) + ca.sin(position) * cross + (1 - ca.cos(position)) * (cross @ cross)
    return pose @ homogeneous(joint.rotation, joint.translation) @ motion


def product_of_poses(chain: Chain, q: ca.SX, base_pose: ca.SX | None = None) -> ca.SX:
    """Return the pose (4x4) of the chain's only tip in the base, or in the world, by 4x4 products."""
    (tip,) = chain.tips
    return joint_poses(chain, q, base_pose)[tip.joint] @ homogeneous(chain.tip_rotation, chain.tip_translation)


def homogeneous(rotation: Any, translation: Any) -> ca.SX:
    """Return the pose (4x4) of a rotation, made orthonormal, and a translation."""
    return ca.vertcat(ca.horzcat(_orthonormal(rotation), ca.DM(translation)), ca.DM([[0, 0, 0, 1]]))


def _orthonormal(rotation: Any) -> ca.SX:
    """Return the rotation next to a matrix that is one up to rounding, by Newton's method."""
    R = np.array(rotation, dtype=np.longdouble)
    for _ in range(2):
        R = R @ (3 * np.eye(3, dtype=np.longdouble) - R.T @ R) / 2
    return long_constant(R)


def _unit(axis: Any) -> ca.SX:
    a = np.array(axis, dtype=np.longdouble)
    return long_constant(a / np.sqrt(a @ a))


def _vee(matrix: ca.SX) -> ca.SX:
    """Return the twist (6), linear first, of its matrix (4x4)."""
    return ca.vertcat(matrix[0, 3], matrix[1, 3], matrix[2, 3], matrix[2, 1], matrix[0, 2], matrix[1, 0])


def _inverse(pose: ca.SX) -> ca.SX:
    rotation = pose[:3, :3].T
    return ca.vertcat(ca.horzcat(rotation, -rotation @ pose[:3, 3]), ca.SX([[0, 0, 0, 1]]))


def jacobian_of(pose: ca.SX, q: ca.SX, representation: Representation) -> ca.SX:
    """Return the Jacobian by differentiation of the pose H: twists of H^-1 dH (body) or dH H^-1 (spatial).

    A hybrid column is the rate of the tip's origin, and the angular velocity of the body column in base axes.
    """
    columns = []
    for k in range(q.shape[0]):
        rate = ca.jacobian(ca.vec(pose), q[k]).reshape((4, 4))  # dH/dq_k
        body = _vee(_inverse(pose) @ rate)
        if representation == "body":
            columns.append(body)
        elif representation == "spatial":
            columns.append(_vee(rate @ _inverse(pose)))
        else:
            columns.append(ca.vertcat(rate[:3, 3], pose[:3, :3] @ body[3:]))
    return ca.horzcat(*columns)


class MovedConfiguration:
    """Symbols of a configuration: joint positions, the base's pose, and the base's motion from there.

    Coordinates are the base's motion (none if it is fixed), then the joint positions. The base moves by x = (v, w) to
    p + R v, R exp([w]), of which two derivatives at zero are exact.
    """

    def __init__(self, chain: Chain) -> None:
        self.floating = chain.floating
        self.q = ca.SX.sym("q", len(chain.coordinates))
        self.base_pose = ca.SX.sym("B", 16)  # row by row
        self.moves = ca.SX.sym("x", chain.base_joints)

    @property
    def coordinates(self) -> ca.SX:
        """Variables of differentiation."""
        return ca.vertcat(self.moves, self.q)

    def base(self, *further: ca.SX) -> ca.SX | None:
        """Return the pose of the base after its motion, and after ``further`` ones; None if it is fixed."""
        if not self.floating:
            return None
        pose = self.base_pose.reshape((4, 4)).T
        for moves in (self.moves, *further):
            turn = ca.skew(moves[3:])
            rotation = ca.SX.eye(3) + turn + turn @ turn / 2
            pose = pose @ ca.blockcat([[rotation, moves[:3]], [ca.SX.zeros(1, 3), ca.SX.ones(1)]])
        return pose


def gamma_F(representation: Representation, wrench: FloatArray) -> FloatArray:
    """Return Gamma F (..., 6, 6) in cross-product matrices (facts of the paper's appendix), for a stack of wrenches.

    Hybrid: [0, 0; 0, [m]^T/2], docs/theory.md (4). Body: [0, [f]; 0, [m]/2]. Spatial: the transpose of the body's.
    """
    force, moment = _cross_matrices(wrench[..., :3]), _cross_matrices(wrench[..., 3:])
    result = np.zeros((*wrench.shape[:-1], 6, 6))
    if representation == "hybrid":
        result[..., 3:, 3:] = np.swapaxes(moment, -1, -2) / 2
        return result
    result[..., :3, 3:] = force
    result[..., 3:, 3:] = moment / 2
    return result if representation == "body" else np.swapaxes(result, -1, -2)


def _cross_matrices(v: FloatArray) -> FloatArray:
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, -2)
