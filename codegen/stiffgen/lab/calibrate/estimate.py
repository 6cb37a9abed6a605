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
_NUMBERS = 10
_FEWEST = 6
_FEWEST_WITH_DRIFT = 8
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
    has_drift = count >= _FEWEST_WITH_DRIFT and float(np.ptp(time)) > 0
    columns = [np.broadcast_to(np.eye(3), (count, 3, 3))]
    if has_drift:
        columns.append(time[:, None, None] / np.ptp(time) * np.eye(3))
    common = np.concatenate(columns, axis=2)  # bias and drift, of forces and of moments alike
    # parameters of the forces: mass, bias (3), drift (3); of the moments: first moment (3), bias (3), drift (3)
    X = [np.concatenate([A[:, :3, :1], common], axis=2), np.concatenate([A[:, 3:, 1:], common], axis=2)]
    excitation = _excitation(A, common)
    force, moment = (_fit(x, poses.reading[:, 3 * k : 3 * k + 3], time) for k, x in enumerate(X))
    rotation, rotation_interval = _rotation(A[:, :3, 0], poses.reading[:, :3], force, common, time)
    scale = np.ptp(time) if has_drift else 1.0
    drift = [*force.values[4:7] / scale, *moment.values[6:9] / scale] if has_drift else np.zeros(6)
    residuals = np.concatenate([force.residuals, moment.residuals], axis=1)
    calibration = Calibration(
        robot,
        place,
        _numbers([*force.values[1:4], *moment.values[3:6]]),
        _numbers([force.values[0], *moment.values[:3]]),
        _numbers([*force.interval()[1:4], *moment.interval()[3:6]]),
        _numbers([force.interval()[0], *moment.interval()[:3]]),
        _numbers(drift),
        _numbers(np.sqrt((residuals**2).sum(axis=0) / np.repeat([force.freedom, moment.freedom], 3))),
        _numbers(rotation),
        _numbers(rotation_interval),
        count,
    )
    return Estimate(calibration, residuals, excitation)


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
    rounds; the likelihood compares covariances.
    """
    count, _, size = X.shape
    freedom = count - size / 3  # per channel
    factor = np.linalg.cholesky(covariance)
    rows, right = np.linalg.solve(factor, X.reshape(count, -1)).reshape(-1, size), np.linalg.solve(factor, y)
    deviation = np.ones(3)
    for _ in range(4):
        weight = np.tile(1 / deviation, count)
        values, *_ = np.linalg.lstsq(rows * weight[:, None], right.ravel() * weight, rcond=None)
        left = right - (rows @ values).reshape(-1, 3)
        deviation = np.sqrt((left**2).sum(axis=0) / freedom)
        deviation = np.maximum(deviation, 1e-12 * max(1.0, float(np.abs(y).max())))
    weight = np.tile(1 / deviation, count)
    information = (rows * weight[:, None]).T @ (rows * weight[:, None])
    determinants = count * np.log(deviation).sum() + 3 * np.log(np.diag(factor)).sum()
    likelihood = -determinants - np.linalg.slogdet(information)[1] / 2
    deviations = np.sqrt(np.diag(np.linalg.inv(information)))
    return Fit(np.asarray(values, dtype=float), deviations, y - X @ values, freedom, float(likelihood))


def _excitation(A: FloatArray, common: FloatArray) -> float:
    """Return the excitation of the payload: what bias and drift cannot explain, over gravity, in the worst direction.

    Raises:
        RecordingError: the poses do not excite the payload.

    """
    gravity = float(np.linalg.norm(A[0, :3, 0])) or 1.0
    base = common.reshape(-1, common.shape[2])
    found = []
    for rows in (A[:, :3, :1], A[:, 3:, 1:]):  # of the mass, of the first moment
        flat = rows.reshape(-1, rows.shape[2])
        left = flat - base @ np.linalg.lstsq(base, flat, rcond=None)[0]
        _, sizes, axes = np.linalg.svd(left, full_matrices=False)
        found.append((float(sizes[-1]) / np.sqrt(len(A)) / gravity, axes[-1]))  # smallest, with its direction
    (of_mass, _), (of_moment, axis) = found
    if min(of_mass, of_moment) < _EXCITED:
        what = "mass" if of_mass < _EXCITED else "first moment"
        along = "" if of_mass < _EXCITED else f" along ({', '.join(f'{x:.2f}' for x in axis)}) of the sensor"
        raise RecordingError(
            f"the poses do not excite the payload's {what}{along}: gravity's direction in sensor axes changes by "
            f"{min(of_mass, of_moment):.2g}, and {_EXCITED:g} is needed. Turn the sensor's axes up, down and sideways, "
            "by 60 deg or more about two of them"
        )
    return float(min(of_mass, of_moment))


def _refuse_sign(force: Fit) -> None:
    raise RecordingError(
        f"the mass would be {force.values[0]:.3g} kg +- {force.interval()[0]:.2g} kg: the sensor reports the wrench of "
        "the other body; generate the robot with the other --sensor sign"
    )


def _rotation(
    gravity: FloatArray, forces: FloatArray, force: Fit, common: FloatArray, time: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3) [rad] of the sensor against its frame that fits the forces best, and its intervals.

    The frame at generation times the rotation is the frame of the sensor.

    Raises:
        RecordingError: the rotation is large and significant, or the forces fit the other sign better.

    """
    base = common.reshape(-1, common.shape[2])

    def without_bias(rows: FloatArray) -> FloatArray:
        """Return rows (P, 3) less what bias and drift can explain."""
        flat = rows.reshape(-1)
        return np.asarray((flat - base @ np.linalg.lstsq(base, flat, rcond=None)[0]).reshape(-1, 3))

    # the rotation of gravity that comes nearest to the forces, by the singular values of their correlation
    U, sizes, Vt = np.linalg.svd(without_bias(forces).T @ without_bias(gravity))
    if not sizes[1] > 1e-9 * max(sizes[0], 1e-300):  # all along one line: any rotation about it fits
        return np.zeros(3), np.full(3, np.pi)
    turn = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    turned = gravity @ turn.T
    first = _fit(np.concatenate([turned[:, :, None], common], axis=2), forces, time)
    # a negative mass without a rotation, and hardly worse: the sign is wrong, and no half turn
    if force.values[0] < -force.interval()[0] and (force.residuals**2).sum() < 2 * (first.residuals**2).sum():
        _refuse_sign(force)
    weight = first.values[0] * turned
    x, y, z = weight.T
    zero = np.zeros(len(weight))
    # r x weight of a small rotation r: its parameters are near 0, and their intervals those of the rotation
    columns = np.stack([np.stack(row, -1) for row in ((zero, z, -y), (-z, zero, x), (y, -x, zero))], 1)
    fit = _fit(np.concatenate([columns, turned[:, :, None], common], axis=2), forces, time)
    rotation, interval = _logarithm(turn.T), fit.interval()[:3]
    angle = float(np.linalg.norm(rotation))
    if angle > _TURNED and angle > 2 * float(np.linalg.norm(interval)) and force.values[0] != 0:
        degrees = ", ".join(f"{each:.1f}" for each in np.degrees(rotation))
        raise RecordingError(
            f"the forces fit a sensor that is turned by the rotation vector ({degrees}) deg against its frame: "
            "generate the robot with another --sensor rpy"
        )
    return rotation, np.minimum(interval, np.pi)


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
    candidates = np.repeat(poses.q, 8, axis=0)  # eight for each recorded posture (P, n) [rad]
    last = slice(max(0, candidates.shape[1] - 3), None)
    candidates[:, last] = random.uniform(lower[last], upper[last], candidates[:, last].shape)
    noise = np.maximum(np.array(found.calibration.noise), 1e-12)  # standard deviations (6) [N], [N m], never 0

    def information(q: FloatArray) -> FloatArray:
        """Return the information matrices (P, 10, 10) of poses about payload and bias; drift is left out."""
        A = np.concatenate([regressors(sensor, q), np.broadcast_to(np.eye(6), (len(q), 6, 6))], axis=2)
        scaled = A / noise[:, None]
        return np.asarray(np.swapaxes(scaled, 1, 2) @ scaled)

    total, gains = information(poses.q).sum(axis=0), information(candidates)
    # 1:4 is the first moment; the candidate that leaves the smallest of its largest deviations is taken, one by one
    chosen, start = [], float(np.sqrt(np.diag(np.linalg.inv(total))[1:4].max()))
    for _ in range(count):
        # largest deviation of the first moment [kg m] after each candidate (P)
        worst = np.sqrt(np.diagonal(np.linalg.inv(total + gains), axis1=1, axis2=2)[:, 1:4].max(axis=1))
        best = int(worst.argmin())
        total = total + gains[best]
        chosen.append((candidates[best], float(worst[best]) / start))
    return chosen
