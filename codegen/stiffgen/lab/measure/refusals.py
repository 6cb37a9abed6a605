# SPDX-License-Identifier: MIT
"""Reasons why a recording shows no stiffness, or one that delays, damping and friction would make asymmetric.

A reading that is late by tau adds ``-tau Km A`` to the fit, with A the regression of the velocity on the twist. Motions
there and back, and motions of several frequencies, have hardly any A; a circle in one sense has its angular velocity.
Damping and friction act alike.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.measure.fit import StiffnessFit, columns
from stiffgen.lab.measure.motion import PoseMotion
from stiffgen.lab.measure.residual import UPPER, residual_of, sensor_columns

DELAY = 0.005
"""[s] delay of the readings by which motions are judged."""
MOST_TURN, MOST_LEVER = np.radians(0.1), 1e-3
"""[rad], [m] errors of the sensor that this delay may fake."""
_SIGMAS = 3.0
"""Standard deviations by which an eigenvalue must lie off 0."""
_LEFT_OVER = 0.3
"""Part of the changes of force or moment that a fit may leave over."""
_LASTING = 2.0
"""Autocorrelation time [samples] from which residuals are more than noise."""
_CURVED = 0.05
"""Change of Km by terms of third order, over its diagonal, that is too large."""
_AXES = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")
_HALVES = (slice(0, 3), slice(3, 6))
"""Entries of translation and rotation, of force and moment."""
_DEVIATIONS = 4.0
"""Standard deviations that chance makes: of 36 entries one has 3."""


def refusals(motion: PoseMotion, fit: StiffnessFit) -> list[str]:
    """Return the reasons to refuse a recording, each beginning with its name; empty for a usable one."""
    return [*_one_way(motion, fit), *_sliding(fit), *_no_function_of_pose(motion, fit), *_too_curved(motion, fit)]


def eigenvalues(fit: StiffnessFit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return eigenvalues (6,), deviations and vectors (6, 6) of the stiffness, scaled by its diagonal to numbers.

    An eigenvalue u^T S K S u changes by (S u)^T dKm (S u), with the scale S and its vector u held.
    """
    K = fit.stiffness
    scale = 1.0 / _sizes(K)
    values, vectors = np.linalg.eigh(K * np.outer(scale, scale))
    along = vectors.T * scale  # row k: S u of eigenvalue k
    of = np.zeros((6, 6, 7))  # per entry of (load, Km): the load, in column 0, has no part
    of[:, :, 1:] = along[:, :, None] * along[:, None, :]
    return values, np.sqrt(np.diag(fit.covariance(of))), vectors


def _sizes(K: FloatArray) -> FloatArray:
    """Return the roots (6) of a stiffness's diagonal: divided by those of its row and column, its diagonal is 1."""
    return np.asarray(np.sqrt(np.maximum(np.abs(np.diag(K)), 1e-300)))


def drift_of(motion: PoseMotion) -> FloatArray:
    """Return the regression (6, 6) of the velocity on the twist [1/s]; its symmetric part, of the ends, is left out.

    The sum of dx x^T over the motion is the area that pairs of coordinates enclose: x_k+1 x_k^T without its symmetric
    part. Over the time it is the mean of velocity times twist.
    """
    X = motion.twist - motion.twist.mean(axis=0)
    products = X[1:].T @ X[:-1]
    area = (products - products.T) / 2 / (motion.time[-1] - motion.time[0])
    return np.asarray(area @ np.linalg.pinv(X.T @ X / len(X), hermitian=True))


def faked_errors(motion: PoseMotion, fit: StiffnessFit) -> tuple[float, float]:
    """Return the turn [rad] and the lever [m] of the sensor that a delay of DELAY would fake in this motion.

    Late readings are those of an earlier twist: Km changes by -DELAY Km times the velocity per twist.
    """
    faked = residual_of(-DELAY * fit.Km @ drift_of(motion), np.zeros(6))
    size = _sizes(fit.Km)
    weight = 1.0 / (size[UPPER[0]] * size[UPPER[1]])  # of the 15 entries, which have several units
    per_error = np.concatenate([sensor_columns(fit.Km, fit.load, name) for name in ("turn", "lever")], axis=1)
    errors = np.linalg.lstsq(per_error * weight[:, None], faked * weight, rcond=1e-9)[0]
    return float(np.linalg.norm(errors[:3])), float(np.linalg.norm(errors[3:]))


def _one_way(motion: PoseMotion, fit: StiffnessFit) -> Iterator[str]:
    """Yield a refusal where a small delay of the sensor would look like a turn or a shift of it."""
    turn, lever = faked_errors(motion, fit)
    if turn > MOST_TURN or lever > MOST_LEVER:
        yield (
            f"one-way motion: a delay of {1000 * DELAY:g} ms would look like a sensor turned by {np.degrees(turn):.2g} "
            f"deg and shifted by {1000 * lever:.2g} mm; move there and back on the same line, or run the excitation of "
            "'stiffgen measure --plan'"
        )


def _sliding(fit: StiffnessFit) -> Iterator[str]:
    """Yield a refusal where the eigenvalues of the stiffness do not have one sign, as a spring's have."""
    values, deviations, vectors = eigenvalues(fit)
    signs = np.where(np.abs(values) > _SIGMAS * deviations, np.sign(values), 0.0)
    if (signs == 1.0).all() or (signs == -1.0).all():
        return
    sign = 1.0 if values.sum() >= 0 else -1.0
    worst = int((sign * values).argmin())
    axis = _AXES[int(np.abs(vectors[:, worst]).argmax())]
    yield (
        f"no spring: {int((signs == sign).sum())} of 6 eigenvalues of the stiffness have one sign; mostly along "
        f"{axis} of the sensor it is {sign * values[worst]:.2g} +- {deviations[worst]:.2g} of the diagonal's. A hand "
        "or tool that slides, free motion and a moving equilibrium have no stiffness: press on one place, and move "
        "about it"
    )


def _no_function_of_pose(motion: PoseMotion, fit: StiffnessFit) -> Iterator[str]:
    """Yield a refusal where the fit leaves lasting changes of forces or moments over."""
    changes = motion.reading - motion.reading.mean(axis=0)
    for name, part in (("forces", slice(0, 3)), ("moments", slice(3, 6))):
        left = float(np.linalg.norm(fit.residuals[:, part])) / max(float(np.linalg.norm(changes[:, part])), 1e-300)
        if left > _LEFT_OVER and fit.growth > _LASTING:  # noise alone only widens the intervals
            yield (
                f"no function of the pose: the fit leaves {100 * left:.0f} % of the changes of the {name} over, and "
                "they last; move farther and slower, and look for friction and slip"
            )


def _too_curved(motion: PoseMotion, fit: StiffnessFit) -> Iterator[str]:
    """Yield a refusal if terms of third order change the stiffness by more than four deviations and _CURVED."""
    cubic = _fit_with_cubes(motion, fit.growth)
    if cubic is None:
        return
    Km, deviation = cubic
    size = _sizes(fit.Km)
    relative = (np.abs(Km - fit.Km) - _DEVIATIONS * deviation) / np.outer(size, size)
    if relative.max() > _CURVED:
        farthest = [1000 * np.linalg.norm(motion.twist[:, part], axis=1).max() for part in _HALVES]
        yield (
            f"too curved: over {farthest[0]:.3g} mm and {farthest[1]:.3g} mrad the stiffness changes by "
            f"{100 * relative.max():.0f} % by terms of third order; halve the motion, or choose a part of the "
            "recording with --window"
        )


def _fit_with_cubes(motion: PoseMotion, growth: float) -> tuple[FloatArray, FloatArray] | None:
    """Return Km (6, 6) and its deviations from a fit with radial terms of third order; None of too few rows.

    These are twelve columns: the twist (v, w), scaled to size 1, times |v|^2, and times |w|^2. ``growth`` is the factor
    of the covariance by errors that last.
    """
    size = np.maximum(np.sqrt((motion.twist**2).mean(axis=0)), 1e-300)
    X = motion.twist / size
    radial = [X * (X[:, part] ** 2).sum(axis=1, keepdims=True) for part in _HALVES]
    Z = np.concatenate([columns(X, quadratic=True), *radial], axis=1)
    if len(Z) < 2 * Z.shape[1]:
        return None
    values = np.linalg.lstsq(Z, motion.reading, rcond=None)[0]
    left = motion.reading - Z @ values
    noise = (left**2).sum(axis=0) / (len(Z) - Z.shape[1])  # variance of each channel
    spread = np.diag(np.linalg.pinv(Z.T @ Z, hermitian=True))[1:7] / size**2  # of each entry of the twist
    return (values[1:7] / size[:, None]).T, np.sqrt(np.outer(noise, spread) * growth)
