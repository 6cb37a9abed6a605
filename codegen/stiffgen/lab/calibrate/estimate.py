# SPDX-License-Identifier: MIT
"""Estimate bias and payload of a sensor from poses at rest, by least squares, with joint intervals.

A reading at rest is bias + A(q) payload, with A from the generated ``sensor.reading``. The mass enters the forces alone
and the first moment the moments alone, so that the two are separate problems. Each of the six channels has its own
variance, estimated from its residuals. Besides drifting, a bias walks at random, so that errors of neighbouring poses
are alike: the walk's share follows from the residuals by restricted likelihood (Patterson and Thompson, 1971), and an
interval is the widest of all plausible shares. The intervals hold for all ten numbers at once (Bonferroni, Student's
t): of 700 simulated recordings, 94 % have all ten inside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stiffgen.core.errors import RecordingError
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.calibrate.calibration import Calibration
from stiffgen.lab.calibrate.poses import StandingPoses
from stiffgen.lab.quantiles import student_quantile

_LEVEL = 0.05
"""Probability that one of the numbers lies outside its interval."""
_NUMBERS = 10
"""Numbers whose intervals hold at once: bias (6) and payload (4)."""
_FEWEST = 6
"""Least number of poses of a calibration."""
_FEWEST_WITH_DRIFT = 8
"""Number of poses from which on the drift is estimated, too."""
_ROUNDS = 4
"""Rounds of least squares in which the channels' variances settle."""
_ALIKE = 1e-9
"""Share of the largest singular value below which forces lie along one line."""
_EXCITED = 0.1
"""Least change of gravity's direction in sensor axes, root mean square over the poses along the worst axis."""
_WALKS = np.array([0.0, *np.logspace(-2, 4, 25)])
"""Variances of the bias's walk over the whole recording that are tried, over the variance of a pose's noise."""
_PLAUSIBLE = 1.92
"""By how much the logarithm of the likelihood of a plausible walk may be below the greatest: 95 %, by chi-squared."""
_TURNED = 0.05
"""[rad] Rotation of the sensor against its frame from which the calibration is refused, if it is significant."""


@dataclass(frozen=True)
class Fit:
    """Least squares of one half of the readings: parameters and deviations, residuals (P, 3), degrees of freedom."""

    values: FloatArray
    deviations: FloatArray
    residuals: FloatArray
    freedom: float
    likelihood: float

    def interval(self) -> FloatArray:
        """Return half widths of the parameters' intervals; the walk's share takes a degree of freedom, too."""
        return student_quantile(self.freedom - 1.0, _LEVEL / _NUMBERS) * self.deviations


@dataclass(frozen=True)
class Estimate:
    """Calibration with the residuals of its poses (P, 6) and the root mean square of the excitation by direction."""

    calibration: Calibration
    residuals: FloatArray
    excitation: float


def regressors(sensor: Any, q: FloatArray) -> FloatArray:
    """Return A(q) (P, 6, 4): the reading at rest is bias + A payload."""
    none = np.zeros(6)
    return np.asarray(np.swapaxes(sensor.reading(q[:, None, :], none, none, np.eye(4)), 1, 2))


def estimate(sensor: Any, poses: StandingPoses, *, robot: str = "", place: str = "") -> Estimate:
    """Return the calibration from poses at rest without contact.

    Args:
        sensor: functions of the sensor, ``module.sensor``.
        poses: poses of :func:`stiffgen.lab.calibrate.poses.standing`.
        robot: name of the robot, for the record.
        place: link, sign and pose of the sensor, for the record.

    Raises:
        RecordingError: there are too few poses, they do not excite the payload, the sensor has the other sign, or is
            turned against its frame.

    """
    count = len(poses)
    if count < _FEWEST:
        raise RecordingError(
            f"the robot stands still at {count} poses, and a calibration needs {_FEWEST}; hold each for a second"
        )
    # time before the last pose: the bias is that of the end of the recording
    A, time = regressors(sensor, poses.q), poses.time - poses.time[-1]
    duration = float(np.ptp(time))
    has_drift = count >= _FEWEST_WITH_DRIFT and duration > 0
    common = [np.broadcast_to(np.eye(3), (count, 3, 3))]  # columns of bias and drift, of forces and of moments alike
    if has_drift:
        common.append(time[:, None, None] / duration * np.eye(3))
    bias_columns = np.concatenate(common, axis=2)
    excitation = _excitation(A, bias_columns)
    forces, moments = poses.reading[:, :3], poses.reading[:, 3:]
    force = _fit(np.concatenate([A[:, :3, :1], bias_columns], axis=2), forces, time)
    moment = _fit(np.concatenate([A[:, 3:, 1:], bias_columns], axis=2), moments, time)
    rotation, rotation_interval = _rotation(A[:, :3, 0], forces, force, bias_columns, time)
    payload, bias, drift = _joined(force.values, moment.values)
    payload_interval, bias_interval, _ = _joined(force.interval(), moment.interval())
    residuals = np.concatenate([force.residuals, moment.residuals], axis=1)
    freedom = np.repeat([force.freedom, moment.freedom], 3)
    calibration = Calibration(
        robot=robot,
        sensor=place,
        bias=_numbers(bias),
        payload=_numbers(payload),
        bias_interval=_numbers(bias_interval),
        payload_interval=_numbers(payload_interval),
        drift=_numbers(drift / duration if has_drift else np.zeros(6)),
        noise=_numbers(np.sqrt((residuals**2).sum(axis=0) / freedom)),
        rotation=_numbers(rotation),
        rotation_interval=_numbers(rotation_interval),
        poses=count,
    )
    return Estimate(calibration, residuals, excitation)


def _joined(force: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return payload (4), bias (6) and drift over the recording (6, or none) from the parameters of both fits.

    Those of the forces are mass, bias (3) and drift (3); those of the moments first moment (3), bias (3) and drift (3).
    """
    mass, force_bias, force_drift = np.split(force, [1, 4])
    first_moment, moment_bias, moment_drift = np.split(moment, [3, 6])
    return (
        np.concatenate([mass, first_moment]),
        np.concatenate([force_bias, moment_bias]),
        np.concatenate([force_drift, moment_drift]),
    )


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(each) for each in values)


def _fit(X: FloatArray, y: FloatArray, time: FloatArray) -> Fit:
    """Return the solution of y = X p, (P, 3) and (P, 3, p), of the likeliest walk; time (P) up to the last pose [s].

    A walk that ends at the last pose, where the bias is asked, has the covariance min(-t_i, -t_j).
    """
    walk = np.minimum.outer(-time, -time) / (float(np.ptp(time)) or 1.0)
    fits = [_fit_of_walk(X, y, np.eye(len(y)) + share * walk) for share in _WALKS]
    best = max(fits, key=lambda fit: fit.likelihood)
    plausible = [fit.deviations for fit in fits if fit.likelihood >= best.likelihood - _PLAUSIBLE]
    return replace(best, deviations=np.max(plausible, axis=0))


def _fit_of_walk(X: FloatArray, y: FloatArray, covariance: FloatArray) -> Fit:
    """Return the solution for a covariance (P, P) of the poses, with one variance per channel.

    X is (P, 3, unknowns), y (P, 3). The variances follow from the residuals, and weigh the channels in the next of four
    rounds. The likelihood compares covariances: with V that of all readings, its logarithm is, up to a constant,
    -log det V / 2 - log det(X^T V^-1 X) / 2.
    """
    count, _, size = X.shape
    freedom = count - size / 3  # per channel
    # Poses times the inverse of the factor have independent errors; rows (3 P, unknowns) are pose by pose.
    factor = np.linalg.cholesky(covariance)
    rows = np.linalg.solve(factor, X.reshape(count, -1)).reshape(-1, size)
    right = np.linalg.solve(factor, y)
    floor = 1e-12 * max(1.0, float(np.abs(y).max()))  # of readings without noise
    deviation = np.ones(3)
    for _ in range(_ROUNDS):
        weight = np.tile(1 / deviation, count)
        values, *_ = np.linalg.lstsq(rows * weight[:, None], right.ravel() * weight, rcond=None)
        left = right - (rows @ values).reshape(-1, 3)
        deviation = np.maximum(np.sqrt((left**2).sum(axis=0) / freedom), floor)
    weight = np.tile(1 / deviation, count)
    information = (rows * weight[:, None]).T @ (rows * weight[:, None])
    half_log_det = count * np.log(deviation).sum() + 3 * np.log(np.diag(factor)).sum()  # of V
    likelihood = -half_log_det - np.linalg.slogdet(information)[1] / 2
    return Fit(
        values=np.asarray(values, dtype=float),
        deviations=np.sqrt(np.diag(np.linalg.inv(information))),
        residuals=y - X @ values,
        freedom=freedom,
        likelihood=float(likelihood),
    )


def _excitation(A: FloatArray, bias_columns: FloatArray) -> float:
    """Return the excitation of the payload: what bias and drift cannot explain, over gravity, in the worst direction.

    Raises:
        RecordingError: the poses do not excite the payload.

    """
    gravity = float(np.linalg.norm(A[0, :3, 0])) or 1.0
    of_mass, _ = _least_excitation(A[:, :3, :1], bias_columns, gravity)
    of_moment, axis = _least_excitation(A[:, 3:, 1:], bias_columns, gravity)
    if min(of_mass, of_moment) < _EXCITED:
        what = "mass" if of_mass < _EXCITED else "first moment"
        along = "" if of_mass < _EXCITED else f" along ({', '.join(f'{x:.2f}' for x in axis)}) of the sensor"
        raise RecordingError(
            f"the poses do not excite the payload's {what}{along}: gravity's direction in sensor axes changes by "
            f"{min(of_mass, of_moment):.2g}, and {_EXCITED:g} is needed. Turn the sensor's axes up, down and sideways, "
            "by 60 deg or more about two of them"
        )
    return float(min(of_mass, of_moment))


def _least_excitation(columns: FloatArray, bias_columns: FloatArray, gravity: float) -> tuple[float, FloatArray]:
    """Return the least excitation of columns (P, 3, k), root mean square over the poses, and its direction (k)."""
    left = _without_bias(columns.reshape(-1, columns.shape[2]), bias_columns)
    _, sizes, axes = np.linalg.svd(left, full_matrices=False)
    return float(sizes[-1]) / np.sqrt(len(columns)) / gravity, axes[-1]


def _without_bias(rows: FloatArray, bias_columns: FloatArray) -> FloatArray:
    """Return rows (3 P, or 3 P, k) less what the columns of bias and drift (P, 3, m) can explain."""
    base = bias_columns.reshape(-1, bias_columns.shape[2])
    return np.asarray(rows - base @ np.linalg.lstsq(base, rows, rcond=None)[0])


def _refuse_sign(force: Fit) -> None:
    raise RecordingError(
        f"the mass would be {force.values[0]:.3g} kg +- {force.interval()[0]:.2g} kg: the sensor reports the wrench of "
        "the other body; generate the robot with the other --sensor sign"
    )


def _rotation(
    gravity: FloatArray, forces: FloatArray, force: Fit, bias_columns: FloatArray, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3) [rad] of the sensor against its frame that fits the forces best, and its intervals.

    The frame at generation times the rotation is the frame of the sensor.

    Raises:
        RecordingError: the rotation is large and significant, or the forces fit the other sign better.

    """
    turn = _nearest_turn(gravity, forces, bias_columns)
    if turn is None:
        return np.zeros(3), np.full(3, np.pi)
    turned = gravity @ turn.T
    first = _fit(np.concatenate([turned[:, :, None], bias_columns], axis=2), forces, time)
    is_negative = force.values[0] < -force.interval()[0]  # the mass, without a rotation
    if is_negative and (force.residuals**2).sum() < 2 * (first.residuals**2).sum():
        _refuse_sign(force)  # hardly worse than with the rotation: it is no half turn
    # r x weight of a small rotation r: its parameters are near 0, and their intervals those of the rotation
    small_turn = _turning(first.values[0] * turned)
    fit = _fit(np.concatenate([small_turn, turned[:, :, None], bias_columns], axis=2), forces, time)
    rotation, interval = _logarithm(turn.T), fit.interval()[:3]
    angle = float(np.linalg.norm(rotation))
    is_significant = angle > 2 * float(np.linalg.norm(interval))
    if angle > _TURNED and is_significant and force.values[0] != 0:
        degrees = ", ".join(f"{each:.1f}" for each in np.degrees(rotation))
        raise RecordingError(
            f"the forces fit a sensor that is turned by the rotation vector ({degrees}) deg against its frame: "
            "generate the robot with another --sensor rpy"
        )
    return rotation, np.minimum(interval, np.pi)


def _turning(vectors: FloatArray) -> FloatArray:
    """Return the matrices (P, 3, 3) that map a rotation vector r to r x w, of vectors w (P, 3)."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    rows = ((zero, z, -y), (-z, zero, x), (y, -x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def _nearest_turn(gravity: FloatArray, forces: FloatArray, bias_columns: FloatArray) -> FloatArray | None:
    """Return the rotation (3, 3) of gravity (P, 3) that comes nearest to the forces (P, 3); None if several do.

    With the correlation forces^T gravity = U S V^T that is U V^T, with the last column's sign that makes it a rotation.
    """
    measured, expected = (_without_bias(each.reshape(-1), bias_columns).reshape(-1, 3) for each in (forces, gravity))
    U, sizes, Vt = np.linalg.svd(measured.T @ expected)
    if not sizes[1] > _ALIKE * max(sizes[0], 1e-300):  # all along one line: any rotation about it fits
        return None
    return np.asarray(U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt)


def _logarithm(R: FloatArray) -> FloatArray:
    """Return the rotation vector of a rotation."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine, cosine = float(np.linalg.norm(axis)), (float(np.trace(R)) - 1) / 2
    if sine > 1e-8:
        return np.asarray(axis / sine * np.arctan2(sine, cosine))
    if cosine > 0:
        return axis
    values, vectors = np.linalg.eigh((R + R.T) / 2)  # half a turn: the axis is an eigenvector of 1
    return np.asarray(np.pi * vectors[:, int(values.argmax())])


def further_poses(
    sensor: Any, poses: StandingPoses, found: Estimate, lower: FloatArray, upper: FloatArray, count: int = 3
) -> list[tuple[FloatArray, float]]:
    """Return up to ``count`` postures that would tighten the intervals most, with the factor on the widest one.

    The postures differ from recorded ones in the last three joints, which stay between ``lower`` and ``upper`` (both
    finite). Whether they are free of collisions is not known.
    """
    random = np.random.default_rng(0)
    candidates = np.repeat(poses.q, 8, axis=0)  # eight for each recorded posture (C, n) [rad]
    last = slice(max(0, candidates.shape[1] - 3), None)
    candidates[:, last] = random.uniform(lower[last], upper[last], candidates[:, last].shape)
    noise = np.maximum(np.array(found.calibration.noise), 1e-12)  # standard deviations (6) [N], [N m], never 0
    total = _information(sensor, poses.q, noise).sum(axis=0)
    gains = _information(sensor, candidates, noise)
    chosen, start = [], float(_widest(total))
    for _ in range(count):  # the candidate that leaves the least is taken, one by one
        after = _widest(total + gains)
        best = int(after.argmin())
        total = total + gains[best]
        chosen.append((candidates[best], float(after[best]) / start))
    return chosen


def _information(sensor: Any, q: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the information matrices (P, 10, 10) of poses about payload (4) and bias (6); drift is left out."""
    bias = np.broadcast_to(np.eye(6), (len(q), 6, 6))
    scaled = np.concatenate([regressors(sensor, q), bias], axis=2) / noise[:, None]
    return np.asarray(np.swapaxes(scaled, 1, 2) @ scaled)


def _widest(information: FloatArray) -> FloatArray:
    """Return the largest deviation of the first moment [kg m], entries 1 to 3, from information (..., 10, 10)."""
    variances = np.diagonal(np.linalg.inv(information), axis1=-2, axis2=-1)
    return np.asarray(np.sqrt(variances[..., 1:4].max(axis=-1)))
