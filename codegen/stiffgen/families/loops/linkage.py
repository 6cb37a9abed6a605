# SPDX-License-Identifier: MIT
"""Numerical study of closed loops at generation: a closed configuration, independent equations, and refusals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from stiffgen.core.errors import ChainError, listed, printable
from stiffgen.core.robot.chain import ClosedLoop, Coordinate, Joint, LoopEnd
from stiffgen.core.robot.geometry import FloatArray

_CLOSED = 1e-5
"""Largest gap of a closed loop [m, rad]: files round points and axes to some digits."""
_INDEPENDENT = 1e-5
"""Smallest part of an equation that others do not explain, relative to the largest equation."""
_STATES = 12
"""Closed configurations in which the loops are studied, beside the start."""
_SPREADS = tuple(0.6 / (1 + k) for k in range(10))
"""Standard deviations of the joint positions from which these are sought [rad, m], in turn: some loops close nearby."""
_NEAR = 2.0
"""Largest distance of a coordinate from the start in these configurations [rad, m]."""
_SINGULAR = 100.0
"""Condition number at the start, relative to the best one, beyond which another configuration becomes the start."""
_TRIES = 60
"""Configurations from which a closed one is sought, the file's and random ones."""
_STEPS = 60
"""Largest number of steps of a search: damped steps converge linearly at first, then square the error."""
_LARGEST_STEP = 0.5
"""Largest change of a coordinate in one step of a search [rad, m]."""


class _EndAt(NamedTuple):
    """End of a loop at some joint positions, in the link that both ends share.

    Attributes:
        rotation: axes of the end's frame (3x3).
        point: its origin [m].
        twists: twists (linear, angular) of the end at unit rates of the coordinates (6, n).

    """

    rotation: FloatArray
    point: FloatArray
    twists: FloatArray


@dataclass(frozen=True)
class Linkage:
    """Closed loops over the coordinates of a chain."""

    file: str
    loops: tuple[ClosedLoop, ...]
    coordinates: tuple[Coordinate, ...]
    base_joints: int

    def study(
        self, reference: Sequence[float], actuated: set[str]
    ) -> tuple[tuple[ClosedLoop, ...], tuple[int, ...], FloatArray]:
        """Return the loops with independent equations, the indices of the motors in q, and a closed configuration.

        Coordinates outside of the loops count as motors.

        Raises:
            ChainError: a loop does not close, a motor cannot move by itself, or a passive joint moves freely.

        """
        random = np.random.default_rng(33)
        start = self._closed_start(np.array(reference, dtype=float), random)
        states = self._states_near(start, random)
        jacobians = [self.equations(q)[1] for q in states]
        rows = _independent(jacobians)
        moved = np.abs(np.array(jacobians)).max(axis=(0, 1)) > 0
        motors = [k for k, each in enumerate(self.coordinates) if not moved[k] or each.name in actuated]
        self._check_mobility([C[rows] for C in jacobians], motors)
        conditions = [self._condition(C[rows], motors) for C in jacobians]
        if conditions[0] > _SINGULAR * min(conditions[1:]):  # the file's configuration is near a singularity
            start = states[int(np.argmin(conditions))]
        return self._with_rows(rows), tuple(motors), start

    def equations(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals of all rows of the loops [m, rad], and their derivatives with respect to q."""
        values, derivatives = [], []
        for loop in self.loops:
            first, second = (self._end(end, q) for end in (loop.first, loop.second))
            # sum of s_k x r_k over the axes of both frames: twice the sine of the angle between them, along its axis
            turned = np.cross(second.rotation.T, first.rotation.T).sum(axis=0) / 2
            rows = list(loop.rows)
            values.append(np.concatenate([first.point - second.point, turned])[rows])
            derivatives.append((first.twists - second.twists)[rows])
        return np.concatenate(values), np.concatenate(derivatives)

    def gap(self, q: FloatArray) -> float:
        """Return the largest distance [m] or angle [rad] between the ends of a loop, all equations included."""
        gaps = [0.0]
        for loop in self.loops:
            first, second = (self._end(end, q) for end in (loop.first, loop.second))
            gaps.append(float(np.linalg.norm(first.point - second.point)))
            if loop.is_weld:  # the norm of R - S is sqrt(2) times the angle, to first order
                gaps.append(float(np.linalg.norm(first.rotation - second.rotation)) / np.sqrt(2))
        return max(gaps)

    def close(self, q: FloatArray) -> FloatArray:
        """Return a configuration near q with the smallest residuals, by damped least-norm steps."""
        for _ in range(_STEPS):
            values, derivatives = self.equations(q)
            step = np.linalg.lstsq(derivatives, values, rcond=1e-9)[0]
            size = float(np.abs(step).max(initial=0.0))
            if size < 1e-14:
                break
            q = q - step * min(1.0, _LARGEST_STEP / size)
        return q

    def _end(self, end: LoopEnd, q: FloatArray) -> _EndAt:
        """Return an end at joint positions q."""
        R, p = np.eye(3), np.zeros(3)
        axes: list[tuple[Joint, FloatArray, FloatArray]] = []
        for joint in end.joints:
            p, R = p + R @ np.array(joint.translation), R @ np.array(joint.rotation)
            axis = np.array(joint.axis)
            position = joint.multiplier * q[joint.coordinate - self.base_joints] + joint.offset
            axes.append((joint, R @ axis, p))
            if joint.prismatic:
                p = p + R @ axis * position
            else:
                cross = np.cross(np.eye(3), axis)  # [axis]_x of Rodrigues' formula
                R = R @ (np.eye(3) + np.sin(position) * cross + (1 - np.cos(position)) * cross @ cross)
        p, R = p + R @ np.array(end.translation), R @ np.array(end.rotation)
        J = np.zeros((6, len(q)))
        for joint, axis, origin in axes:
            column = [*axis, 0, 0, 0] if joint.prismatic else [*np.cross(axis, p - origin), *axis]
            J[:, joint.coordinate - self.base_joints] += joint.multiplier * np.array(column)
        return _EndAt(rotation=R, point=p, twists=J)

    def _closed_start(self, reference: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return a configuration that closes all loops, from the file's reference or from random ones.

        Raises:
            ChainError: none is found; the loop that stays open farthest is named.

        """
        lower, upper = np.array([each.range_within(np.pi) for each in self.coordinates]).T
        best, smallest = reference, np.inf
        for attempt in range(_TRIES):
            q = self.close(np.clip(reference, lower, upper) if attempt == 0 else random.uniform(lower, upper))
            gap = self.gap(q)
            if gap < smallest:
                best, smallest = q, gap
            if gap <= _CLOSED:
                return q
        worst = max(self.loops, key=lambda loop: replace(self, loops=(loop,)).gap(best))
        names = dict.fromkeys(joint.name for end in (worst.first, worst.second) for joint in end.joints)
        raise ChainError(
            f"{self.file}: {printable(worst.name)} does not close: its ends stay {smallest:.2g} (m or rad) apart "
            f"wherever joints {listed(list(names))} stand; correct the points, the lengths or the joints' limits"
        )

    def _states_near(self, start: FloatArray, random: np.random.Generator) -> list[FloatArray]:
        """Return the start and random closed configurations near it."""
        states = [start]
        for attempt in range(20 * _STATES):
            spread = _SPREADS[attempt % len(_SPREADS)]
            q = self.close(start + random.normal(size=len(start)) * spread)
            if self.gap(q) <= _CLOSED and np.abs(q - start).max() < _NEAR:
                states.append(q)
            if len(states) > _STATES:
                break
        return states

    def _condition(self, C: FloatArray, motors: list[int]) -> float:
        """Return the condition number of C_p with its units, which cancel in ratios of two configurations."""
        passive = [k for k in range(len(self.coordinates)) if k not in motors]
        return float(np.linalg.cond(C[:, passive]))

    def _check_mobility(self, jacobians: list[FloatArray], motors: list[int]) -> None:
        """Refuse motors that the loops lock, and passive joints that no motor determines."""
        passive = [k for k in range(len(self.coordinates)) if k not in motors]
        # the state farthest from a singularity
        generic = max(jacobians, key=lambda C: float(np.linalg.svd(C, compute_uv=False)[-1]))
        left, right, rank = np.eye(len(generic)), np.eye(0), 0
        if passive:
            left, sizes, right = np.linalg.svd(generic[:, passive])
            rank = int((sizes > _INDEPENDENT * sizes.max()).sum())
        if rank < len(passive):  # right[rank:] spans the passive motions that the equations allow
            index = passive[int(np.abs(right[rank:]).max(axis=0).argmax())]
            raise ChainError(
                f"{self.file}: joint '{printable(self.coordinates[index].name)}' of a closed loop is passive but free: "
                f"{len(passive) - rank} of the passive joints move although all motors stand; name as many more with "
                "--actuated, lock or remove the joint, or add the missing loop"
            )
        if rank < len(generic):  # left[:, rank:] combines equations in which no passive joint occurs
            held = np.abs(left[:, rank:].T @ generic).max(axis=0)
            name = self.coordinates[int(held.argmax())].name
            raise ChainError(
                f"{self.file}: the closed loops are overconstrained: motor '{printable(name)}' cannot move by itself, "
                f"since {len(generic)} equations hold {len(passive)} passive joints; leave {len(generic) - rank} "
                "joints out of --actuated, or a loop out"
            )

    def _with_rows(self, rows: list[int]) -> tuple[ClosedLoop, ...]:
        """Return the loops with some of their equations; ``rows`` count the equations of all loops in turn."""
        loops, first = [], 0
        for loop in self.loops:
            own = tuple(row for k, row in enumerate(loop.rows) if first + k in rows)
            first += len(loop.rows)
            loops.append(replace(loop, rows=own))
        return tuple(loops)


def _independent(jacobians: list[FloatArray]) -> list[int]:
    """Return rows that are independent in every state: each time the row with the largest median remainder.

    A remainder is the part of a row that the rows chosen before do not explain (Gram and Schmidt).
    """
    remainders = [np.array(C) for C in jacobians[1:] or jacobians]  # per state; the start may be singular
    largest = max(float(np.linalg.norm(C, axis=1).max(initial=0.0)) for C in remainders)
    chosen: list[int] = []
    while len(chosen) < len(remainders[0]):
        lengths: Any = np.median([np.linalg.norm(C, axis=1) for C in remainders], axis=0)
        row = int(lengths.argmax())
        if lengths[row] <= _INDEPENDENT * largest:
            break
        chosen.append(row)
        for C in remainders:
            norm = np.linalg.norm(C[row])
            if norm > 0:
                direction = C[row] / norm
                C -= np.outer(C @ direction, direction)  # takes each row's part along the chosen one, in place
            C[chosen] = 0.0
    return sorted(chosen)
