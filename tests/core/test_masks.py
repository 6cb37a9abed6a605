# SPDX-License-Identifier: MIT
"""Masks leave a result or make it NaN, and keep a NaN that comes in."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from stiffgen.families import masks

NAN = np.nan


def value(expression: ca.SX, symbols: list[ca.SX], *numbers: float) -> float:
    return float(ca.Function("f", symbols, [expression])(*numbers))


@pytest.mark.parametrize(
    ("mask", "cases"),
    [
        (lambda a, b: masks.reciprocal_or_nan(a, a * a, b), {(2.0, 1.0): 0.5, (-2.0, 1.0): -0.5, (1.0, 1.0): NAN}),
        (lambda a, b: masks.one_where(a <= b), {(1.0, 2.0): 1.0, (2.0, 1.0): NAN}),
        (lambda a, b: masks.reciprocal_where(a <= b, a), {(2.0, 2.0): 0.5, (2.0, 1.0): NAN}),
        (lambda a, b: masks.zero_or_nan(a <= b), {(1.0, 2.0): 0.0, (2.0, 1.0): NAN}),
        (lambda a, b: masks.ones_or_nan(a) * b, {(1.0, 2.0): 2.0, (-1e200, 2.0): 2.0, (0.0, 2.0): 2.0}),
        (masks.larger_or_nan, {(1.0, 2.0): 2.0, (2.0, 1.0): 2.0, (1.0, 1.0): 1.0}),
    ],
)
def test_masks(mask, cases):
    """Evaluate masks at numbers on both sides of their condition, and at NaN, which must stay NaN."""
    symbols = [ca.SX.sym("a"), ca.SX.sym("b")]
    for numbers, expected in (cases | {(NAN, 1.0): NAN, (1.0, NAN): NAN}).items():
        assert np.array_equal(value(mask(*symbols), symbols, *numbers), expected, equal_nan=True), numbers
