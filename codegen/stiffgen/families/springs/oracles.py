# SPDX-License-Identifier: MIT
"""Oracles of the springs."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.model import folded
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.references import References, as_columns
from stiffgen.families.springs.reference import differentiated
from stiffgen.families.springs.springs import Spring

Oracles = dict[str, tuple[Oracle, ...]]


def springs(r: References) -> dict[str, dict[str, FloatArray]]:
    """Return the results of each spring's kernels by name, from its differentiated energy."""
    return {spring.name: _spring(r, spring) for spring in r.options.all_springs()}


def _spring(r: References, spring: Spring) -> dict[str, FloatArray]:
    """Return the results of a spring's kernels."""
    symbols = [ca.SX.sym(a.name, *folded(a.array(r.chain).shape)) for a in spring.parameters]
    # Stacks enter as columns, a matrix row by row.
    rows = [ca.vec(symbol.T) for symbol in symbols]
    columns = [as_columns(each) for each in r.samples.of(spring.parameters)]
    q, placement = r.place.coordinates, r.options.placement
    results = differentiated(spring, placement, r.pose_expression, q, symbols)
    return {name: r.evaluate(expression, rows, columns) for name, expression in results.items()}


def _of_spring(spring: str, results: tuple[str, ...]) -> Oracle:
    return Oracle("differentiated energy", lambda r: tuple(r.of(springs)[spring][result] for result in results))


def _bound(spring: str) -> Callable[[References], FloatArray]:
    """Return the function of J^T diag(sum_j |K_ij|) J + diag(sum_j |A_ij|), A the stiffness of the wrench alone."""

    def bound(r: References) -> FloatArray:
        J, values = r.jacobian["hybrid"], r.of(springs)[spring]
        J_T, K = np.swapaxes(J, 1, 2), values["task_stiffness"]
        A = values["joint_stiffness"] - J_T @ K @ J
        of_K, of_A = np.abs(K).sum(axis=2), np.abs(A).sum(axis=2)  # sums over each row, (samples, rows)
        result: FloatArray = J_T @ (of_K[:, :, None] * J) + of_A[:, :, None] * np.eye(J.shape[2])
        return result

    return bound


def of_options(options: KernelOptions | None) -> Oracles:
    """Return the oracles of the chosen springs, also of a user's potentials."""
    table: Oracles = {}
    for spring in (options or KernelOptions()).all_springs():
        names = ("energy", "wrench", "task_stiffness", "torque", "joint_stiffness")
        for name in names:
            table[f"{spring.name}_{name}"] = (_of_spring(spring.name, (name,)),)
        table[f"{spring.name}_linearization"] = (_of_spring(spring.name, ("energy", "torque", "joint_stiffness")),)
        table[f"{spring.name}_positive_tangent"] = (Oracle("row sums of |K| and of the load", _bound(spring.name)),)
    return table


ORACLES: Oracles = {}
"""Those of springs follow from the options."""
