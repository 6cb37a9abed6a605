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

C_p consists of blocks, one for each set of loops that share passive joints (:mod:`stiffgen.families.factors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from stiffgen.core.robot.chain import Chain, Joint, LoopEnd
from stiffgen.core.symbolic.kinematics import constant, cross, joint_position
from stiffgen.families.factors import Factors, Units
from stiffgen.families.masks import larger_or_nan

_Angle = tuple[int, float, float]
Turns = dict[_Angle, tuple[ca.SX, ca.SX]]
"""Sine and cosine of each angle of a hinge: joints of one coordinate, multiplier and offset have the same angle."""


def _angle(joint: Joint) -> _Angle:
    """Return what two hinges have in common whose angles are equal at every q."""
    return joint.coordinate, joint.multiplier, joint.offset


def hinges(chain: Chain) -> tuple[Joint, ...]:
    """Return one hinge for each angle that occurs in the loops, in the order of the coordinates."""
    ends = (end for loop in chain.loops for end in (loop.first, loop.second))
    joints = {_angle(joint): joint for end in ends for joint in end.joints if not joint.prismatic}
    return tuple(joints[angle] for angle in sorted(joints))


def sines_and_cosines(chain: Chain, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return sines and cosines of the angles of all ``hinges``."""
    angles = ca.vertcat(*(joint_position(chain, joint, q) for joint in hinges(chain)))
    return ca.sin(angles), ca.cos(angles)


@dataclass(frozen=True)
class _End:
    """End of a loop, in the axes of the link that both ends share.

    Attributes:
        rotation: axes of the end's frame.
        point: its origin [m].
        moves: the joints from the shared link to the end, each with its axis (zero if it slides) and the velocity v of
            the end at its unit rate.

    """

    rotation: ca.SX
    point: ca.SX
    moves: tuple[tuple[Joint, ca.SX, ca.SX], ...]

    @staticmethod
    def of(chain: Chain, end: LoopEnd, q: ca.SX, turns: Turns) -> _End:
        """Return the end at joint positions q; ``turns`` has the sine and cosine of every hinge."""
        R = ca.SX.eye(3)
        placed: list[tuple[Joint, ca.SX, ca.SX]] = []  # joint, its axis, offset [m] from the joint before
        for joint in end.joints:
            offset = R @ constant(joint.translation)
            R = R @ constant(joint.rotation)
            axis = constant(joint.axis)
            direction = ca.densify(R @ axis)
            if joint.prismatic:
                offset += R @ axis * joint_position(chain, joint, q)
            else:
                along, (sine, cosine) = axis @ axis.T, turns[_angle(joint)]
                R = R @ (along + cosine * (ca.SX.eye(3) - along) + sine * ca.skew(axis))  # Rodrigues' formula
            placed.append((joint, direction, offset))
        moves: list[tuple[Joint, ca.SX, ca.SX]] = []  # the last joint first
        arm = R @ constant(end.translation)  # from a joint's origin to the end
        for joint, direction, offset in reversed(placed):
            if joint.prismatic:
                moves.append((joint, ca.SX.zeros(3), direction))
            else:
                moves.append((joint, direction, cross(direction, arm)))
            arm = arm + offset
        return _End(rotation=ca.densify(R @ constant(end.rotation)), point=ca.densify(arm), moves=tuple(moves[::-1]))

    def add_stiffness(self, wrench: ca.SX, total: ca.SX, sign: int) -> None:
        """Add ``sign`` times the symmetric part of the kinematic stiffness under a wrench to ``total`` (n x n).

        The formula is that of the module's head; it holds for joint i before joint j and fills both triangles.
        """
        force, moment = wrench[:3], wrench[3:]
        for j, (outer, outer_axis, velocity) in enumerate(self.moves):
            for i, (inner, axis, _) in enumerate(self.moves[: j + 1]):
                value = ca.dot(force, cross(axis, velocity))
                if i < j:
                    value += ca.dot(moment, cross(axis, outer_axis)) / 2
                value *= sign * inner.multiplier * outer.multiplier
                total[inner.coordinate, outer.coordinate] += value
                if i < j:
                    total[outer.coordinate, inner.coordinate] += value

    def acceleration(self, rates: ca.SX) -> ca.SX:
        """Return the end's acceleration (linear, angular) at constant rates of the coordinates.

        Joint j, with the axis a_j and the end's velocity v_j at its unit rate, contributes (2 w + a_j rate_j) x v_j
        rate_j and w x a_j rate_j, with the angular velocity w of the joints before it. A joint i before j counts twice:
        it turns v_j, and j lengthens its arm.
        """
        angular, total = ca.SX.zeros(3), ca.SX.zeros(6)
        for joint, axis, velocity in self.moves:
            rate = joint.multiplier * rates[joint.coordinate]
            total += ca.vertcat(cross(2 * angular + axis * rate, velocity), cross(angular, axis)) * rate
            angular = angular + axis * rate
        return total


class Closure:
    """Closed loops of a chain at joint positions q; ``turns`` are sines and cosines of the hinges, if known.

    ``rows`` has the loop and the row (0..2 position, 3..5 angle) of each equation, ``jacobian`` is C = dc/dq.
    """

    def __init__(self, chain: Chain, q: ca.SX, *turns: ca.SX) -> None:
        """Derive the gaps c at the loops' ends, and their Jacobian dc/dq (rows of all loops, n)."""
        self.chain = chain
        self.n, self.motors = chain.dof, chain.motors
        pairs = zip(*map(ca.vertsplit, turns or sines_and_cosines(chain, q)), strict=True)
        turn_of = dict(zip(map(_angle, hinges(chain)), pairs, strict=True))
        self.ends = [
            (_End.of(chain, loop.first, q, turn_of), _End.of(chain, loop.second, q, turn_of)) for loop in chain.loops
        ]
        self.rows = [(k, row) for k, loop in enumerate(chain.loops) for row in loop.rows]
        self.jacobian = ca.SX(len(self.rows), self.n)
        for number, (k, row) in enumerate(self.rows):
            for sign, end in zip((1, -1), self.ends[k], strict=True):  # c is the first end less the second
                for joint, axis, velocity in end.moves:
                    value = ca.vertcat(velocity, axis)[row]
                    if not value.is_zero():
                        self.jacobian[number, joint.coordinate] += sign * joint.multiplier * value
        self.passive = [k for k in range(self.n) if k not in self.motors]

    def residual(self) -> ca.SX:
        """Return c(q) of the independent equations [m, rad]."""
        values = []
        for first, second in self.ends:
            axes = zip(ca.horzsplit(second.rotation), ca.horzsplit(first.rotation), strict=True)
            # sum of s_k x r_k over the axes of both frames: twice the sine of the angle between them, along its axis
            turned = sum((cross(s, r) for s, r in axes), ca.SX.zeros(3)) / 2
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
        """Factors of the blocks of C_p: equations that share passive coordinates, directly or through others."""
        groups: list[tuple[set[int], set[int]]] = []  # rows and passive coordinates, which no two groups share
        for number in range(len(self.rows)):
            rows, columns = {number}, {k for k in self.passive if not self.jacobian[number, k].is_zero()}
            joined = [group for group in groups if group[1] & columns]
            apart = [group for group in groups if not group[1] & columns]
            for other_rows, other_columns in joined:
                rows, columns = rows | other_rows, columns | other_columns
            groups = [*apart, (rows, columns)]
        return [
            Factors(self.jacobian, self._by_loop(sorted(rows)), sorted(columns), self._units(sorted(rows)))
            for rows, columns in groups
        ]

    def _by_loop(self, rows: Sequence[int]) -> list[list[int]]:
        """Return the rows of each loop."""
        loops = dict.fromkeys(self.rows[row][0] for row in rows)
        return [[row for row in rows if self.rows[row][0] == loop] for loop in loops]

    def _units(self, rows: Sequence[int]) -> Units:
        """Return the unit of length of the block with these rows."""
        coordinates = enumerate(self.chain.coordinates, start=self.chain.base_joints)
        slides = {k for k, coordinate in coordinates if coordinate.type == "prismatic"}
        angular = {row for row in rows if self.rows[row][1] >= 3}
        of_points = [row for row in rows if row not in angular]
        here = self.jacobian[of_points, :]  # its columns are levers of hinges [m per rad], and directions of slides
        hinges_with_levers = [k for k in range(self.n) if k not in slides and here[:, k].nnz()]
        typical, squared = 1.0, ca.SX(1)
        if hinges_with_levers:
            at_start = _jacobian_at_start(self.chain)[of_points, :][:, hinges_with_levers]
            typical = float((at_start**2).sum() / len(hinges_with_levers))
            squared = ca.sumsqr(here[:, hinges_with_levers]) / len(hinges_with_levers)
        return Units(
            squared=squared,
            typical=float(f"{typical:.3g}"),
            slides=frozenset(slides),
            angular=frozenset(angular),
            has_points=bool(of_points),
        )

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
            largest = larger_or_nan(largest, block.condition())
        return largest


@cache
def _jacobian_at_start(chain: Chain) -> NDArray[np.float64]:
    """Return C where the chain starts."""
    q = ca.SX.sym("q", len(chain.coordinates))
    return np.array(ca.Function("C", [q], [ca.densify(Closure(chain, q).jacobian)])(chain.start))


def motor_gradient(chain: Chain, q: ca.SX, gradient: ca.SX) -> ca.SX:
    """Return (dq/da)^T of a gradient with respect to the joint positions, for the actuated joints."""
    of_tree = ca.vertcat(ca.SX.zeros(chain.base_joints), gradient)
    closure = Closure(chain, q)
    return closure.gradient(of_tree, closure.multipliers(of_tree))[chain.base_joints :]
