# SPDX-License-Identifier: MIT
"""CasADi expressions of closed loops: equations, motion of the passive joints with the motors, forces in the loops.

The tree's coordinates q (on a floating base after its twist) fulfil the equations c(q) = 0. With the motors'
coordinates a and the passive ones p,

    C = dc/dq = [C_a C_p]       G = dq/da = [1; -C_p^-1 C_a]
    multipliers                 lambda = C_p^-T dU/dp           forces and moments that hold the loops closed
    torque of the motors        -dU/da = -(dU/dq_a - C_a^T lambda) = -G^T dU/dq
    stiffness of the motors     d2U/da2 = G^T (d2U/dq2 - sum_k lambda_k d2c_k/dq2) G

The sum is the kinematic stiffness of the closure. For one loop with the multipliers F = (f, m) at both ends, it is the
difference of the kinematic stiffnesses of the two ends under the wrench F. Only the symmetric part matters:

    f . (a_i x v_j) + m . (a_i x a_j) / 2       joint i before joint j, axes a, velocities v of the end at unit rates

All vectors are in the axes of the last link that both ends share, so that joints before that link do not enter.

C_p consists of blocks, one for each set of loops that share passive joints. Every block is solved by Householder's
reflections. They are backward stable without exchanging rows, so that the printed code has no branches: one order of
operations in single calls, in vectors of configurations and on a GPU. Entries that are zero by structure stay out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from stiffgen.robot.chain import Chain, Joint, LoopEnd
from stiffgen.symbolic.kinematics import constant, cross, joint_position

SINGULAR = 1e-9
"""Distance of a column of C_p from the span of those before it, below which the results are NaN; see ``_Units``."""
_NONE = ca.SX(0)


@dataclass(frozen=True)
class _End:
    """Frame of an end in the shared link; joints with the axis (zero if it slides) and the end's velocity v."""

    rotation: ca.SX
    point: ca.SX
    moves: tuple[tuple[Joint, ca.SX, ca.SX], ...]

    @staticmethod
    def of(chain: Chain, end: LoopEnd, q: ca.SX) -> _End:
        R, p = ca.SX.eye(3), ca.SX.zeros(3)
        axes = []
        for joint in end.joints:
            p, R = p + R @ constant(joint.translation), R @ constant(joint.rotation)
            axis, position = constant(joint.axis), joint_position(chain, joint, q)
            axes.append((joint, ca.densify(R @ axis), p))
            if joint.prismatic:
                p = p + R @ axis * position
            else:
                along = axis @ axis.T
                R = R @ (along + ca.cos(position) * (ca.SX.eye(3) - along) + ca.sin(position) * ca.skew(axis))
        p, R = ca.densify(p + R @ constant(end.translation)), R @ constant(end.rotation)
        zero = ca.SX.zeros(3)
        moves = ((j, zero, a) if j.prismatic else (j, a, cross(a, p - origin)) for j, a, origin in axes)
        return _End(ca.densify(R), p, tuple(moves))

    def add_stiffness(self, wrench: ca.SX, total: ca.SX, sign: int) -> None:
        """Add the symmetric part of the kinematic stiffness under a wrench."""
        for j, (outer, _, velocity) in enumerate(self.moves):
            for i, (inner, axis, _) in enumerate(self.moves[: j + 1]):
                value = ca.dot(wrench[:3], cross(axis, velocity))
                if i < j:
                    value += ca.dot(wrench[3:], cross(axis, self.moves[j][1])) / 2
                value *= sign * inner.multiplier * outer.multiplier
                total[inner.coordinate, outer.coordinate] += value
                if i < j:
                    total[outer.coordinate, inner.coordinate] += value

    def acceleration(self, rates: ca.SX) -> ca.SX:
        """Return the end's acceleration (linear, angular) at constant rates of the coordinates."""
        angular, total = ca.SX.zeros(3), ca.SX.zeros(6)
        for joint, axis, velocity in self.moves:
            rate = joint.multiplier * rates[joint.coordinate]
            total += ca.vertcat(cross(2 * angular + axis * rate, velocity), cross(angular, axis)) * rate
            angular = angular + axis * rate
        return total


class Closure:
    """Closed loops of a chain at joint positions q."""

    def __init__(self, chain: Chain, q: ca.SX) -> None:
        self.chain = chain
        self.n, self.motors = chain.dof, chain.motors
        self.ends = [(_End.of(chain, loop.first, q), _End.of(chain, loop.second, q)) for loop in chain.loops]
        self.rows = [(k, row) for k, loop in enumerate(chain.loops) for row in loop.rows]
        self.jacobian = ca.SX(len(self.rows), self.n)
        for number, (k, row) in enumerate(self.rows):
            for sign, end in zip((1, -1), self.ends[k], strict=True):
                for joint, axis, velocity in end.moves:
                    value = ca.vertcat(velocity, axis)[row]
                    if not value.is_zero():
                        self.jacobian[number, joint.coordinate] += sign * joint.multiplier * value
        self.passive = [k for k in range(self.n) if k not in self.motors]

    def residual(self) -> ca.SX:
        """Return c(q) of the independent equations [m, rad]."""
        values = []
        for first, second in self.ends:
            pairs = zip(ca.horzsplit(second.rotation), ca.horzsplit(first.rotation), strict=True)
            turned = sum((cross(a, b) for a, b in pairs), ca.SX.zeros(3)) / 2
            values.append(ca.vertcat(first.point - second.point, turned))
        return ca.vertcat(*(values[k][row] for k, row in self.rows))

    def squared_gap(self) -> ca.SX:
        """Return the sum of the squared distances of all ends [m], for welds also of the squared angles [rad]."""
        total = ca.SX(0)
        for loop, (first, second) in zip(self.chain.loops, self.ends, strict=True):
            total += ca.sumsqr(first.point - second.point)
            if loop.is_weld:
                total += ca.sumsqr(first.rotation - second.rotation) / 2
        return total

    @cached_property
    def blocks(self) -> list[Factors]:
        """Factors of the blocks of C_p."""
        groups: list[tuple[set[int], set[int]]] = []  # rows and passive coordinates
        for number in range(len(self.rows)):
            rows, columns = {number}, {k for k in self.passive if not self.jacobian[number, k].is_zero()}
            apart = []
            for other in groups:
                if other[1] & columns:
                    rows, columns = rows | other[0], columns | other[1]
                else:
                    apart.append(other)
            groups = [*apart, (rows, columns)]
        return [
            Factors(self.jacobian, sorted(rows), sorted(columns), self._units(sorted(rows))) for rows, columns in groups
        ]

    def _units(self, rows: Sequence[int]) -> _Units:
        types = enumerate(self.chain.coordinates, start=self.chain.base_joints)
        slides = {k for k, coordinate in types if coordinate.type == "prismatic"}
        angular = {row for row in rows if self.rows[row][1] >= 3}
        block = self.jacobian[[row for row in rows if row not in angular], :]
        levers = [block[:, k] for k in range(self.n) if k not in slides and block[:, k].nnz()]
        squared = sum(map(ca.sumsqr, levers), _NONE) / len(levers) if levers else ca.SX(1)
        return _Units(squared, frozenset(slides), frozenset(angular), has_points=len(angular) < len(rows))

    def motion(self) -> ca.SX:
        """Return G = dq/da; entries that are zero by structure are not stored."""
        G = ca.SX(self.n, len(self.motors))
        for column, motor in enumerate(self.motors):
            G[motor, column] = 1
            for block in self.blocks:
                right = [self.jacobian[row, motor] for row in block.rows]
                if not all(value.is_zero() for value in right):
                    for passive, value in zip(block.columns, block.solve(right), strict=True):
                        G[passive, column] = -value
        return G

    def passive_rates(self, right: ca.SX) -> ca.SX:
        """Return the passive entries of -C_p^-1 right among all coordinates; those of the motors are zero."""
        result = ca.SX.zeros(self.n)
        for block in self.blocks:
            for passive, value in zip(block.columns, block.solve([right[row] for row in block.rows]), strict=True):
                result[passive] = -value
        return result

    def multipliers(self, gradient: ca.SX) -> ca.SX:
        """Return lambda = C_p^-T dU/dp, one per independent equation [N, N m]."""
        result = ca.SX.zeros(len(self.rows))
        for block in self.blocks:
            values = block.solve_transposed([gradient[k] for k in block.columns])
            for row, value in zip(block.rows, values, strict=True):
                result[row] = value
        return result

    def gradient(self, gradient: ca.SX, multipliers: ca.SX) -> ca.SX:
        """Return dU/da = dU/dq_a - C_a^T lambda."""
        reduced = gradient - self.jacobian.T @ multipliers
        return ca.densify(ca.vertcat(*(reduced[k] for k in self.motors)))

    def stiffness(self, multipliers: ca.SX) -> ca.SX:
        """Return the sum of lambda_k d2c_k/dq2 over all equations, up to terms that G^T (...) G removes."""
        total = ca.SX(self.n, self.n)
        for k, ends in enumerate(self.ends):
            wrench = ca.SX.zeros(6)
            for number, (of, row) in enumerate(self.rows):
                if of == k:
                    wrench[row] = multipliers[number]
            for sign, end in zip((1, -1), ends, strict=True):
                end.add_stiffness(wrench, total, sign)
        return total

    def acceleration(self, rates: ca.SX) -> ca.SX:
        """Return dC/dt dq/dt of the independent equations."""
        values = [first.acceleration(rates) - second.acceleration(rates) for first, second in self.ends]
        return ca.vertcat(*(values[k][row] for k, row in self.rows))

    def condition(self) -> ca.SX:
        """Return the largest condition number of a block, 1 at best."""
        largest = ca.SX(1)
        for block in self.blocks:
            value = block.condition()
            is_less = value < largest
            largest = is_less * largest + (1 - is_less) * value  # NaN if one is; fmax would drop it
        return largest


@dataclass(frozen=True)
class _Units:
    """Unit of length of a block: root mean square of the levers of all its hinges, those of motors included.

    A lever is the displacement of an end per radian. One unit for all columns, since a column that vanishes is a
    singularity of the motors. ``squared`` is the unit's square [m^2], ``slides`` are coordinates, ``angular`` rows.
    """

    squared: ca.SX
    slides: frozenset[int]
    angular: frozenset[int]
    has_points: bool

    def column(self, coordinate: int) -> ca.SX:
        """Return the squared length of a typical column."""
        if coordinate in self.slides:
            return ca.SX(1)
        return self.squared * int(self.has_points) + int(bool(self.angular))

    def entry(self, row: int, coordinate: int) -> ca.SX:
        """Return the square of the factor that frees an entry of C from its unit."""
        factor = ca.SX(1) if row in self.angular else 1 / self.squared
        return factor * self.squared if coordinate in self.slides else factor


class Factors:
    """Block of C_p as a product of Householder's reflections and a triangle; its rows are in the order of the columns.

    Columns with few entries come first, so that reflections stay short.
    """

    def __init__(self, matrix: ca.SX, rows: Sequence[int], columns: Sequence[int], units: _Units) -> None:
        def filled(column: int) -> int:
            return sum(not matrix[row, column].is_zero() for row in rows)

        order, left = sorted(columns, key=filled), list(rows)
        self.rows: list[int] = []
        for column in order:
            self.rows.append(next((row for row in left if not matrix[row, column].is_zero()), left[0]))
            left.remove(self.rows[-1])
        self.columns = order
        self.size = len(order)
        self.whole, self.units = matrix, units
        self.reflections: list[tuple[int, list[ca.SX], ca.SX]] = []
        self.inverse_diagonal: list[ca.SX] = []
        self.triangle = [[ca.SX(matrix[row, column]) for column in order] for row in self.rows]
        for k in range(self.size):
            self._eliminate(k)

    def _eliminate(self, k: int) -> None:
        A = self.triangle
        column = [A[i][k] for i in range(k, self.size)]
        if all(value.is_zero() for value in column[1:]):
            pivot = column[0]
        else:
            norm = ca.sqrt(ca.sumsqr(ca.vertcat(*column)))
            is_negative = column[0] < 0
            pivot = norm * (2 * is_negative - 1)  # of the other sign than the entry: no difference of near numbers
            v = [column[0] - pivot, *column[1:]]
            scale = -1 / (pivot * v[0])  # 2 / v.v
            self.reflections.append((k, v, scale))
            for j in range(k + 1, self.size):
                rest = _reflected(v, scale, [A[i][j] for i in range(k, self.size)])
                for i, value in enumerate(rest, start=k):
                    A[i][j] = value
        distance, least = pivot * pivot, SINGULAR**2 * self.units.column(self.columns[k])
        is_regular, is_singular = distance > least, distance <= least
        # 0/0 at a singularity; CasADi would simplify x / pivot / x
        self.inverse_diagonal.append(is_regular / (pivot * (1 - is_singular)))

    def solve(self, right: Sequence[ca.SX]) -> list[ca.SX]:
        """Return the solution x of A x = right, in the order of the columns."""
        b = [ca.SX(value) for value in right]
        for k, v, scale in self.reflections:
            b[k:] = _reflected(v, scale, b[k:])
        for k in reversed(range(self.size)):
            terms = (self.triangle[k][j] * b[j] for j in range(k + 1, self.size))
            b[k] = (b[k] - sum(terms, _NONE)) * self.inverse_diagonal[k]
        return b

    def solve_transposed(self, right: Sequence[ca.SX]) -> list[ca.SX]:
        """Return the solution y of A^T y = right, in the order of the rows."""
        b = [ca.SX(value) for value in right]
        for k in range(self.size):
            terms = (self.triangle[j][k] * b[j] for j in range(k))
            b[k] = (b[k] - sum(terms, _NONE)) * self.inverse_diagonal[k]
        for k, v, scale in reversed(self.reflections):
            b[k:] = _reflected(v, scale, b[k:])
        return b

    def condition(self) -> ca.SX:
        """Return |C| |C_p^-1| of the block without units, in Frobenius' norm, less size - 1.

        This is at least 1, at least cond(C_p) - 1 in the spectral norm, and grows with G = -C_p^-1 C_a.
        """
        size, inverse = ca.SX(0), ca.SX(0)
        for row in self.rows:
            for k in range(self.whole.size2()):
                value = self.whole[row, k]
                if not value.is_zero():
                    size += self.units.entry(row, k) * value * value
        for unit, row in enumerate(self.rows):
            solution = self.solve([ca.SX(int(i == unit)) for i in range(self.size)])
            for k, value in zip(self.columns, solution, strict=True):
                inverse += value * value / self.units.entry(row, k)
        return ca.sqrt(size * inverse) - (self.size - 1)


def _reflected(v: list[ca.SX], scale: ca.SX, b: list[ca.SX]) -> list[ca.SX]:
    """Return b - scale v (v . b)."""
    product = sum((x * y for x, y in zip(v, b, strict=True)), _NONE) * scale
    if product.is_zero():
        return b
    return [y if x.is_zero() else y - product * x for x, y in zip(v, b, strict=True)]


def motor_gradient(chain: Chain, q: ca.SX, gradient: ca.SX) -> ca.SX:
    """Return (dq/da)^T of a gradient with respect to the joint positions, for the actuated joints."""
    whole = ca.vertcat(ca.SX.zeros(chain.base_joints), gradient)
    closure = Closure(chain, q)
    return closure.gradient(whole, closure.multipliers(whole))[chain.base_joints :]
