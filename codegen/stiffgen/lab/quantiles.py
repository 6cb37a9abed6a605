# SPDX-License-Identifier: MIT
"""Quantiles for the intervals of measurements."""

from __future__ import annotations

from functools import lru_cache

import mpmath
import numpy as np


@lru_cache(maxsize=64)
def student_quantile(freedom: float, tail: float) -> float:
    """Return the two-sided quantile of Student's t that is exceeded with a probability of ``tail``; by bisection."""
    low, high = 0.0, 1.0  # of freedom / (freedom + t^2), which falls as t grows
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_beyond = mpmath.betainc(freedom / 2, 0.5, 0, middle, regularized=True) < tail
        low, high = (middle, high) if is_beyond else (low, middle)
    return float(np.sqrt(freedom * (1.0 / high - 1.0)))
