# SPDX-License-Identifier: MIT
"""Differentiation by complex steps: f(x + ih) has f'(x) as its imaginary part over h, with no difference to cancel.

A ``casadi.Function`` of scalars is run instruction by instruction on complex numbers, a whole stack of states at a
time. That shares nothing with CasADi's differentiation: each operation is extended to complex numbers here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from stiffgen.symbolic.model import folded

STEP = 1e-100


def _choice(condition: np.ndarray) -> np.ndarray:
    return condition.astype(complex)


def _atan2(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    turn = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    result: np.ndarray = np.arctan2(y.real, x.real) + 1j * turn
    return result


_BINARY: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide, ca.OP_ATAN2: _atan2,
    ca.OP_LT: lambda a, b: _choice(a.real < b.real), ca.OP_LE: lambda a, b: _choice(a.real <= b.real),
    ca.OP_AND: lambda a, b: _choice((a.real != 0) & (b.real != 0)),
    ca.OP_OR: lambda a, b: _choice((a.real != 0) | (b.real != 0)),
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a.real != 0, b, 0),
    ca.OP_CONSTPOW: lambda a, b: a**b, ca.OP_POW: lambda a, b: a**b,
}  # fmt: skip
_UNARY: dict[int, Callable[..., Any]] = {
    ca.OP_NEG: np.negative, ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_SQRT: np.sqrt, ca.OP_SQ: np.square,
    ca.OP_ATAN: lambda a: np.arctan(a.real) + 1j * a.imag / (1 + a.real**2),
    ca.OP_TWICE: lambda a: 2 * a, ca.OP_INV: lambda a: 1 / a, ca.OP_NOT: lambda a: _choice(a.real == 0),
}  # fmt: skip


class ComplexFunction:
    """A dense ``casadi.Function``, for stacks of states on complex numbers."""

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

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Arguments (count, rows, columns) as CasADi has them; results (count, entries), column by column."""
        count = len(arguments[0])
        flat = [np.asarray(a).reshape(count, a.shape[1], -1).transpose(0, 2, 1).reshape(count, -1) for a in arguments]
        sizes = [self.function.nnz_out(k) for k in range(self.function.n_out())]
        results = [np.zeros((count, size), dtype=complex) for size in sizes]
        work: dict[int, np.ndarray] = {}
        for operation, given, into, constant in self.steps:
            if operation == ca.OP_INPUT:
                work[into[0]] = flat[given[0]][:, given[1]].astype(complex)
            elif operation == ca.OP_OUTPUT:
                results[into[0]][:, into[1]] = work[given[0]]
            elif operation == ca.OP_CONST:
                work[into[0]] = np.full(count, constant, dtype=complex)
            elif operation in _BINARY:
                work[into[0]] = _BINARY[operation](work[given[0]], work[given[1]])
            else:
                work[into[0]] = _UNARY[operation](work[given[0]])
        return results


TWISTS = np.zeros((6, 4, 4))
"""Rates of a pose, seen from itself, at unit twists (linear, angular) in its own axes."""
for _k in range(3):
    TWISTS[_k, _k, 3] = 1
    TWISTS[3 + _k, (_k + 2) % 3, (_k + 1) % 3], TWISTS[3 + _k, (_k + 1) % 3, (_k + 2) % 3] = 1, -1


def columns(stack: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A stack of arguments of a kernel in the shapes that CasADi has."""
    rows = folded(shape) if shape else (1,)
    return stack.reshape(len(stack), *rows, *[1] * (2 - len(rows)))


def gradients(function: ca.Function, arguments: list[np.ndarray], cotangents: list[np.ndarray]) -> list[np.ndarray]:
    """Gradients of the sum of cotangents times results by every argument; stacks as in CasADi.

    By every entry; by a floating base's pose along its body twists, (count, 6, 1).
    """
    run = ComplexFunction(function)
    weights = [c.reshape(len(c), c.shape[1], -1).transpose(0, 2, 1).reshape(len(c), -1) for c in cotangents]
    found = []
    for k, argument in enumerate(arguments):
        if function.name_in(k) == "base_pose":
            rates = [argument @ twist for twist in TWISTS]
            shape: tuple[int, ...] = (6, 1)
        else:
            shape = argument.shape[1:]
            rates = list(np.eye(argument[0].size).reshape(-1, *shape))
        gradient = np.zeros((len(argument), len(rates)))
        for number, rate in enumerate(rates):
            moved = [a + 1j * STEP * rate if i == k else a for i, a in enumerate(arguments)]
            with np.errstate(all="ignore"):  # in branches that are not chosen
                results = run(*moved)
            changes = [(w * r.imag).sum(axis=1) / STEP for w, r in zip(weights, results, strict=True)]
            gradient[:, number] = np.sum(changes, axis=0)
        found.append(gradient.reshape(len(argument), *shape))
    return found
