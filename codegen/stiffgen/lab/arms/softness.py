# SPDX-License-Identifier: MIT
"""Gradients of the tip's compliance with respect to the joint positions, for motions towards stiff postures.

With y = H^-1 J^T u, the compliance u^T C u = y^T H y along a direction u has the gradient

    d(u^T C u)/dq_i = 2 y^T dJ^T/dq_i u + y^T (dKload/dq_i) y      Kload = dJ^T/dq . F + J^T (Gamma F) J = Kth - H

where the last term is ``hybrid.stiffness_direction_gradient`` of a tip without a spring. Wrench, springs and direction
are held. The gradient of log det C is the sum of these gradients over the directions u_k with C^-1 = sum of u_k u_k^T.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.arms.loaded import arm_on_springs

_ROWS: dict[str, slice] = {"all": slice(0, 6), "translation": slice(0, 3), "rotation": slice(3, 6)}


def compliance_gradient(
    robot: GeneratedRobot | ModuleType,
    q: ArrayLike,
    wrench: ArrayLike,
    joint_stiffness: ArrayLike,
    direction: ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """Return the tip's compliance along a direction, u^T C u, and its gradient with respect to q.

    It is ``tip_compliance_vjp`` (``--kernels all,compliance --derivatives``) with the cotangent u u^T, for robots
    generated without these options. Leading dimensions broadcast.

    Args:
        robot: a robot with a fixed base, from ``stiffgen.load`` or ``open_robot``, its module, or the part of one tip.
        q: (..., n) joint positions under the load [rad or m].
        wrench: (..., 6) wrench of the environment on the robot at the tip, hybrid: base axes [N, N m].
        joint_stiffness: Kth (..., n, n), or (n) for independent springs [N m/rad, N/m for sliding joints].
        direction: u, (..., 3) direction of a force, or (..., 6) of a wrench, in base axes.

    Returns:
        The compliance (...), in m/N for a unit force, and its gradient (..., n) per rad or m. NaN where the posture is
        unstable.

    Raises:
        StiffgenError: the robot has a moving base, closed loops, ball joints or a tool at run time, or a shape does not
            fit.

    """
    posture = _Posture.of("compliance_gradient", robot, q, wrench, joint_stiffness)
    u = np.asarray(direction, dtype=float)
    if u.shape[-1:] not in ((3,), (6,)):
        raise StiffgenError(f"compliance_gradient: takes directions (..., 3) or (..., 6), not {u.shape}")
    if u.shape[-1] == 3:  # a force has no moment
        u = np.concatenate([u, np.zeros_like(u)], axis=-1)
    return posture.sum_along(u[..., None, :])


def compliance_determinant_gradient(
    robot: GeneratedRobot | ModuleType,
    q: ArrayLike,
    wrench: ArrayLike,
    joint_stiffness: ArrayLike,
    block: Literal["all", "translation", "rotation"] = "all",
) -> tuple[FloatArray, FloatArray]:
    """Return the logarithm of the determinant of the tip's compliance, and its gradient with respect to q.

    The determinant is the square of the volume of the compliance ellipsoid, up to a constant. Leading dimensions
    broadcast.

    Args:
        robot: as in :func:`compliance_gradient`.
        q: as in :func:`compliance_gradient`.
        wrench: as in :func:`compliance_gradient`.
        joint_stiffness: as in :func:`compliance_gradient`.
        block: "all" of C (6 x 6), or its "translation" or "rotation" block (3 x 3).

    Returns:
        log det (...) of the entries in SI units, and its gradient (..., n) [1/rad or 1/m]. NaN where the posture is
        unstable or the block is singular, as the whole of C is with fewer than six joints.

    Raises:
        StiffgenError: as in :func:`compliance_gradient`, or the block is unknown.

    """
    if block not in _ROWS:
        raise StiffgenError(
            f"compliance_determinant_gradient: no block '{block}'; it must be one of {', '.join(_ROWS)}"
        )
    posture = _Posture.of("compliance_determinant_gradient", robot, q, wrench, joint_stiffness)
    rows = _ROWS[block]
    J = posture.jacobian[..., rows, :]
    # C = V diag(values) V^T; d log det C = tr(C^-1 dC) is the sum of u^T dC u over the columns u of V values^(-1/2)
    values, vectors = np.linalg.eigh(J @ np.linalg.solve(posture.hessian, np.swapaxes(J, -1, -2)))
    is_singular = values[..., 0] <= 1e-15 * values.shape[-1] * values[..., -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        directions = np.swapaxes(
            vectors / np.sqrt(np.where(is_singular[..., None], np.nan, values))[..., None, :], -1, -2
        )
        logarithm = np.where(is_singular, np.nan, np.log(np.abs(values)).sum(axis=-1))
    u = np.zeros((*directions.shape[:-1], 6))
    u[..., rows] = directions
    _, gradient = posture.sum_along(u)
    return np.where(posture.is_stable, logarithm, np.nan), gradient


class _Posture:
    """A stack of loaded postures: H (..., n, n), the identity where it is not positive definite, and J (..., 6, n)."""

    def __init__(self, module: Any, q: FloatArray, wrench: FloatArray, springs: FloatArray) -> None:
        """Evaluate H = diag(springs) - Kq of the load (..., n, n) and J (..., 6, n); unstable postures get H = 1, J =
        0.
        """
        hybrid = module.hybrid
        with np.errstate(invalid="ignore"):
            hessian = springs - hybrid.joint_stiffness(q, wrench, np.zeros((6, 6)))
            is_finite = np.isfinite(hessian).all(axis=(-1, -2))
            filled = np.where(is_finite[..., None, None], hessian, np.eye(q.shape[-1]))
            self.is_stable = is_finite & (np.linalg.eigvalsh(filled)[..., 0] > 0)
            self.hessian = np.where(self.is_stable[..., None, None], filled, np.eye(q.shape[-1]))
            self.jacobian = np.where(self.is_stable[..., None, None], hybrid.jacobian(q), 0.0)
            self._derivative = hybrid.jacobian_transpose_derivative(q)
        self._q, self._wrench, self._hybrid = q, wrench, hybrid

    @staticmethod
    def of(
        name: str, robot: GeneratedRobot | ModuleType, q: ArrayLike, wrench: ArrayLike, joint_stiffness: ArrayLike
    ) -> _Posture:
        """Return the postures; StiffgenError if the function of this name cannot take the arguments."""
        module, position, springs = arm_on_springs(name, robot, q, joint_stiffness)
        F = np.asarray(wrench, dtype=float)
        if F.shape[-1:] != (6,):
            raise StiffgenError(f"{name}: takes wrenches (..., 6), not {F.shape}")
        return _Posture(module, position, F, springs)

    def sum_along(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sums over directions u (..., k, 6) of u^T C u and of its gradient."""
        torques = u @ self.jacobian  # (..., k, n)
        y = np.swapaxes(np.linalg.solve(self.hessian, np.swapaxes(torques, -1, -2)), -1, -2)
        with np.errstate(invalid="ignore"):
            turned = np.einsum("...iba,...kb,...ka->...i", self._derivative, y, u)
            stiffened = self._hybrid.stiffness_direction_gradient(
                self._q[..., None, :], self._wrench[..., None, :], np.zeros((6, 6)), y
            )
        value, gradient = (torques * y).sum(axis=(-1, -2)), 2 * turned + stiffened.sum(axis=-2)
        return np.where(self.is_stable, value, np.nan), np.where(self.is_stable[..., None], gradient, np.nan)
