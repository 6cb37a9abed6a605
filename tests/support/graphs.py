# SPDX-License-Identifier: MIT
"""Interpret CasADi graphs over number types: complex stacks, 60 digits, balls (Arb), or any other.

A ``casadi.Function`` of scalars is run operation by operation. That shares nothing with CasADi's own evaluation and
differentiation: each operation is extended to the number type by the table that the caller passes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from flint import arb
from mpmath import mp

Operations = Mapping[int, Callable[..., Any]]

ARITHMETIC: Operations = {
    ca.OP_ADD: operator.add, ca.OP_SUB: operator.sub, ca.OP_MUL: operator.mul, ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg, ca.OP_SQ: lambda a: a * a, ca.OP_TWICE: lambda a: 2 * a, ca.OP_INV: lambda a: 1 / a,
    ca.OP_POW: operator.pow, ca.OP_CONSTPOW: operator.pow,
}  # fmt: skip
BALLS: Operations = {**ARITHMETIC, ca.OP_SIN: arb.sin, ca.OP_COS: arb.cos}
DIGITS: Operations = {**ARITHMETIC, ca.OP_SIN: mp.sin, ca.OP_COS: mp.cos}


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


class Graph:
    """A dense ``casadi.Function`` of scalars, to be run on numbers of any type."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self.steps = [
            (
                function.instruction_id(k),
                function.instruction_input(k),
                function.instruction_output(k),
                function.instruction_constant(k) if function.instruction_id(k) == ca.OP_CONST else 0.0,
            )
            for k in range(function.n_instructions())
        ]

    def run(
        self, arguments: Sequence[Sequence[Any]], constant: Callable[[float], Any], operations: Operations
    ) -> list[list[Any]]:
        """Evaluate the function.

        Args:
            arguments: for each argument its entries, column by column, as numbers of the type.
            constant: makes a number of the type.
            operations: what each CasADi operation does to such numbers.

        Returns:
            For each result its entries, column by column.

        """
        results = [[constant(0.0)] * self.function.nnz_out(k) for k in range(self.function.n_out())]
        work: dict[int, Any] = {}
        for operation, sources, outputs, value in self.steps:
            if operation == ca.OP_INPUT:
                work[outputs[0]] = arguments[sources[0]][sources[1]]
            elif operation == ca.OP_OUTPUT:
                results[outputs[0]][outputs[1]] = work[sources[0]]
            elif operation == ca.OP_CONST:
                work[outputs[0]] = constant(value)
            else:
                work[outputs[0]] = operations[operation](*(work[each] for each in sources))
        return results
