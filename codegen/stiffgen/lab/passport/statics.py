# SPDX-License-Identifier: MIT
"""Statics of postures: the force that the motors leave, what elastic gears take, and what joint gains give."""

from __future__ import annotations

import numpy as np

from stiffgen.core.robot.geometry import FloatArray

DIRECTIONS = ("x+", "x-", "y+", "y-", "z+", "z-")
"""Directions of a force at the tip, in base axes."""
UNITS = np.kron(np.eye(3), [[1.0], [-1.0]])
"""Their unit vectors (6, 3)."""


def available_force(jacobian: FloatArray, gravity: FloatArray, effort: FloatArray) -> FloatArray:
    """Return the force [N] that the tip can exert at rest in each direction (P, 6); 0 where gravity takes all torque.

    Exerting f u takes the torques g + J^T u f, each within its effort limit; moments are zero. With t = J^T u, joint i
    allows f up to (effort_i - sign(t_i) g_i) / abs(t_i).

    Args:
        jacobian: hybrid Jacobians (P, 6, n).
        gravity: torques that hold the arm (P, n) [N m or N].
        effort: effort limits (n) [N m or N].

    """
    per_newton = np.einsum("dk,pki->pdi", UNITS, jacobian[:, :3])  # t (P, 6, n)
    left = effort - np.sign(per_newton) * gravity[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = np.where(np.abs(per_newton) > 1e-12, left / np.abs(per_newton), np.inf)
    force = np.maximum(allowed.min(axis=2), 0.0)  # the weakest joint decides
    holds_arm = np.asarray(np.abs(gravity) <= effort).all(axis=1, keepdims=True)
    return np.asarray(np.where(holds_arm, force, 0.0))


def softest(jacobian: FloatArray, joint_stiffness: FloatArray) -> FloatArray:
    """Return the tip's stiffness in its softest direction (P) [N/m], from joint stiffnesses (P, n, n).

    It is one over the largest eigenvalue of the translational compliance, a block of J Kq^-1 J^T.
    """
    compliance = jacobian @ np.linalg.solve(joint_stiffness, np.swapaxes(jacobian, 1, 2))
    return np.asarray(1.0 / np.linalg.eigvalsh(compliance[:, :3, :3])[:, -1])


def buckling_force(kinematic: FloatArray, joint_stiffness: FloatArray) -> FloatArray:
    """Return the least force [N] of all directions under which a posture is no longer stable (P); infinite for none.

    The energy's Hessian is Kth - f Kkin(u). With Kth = L L^T it is singular first at 1/f = the largest eigenvalue of
    L^-1 Kkin L^-T. The posture stays: the motors' set-points follow the load.

    Args:
        kinematic: kinematic stiffnesses of unit forces on the robot in each direction (P, 6, n, n).
        joint_stiffness: Kth (P, n, n), positive definite.

    """
    L = np.linalg.cholesky(joint_stiffness)[:, None]
    half = np.linalg.solve(L, kinematic)  # L^-1 Kkin; its transpose is Kkin L^-T
    eigenvalues = np.linalg.eigvalsh(np.linalg.solve(L, np.swapaxes(half, 2, 3)))  # (P, 6, n) [1/N]
    largest = eigenvalues[..., -1].max(axis=1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(largest > 1e-12, 1.0 / largest, np.inf))


def errors_by_friction(
    jacobian: FloatArray, joint_stiffness: FloatArray, friction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the largest rest error [m] and force error [N] along x, y or z that sticking joints leave (P), (P).

    At rest the springs' torque in each joint is at most its friction: Kq dq = s with abs(s_i) <= c_i, and the tip is
    off by J dq. Along a unit vector u that is at most e = sum_i c_i abs((u^T J Kq^-1)_i), with every joint's friction
    at its worst sign. A rigid wall with the normal u takes the error, and its force is off by e / (u^T J Kq^-1 J^T u).
    Both hold for small errors, about one posture.

    Args:
        jacobian: hybrid Jacobians (P, 6, n).
        joint_stiffness: Kq of the springs (P, n, n), positive definite [N m/rad].
        friction: of each joint (n) [N m or N].

    """
    J = jacobian[:, :3]
    per_torque = np.swapaxes(np.linalg.solve(joint_stiffness, np.swapaxes(J, 1, 2)), 1, 2)  # J Kq^-1 (P, 3, n)
    error = np.abs(per_torque) @ friction
    compliance = np.einsum("pki,pki->pk", per_torque, J)  # diagonal of J Kq^-1 J^T (P, 3)
    return np.asarray(error.max(axis=1)), np.asarray((error / compliance).max(axis=1))
