# SPDX-License-Identifier: MIT
"""Operations of number types on which CasADi graphs are run: complex stacks, 60 digits, balls (Arb).

The interpreter is :func:`stiffgen.core.verify.kernels.rounding.run`. It shares nothing with CasADi's own evaluation and
differentiation: each operation is extended to the number type by one of these tables.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
from flint import arb

from stiffgen.core.verify.kernels.rounding import run
from support.exact_tree import mp

Operations = Mapping[int, Callable[..., Any]]

ARITHMETIC: Operations = {
    ca.OP_ADD: operator.add, ca.OP_SUB: operator.sub, ca.OP_MUL: operator.mul, ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg, ca.OP_SQ: lambda a: a * a, ca.OP_TWICE: lambda a: 2 * a, ca.OP_INV: lambda a: 1 / a,
    ca.OP_POW: operator.pow, ca.OP_CONSTPOW: operator.pow,
}  # fmt: skip
BALLS: Operations = {**ARITHMETIC, ca.OP_SIN: arb.sin, ca.OP_COS: arb.cos}


def _ratio(a: Any, b: Any) -> Any:
    """Return a / b; NaN for b = 0, which occurs in branches that are not selected."""
    return a / b if b else mp.nan


DIGITS: Operations = {
    **ARITHMETIC, ca.OP_DIV: _ratio, ca.OP_INV: lambda a: _ratio(mp.one, a),
    ca.OP_SIN: mp.sin, ca.OP_COS: mp.cos, ca.OP_ATAN2: mp.atan2, ca.OP_ATAN: mp.atan, ca.OP_FABS: abs,
    ca.OP_SQRT: lambda a: mp.sqrt(a) if a >= 0 else mp.nan,
    ca.OP_LT: lambda a, b: mp.mpf(a < b), ca.OP_LE: lambda a, b: mp.mpf(a <= b), ca.OP_NOT: lambda a: mp.mpf(a == 0),
    ca.OP_AND: lambda a, b: mp.mpf(a != 0 and b != 0), ca.OP_OR: lambda a, b: mp.mpf(a != 0 or b != 0),
    ca.OP_IF_ELSE_ZERO: lambda a, b: b if a != 0 else mp.zero, ca.OP_FMAX: max, ca.OP_FMIN: min,
    ca.OP_SIGN: mp.sign,
}  # fmt: skip


def _truth(condition: np.ndarray) -> np.ndarray:
    return condition.astype(complex)


def _atan2(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    turn = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    result: np.ndarray = np.arctan2(y.real, x.real) + 1j * turn
    return result


COMPLEX: Operations = {
    **ARITHMETIC, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_SQRT: np.sqrt, ca.OP_ATAN2: _atan2,
    ca.OP_ATAN: lambda a: np.arctan(a.real) + 1j * a.imag / (1 + a.real**2),
    ca.OP_FMAX: lambda a, b: np.where(a.real >= b.real, a, b), ca.OP_FABS: lambda a: np.where(a.real >= 0, a, -a),
    ca.OP_LT: lambda a, b: _truth(a.real < b.real), ca.OP_LE: lambda a, b: _truth(a.real <= b.real),
    ca.OP_AND: lambda a, b: _truth((a.real != 0) & (b.real != 0)),
    ca.OP_OR: lambda a, b: _truth((a.real != 0) | (b.real != 0)),
    ca.OP_NOT: lambda a: _truth(a.real == 0), ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a.real != 0, b, 0),
}  # fmt: skip
"""Complex operations whose imaginary part is a derivative: comparisons read the real part."""


def exactly(function: ca.Function, *arguments: Any) -> list[np.ndarray]:
    """Return the results of a function with 60 digits, as matrices of them; arguments are arrays of any numbers."""
    shaped = [np.asarray(each).reshape(function.size_in(k)) for k, each in enumerate(arguments)]
    given = [[x if isinstance(x, mp.mpf) else mp.mpf(float(x)) for x in each.T.ravel()] for each in shaped]
    results = run(function, given, mp.mpf, DIGITS)
    shapes = [function.size_out(k)[::-1] for k in range(function.n_out())]
    return [np.array(each, object).reshape(shape).T for each, shape in zip(results, shapes, strict=True)]
