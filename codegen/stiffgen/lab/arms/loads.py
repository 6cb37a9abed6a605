# SPDX-License-Identifier: MIT
"""Wrenches from joint torques, and the standard deviations of a joint stiffness under an uncertain wrench.

The functions take a robot's module (``robot.module`` of :func:`stiffgen.open_robot`), or the part of one tip
(``module.left_hand``). All wrenches are hybrid: (force, moment) that the environment applies to the robot, in base
axes, moment about the tip's origin. Leading dimensions broadcast.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import symmetric

_SINGULAR = 1e10
"""Condition number from which a wrench has no digit left that can be believed."""


@dataclass(frozen=True)
class ExternalWrench:
    """Wrench that explains external joint torques best.

    Attributes:
        wrench: (6) [N, N m]; NaN where the condition is 1e10 or more.
        unexplained: external torque less J^T times the wrench (n) [N m or N]: friction, contacts elsewhere, errors.
        condition: condition number of J^T with its rows divided by the deviations; infinite with fewer than six joints.
        covariance: covariance of the wrench (6, 6) for torques with these deviations.

    """

    wrench: FloatArray
    unexplained: FloatArray
    condition: FloatArray
    covariance: FloatArray


def external_wrench(robot: Any, q: ArrayLike, external_torque: ArrayLike, deviation: ArrayLike = 1.0) -> ExternalWrench:
    """Estimate the wrench at the tip from external joint torques, by weighted least squares of J^T F = torque.

    Args:
        robot: module of the robot, or of one tip.
        q: joint positions (n) [rad or m].
        external_torque: torques that the environment causes (n): measured less modelled ones [N m or N].
        deviation: standard deviations of the torques (n), or one for all [N m or N].

    Returns:
        The wrench with its covariance, the part of the torques that no wrench explains, and the condition number.

    Raises:
        ValueError: shapes differ, or a deviation is not positive.

    """
    tau, sigma = np.asarray(external_torque, dtype=float), np.asarray(deviation, dtype=float)
    J_T = np.swapaxes(robot.hybrid.jacobian(q), -1, -2)  # (..., n, 6)
    n = J_T.shape[-2]
    if tau.shape[-1:] != (n,):
        raise ValueError(f"external_torque must end with {n} torques, not have the shape {tau.shape}")
    if sigma.ndim and sigma.shape[-1] != n:
        raise ValueError(f"deviation must be one number or end with {n} numbers, not have the shape {sigma.shape}")
    if not np.all(sigma > 0):
        raise ValueError("deviation: every standard deviation must be positive")
    # With rows divided by the deviations, the errors of all torques have the deviation 1.
    weights = 1.0 / np.broadcast_to(sigma, (*sigma.shape[:-1], n))
    weighted = J_T * weights[..., None]
    left, values, right = np.linalg.svd(np.where(np.isfinite(weighted), weighted, 0.0), full_matrices=False)
    is_finite = np.isfinite(weighted).all(axis=(-1, -2))
    smallest = values[..., -1] if n >= 6 else np.zeros(values.shape[:-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(is_finite, np.where(smallest > 0, values[..., 0] / smallest, np.inf), np.nan)
        inverse = np.where((condition < _SINGULAR)[..., None], 1.0 / values, np.nan)
    along = np.einsum("...nk,...n->...k", left, tau * weights)
    wrench = np.einsum("...ki,...k->...i", right, inverse * along)
    covariance = np.einsum("...ki,...k,...kj->...ij", right, inverse**2, right)
    return ExternalWrench(wrench, tau - np.einsum("...ni,...i->...n", J_T, wrench), condition, covariance)


def tip_covariance(robot: Any, q: ArrayLike, reading_covariance: ArrayLike) -> FloatArray:
    """Return the covariance (6, 6) of the wrench at the tip from that of a force-torque sensor's reading.

    Args:
        robot: module of a robot with a sensor (``--sensor``), or of the sensor's tip.
        q: joint positions (n) [rad or m].
        reading_covariance: covariance of the reading (6, 6) [N^2, N^2 m, N^2 m^2].

    """
    position = np.asarray(q, dtype=float)[..., None, :]
    no_bias, no_payload = np.zeros(6), np.zeros(4)
    wrenches = robot.sensor.tip_wrench(position, np.eye(6), no_bias, no_payload)  # row k: wrench of unit reading k
    return np.asarray(np.swapaxes(wrenches, -1, -2) @ np.asarray(reading_covariance, dtype=float) @ wrenches)


@dataclass(frozen=True)
class StiffnessDeviation:
    """Joint stiffness and the standard deviations that follow from the covariance of its wrench.

    The entries are linear in the wrench, so that their deviations are exact. Those of eigenvalue and singular value are
    to first order in the wrench's error.

    Attributes:
        joint_stiffness: symmetric joint stiffness (n, n) [N m/rad].
        deviation: standard deviation of each of its entries (n, n).
        smallest: its smallest eigenvalue.
        smallest_deviation: standard deviation of the smallest eigenvalue.
        antisymmetric: largest singular value of the antisymmetric part (A - A^T)/2 of the conventional stiffness A.
        antisymmetric_deviation: standard deviation of that singular value; it is an upper bound at zero.

    """

    joint_stiffness: FloatArray
    deviation: FloatArray
    smallest: FloatArray
    smallest_deviation: FloatArray
    antisymmetric: FloatArray
    antisymmetric_deviation: FloatArray


def stiffness_deviation(
    robot: Any, q: ArrayLike, wrench: ArrayLike, task_stiffness: ArrayLike, covariance: ArrayLike
) -> StiffnessDeviation:
    """Return the joint stiffness under an uncertain wrench, with the standard deviations of its entries.

    Args:
        robot: module of the robot, or of one tip.
        q: joint positions (n) [rad or m].
        wrench: hybrid wrench of the environment at the tip (6) [N, N m].
        task_stiffness: symmetric task stiffness (6, 6), hybrid (:func:`stiffgen.measured_stiffness`).
        covariance: covariance of the wrench (6, 6), as from :func:`tip_covariance` or :func:`external_wrench`.

    Raises:
        StiffgenError: the task stiffness is not symmetric, or has another shape.

    """
    sigma = np.asarray(covariance, dtype=float)
    K = symmetric("stiffness_deviation: task_stiffness", task_stiffness, 6)
    position, units, zero = np.asarray(q, dtype=float)[..., None, :], np.eye(6), np.zeros((6, 6))
    stiffness = robot.hybrid.joint_stiffness(q, wrench, K)
    rates = robot.hybrid.joint_stiffness(position, units, zero)  # (..., 6, n, n): derivative with respect to F_k
    values, vectors = np.linalg.eigh(stiffness)
    lowest = vectors[..., :, 0]
    of_eigenvalue = np.einsum("...i,...kij,...j->...k", lowest, rates, lowest)
    conventional = robot.hybrid.kinematic_stiffness(q, wrench)
    skew = (conventional - np.swapaxes(conventional, -1, -2)) / 2  # J^T K J is symmetric
    of_units = robot.hybrid.kinematic_stiffness(position, units)
    skew_rates = (of_units - np.swapaxes(of_units, -1, -2)) / 2
    left, sizes, right = np.linalg.svd(skew)
    of_singular_value = np.einsum("...i,...kij,...j->...k", left[..., :, 0], skew_rates, right[..., 0, :])
    return StiffnessDeviation(
        stiffness,
        np.sqrt(np.einsum("...kij,...kl,...lij->...ij", rates, sigma, rates)),
        values[..., 0],
        _deviation(of_eigenvalue, sigma),
        sizes[..., 0],
        _deviation(of_singular_value, sigma),
    )


def _deviation(gradient: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the standard deviation of a number with this gradient with respect to the wrench."""
    return np.asarray(np.sqrt(np.einsum("...k,...kl,...l->...", gradient, covariance, gradient)))
