# SPDX-License-Identifier: MIT
"""Antisymmetric residual of a measured stiffness, and the errors of a sensor that would make it.

In every conservative environment antisym(Km) is known from the load alone: in body representation
``[[0, [f]], [[f], [m]]] / 2`` (docs/analyze.md, equation 2). What is left over comes from the sensor: a turn and a
shift of its frame change Km by ``T Km``, which is asymmetric whatever the load, and a bias is a load that is not there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mpmath
import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import measured_stiffness
from stiffgen.lab.measure.fit import StiffnessFit
from stiffgen.lab.measure.motion import skew

UPPER = np.triu_indices(6, 1)
"""Rows and columns of the 15 entries above the diagonal."""
NORMAL = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""
CONFUSED = 50.0
"""Factor by which others may widen the deviation of an error before it counts as not separable."""
_BLIND = 1e-6
"""Part of a direction that the readings may lack before an error along it counts as not seen."""

ErrorVerdict = Literal["none", "found", "not separable"]


def residual_of(Km: FloatArray, load: FloatArray) -> FloatArray:
    """Return the 15 upper entries of antisym(Km) less what the load explains [N/m, N, N m]."""
    return np.asarray(measured_stiffness(Km, load, "body").residual.matrix[UPPER])


def _operator() -> FloatArray:
    """Return the linear map (15, 6, 7) from (load, Km), row by row, to the residual."""
    units = np.eye(42).reshape(42, 6, 7)
    return np.stack([residual_of(each[:, 1:], each[:, 0]) for each in units], axis=1).reshape(15, 6, 7)


@dataclass(frozen=True)
class SensorError:
    """An error of the sensor that would make the residual: three numbers of one unit.

    Attributes:
        name: "turn" (rotation vector of the sensor against its frame [rad]), "lever" (shift of its origin [m]), "force
            bias" [N] or "moment bias" [N m]; all in sensor axes.
        value: (3,) estimate.
        deviation: (3,) standard deviations, with all errors that were looked for.
        verdict: "found" (its chi-square exceeds the 95 % quantile), "none", or "not separable" from the others.

    """

    name: str
    value: FloatArray
    deviation: FloatArray
    verdict: ErrorVerdict


@dataclass(frozen=True)
class Residual:
    """Antisymmetric residual, what chance makes of it, and what explains it.

    Attributes:
        values: (15,) residual, the upper entries row by row [N/m, N, N m].
        covariance: (15, 15).
        chi2: its size, chi-square with 15 degrees of freedom if the sensor is right.
        probability: that chance makes a larger one.
        errors: of the sensor, estimated together.
        left: (15,) residual after the errors found.
        left_probability: that chance makes a larger one than what all errors leave over.

    """

    values: FloatArray
    covariance: FloatArray
    chi2: float
    probability: float
    errors: tuple[SensorError, ...]
    left: FloatArray
    left_probability: float

    @property
    def is_alarm(self) -> bool:
        """Whether the residual is larger than chance makes it in 95 of 100 recordings."""
        return self.probability < 0.05


def analyse_residual(fit: StiffnessFit, *, has_bias: bool) -> Residual:
    """Return the residual of a fit and its causes; ``has_bias``: readings may have a bias that is not known.

    The causes theta follow from whitened least squares: r = W theta + noise of variance 1.
    """
    values, operator = residual_of(fit.Km, fit.load), _operator()
    covariance = fit.covariance(operator)
    names = ("turn", "lever", "force bias", "moment bias") if has_bias else ("turn", "lever")
    causes = np.concatenate([sensor_columns(fit.Km, fit.load, name) for name in names], axis=1)  # (15, 3 names)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    r, W = whiten @ values, whiten @ causes
    scale = np.maximum(np.linalg.norm(W, axis=0), 1e-300)  # columns of length 1, for the condition
    information = (W / scale).T @ (W / scale)
    inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    theta, spread = inverse @ (W / scale).T @ r / scale, inverse / np.outer(scale, scale)
    # along a direction in which nothing is seen the pseudo-inverse has no spread
    is_blind = np.diag(information @ inverse) < 1 - _BLIND
    deviations = np.where(is_blind, np.inf, np.sqrt(np.diag(spread)))
    errors = []
    for k, name in enumerate(names):
        part = slice(3 * k, 3 * k + 3)
        widened = deviations[part] * scale[part]  # 1 / scale: the deviation if all others were known
        verdict = _verdict(theta[part], spread[part, part], widened)
        errors.append(SensorError(name, theta[part], deviations[part], verdict))
    found = np.repeat([each.verdict == "found" for each in errors], 3)
    left_over = r - W @ theta
    freedom = len(values) - np.linalg.matrix_rank(W / scale, tol=1e-6)
    return Residual(
        values=values,
        covariance=covariance,
        chi2=float(r @ r),
        probability=tail(float(r @ r), len(values)),
        errors=tuple(errors),
        left=values - causes @ np.where(found, theta, 0.0),
        left_probability=tail(float(left_over @ left_over), freedom),
    )


def _verdict(value: FloatArray, spread: FloatArray, widened: FloatArray) -> ErrorVerdict:
    """Return whether an error of three numbers with a covariance (3, 3) is there.

    ``widened`` (3) are the factors by which the other errors widen its deviations.
    """
    if (widened > CONFUSED).any():
        return "not separable"
    return "found" if tail(float(value @ np.linalg.solve(spread, value)), 3) < 0.05 else "none"


def sensor_columns(Km: FloatArray, load: FloatArray, name: str) -> FloatArray:
    """Return the change of the residual (15, 3) per number of an error of the sensor, by its name.

    A turn or a lever changes readings by a matrix T (6, 6), and Km and load with them; a bias is a load of its own.
    """
    rows = []
    for k, axis in enumerate(np.eye(3)):
        T, bias = np.zeros((6, 6)), np.zeros(6)
        if name == "turn":  # readings in axes that are turned by a rotation vector: F - axis x F
            T[:3, :3] = T[3:, 3:] = -skew(axis)
        elif name == "lever":  # moments about an origin that is shifted: m - axis x f
            T[3:, :3] = -skew(axis)
        else:
            bias[k + 3 if name == "moment bias" else k] = 1.0
        rows.append(residual_of(T @ Km, T @ load + bias))
    return np.stack(rows, axis=1)


def tail(chi2: float, freedom: int) -> float:
    """Return the probability of a larger chi-square; 1 without degrees of freedom."""
    return float(mpmath.gammainc(freedom / 2, chi2 / 2, mpmath.inf, regularized=True)) if freedom > 0 else 1.0
