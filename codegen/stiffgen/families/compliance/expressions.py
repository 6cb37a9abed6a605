# SPDX-License-Identifier: MIT
"""Expressions of the tip's compliance: a loaded arm with springs in its joints, solved without exchanging rows.

H = Kth - Kload is the Hessian of the springs' energy less that of the load. An arm that is stable under its load has a
positive definite H, whose factors H = L D L^T need no exchange of rows. A pivot that is not positive means that the arm
gives way: all results are then NaN.

The smallest eigenvalue of H follows from Householder's tridiagonal form by bisection: x is below all eigenvalues if and
only if all pivots of T - x are positive. Both are backward stable: errors are some units of rounding of the largest
entry of H.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import Expressions
from stiffgen.core.symbolic.stiffness import symmetric_from_upper
from stiffgen.families.factors import SINGULAR
from stiffgen.families.masks import larger_or_nan, one_where, reciprocal_or_nan, reciprocal_where, zero_or_nan

HALVINGS = 4
"""Halvings of the interval of the smallest eigenvalue in one call of the C function."""
CALLS = 14
"""Calls: 56 halvings leave 1e-17 of the interval."""
_Grid = list[list[ca.SX]]


@dataclass(frozen=True)
class Elimination:
    """Factors L (unit lower triangle) and D of a symmetric matrix.

    ``inverse`` holds the reciprocals of D. The last one is NaN unless all of D is positive, so that whatever reads all
    of them is NaN, too.
    """

    lower: _Grid
    inverse: list[ca.SX]

    @staticmethod
    def of(matrix: ca.SX) -> Elimination:
        """Factor the matrix; its upper triangle is read.

        Two pivots are eliminated together: the reciprocal of the second one is that of the first times a minor of two
        rows, and both divisions start at once. A pivot or a minor that is infinite refuses, too.
        """
        n = matrix.shape[0]
        factors = _FactorsUnderWay(matrix)
        is_first_positive = matrix[0, 0] > 0
        k = 0  # rows eliminated so far
        while k < n - 1:
            first, second = factors.reduced_row(k), factors.reduced_row(k + 1)
            # CasADi would make divisions of x * (1 / pivot): a mask of the first pivot is the 1 of the others.
            of_first = one_where(is_first_positive) / first[k] if k else reciprocal_where(is_first_positive, first[0])
            factors.eliminate(first, of_first)
            k += 1
            rows_left = n - k
            if rows_left % 2 == 0:  # the next row, too; the last one is always alone
                pivot, beside = first[k - 1], first[k]
                minor = pivot * second[k] - beside**2  # pivot times the next pivot
                ratio = factors.lower[k][k - 1]
                factors.eliminate([y - ratio * x for x, y in zip(first, second, strict=True)], pivot / minor)
                k += 1
        last = factors.reduced_row(n - 1)[-1]
        is_stable = ca.SX(1)
        for reciprocal in factors.inverse:
            is_stable *= reciprocal > 0
        of_last = reciprocal_where(is_stable * (last < 2 * last), last)  # positive, and not infinite
        return Elimination(factors.lower, [*factors.inverse, of_last])

    def refused(self, values: ca.SX) -> ca.SX:
        """Return dense values whose structural zeros refuse, too: 0, or NaN where the matrix is not positive definite.

        All other entries of a result contain ``inverse``. CasADi drops it from a product with a zero, such as the
        entry of a direction in which no joint moves the tip.
        """
        zero = zero_or_nan(self.inverse[-1] > 0)
        entries = [zero if value.is_zero() else value for value in ca.vertsplit(ca.vec(ca.densify(values)))]
        return ca.reshape(ca.vertcat(*entries), *values.shape)

    def forward(self, right: ca.SX) -> _Grid:
        """Return the rows of L^-1 B."""
        rows: _Grid = []
        for k, row in enumerate(ca.vertsplit(ca.densify(right))):
            entries = ca.horzsplit(row)
            rows.append([_less(x, self.lower[k], [each[c] for each in rows]) for c, x in enumerate(entries)])
        return rows

    def backward(self, right: Sequence[ca.SX]) -> list[ca.SX]:
        """Return L^-T b."""
        solution = list(right)
        for k in reversed(range(len(solution))):
            column = [self.lower[i][k] for i in range(k + 1, len(solution))]
            solution[k] = solution[k] - _dot(column, solution[k + 1 :])
        return solution


class _FactorsUnderWay:
    """Factors of a symmetric matrix of which some rows are eliminated: ``rows`` are those of D L^T.

    ``lower`` has the entries of L below the diagonal by row, as far as the columns are known; ``inverse`` has the
    reciprocals of the pivots.
    """

    def __init__(self, matrix: ca.SX) -> None:
        self.matrix = matrix
        self.rows = list[list[ca.SX]]()
        self.lower: _Grid = [list[ca.SX]() for _ in range(matrix.shape[0])]
        self.inverse = list[ca.SX]()

    def reduced_row(self, k: int) -> list[ca.SX]:
        """Return row k less its parts in the eliminated rows; entries before the diagonal are not read."""
        n = self.matrix.shape[0]
        row = [self.matrix[min(j, k), max(j, k)] for j in range(n)]  # from the upper triangle
        return [_less(row[j], [eliminated[j] for eliminated in self.rows], self.lower[k]) for j in range(n)]

    def eliminate(self, row: list[ca.SX], reciprocal: ca.SX) -> None:
        """Take the next row, reduced already, with the reciprocal of its pivot."""
        for j in range(len(self.rows) + 1, self.matrix.shape[0]):
            self.lower[j].append(row[j] * reciprocal)
        self.rows.append(row)
        self.inverse.append(reciprocal)


def _less(value: ca.SX, left: Sequence[ca.SX], right: Sequence[ca.SX]) -> ca.SX:
    """Return a value less a dot product; the last product, which is known last, is subtracted last."""
    if len(left) > 1:
        value = value - _dot(left[:-1], right[:-1])
    return value - _dot(left[-1:], right[-1:]) if left else value


def _dot(left: Sequence[ca.SX], right: Sequence[ca.SX]) -> ca.SX:
    """Return the dot product of two lists of equal length, 0 if they are empty."""
    return sum((x * y for x, y in zip(left, right, strict=True)), ca.SX(0))


def wrench_at_tip(pose: ca.SX, wrench: ca.SX) -> ca.SX:
    """Return a wrench about the origin with its moment about the tip: (f, m - p x f), in the same axes."""
    return ca.densify(ca.vertcat(wrench[:3], wrench[3:] - ca.cross(pose[:3, 3], wrench[:3])))


def column_at_origin(column: ca.SX, pose: ca.SX) -> ca.SX:
    """Return a hybrid column in spatial representation: (v + p x w, w)."""
    return ca.densify(ca.vertcat(column[:3] + ca.cross(pose[:3, 3], column[3:]), column[3:]))


def loaded_hessian(chain: Chain, joint_stiffness: ca.SX, load_stiffness: ca.SX) -> Expressions:
    """Return H = Kth - Kload, from upper triangles."""
    return Expressions(ca.vec(ca.densify(symmetric_from_upper(joint_stiffness - load_stiffness))), ())


def packed_hessian(chain: Chain, joint_stiffness: ca.SX, load_stiffness: ca.SX) -> Expressions:
    """Return the upper triangle of H, row by row."""
    hessian, n = joint_stiffness - load_stiffness, joint_stiffness.shape[0]
    return Expressions(ca.vertcat(*(hessian[i, j] for i in range(n) for j in range(i, n))), ())


def unpacked(triangle: ca.SX) -> ca.SX:
    """Return the symmetric matrix of an upper triangle that is stored row by row."""
    n = math.isqrt(2 * triangle.numel())  # n (n + 1) / 2 entries: the root of twice as many, rounded down, is n
    result, entries = ca.SX(n, n), iter(ca.vertsplit(triangle))
    for i in range(n):
        for j in range(i, n):
            result[i, j] = result[j, i] = next(entries)
    return result


def packed_factors(chain: Chain, hessian: ca.SX) -> Expressions:
    """Return L row by row, each with the reciprocal of its pivot in place of the 1 on the diagonal."""
    factors = Elimination.of(unpacked(hessian))
    rows = ((*row, inverse) for row, inverse in zip(factors.lower, factors.inverse, strict=True))
    return Expressions(ca.vertcat(*(entry for row in rows for entry in row)), ())


def tip_compliance(chain: Chain, J: ca.SX, hessian: ca.SX) -> Expressions:
    """Return C = J H^-1 J^T = (L^-1 J^T)^T D^-1 (L^-1 J^T)."""
    factors = Elimination.of(unpacked(hessian))
    rows = factors.forward(J.T)
    scaled = [[x * inverse for x in row] for row, inverse in zip(rows, factors.inverse, strict=True)]
    size = J.shape[0]
    result = ca.SX(size, size)
    for a in range(size):
        for b in range(a, size):
            value = _dot([row[a] for row in rows], [row[b] for row in scaled])
            result[a, b] = result[b, a] = value
    return Expressions(ca.vec(factors.refused(result)), ())


def tip_stiffness(chain: Chain, J: ca.SX, hessian: ca.SX) -> Expressions:
    """Return K = (J H^-1 J^T)^-1 from orthogonal columns of L^-1 J^T in the metric D^-1, which C would square.

    Gram and Schmidt make the columns orthogonal by a unit lower triangle U. With their squared lengths S,
    C = U^-1 S U^-T and K = U^T S^-1 U.
    """
    factors = Elimination.of(unpacked(hessian))
    columns = [list(column) for column in zip(*factors.forward(J.T), strict=True)]
    U, inverse_squares = _orthogonalised(columns, metric=factors.inverse)
    size = len(columns)
    result = ca.SX(size, size)  # U^T S^-1 U
    for a in range(size):
        for b in range(a, size):
            terms = [U[k][a] * U[k][b] * inverse_squares[k] for k in range(b, size)]
            result[a, b] = result[b, a] = sum(terms, ca.SX(0))
    return Expressions(ca.vec(factors.refused(result)), ())


def _orthogonalised(columns: Sequence[Sequence[ca.SX]], metric: Sequence[ca.SX]) -> tuple[_Grid, list[ca.SX]]:
    """Return the rows of U, such that the columns combined by them are orthogonal, and their inverse squared lengths.

    ``metric`` is the diagonal of the metric. A column that lies in the span of those before has NaN.
    """

    def product(left: Sequence[ca.SX], right: Sequence[ca.SX]) -> ca.SX:
        return sum((x * y * d for x, y, d in zip(left, right, metric, strict=True)), ca.SX(0))

    orthogonal, U, inverse_squares = list[Sequence[ca.SX]](), list[list[ca.SX]](), list[ca.SX]()
    for a, column in enumerate(columns):
        square_before, row = product(column, column), [ca.SX(0)] * len(columns)
        for other, row_of_other, inverse_square in zip(orthogonal, U, inverse_squares, strict=True):
            part = product(column, other) * inverse_square
            column = [x - part * y for x, y in zip(column, other, strict=True)]
            row = [x - part * y for x, y in zip(row, row_of_other, strict=True)]
        row[a] += 1
        square = product(column, column)
        orthogonal.append(column)
        U.append(row)
        inverse_squares.append(reciprocal_or_nan(square, square, SINGULAR**2 * square_before))
    return U, inverse_squares


def deflection(chain: Chain, J: ca.SX, hessian: ca.SX, increment: ca.SX) -> Expressions:
    """Return dq = H^-1 J^T dF."""
    factors = Elimination.of(unpacked(hessian))
    rows = factors.forward(J.T @ ca.vec(increment.T))
    solution = factors.backward([x * inverse for (x,), inverse in zip(rows, factors.inverse, strict=True)])
    return Expressions(factors.refused(ca.vertcat(*solution)), ())


def tridiagonal(chain: Chain, hessian: ca.SX) -> Expressions:
    """Return the diagonal of Householder's form of H, the squares beside it, and an interval of the eigenvalue.

    No eigenvalue is below the lowest end of Gershgorin's discs. The smallest is at most Rayleigh's quotient of an axis:
    any entry of the diagonal.
    """
    matrix = unpacked(hessian)
    n = matrix.shape[0]
    A: _Grid = [[matrix[i, k] for k in range(n)] for i in range(n)]
    beside = [_reflect(A, k) for k in range(n - 1)]  # entries beside the diagonal; A becomes tridiagonal in place
    diagonal, zero = [A[k][k] for k in range(n)], ca.SX(0)
    sizes = [ca.fabs(each) for each in beside]
    # Gershgorin: an eigenvalue lies within the sum of the row's other entries, before and behind the diagonal.
    disc_ends = [d - a - b for d, a, b in zip(diagonal, [zero, *sizes], [*sizes, zero], strict=True)]
    minus_lower, minus_upper = -disc_ends[0], -diagonal[0]  # minima as maxima, which masks.py has
    for k in range(1, n):
        minus_lower = larger_or_nan(minus_lower, -disc_ends[k])
        minus_upper = larger_or_nan(minus_upper, -diagonal[k])
    squares = [each * each for each in beside]
    return Expressions(ca.vertcat(*diagonal, *squares, -minus_lower, -minus_upper), ())


def _reflect(A: _Grid, k: int) -> ca.SX:
    """Reflect column k below the diagonal onto its first entry, on both sides, and return that entry.

    With the column x, v = x + sign(x_0) |x| e_0 and s = 2/|v|^2, the reflection 1 - s v v^T takes x to
    -sign(x_0) |x| e_0. The trailing block of A becomes, in place,

        (1 - s v v^T) A (1 - s v v^T) = A - v w^T - w v^T        w = p - (s p . v/2) v,  p = s A v
    """
    rest = range(k + 1, len(A))
    x = [A[i][k] for i in rest]
    if len(x) == 1:
        return x[0]
    norm = ca.sqrt(sum((each * each for each in x), ca.SX(0)))
    sign = 2 * (x[0] >= 0) - 1
    v = [x[0] + sign * norm, *x[1:]]
    half_square = norm * (norm + ca.fabs(x[0]))  # |v|^2/2
    s = 1 / (half_square + (half_square <= 0))  # v = 0 where the column is
    p = [s * _dot([A[i][j] for j in rest], v) for i in rest]
    along_v = s * _dot(p, v) / 2
    w = [a - along_v * b for a, b in zip(p, v, strict=True)]
    for i, row in enumerate(rest):
        for j, column in enumerate(rest):
            if j >= i:
                A[row][column] = A[column][row] = A[row][column] - v[i] * w[j] - w[i] * v[j]
    return -sign * norm


def only_entry(chain: Chain, H: ca.SX) -> Expressions:
    """Return the eigenvalue of a 1 x 1 matrix."""
    return Expressions(H[0], ())


def halved(chain: Chain, diagonal: ca.SX, squares: ca.SX, interval: ca.SX) -> Expressions:
    """Return the interval after some halvings: its lower end is below all eigenvalues, its upper end is not.

    The middle is below all eigenvalues if all pivots of T - middle are positive; masks choose the half.
    """
    lower, upper = interval[0], interval[1]
    for _ in range(HALVINGS):
        middle = (lower + upper) / 2
        pivot = diagonal[0] - middle
        is_below = pivot > 0
        for k in range(1, diagonal.numel()):
            pivot = diagonal[k] - middle - squares[k - 1] / pivot
            is_below *= pivot > 0
        lower, upper = lower + is_below * (middle - lower), upper + (1 - is_below) * (middle - upper)
    return Expressions(ca.vertcat(lower, upper), ())


def middle(chain: Chain, interval: ca.SX) -> Expressions:
    """Return the middle of an interval."""
    return Expressions((interval[0] + interval[1]) / 2, ())
