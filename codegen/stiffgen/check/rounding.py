# SPDX-License-Identifier: MIT
"""What rounding does to the results of a kernel: a running error analysis of its CasADi function.

Every operation is followed with its value and the size of the error that it carries, in units of the last place: its
own, and those of its operands times its derivatives by them, as if they were independent. A result whose
contributions cancel has an error that nothing relative to the result itself could tell from a fault.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from stiffgen.check.result import Array
from stiffgen.emit.target import DOUBLE, Scalar
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.kernels import Kernel
from stiffgen.symbolic.model import casadi_function

SIGMAS = 8.0
"""Errors beyond so many times their size are none of rounding."""

_Values = tuple[Array, ...]
_Rule = tuple[Callable[..., Array], Callable[..., _Values]]


def _truth(condition: Array) -> Array:
    return condition.astype(float)


def _nothing(*given: Array) -> _Values:
    return tuple(np.zeros_like(each) for each in given)


_RULES: dict[int, _Rule] = {
    ca.OP_ADD: (np.add, lambda a, b: (np.ones_like(a), np.ones_like(b))),
    ca.OP_SUB: (np.subtract, lambda a, b: (np.ones_like(a), np.ones_like(b))),
    ca.OP_MUL: (np.multiply, lambda a, b: (b, a)),
    ca.OP_DIV: (np.divide, lambda a, b: (1 / b, a / b**2)),
    ca.OP_ATAN2: (np.arctan2, lambda a, b: (b / (a**2 + b**2), a / (a**2 + b**2))),
    ca.OP_POW: (np.power, lambda a, b: (b * a ** (b - 1), np.zeros_like(b))),
    ca.OP_CONSTPOW: (np.power, lambda a, b: (b * a ** (b - 1), np.zeros_like(b))),
    ca.OP_LT: (lambda a, b: _truth(a < b), _nothing),
    ca.OP_LE: (lambda a, b: _truth(a <= b), _nothing),
    ca.OP_EQ: (lambda a, b: _truth(a == b), _nothing),
    ca.OP_NE: (lambda a, b: _truth(a != b), _nothing),
    ca.OP_AND: (lambda a, b: _truth((a != 0) & (b != 0)), _nothing),
    ca.OP_OR: (lambda a, b: _truth((a != 0) | (b != 0)), _nothing),
    ca.OP_NOT: (lambda a: _truth(a == 0), _nothing),
    ca.OP_IF_ELSE_ZERO: (lambda a, b: np.where(a != 0, b, 0.0), lambda a, b: (np.zeros_like(a), _truth(a != 0))),
    ca.OP_FMIN: (np.fmin, lambda a, b: (_truth(a <= b), _truth(b < a))),
    ca.OP_FMAX: (np.fmax, lambda a, b: (_truth(a >= b), _truth(b > a))),
    ca.OP_FABS: (np.abs, lambda a: (np.ones_like(a),)),
    ca.OP_NEG: (np.negative, lambda a: (np.ones_like(a),)),
    ca.OP_TWICE: (lambda a: 2 * a, lambda a: (np.full_like(a, 2.0),)),
    ca.OP_SQ: (np.square, lambda a: (2 * a,)),
    ca.OP_INV: (lambda a: 1 / a, lambda a: (1 / a**2,)),
    ca.OP_SIN: (np.sin, lambda a: (np.cos(a),)),
    ca.OP_COS: (np.cos, lambda a: (np.sin(a),)),
    ca.OP_SQRT: (np.sqrt, lambda a: (0.5 / np.sqrt(a),)),
    ca.OP_ATAN: (np.arctan, lambda a: (1 / (1 + a**2),)),
    ca.OP_EXP: (np.exp, lambda a: (np.exp(a),)),
    ca.OP_LOG: (np.log, lambda a: (1 / a,)),
}


def rounding_errors(
    chain: Chain, kernel: Kernel, stacks: Sequence[Array], scalar: Scalar = DOUBLE
) -> list[Array] | None:
    """Standard errors of every entry of a kernel's results, one array a result, for stacks of its arguments.

    Where ``scalar`` has fewer digits than the arguments, which are doubles, these are rounded, too.

    None where a user's potential has a function that has no rule here.
    """
    function = casadi_function(chain, kernel)
    count = len(stacks[0])
    given = [
        np.asarray(stack, dtype=float)
        .reshape(count, -1, *function.size_in(k)[1:])
        .transpose(0, 2, 1)
        .reshape(count, -1)
        for k, stack in enumerate(stacks)
    ]
    found = [np.zeros((count, function.nnz_out(k))) for k in range(function.n_out())]
    work: dict[int, tuple[Array, Array]] = {}
    nothing = np.zeros(count)
    with np.errstate(all="ignore"):  # in branches that are not chosen
        for k in range(function.n_instructions()):
            operation, taken = function.instruction_id(k), function.instruction_input(k)
            into = function.instruction_output(k)
            if operation == ca.OP_INPUT:
                value = given[taken[0]][:, taken[1]]
                work[into[0]] = value, nothing if scalar == DOUBLE else np.abs(value)
            elif operation == ca.OP_CONST:
                work[into[0]] = np.full(count, function.instruction_constant(k)), nothing
            elif operation == ca.OP_OUTPUT:
                found[into[0]][:, into[1]] = work[taken[0]][1]
            elif operation in _RULES:
                evaluate, slopes = _RULES[operation]
                values, errors = zip(*(work[each] for each in taken), strict=True)
                value = evaluate(*values)
                parts = [np.where(e == 0, 0.0, s * e) for s, e in zip(slopes(*values), errors, strict=True)]
                own = nothing if operation in (ca.OP_NEG, ca.OP_TWICE) else value
                work[into[0]] = value, np.sqrt(sum((part**2 for part in parts), own**2))
            else:
                return None
    return [
        scalar.unit * each.reshape(count, *function.size_out(k)[::-1]).transpose(0, 2, 1)
        for k, each in enumerate(found)
    ]  # fmt: skip


def beyond_rounding(difference: Array, errors: Array) -> Array:
    """What of differences rounding does not explain."""
    explained = np.nan_to_num(errors.reshape(difference.shape), nan=0.0, posinf=0.0)
    rest: Array = np.where(np.abs(difference) <= SIGMAS * explained, 0.0, difference)
    return rest
