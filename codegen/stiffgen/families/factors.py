# SPDX-License-Identifier: MIT
"""Solution of the passive joints' equations: one block of C_p for each set of loops that share passive joints.

A block is solved in two stages:

1. Rods. A loop of 3 equations often has exactly 2 passive joints that no other loop has (a rod with two hinges), and a
   planar loop of 2 equations one. The columns c_1, c_2 of these joints span a plane. Its normal n = c_1 x c_2 turns the
   equations of the loop into one without the rod, n . C x = n . b. The dual vectors c_2 x n / n.n and n x c_1 / n.n
   return the rod's rates from the remainder of b. With a single column, n is that column turned by 90 degrees.
2. Core. One or two remaining columns are solved by the adjugate matrix, more by Householder's reflections, which are
   backward stable without exchanging rows.

Neither stage has branches: one order of operations in single calls, in vectors of configurations and on a GPU. Entries
that are zero by structure stay out. Next to a singularity the solutions are NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.core.symbolic.kinematics import cross
from stiffgen.families.masks import reciprocal_or_nan

SINGULAR = 1e-9
"""Distance of a column from the span of the others, relative to typical columns (``Units``), for NaN."""
NONE = ca.SX(0)
Entries = list[ca.SX]


@dataclass(frozen=True)
class Units:
    """Unit of length of a block: root mean square of the levers of all its hinges, those of motors included.

    A lever is the displacement of an end per radian. One unit for all columns, since a column that vanishes is a
    singularity of the motors.

    Attributes:
        squared: square of the unit [m^2].
        typical: ``squared`` at the start configuration.
        slides: coordinates of prismatic joints.
        angular: rows of equations of angles.
        has_points: whether the block has rows of positions.

    """

    squared: ca.SX
    typical: float
    slides: frozenset[int]
    angular: frozenset[int]
    has_points: bool

    def column(self, coordinate: int) -> float:
        """Return the squared length of a typical column."""
        if coordinate in self.slides:
            return 1.0
        return self.typical * int(self.has_points) + int(bool(self.angular))

    def entry(self, row: int, coordinate: int) -> ca.SX:
        """Return the square of the factor that frees an entry of C (m per rad, rad per m ...) from its unit."""
        factor = ca.SX(1) if row in self.angular else 1 / self.squared
        return factor * self.squared if coordinate in self.slides else factor


@dataclass(frozen=True)
class _Rod:
    """Rows of one loop, its passive joints that no other loop has, and their normal and dual vectors."""

    rows: list[int]
    columns: list[int]
    normal: Entries
    duals: list[Entries]
    squared: ca.SX

    @staticmethod
    def of(C: ca.SX, rows: list[int], columns: list[int], units: Units) -> _Rod:
        """Return the rod of a loop with 2 rows and 1 column, or 3 rows and 2 columns; see the head of the module."""
        vectors = [[ca.SX(C[row, column]) for row in rows] for column in columns]  # c_1, or c_1 and c_2
        if len(rows) == 2:
            ((x, y),) = vectors
            normal, duals = [-y, x], vectors  # c_1 is as long as n, so that its dual is c_1 / n.n
        else:
            c_1, c_2 = (ca.vertcat(*vector) for vector in vectors)
            n = cross(c_1, c_2)
            normal, duals = ca.vertsplit(n), [ca.vertsplit(cross(c_2, n)), ca.vertsplit(cross(n, c_1))]
        squared = _dot(normal, normal)
        least = SINGULAR**2 * math.prod(units.column(column) for column in columns)
        inverse = reciprocal_or_nan(squared, squared, least)
        return _Rod(rows, columns, normal, [[x * inverse for x in dual] for dual in duals], squared)


def _rods(C: ca.SX, loops: Sequence[Sequence[int]], columns: Sequence[int], units: Units) -> list[_Rod]:
    """Return the rods: loops of which one or two columns have no entry in the rows of any other loop."""
    rods = []
    for rows in loops:
        others = [row for other in loops for row in other if row not in rows]
        alone = [k for k in columns if all(C[row, k].is_zero() for row in others)]
        if (len(rows), len(alone)) in ((2, 1), (2, 2), (3, 2)):  # of three such columns, two can be near a line
            rods.append(_Rod.of(C, list(rows), alone[: len(rows) - 1], units))
    return rods


class Factors:
    """A block of C_p, ready to be solved; its rows and columns are in the order of ``rows`` and ``columns``.

    Rods come first. The core has one row per rod (the equation along the rod's normal), then the rows without a rod
    (``others``), and as many columns (``shared``).
    """

    def __init__(self, C: ca.SX, loops: Sequence[Sequence[int]], columns: Sequence[int], units: Units) -> None:
        self.C, self.units = C, units
        all_rows = [row for rows in loops for row in rows]
        self.rods = _rods(C, loops, columns, units)
        in_rods = [row for rod in self.rods for row in rod.rows]
        private = [column for rod in self.rods for column in rod.columns]
        self.others = [row for row in all_rows if row not in in_rods]
        self.shared = [column for column in columns if column not in private]
        self.rows, self.columns = [*in_rods, *self.others], [*private, *self.shared]
        self.core = self._core()

    def _core(self) -> _Adjugate | _Reflections:
        """Return the core: a row per rod, its equation along the normal, then the rows without a rod."""
        entries = [[_dot(rod.normal, [self.C[row, k] for row in rod.rows]) for k in self.shared] for rod in self.rods]
        entries += [[ca.SX(self.C[row, k]) for k in self.shared] for row in self.others]
        scales = [rod.squared for rod in self.rods] + [ca.SX(1)] * len(self.others)
        lengths = [self.units.column(k) for k in self.shared]
        return (_Adjugate if len(self.shared) <= 2 else _Reflections)(entries, scales, lengths)

    def solve(self, right: Sequence[ca.SX]) -> Entries:
        """Return the solution x of A x = right, in the order of the columns; ``right`` is in the order of the rows."""
        b = dict(zip(self.rows, map(ca.SX, right), strict=True))
        along_normals = [_dot(rod.normal, [b[row] for row in rod.rows]) for rod in self.rods]
        shared = self.core.solve([*along_normals, *(b[row] for row in self.others)])
        x = dict(zip(self.shared, shared, strict=True))
        for rod in self.rods:
            remainder = [b[row] - _dot([self.C[row, k] for k in self.shared], shared) for row in rod.rows]
            x |= {column: _dot(dual, remainder) for column, dual in zip(rod.columns, rod.duals, strict=True)}
        return [x[column] for column in self.columns]

    def solve_transposed(self, right: Sequence[ca.SX]) -> Entries:
        """Return the solution y of A^T y = right, in the order of the rows; ``right`` is in that of the columns.

        Of a rod's rows, the duals give the part of y in the plane of its columns; the core gives the part along the
        normal, from what the first part leaves of the other columns' equations.
        """
        b = dict(zip(self.columns, map(ca.SX, right), strict=True))
        y: dict[int, ca.SX] = {}  # of the rods' rows, in the planes of their columns
        for rod in self.rods:
            of_columns = [b[k] for k in rod.columns]
            y |= {row: _dot([dual[i] for dual in rod.duals], of_columns) for i, row in enumerate(rod.rows)}
        remainder = [b[k] - _dot([self.C[row, k] for row in y], y.values()) for k in self.shared]
        of_core = self.core.solve_transposed(remainder)
        along_normals, of_others = of_core[: len(self.rods)], of_core[len(self.rods) :]
        for rod, value in zip(self.rods, along_normals, strict=True):
            y |= {row: y[row] + x * value for row, x in zip(rod.rows, rod.normal, strict=True)}
        return [y[row] for rod in self.rods for row in rod.rows] + of_others

    def condition(self) -> ca.SX:
        """Return |C| |C_p^-1| - (n - 1) of the block without units, n its number of equations, in Frobenius' norm.

        C has the block's rows and the columns of all coordinates. The norms of an n x n matrix and its inverse multiply
        to n or more, so that the result is at least 1. It is at least cond(C_p) - 1 in the spectral norm, and grows
        with G = -C_p^-1 C_a. Frobenius' norm is the root of the sum of all squares.
        """
        squares, inverse_squares, n = ca.SX(0), ca.SX(0), len(self.rows)
        for row in self.rows:
            for coordinate in range(self.C.size2()):
                value = self.C[row, coordinate]
                if not value.is_zero():
                    squares += self.units.entry(row, coordinate) * value * value
        for equation, row in enumerate(self.rows):
            unit_vector = [ca.SX(int(k == equation)) for k in range(n)]
            column_of_inverse = self.solve(unit_vector)
            for coordinate, value in zip(self.columns, column_of_inverse, strict=True):
                inverse_squares += value * value / self.units.entry(row, coordinate)  # it has the inverse unit
        return ca.sqrt(squares * inverse_squares) - (n - 1)


class _Adjugate:
    """Matrix of at most two columns; its inverse is the adjugate over the determinant.

    ``scales`` are squared lengths of the factors of the rows, ``lengths`` squared lengths of typical columns.
    """

    def __init__(self, entries: Sequence[Entries], scales: Sequence[ca.SX], lengths: Sequence[float]) -> None:
        if len(entries) == 2:
            (a, b), (c, d) = entries
            determinant, self.adjugate = a * d - b * c, [[d, -b], [-c, a]]
        else:  # one column, or none
            determinant, self.adjugate = (entries[0][0] if entries else ca.SX(1)), [[ca.SX(1)]] * len(entries)
        least = math.prod(scales, start=ca.SX(SINGULAR**2 * math.prod(lengths)))
        self.inverse = reciprocal_or_nan(determinant, determinant * determinant, least)

    def solve(self, right: Entries) -> Entries:
        """Return the solution x of A x = right."""
        return [_dot(row, right) * self.inverse for row in self.adjugate]

    def solve_transposed(self, right: Entries) -> Entries:
        """Return the solution y of A^T y = right."""
        return [_dot(column, right) * self.inverse for column in zip(*self.adjugate, strict=True)]


class _Reflections:
    """Matrix as a product of Householder's reflections and a triangle; rows are divided by the roots of ``scales``.

    Columns with few entries come first, each with a row in which it has one, so that reflections stay short. The
    arguments are those of ``_Adjugate``.

    Attributes:
        size: number of rows and of columns.
        columns, rows: order in which columns and rows of the matrix stand in the triangle.
        factors: reciprocal roots of ``scales``, by which the rows are multiplied, in the order of ``rows``.
        triangle: the matrix in that order, then its upper triangle.
        reflections: (k, v, scale): b[k:] becomes b[k:] - scale v (v . b[k:]).
        inverse_diagonal: reciprocals of the triangle's diagonal.

    """

    def __init__(self, entries: Sequence[Entries], scales: Sequence[ca.SX], lengths: Sequence[float]) -> None:
        self.size = len(entries)
        rows_left = list(range(self.size))
        self.columns = sorted(range(self.size), key=lambda k: sum(not row[k].is_zero() for row in entries))
        self.rows: list[int] = []
        for k in self.columns:
            row_of_entry = next((row for row in rows_left if not entries[row][k].is_zero()), rows_left[0])
            self.rows.append(row_of_entry)
            rows_left.remove(row_of_entry)
        self.factors = [1 / ca.sqrt(scales[row]) for row in self.rows]
        self.triangle = [
            [entries[row][k] * f for k in self.columns] for row, f in zip(self.rows, self.factors, strict=True)
        ]
        self.reflections: list[tuple[int, Entries, ca.SX]] = []
        self.inverse_diagonal = [self._eliminate(k, lengths[column]) for k, column in enumerate(self.columns)]

    def _eliminate(self, k: int, length: float) -> ca.SX:
        """Clear column k below the diagonal by a reflection of rows k and below; return the pivot's reciprocal or NaN.

        The reflection 1 - 2 v v^T/(v . v) takes the column x to (pivot, 0, ...) with |pivot| = |x| and v = x - (pivot,
        0, ...). ``length`` is the squared length of a typical column.
        """
        A = self.triangle
        column = [A[i][k] for i in range(k, self.size)]
        if all(value.is_zero() for value in column[1:]):
            pivot = column[0]
        else:
            norm = ca.sqrt(ca.sumsqr(ca.vertcat(*column)))
            is_negative = column[0] < 0
            pivot = norm * (2 * is_negative - 1)  # of the other sign than the entry: no difference of near numbers
            v = [column[0] - pivot, *column[1:]]
            scale = -1 / (pivot * v[0])  # 2 / v.v, since v.v = 2 pivot (pivot - x_0)
            self.reflections.append((k, v, scale))
            for j in range(k + 1, self.size):
                rest = _reflected(v, scale, [A[i][j] for i in range(k, self.size)])
                for i, value in enumerate(rest, start=k):
                    A[i][j] = value
        return reciprocal_or_nan(pivot, pivot * pivot, SINGULAR**2 * length)

    def solve(self, right: Entries) -> Entries:
        """Return the solution x of A x = right."""
        b = [right[row] * factor for row, factor in zip(self.rows, self.factors, strict=True)]
        for k, v, scale in self.reflections:
            b[k:] = _reflected(v, scale, b[k:])
        for k in reversed(range(self.size)):
            b[k] = (b[k] - _dot(self.triangle[k][k + 1 :], b[k + 1 :])) * self.inverse_diagonal[k]
        return [b[self.columns.index(k)] for k in range(self.size)]

    def solve_transposed(self, right: Entries) -> Entries:
        """Return the solution y of A^T y = right."""
        b = [right[column] for column in self.columns]
        for k in range(self.size):
            terms = _dot([self.triangle[j][k] for j in range(k)], b[:k])  # the transposed triangle is solved forwards
            b[k] = (b[k] - terms) * self.inverse_diagonal[k]
        for k, v, scale in reversed(self.reflections):
            b[k:] = _reflected(v, scale, b[k:])
        b = [value * factor for value, factor in zip(b, self.factors, strict=True)]
        return [b[self.rows.index(row)] for row in range(self.size)]


def _dot(left: Iterable[ca.SX], right: Iterable[ca.SX]) -> ca.SX:
    return sum((x * y for x, y in zip(left, right, strict=True)), NONE)


def _reflected(v: Entries, scale: ca.SX, b: Entries) -> Entries:
    """Return b - scale v (v . b)."""
    product = _dot(v, b) * scale
    if product.is_zero():
        return b
    return [y if x.is_zero() else y - product * x for x, y in zip(v, b, strict=True)]
