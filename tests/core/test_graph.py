# SPDX-License-Identifier: MIT
"""Graphs of operations: which of them can make a number of a NaN."""

from __future__ import annotations

import casadi as ca
import pytest

from stiffgen.core.lower.graph import build_graph
from stiffgen.families.factors import Factors, Units

X = ca.SX.sym("x", 3)
MASK = X[0] > X[1]
SAFE = {
    "product": X[0] * X[1],
    "a comparison that divides by itself": MASK / (X[2] * MASK**2),
    "its derivative": ca.gradient(MASK / (X[2] * MASK**2), X[2]),
    "two of them": MASK / (X[2] * MASK**2) * (X[2] < X[1]) / (X[0] * (X[2] < X[1]) ** 2),
}
UNSAFE = {
    "comparison": ca.SX(MASK),
    "product with a comparison": MASK * X[2],
    "a comparison in the numerator alone": MASK / X[2],
    "a comparison in the denominator alone": 1 / (X[2] * MASK),
    "the opposite comparison in the denominator": MASK / (X[2] * (1 - (X[0] <= X[1]))),
    "one result without the division": ca.vertcat(MASK / (X[2] * MASK**2), MASK * X[2]),
    "maximum of a quotient": ca.fmax(MASK / (X[2] * MASK**2), X[2]),
}


def chooses(expression: ca.SX) -> bool:
    graph, results = build_graph(ca.Function("f", [X], [ca.densify(expression)]))
    return graph.chooses(results)


@pytest.mark.parametrize("name", SAFE)
def test_no_number_comes_from_a_nan(name: str) -> None:
    assert not chooses(SAFE[name])


@pytest.mark.parametrize("name", UNSAFE)
def test_a_number_may_come_from_a_nan(name: str) -> None:
    assert chooses(UNSAFE[name])


@pytest.mark.parametrize("size", [2, 4])
def test_solutions_of_closed_loops_need_no_guard(size: int) -> None:
    """Blocks with a determinant and with reflections; near a singularity and with a NaN they are NaN."""
    C = ca.SX.sym("C", size, size)
    units = Units(ca.SX(1), 1.0, frozenset(), frozenset(), has_points=True)
    rows = [[k] for k in range(size)]
    solution = ca.vertcat(*Factors(C, rows, list(range(size)), units).solve([ca.SX(1)] * size))
    f = ca.Function("f", [ca.vec(C)], [solution])
    graph, results = build_graph(f)
    assert not graph.chooses(results) or size > 2  # the sign of a reflection is a choice
    regular = ca.DM.eye(size) + 0.1
    assert abs(ca.mtimes(regular, f(ca.vec(regular))) - 1).is_regular()
    assert float(ca.mmax(abs(ca.mtimes(regular, f(ca.vec(regular))) - 1))) < 1e-14
    for spoiled in (float("nan"), None):
        matrix = ca.DM(regular)
        matrix[:, 0] = matrix[:, 1] if spoiled is None else spoiled
        assert all(value != value for value in f(ca.vec(matrix)).full().ravel())
