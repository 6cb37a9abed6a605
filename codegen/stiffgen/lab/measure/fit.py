# SPDX-License-Identifier: MIT
"""Fit a measured stiffness Km to small motions and readings, with the covariance of its entries.

Readings follow ``Y = b + X Km^T``, with quadratic columns where the motion is large or the readings show them: springs
are curved, and coordinates of a rotation have terms of second order. Channels have correlated errors, with the
covariance of the residuals. Errors that last from sample to sample leave less information in the same rows: the
covariance grows by the autocorrelation time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import measured_stiffness
from stiffgen.lab.measure.motion import PoseMotion

LINEAR = (0.004, 0.04)
"""[m, rad] farthest from the reference up to which linear columns may do."""
_MOST_BY_CHANCE = 126 + 3 * np.sqrt(2 * 126)
"""Largest chi-square of 126 degrees of freedom that chance makes (3 standard deviations)."""


@dataclass(frozen=True)
class StiffnessFit:
    """Measured stiffness in body representation, reading at the reference pose, and their errors.

    Attributes:
        Km: (6, 6) change of each component of the reading per component of the twist [N/m, N, N m].
        load: (6,) reading at the reference pose [N, N m].
        noise: (6, 6) covariance of a row's residuals.
        information: (7, 7) inverse of the normal matrix of the columns (1, X): ``noise`` times it is the covariance of
            the rows of (load, Km).
        quadratic: whether quadratic columns were fitted.
        residuals: (N, 6) readings less the fit.
        growth: factor of the covariance by errors that last; it is contained in ``information``.

    """

    Km: FloatArray
    load: FloatArray
    noise: FloatArray
    information: FloatArray
    quadratic: bool
    residuals: FloatArray
    growth: float

    @property
    def stiffness(self) -> FloatArray:
        """Symmetric stiffness (6, 6), body representation: sym(Km - Gamma F) [N/m, N, N m]."""
        return measured_stiffness(self.Km, self.load, "body").K

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations (6, 6) of the entries of Km."""
        return np.asarray(np.sqrt(np.outer(np.diag(self.noise), np.diag(self.information)[1:])))

    @property
    def load_deviation(self) -> FloatArray:
        """Standard deviations (6,) of the load [N, N m]."""
        return np.asarray(np.sqrt(np.diag(self.noise) * self.information[0, 0]))

    def covariance(self, of: FloatArray) -> FloatArray:
        """Return the covariance of linear combinations ``of`` (k, 6, 7) of the rows of (load, Km)."""
        return np.asarray(np.einsum("aij,ik,jl,bkl->ab", of, self.noise, self.information, of, optimize=True))


def fit_stiffness(motion: PoseMotion) -> StiffnessFit:
    """Return the fit by least squares, with quadratic columns where the motion is large or the readings show them.

    Six channels have 126 quadratic coefficients: where these are 0, the logarithm of the likelihoods' ratio, twice, is
    chi-square with 126 degrees of freedom (Wilks).
    """
    straight = _fit(motion, quadratic=False)
    curved = _fit(motion, quadratic=True)
    ratio = len(motion) * (np.linalg.slogdet(straight.noise)[1] - np.linalg.slogdet(curved.noise)[1])
    return curved if is_large(motion) or ratio > _MOST_BY_CHANCE else straight


def _fit(motion: PoseMotion, *, quadratic: bool) -> StiffnessFit:
    """Fit readings (rows, 6) to columns of the twists by least squares; also noise and its growth by correlation in
    time.
    """
    X, Y = motion.twist, motion.reading
    size = np.maximum(np.sqrt((X**2).mean(axis=0)), 1e-300)  # columns of equal size, for the condition
    Z = columns(X / size, quadratic=quadratic)
    values = np.linalg.lstsq(Z, Y, rcond=None)[0]
    residuals = Y - Z @ values
    growth = autocorrelation_time(residuals)  # factor of the variance: correlated rows tell less than independent ones
    scale = np.concatenate([[1.0], size])
    information = np.linalg.pinv(Z.T @ Z, hermitian=True)[:7, :7] / np.outer(scale, scale) * growth
    floor = np.diag((1e-12 * np.maximum(np.abs(Y).max(axis=0), 1e-6)) ** 2)  # readings without noise
    noise = residuals.T @ residuals / (len(X) - Z.shape[1]) + floor
    return StiffnessFit((values[1:7] / size[:, None]).T, values[0], noise, information, quadratic, residuals, growth)


def columns(X: FloatArray, *, quadratic: bool) -> FloatArray:
    """Return the columns of a fit: 1, the six components of the twist, and their 21 products."""
    linear = np.concatenate([np.ones((len(X), 1)), X], axis=1)
    rows, others = np.triu_indices(6)
    return np.concatenate([linear, X[:, rows] * X[:, others]], axis=1) if quadratic else linear


def is_large(motion: PoseMotion) -> bool:
    """Return whether the motion leaves the range in which linear columns do."""
    farthest = [np.linalg.norm(motion.twist[:, k : k + 3], axis=1).max() for k in (0, 3)]
    return bool(farthest[0] > LINEAR[0] or farthest[1] > LINEAR[1])


def autocorrelation_time(residuals: FloatArray) -> float:
    """Return the samples for which errors last, of the worst channel: 1 for independent ones."""
    count = len(residuals)
    centred = residuals - residuals.mean(axis=0)
    spectrum = np.abs(np.fft.rfft(centred, n=2 * count, axis=0)) ** 2
    lagged = np.fft.irfft(spectrum, axis=0)[: count // 2]
    total = np.maximum(lagged[0], 1e-300)
    longest = 1.0
    for channel in (lagged / total).T:
        below = np.flatnonzero(channel < 2.0 / np.sqrt(count))  # what chance makes of independent errors
        last = int(below[0]) if len(below) else len(channel)
        longest = max(longest, 1.0 + 2.0 * float(channel[1:last].sum()))
    return longest
