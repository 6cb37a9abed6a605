# SPDX-License-Identifier: MIT
"""Estimate the rounding errors of a kernel's results by a running error analysis of its CasADi function.

The analysis follows every operation with its value and the size of its error in units of the last place. The error
combines the operation's own rounding with the errors of its operands times its derivatives with respect to them, as if
they were independent. If the contributions to a result cancel, a bound relative to the result could not tell rounding
from a fault.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.symbolic.program import as_operand, evaluate
from stiffgen.core.symbolic.steps import CloseLoops, StraightLine

SIGMAS = 8.0
"""Multiple of the estimated size beyond which a difference is not rounding."""

ONE = ca.SX.sym("one")
"""A symbol that is 1: CasADi adds constants in doubles, but leaves a + b ONE, which has more digits."""

_Values = tuple[FloatArray, ...]
_Rule = tuple[Callable[..., FloatArray], Callable[..., _Values]]
"""An operation, and the sizes of its derivatives with respect to its operands (their signs do not matter)."""
_WithError = tuple[FloatArray, FloatArray]
"""Values of a number in all states, and the sizes of their errors in units of the last place."""


def truth(condition: FloatArray) -> FloatArray:
    """Return 1 where a condition holds, else 0."""
    return condition.astype(float)


def _nothing(*given: FloatArray) -> _Values:
    return tuple(np.zeros_like(each) for each in given)


_RULES: dict[int, _Rule] = {
    ca.OP_ADD: (np.add, lambda a, b: (np.ones_like(a), np.ones_like(b))),
    ca.OP_SUB: (np.subtract, lambda a, b: (np.ones_like(a), np.ones_like(b))),
    ca.OP_MUL: (np.multiply, lambda a, b: (b, a)),
    ca.OP_DIV: (np.divide, lambda a, b: (1 / b, a / b**2)),
    ca.OP_ATAN2: (np.arctan2, lambda a, b: (b / (a**2 + b**2), a / (a**2 + b**2))),
    ca.OP_POW: (np.power, lambda a, b: (b * a ** (b - 1), np.zeros_like(b))),
    ca.OP_CONSTPOW: (np.power, lambda a, b: (b * a ** (b - 1), np.zeros_like(b))),
    ca.OP_LT: (lambda a, b: truth(a < b), _nothing),
    ca.OP_LE: (lambda a, b: truth(a <= b), _nothing),
    ca.OP_EQ: (lambda a, b: truth(a == b), _nothing),
    ca.OP_NE: (lambda a, b: truth(a != b), _nothing),
    ca.OP_AND: (lambda a, b: truth((a != 0) & (b != 0)), _nothing),
    ca.OP_OR: (lambda a, b: truth((a != 0) | (b != 0)), _nothing),
    ca.OP_NOT: (lambda a: truth(a == 0), _nothing),
    ca.OP_IF_ELSE_ZERO: (lambda a, b: np.where(a != 0, b, 0.0), lambda a, b: (np.zeros_like(a), truth(a != 0))),
    ca.OP_FMIN: (np.fmin, lambda a, b: (truth(a <= b), truth(b < a))),
    ca.OP_FMAX: (np.fmax, lambda a, b: (truth(a >= b), truth(b > a))),
    ca.OP_FABS: (np.abs, lambda a: (np.ones_like(a),)),
    ca.OP_SIGN: (np.sign, _nothing),
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


_EXACT = {operation for operation, (_, slopes) in _RULES.items() if slopes is _nothing} | {ca.OP_NEG, ca.OP_TWICE}
"""Operations without a rounding error of their own."""


def rounding_errors(
    chain: Chain, kernel: Kernel, stacks: Sequence[FloatArray], scalar: Scalar = DOUBLE, *, rounded: str = ""
) -> list[FloatArray] | None:
    """Return standard errors of every entry of a kernel's results, one array per result, for stacks of arguments.

    Where ``scalar`` has fewer digits than the arguments, which are doubles, these are rounded, too.

    ``rounded`` counts the rounding of the doubles that the function is given: "constants" of the chain, whose rotations
    are orthonormal up to rounding only, and which another formula uses in another way; or "arguments", both.

    None where a user's potential has a function that has no rule here.
    """
    kernel, stacks = _last_step(chain, kernel, stacks)
    function = casadi_function(chain, kernel)
    count = len(stacks[0])
    nothing = np.zeros(count)

    def argument(value: FloatArray) -> _WithError:
        return value, nothing if scalar == DOUBLE and rounded != "arguments" else np.abs(value)

    def constant(number: float) -> _WithError:
        value = np.full(count, number)
        is_exact = 4 * number % 1 == 0  # multiples of 1/4 belong to formulas; a chain's constants are rounded
        return value, np.abs(value) if rounded and not is_exact else nothing

    def result(operation: int, *operands: _WithError) -> _WithError:
        """Return value and error of an operation; errors of operands that have none count as zero, also times NaN."""
        evaluate, slopes = _RULES[operation]
        values, errors = zip(*operands, strict=True)
        value = evaluate(*values)
        parts = [np.where(e == 0, 0.0, s * e) for s, e in zip(slopes(*values), errors, strict=True)]
        rounding = nothing if operation in _EXACT else value
        return value, np.sqrt(sum((part**2 for part in parts), rounding**2))

    arguments = [list(map(argument, entries.T)) for entries in entries_of_stacks(function, stacks)]
    try:
        with np.errstate(all="ignore"):  # in branches that are not selected
            results = run(
                function, arguments, constant, {operation: partial(result, operation) for operation in _RULES}
            )
    except KeyError:
        return None
    errors = (np.stack([error for _, error in entries], axis=1) for entries in results)  # (states, entries)
    return [scalar.unit * _matrices(each, *function.size_out(k)) for k, each in enumerate(errors)]


def _matrices(entries: FloatArray, rows: int, columns: int) -> FloatArray:
    """Return matrices (states, rows, columns) of which ``entries`` (states, entries) has the columns, stacked."""
    return entries.reshape(len(entries), columns, rows).transpose(0, 2, 1)


def _last_step(chain: Chain, kernel: Kernel, stacks: Sequence[FloatArray]) -> tuple[Kernel, Sequence[FloatArray]]:
    """Return the last step of Newton's method from the closed configuration; any other kernel as it is.

    The steps before it do not matter: each removes the rounding of the step before, which the analysis does not see.
    """
    steps = kernel.steps(chain)
    if not isinstance(steps[-1], CloseLoops):
        return kernel, stacks
    function, newton = casadi_function(chain, kernel), steps[-2]
    assert isinstance(newton, StraightLine)
    closed = function.map(len(stacks[0]))(*(each.T for each in entries_of_stacks(function, stacks)))
    arguments = tuple(argument.array(chain) for argument in kernel.arguments)
    last = replace(newton, arguments=arguments, outputs=steps[-1].outputs)
    return replace(kernel, program=lambda chain: (last,)), (stacks[0], np.asarray(closed).T)


def entries_of_stacks(function: ca.Function, stacks: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the entries of stacks of arguments in CasADi's order: (states, entries), a matrix column by column."""
    count = len(stacks[0])
    entries = []
    for k, stack in enumerate(stacks):
        matrices = np.asarray(stack, dtype=float).reshape(count, *function.size_in(k))  # (states, rows, columns)
        entries.append(matrices.transpose(0, 2, 1).reshape(count, -1))
    return entries


@dataclass(frozen=True)
class Stages:
    """Kernel in stages, in the order of the printed C.

    A single CasADi function would combine constants of two steps, and round where C does not.

    Attributes:
        functions: one function per stage. Its argument is the vector of all numbers so far: the arguments' entries,
            row-major, then the results of the functions before.
        results: positions of the results' entries among all numbers, row-major; or constants.

    """

    functions: tuple[ca.Function, ...]
    results: tuple[int | float, ...]

    @staticmethod
    def of(chain: Chain, kernel: Kernel) -> Stages:
        """Return the stages of a chain's kernel."""
        arrays = [argument.array(chain) for argument in kernel.arguments]
        entries = [[ca.SX.sym("x") for _ in range(array.size)] for array in arrays]
        numbers = [entry for own in entries for entry in own]
        functions: list[ca.Function] = []

        def close_stage(written: list[ca.SX]) -> list[ca.SX]:
            """Return what a step has written with a new symbol, a number for later stages, for each computed entry.

            Copies, and 0, 1 and -1 stay as they are.
            """
            computed = [k for k, entry in enumerate(written) if not (entry.is_symbolic() or _is_plain(entry))]
            if not computed:
                return written
            stacked = ca.densify(ca.vertcat(*(written[k] for k in computed)))
            functions.append(ca.Function("step", [ca.vertcat(*numbers)], [stacked]))
            readable = list(written)
            for k in computed:
                readable[k] = ca.SX.sym("x")
                numbers.append(readable[k])
            return readable

        arguments = {a.name: as_operand(folded(a.shape), each) for a, each in zip(arrays, entries, strict=True)}
        values = evaluate(kernel.scope(chain), kernel.steps(chain), arguments, close_stage)
        place_of = {number.element_hash(): k for k, number in enumerate(numbers)}
        results = [entry for each in kernel.results for entry in values[each.array(chain).name]]
        places = (place_of.get(e.element_hash(), 0) if e.is_symbolic() else float(e) for e in results)
        return Stages(tuple(functions), tuple(places))

    def run(
        self, arguments: Sequence[Any], constant: Callable[[float], Any], operations: Mapping[int, Any]
    ) -> list[Any]:
        """Evaluate the results in any arithmetic, from the arguments' entries, row-major, and ``operations``."""
        numbers = list(arguments)
        for function in self.functions:
            numbers += run(function, [numbers], constant, operations)[0]
        return [constant(each) if isinstance(each, float) else numbers[each] for each in self.results]


def _is_plain(entry: ca.SX) -> bool:
    return bool(entry.is_constant()) and float(entry) in (-1.0, 0.0, 1.0)


def run(
    function: ca.Function,
    given: Sequence[Sequence[Any]],
    constant: Callable[[float], Any],
    operations: Mapping[int, Callable[..., Any]],
) -> list[list[Any]]:
    """Evaluate a function operation by operation, in any arithmetic.

    Args:
        function: function whose results are dense.
        given: entries of each argument, a matrix column by column.
        constant: function that makes a number of the arithmetic.
        operations: functions of numbers, by CasADi's code of the operation.

    Returns:
        Entries of each result, a matrix column by column.

    Raises:
        KeyError: an operation is not among ``operations``.

    """
    work: dict[int, Any] = {}  # numbers by CasADi's register
    results = [[constant(0.0)] * function.nnz_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation, into = function.instruction_id(k), function.instruction_output(k)
        if operation == ca.OP_CONST:
            work[into[0]] = constant(function.instruction_constant(k))
            continue
        taken = function.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[into[0]] = given[taken[0]][taken[1]]
        elif operation == ca.OP_OUTPUT:
            results[into[0]][into[1]] = work[taken[0]]
        else:
            work[into[0]] = operations[operation](*[work[each] for each in taken])
    return results


OPERATIONS = {operation: evaluate_it for operation, (evaluate_it, _) in _RULES.items()}


def with_more_digits(chain: Chain, kernel: Kernel, stacks: Sequence[FloatArray]) -> NDArray[np.longdouble]:
    """Return the entries of a kernel's results, one after the other, in the longest numbers that this machine has.

    Raises:
        KeyError: it has an operation without a rule here.

    """
    count = len(stacks[0])
    entries = np.concatenate([np.reshape(stack, (count, -1)) for stack in stacks], axis=1).astype(np.longdouble)
    results = Stages.of(chain, kernel).run(list(entries.T), partial(np.full, count, dtype=np.longdouble), OPERATIONS)
    return np.stack(results, axis=1)


def long_constant(values: NDArray[np.longdouble]) -> ca.SX:
    """Return a constant of which `evaluate_longer` sees more digits than a double has."""
    leading = np.asarray(values, dtype=float)
    rest = np.asarray(values - leading, dtype=float)
    return ca.DM(leading) + ca.DM(rest) * ONE if rest.any() else ca.SX(ca.DM(leading))


def in_doubles(expression: ca.SX) -> ca.SX:
    """Return an expression with `ONE` replaced by 1, for a function that CasADi evaluates."""
    return ca.substitute(expression, ONE, 1)


def evaluate_longer(symbols: Sequence[ca.SX], expression: ca.SX, columns: Sequence[FloatArray]) -> FloatArray:
    """Evaluate a matrix of the entries of some symbols at many states, in the longest numbers that this machine has.

    Args:
        symbols: column vectors.
        expression: matrix of their entries, and of `ONE`.
        columns: values of each symbol, (entries, states).

    Returns:
        Values (states, rows, columns); in doubles for an operation without a rule here. A value that is no larger than
        the rounding of its entry, as the largest difference from the values in doubles shows it, is 0.

    """
    count = columns[0].shape[1]
    inputs = np.concatenate([*columns, np.ones((1, count))])  # (entries, states)
    function = ca.Function("f", [ca.vertcat(*symbols, ONE)], [ca.vec(ca.densify(expression))])

    constant, in_doubles_only = partial(np.full, count, dtype=np.longdouble), np.asarray(function.map(count)(inputs))
    try:
        with np.errstate(all="ignore"):  # in branches that are not selected
            entries = np.stack(run(function, [list(inputs.astype(np.longdouble))], constant, OPERATIONS)[0])
            lost = np.nanmax(np.abs(entries - in_doubles_only), axis=1, initial=0.0, keepdims=True)
            rounding = np.finfo(np.longdouble).eps / np.finfo(np.float64).eps * lost
            entries = np.where(np.abs(entries) <= 16 * rounding, 0, entries)
    except KeyError:
        entries = in_doubles_only
    return np.ascontiguousarray(_matrices(entries.T, *expression.shape))


def beyond_rounding(difference: FloatArray, errors: FloatArray) -> FloatArray:
    """Return the part of differences that rounding does not explain."""
    explained = np.nan_to_num(errors.reshape(difference.shape), nan=0.0, posinf=0.0)
    rest: FloatArray = np.where(np.abs(difference) <= SIGMAS * explained, 0.0, difference)
    return rest
