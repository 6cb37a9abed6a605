# SPDX-License-Identifier: MIT
"""How a kernel refuses: masks that turn results into NaN, without a branch, where they would be no answer.

Each keeps a NaN that comes in: a NaN compares as false, and false makes NaN.
"""

from __future__ import annotations

import casadi as ca

_LARGEST = 1e300


def reciprocal_or_nan(number: ca.SX, size: ca.SX, least: ca.SX | float) -> ca.SX:
    """Return 1 / number; NaN unless its ``size`` is above ``least``."""
    return reciprocal_where(size > least, number)


def reciprocal_where(condition: ca.SX, number: ca.SX) -> ca.SX:
    """Return 1 / number where a condition holds, else NaN."""
    return condition / (number * condition**2)  # 0/0; CasADi would simplify x / (number x)


def zero_or_nan(condition: ca.SX) -> ca.SX:
    """Return 0 where a condition holds, else NaN: a summand for all entries of a result, which it leaves or refuses."""
    return ca.sqrt(condition - 1)


def one_where(condition: ca.SX) -> ca.SX:
    """Return 1 where a condition holds, else NaN; printers know the division as a mask."""
    return condition / condition**2


def ones_or_nan(numbers: ca.SX) -> ca.SX:
    """Return 1 for each number, NaN for NaN: factors of results that do not depend on the numbers otherwise."""
    sizes = ca.fabs(numbers)
    return (sizes < _LARGEST) / (sizes <= _LARGEST)


def larger_or_nan(first: ca.SX, second: ca.SX) -> ca.SX:
    """Return the larger number; NaN if one is NaN, which fmax would drop."""
    is_less = second < first
    return is_less * first + (1 - is_less) * second
