# SPDX-License-Identifier: MIT
"""Measure the stiffness about a pose, and what its antisymmetric part says of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import RecordingError
from stiffgen.core.robot.chain import MountedSensor
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import measured_stiffness
from stiffgen.lab.measure.fit import StiffnessFit, fit_stiffness
from stiffgen.lab.measure.motion import PoseMotion, motion, skew
from stiffgen.lab.measure.refusals import eigenvalues, faked_errors, refusals
from stiffgen.lab.measure.residual import NORMAL, Residual, analyse_residual


@dataclass(frozen=True)
class Measurement:
    """Stiffness measured about a pose, in body representation: the sensor's axes, about its origin.

    Attributes:
        motion: the rows that were used.
        fit: Km, the load, and their covariance.
        residual: antisymmetric residual, and the sensor's errors that would make it.
        sign: 1 if the readings are the wrench that stretches the spring, -1 if they are the spring's own.
        faked: turn [rad] and lever [m] that a delay of 5 ms would fake in this motion.

    """

    motion: PoseMotion
    fit: StiffnessFit
    residual: Residual
    sign: int
    faked: tuple[float, float]

    @property
    def K(self) -> FloatArray:
        """Positive definite task stiffness (6, 6), sym(Km - Gamma F) [N/m, N, N m]; the argument of joint_stiffness."""
        return self.sign * self.fit.stiffness

    @property
    def load(self) -> FloatArray:
        """Wrench (6,) that goes with K: the readings' at the reference pose, times ``sign`` [N, N m]."""
        return self.sign * self.fit.load

    @property
    def interval(self) -> FloatArray:
        """Half widths (6, 6) of the 95 % intervals of the entries of Km [N/m, N, N m]."""
        return NORMAL * self.fit.deviation


def measure_stiffness(
    time: ArrayLike, poses: ArrayLike, readings: ArrayLike, *, in_base_axes: bool = False, has_bias: bool = True
) -> Measurement:
    """Return the stiffness about the mean of recorded poses, and what is wrong with the sensor.

    Args:
        time: (N,) time [s].
        poses: (N, 4, 4) poses of the sensor's frame in base axes [m].
        readings: (N, 6) force and moment about the sensor's origin [N, N m], in the axes of the sensor's frame.
        in_base_axes: readings are in base axes.
        has_bias: readings may have a bias that is not known, which makes turn and lever ten times less certain.

    Raises:
        RecordingError: the rows do not fit, or show no stiffness; the message names every reason.

    """
    rows = motion(time, poses, readings, in_base_axes=in_base_axes)
    fit = fit_stiffness(rows)
    reasons = refusals(rows, fit)
    if reasons:
        raise RecordingError("no stiffness can be measured from these rows:\n- " + "\n- ".join(reasons))
    sign = 1 if eigenvalues(fit)[0].sum() > 0 else -1
    return Measurement(rows, fit, analyse_residual(fit, has_bias=has_bias), sign, faked_errors(rows, fit))


@dataclass(frozen=True)
class MeasuredJointStiffness:
    """Joint stiffness (n, n) of a measured task stiffness under its load, and its standard deviations [N m/rad]."""

    joint_stiffness: FloatArray
    deviation: FloatArray


def joint_stiffness_deviation(
    found: Measurement, functions: Any, q: ArrayLike, sensor: MountedSensor | None = None
) -> MeasuredJointStiffness:
    """Return the joint stiffness of a measurement, with deviations from the errors of load and stiffness together.

    It is the counterpart of :func:`stiffgen.stiffness_deviation`, where K is exact and the wrench is not.

    Args:
        found: the measurement.
        functions: module of the robot, or of the tip that moves with the sensor.
        q: joint positions (n) at the reference pose [rad or m].
        sensor: its place in the tip's frame; None: the readings are those at the tip.

    """
    to_sensor, position = _to_sensor(sensor), np.asarray(q, dtype=float)

    def linear(F: FloatArray, Km: FloatArray) -> FloatArray:
        """Return Kq of a load and its changes per twist at the sensor; it is linear in both.

        Km moves to the tip as the wrench does. Its symmetric part does not: Gamma F is that of the tip's own twists.
        """
        load, at_tip = F @ to_sensor, to_sensor.T @ Km @ to_sensor
        K = measured_stiffness(at_tip, load, "body").K
        return np.asarray(functions.body.joint_stiffness(position, load, K), dtype=float)

    value = linear(found.load, found.sign * found.fit.Km)
    # the map itself, entry by entry of (load, Km), (6, 7): column 0 is the load
    units = np.eye(42).reshape(42, 6, 7)
    rates = np.stack([linear(unit[:, 0], unit[:, 1:]).ravel() for unit in units], axis=1)
    covariance = found.fit.covariance(rates.reshape(value.size, 6, 7))
    return MeasuredJointStiffness(value, np.sqrt(np.diag(covariance)).reshape(value.shape))


def _to_sensor(sensor: MountedSensor | None) -> FloatArray:
    """Return the map (6, 6) from twists of the tip to twists of the sensor, each in its own axes.

    With the sensor at (R, p) in the tip's frame, its twist is (R^T (v + w x p), R^T w).
    """
    matrix = np.eye(6)
    if sensor is not None:
        R = np.array(sensor.rotation, dtype=float)
        matrix[:3, :3] = matrix[3:, 3:] = R.T
        matrix[:3, 3:] = -R.T @ skew(np.array(sensor.translation, dtype=float))
    return matrix
