# SPDX-License-Identifier: MIT
"""Compute what both experiments report: the antisymmetric part's closed form, and the energy bound."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from examples.experiments.trial import Trace

Array = NDArray[np.float64]


def closed_form(robot: ModuleType, q: Array, wrench: Array) -> Array:
    """Return the antisymmetric part of the conventional joint stiffness, J_r^T [m]x J_r / 2.

    J_r is the angular part of the Jacobian. The corrected stiffness is symmetric and differs from the conventional one
    by J^T (Gamma F) J. In hybrid form Gamma F = [[0, 0], [0, [m]x^T / 2]] is antisymmetric itself.

    Args:
        robot: generated module of the arm with its tool.
        q: (N, n) [rad].
        wrench: (N, 6) of the environment on the robot, hybrid frame [N, N m].

    Returns:
        (N, n, n) [N m/rad].

    """
    Jr = robot.hybrid.jacobian(q)[:, 3:]
    moment_cross_J = np.cross(wrench[:, 3:, None], Jr, axis=1)
    return np.asarray(np.swapaxes(Jr, 1, 2) @ moment_cross_J / 2)


def worst_per_moment(robot: ModuleType, q: Array) -> float:
    """Largest singular value of :func:`closed_form` at any posture q (N, n) under any moment of 1 N m [1/rad].

    With J_r = U S V^T it is that of S [U^T m]x S / 2: for the moment along the third left singular vector, half the
    product of the two largest singular values.
    """
    singular = np.linalg.svd(robot.hybrid.jacobian(q)[:, 3:], compute_uv=False)
    return float((singular[:, 0] * singular[:, 1]).max() / 2)


def excess(trace: Trace) -> float:
    """Return the largest work at the port beyond the controller's bound (docs/energy.md) [J]; negative: kept."""
    return float(np.max(trace["port_total"][1:] - trace["supplied_total"][:-1]))


def largest(values: Array) -> float:
    """Return the largest absolute value."""
    return float(np.abs(values).max())


@dataclass(frozen=True)
class Row:
    """Row of the summary: quantity, statement of the paper, measured value, and remark on a difference."""

    what: str
    paper: str
    measured: str
    remark: str
