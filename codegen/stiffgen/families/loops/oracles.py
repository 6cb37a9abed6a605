# SPDX-License-Identifier: MIT
"""Oracles of the functions of closed loops: projections of the references of the tree.

The equations c(q) are products of 4x4 matrices, differentiated twice by CasADi; NumPy solves the linear systems. The
gradient and Hessian of each energy are the references of the tree's own functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from stiffgen.core.robot.chain import Chain, LoopEnd
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.comparison import Oracle
from stiffgen.core.verify.kernels.oracles import oracles_of
from stiffgen.core.verify.kernels.poses import homogeneous, moved_pose
from stiffgen.core.verify.kernels.references import WRENCH, References
from stiffgen.core.verify.kernels.rounding import in_doubles
from stiffgen.core.verify.kernels.samples import Samples, symmetric
from stiffgen.core.verify.result import Check, Kernels
from stiffgen.families.loops.kernels import ACTUATED, GRADIENT, HESSIAN, START

CLOSE = "close"
"""Name of the kernel that closes the loops: :func:`check_loops` evaluates the equations at its results."""
_BOUND = 1e-10
"""Relative bound: the passive joints are solved from equations with condition numbers up to about 1e3."""


def _end_pose(chain: Chain, end: LoopEnd, q: ca.SX) -> ca.SX:
    """Return the pose (4x4) of a loop's end in the link that both ends share."""
    pose = ca.SX.eye(4)
    for joint in end.joints:
        pose = moved_pose(pose, joint, q[joint.coordinate - chain.base_joints])
    return pose @ homogeneous(end.rotation, end.translation)


class _EquationsAt(NamedTuple):
    """Equations of the loops at one configuration.

    Attributes:
        c: gaps, 0 where the loops are closed [m, rad].
        jacobian: C = dc/dq.
        curvature: weighted sum of d2c_k/dq2.
        moving: dC/dt dq/dt at constant rates.

    """

    c: FloatArray
    jacobian: FloatArray
    curvature: FloatArray
    moving: FloatArray


class _Equations:
    """Equations c(q) of a chain's loops and their derivatives; ``rows`` has loop and row (of 6) of each equation."""

    def __init__(self, chain: Chain) -> None:
        """Derive gaps, Jacobian, weighted Hessian and velocity products by CasADi's own derivatives."""
        self.count, self.coordinates = sum(len(loop.rows) for loop in chain.loops), len(chain.coordinates)
        q, rates = ca.SX.sym("q", self.coordinates), ca.SX.sym("dq", self.coordinates)
        weights = ca.SX.sym("w", self.count)
        self.rows: list[tuple[int, int]] = []
        equations = []
        for number, loop in enumerate(chain.loops):
            first, second = (_end_pose(chain, end, q) for end in (loop.first, loop.second))
            # Six rows: the ends' distance, and the axis of their turn times its sine; a loop uses some of them.
            turn = (first[:3, :3] @ second[:3, :3].T - second[:3, :3] @ first[:3, :3].T) / 2
            gap = ca.vertcat(first[:3, 3] - second[:3, 3], turn[2, 1], turn[0, 2], turn[1, 0])
            equations += [gap[row] for row in loop.rows]
            self.rows += [(number, row) for row in loop.rows]
        c = in_doubles(ca.vertcat(*equations))
        C = ca.jacobian(c, q)
        hessian, _ = ca.hessian(ca.dot(weights, c), q)
        moving = ca.jacobian(C @ rates, q) @ rates
        self._function = ca.Function("c", [q, weights, rates], [c, C, hessian, moving])

    def at(self, q: FloatArray, *, weights: FloatArray | None = None, rates: FloatArray | None = None) -> _EquationsAt:
        """Return the equations at a configuration; weights and rates are zero by default."""
        weights = np.zeros(self.count) if weights is None else weights
        rates = np.zeros(self.coordinates) if rates is None else rates
        c, C, curvature, moving = (np.asarray(each) for each in self._function(q, weights, rates))
        return _EquationsAt(c[:, 0], C, curvature, moving[:, 0])


class Projection:
    """Closed configurations, G = dq/da, and references of the tree there; ``whole`` lends its equations to a tip."""

    def __init__(self, references: References, whole: Projection | None = None) -> None:
        self.references, self.chain, self.samples = references, references.chain, references.samples
        self.q = self.samples[Q]
        self.equations: _Equations = whole.equations if whole else _Equations(self.chain)

    @cached_property
    def tips(self) -> list[Projection]:
        """Projections of the references of each tip."""
        return [Projection(each, self) for each in self.references.tips]

    @property
    def motion(self) -> FloatArray:
        """G in every state."""
        return np.array([self._motion(k) for k in range(len(self.q))])

    @cached_property
    def _passive(self) -> list[int]:
        """Entries of q that are no motors."""
        return [i for i in range(len(self.chain.coordinates)) if i not in self.chain.actuated]

    @property
    def _passive_rates(self) -> list[int]:
        """Velocity coordinates that are no motors."""
        return [self.chain.base_joints + i for i in self._passive]

    @cached_property
    def _jacobians(self) -> list[FloatArray]:
        """C = dc/dq in every state."""
        return [self.equations.at(q).jacobian for q in self.q]

    def _passive_jacobian(self, k: int) -> FloatArray:
        """Return C_p in state k."""
        return self._jacobians[k][:, self._passive]

    def _motion(self, k: int) -> FloatArray:
        """Return G = dq/da in state k over the velocity coordinates: 1 for a motor, -C_p^-1 C_a for passive joints."""
        motors, of_base = list(self.chain.motors), self.chain.base_joints  # a floating base's coordinates come first
        C_a = self._jacobians[k][:, list(self.chain.actuated)]
        G = np.zeros((self.chain.dof, len(motors)))
        G[motors, range(len(motors))] = 1
        G[self._passive_rates, of_base:] = -np.linalg.solve(self._passive_jacobian(k), C_a)
        return G

    def multipliers(self, gradient: FloatArray) -> FloatArray:
        """Return the forces lambda = C_p^-T dU/dp that hold the loops closed under gradients of the tree."""
        of_passive = gradient[:, self._passive_rates]
        forces = [np.linalg.solve(self._passive_jacobian(k).T, each) for k, each in enumerate(of_passive)]
        return np.array(forces)

    def reduced(self, gradient: FloatArray, hessian: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return dU/da and d2U/da2 (without a Hessian: of zeros) from gradients and Hessians of the tree."""
        gradient = np.asarray(gradient, dtype=float).reshape(len(self.q), -1)
        base, firsts, seconds = self.chain.base_joints, [], []
        for k, (dU_dq, multipliers) in enumerate(zip(gradient, self.multipliers(gradient), strict=True)):
            G = self._motion(k)
            firsts.append(G.T @ dU_dq)
            H = np.zeros((len(dU_dq), len(dU_dq))) if hessian is None else np.array(hessian[k], dtype=float)
            H[base:, base:] -= self.equations.at(self.q[k], weights=multipliers).curvature
            seconds.append(G.T @ H @ G)
        return np.array(firsts), np.array(seconds)

    def rates(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rates and accelerations of the tree at constant rates of the motors."""
        base, rates, accelerations = self.chain.base_joints, [], []
        for k, of_motors in enumerate(velocity):
            rate = self._motion(k) @ of_motors
            acceleration = np.zeros(len(rate))
            moving = self.equations.at(self.q[k], rates=rate[base:]).moving
            acceleration[self._passive_rates] = -np.linalg.solve(self._passive_jacobian(k), moving)
            rates.append(rate)
            accelerations.append(acceleration)
        return np.array(rates), np.array(accelerations)

    def condition(self) -> FloatArray:
        """Return the largest |C| |C_p^-1| - size + 1 of a block of C_p, lengths in units of its hinges' levers."""
        return np.array([self._condition(C) for C in self._jacobians])

    def _condition(self, C: FloatArray) -> float:
        """Return the condition in one state from C = dc/dq there."""
        largest = 1.0
        slides = np.array([coordinate.type == "prismatic" for coordinate in self.chain.coordinates])
        is_angular = np.array([row >= 3 for _, row in self.equations.rows])
        for rows, columns in self._blocks:
            of_points = [row for row in rows if not is_angular[row]]
            hinges = self._pattern[of_points].any(axis=0) & ~slides  # that move a point of the block
            levers = C[of_points][:, hinges]
            unit = np.sqrt((levers**2).sum() / levers.shape[1]) if levers.size else 1.0  # [m]
            of_rows, of_columns = np.where(is_angular[rows], 1.0, 1.0 / unit), np.where(slides, unit, 1.0)
            without_units = C[rows] * of_rows[:, None] * of_columns
            inverse = np.linalg.inv(without_units[:, columns])
            condition = np.linalg.norm(without_units) * np.linalg.norm(inverse) - len(rows) + 1
            largest = max(largest, float(condition))
        return largest

    @cached_property
    def _pattern(self) -> Any:
        """Entries of C that are not zero in every state."""
        return np.array([np.abs(C) > 1e-12 for C in self._jacobians]).any(axis=0)

    @cached_property
    def _blocks(self) -> list[tuple[list[int], list[int]]]:
        """Rows and passive columns of the blocks: equations that share passive joints, directly or through others."""
        blocks: list[tuple[set[int], set[int]]] = []
        for row, pattern in enumerate(self._pattern):
            rows, columns = {row}, {k for k in self._passive if pattern[k]}
            joined = [block for block in blocks if block[1] & columns]
            blocks = [block for block in blocks if block not in joined]
            for other_rows, other_columns in joined:
                rows, columns = rows | other_rows, columns | other_columns
            blocks.append((rows, columns))
        return [(sorted(rows), sorted(columns)) for rows, columns in blocks]


def projected(values: Callable[[Projection], Any]) -> tuple[Oracle, ...]:
    """Return the oracle of one kernel, from values at closed configurations."""
    return (Oracle("projection of the tree", values, bound=_BOUND, closed=True),)


def _residual(r: References) -> FloatArray:
    """Return c(q) at random configurations, where loops are open."""
    equations = _Equations(r.chain)
    return np.array([equations.at(q).c for q in r.samples[Q]])


def of_wrench(p: Projection) -> FloatArray:
    """Return the gradient J^T F of the tree."""
    return np.asarray(np.einsum("skj,sk->sj", p.references.jacobian["hybrid"], p.samples[WRENCH]))


ORACLES = {
    "motors_residual": (Oracle("products of poses", _residual, bound=_BOUND),),
    "motors_jacobian": projected(lambda p: p.motion),
    "motors_condition": projected(lambda p: p.condition()),
    "motors_multipliers": projected(lambda p: p.multipliers(p.samples[GRADIENT])),
    "motors_from_joints": projected(lambda p: p.reduced(p.samples[GRADIENT], symmetric(p.samples[HESSIAN]))),
    "motors_torque": projected(lambda p: -p.reduced(of_wrench(p))[0]),
    "motors_joint_stiffness": projected(
        lambda p: p.reduced(of_wrench(p), p.references.joint_stiffness("hybrid", corrected=True))[1]
    ),
}


def check_loops(
    kernels: Kernels, chain: Chain, count: int, seed: int, options: KernelOptions, table: Sequence[Kernel]
) -> list[Check]:
    """Compare the functions in motor coordinates with projections of the tree's references; nothing without loops."""
    if not chain.loops:
        return []
    actuated, start = Samples(chain, count, seed).of((ACTUATED, START))
    closed_or_nan = np.asarray(kernels[CLOSE](actuated, start), dtype=float)
    closes = np.isfinite(closed_or_nan).all(axis=1)
    q = closed_or_nan[closes]
    equations = _Equations(chain)
    # gap of the loops [m], [rad] in all configurations that are closed
    residual = max((float(np.abs(equations.at(each).c).max(initial=0.0)) for each in q), default=0.0)
    moved = np.abs(q[:, chain.actuated] - actuated[closes]).max(initial=0.0)
    checks = [
        Check(CLOSE, "share of starts that do not close", 1 - float(closes.mean()), 0.5),
        Check(CLOSE, "residual", residual, 1e-9),
        Check(CLOSE, "motors where asked for", float(moved), 0.0),
    ]
    if not closes.any():
        return checks
    closed = References(chain, len(q), seed, options, Samples(chain, len(q), seed, {Q: q}))
    projection = Projection(closed)
    oracles = oracles_of(options)
    tips = {tip.name: each for tip, each in zip(chain.tips, projection.tips, strict=True)}
    for kernel in table:
        projection_of_tip = tips[kernel.tip.name] if kernel.tip else projection
        for oracle in oracles.get(kernel.function, ()):
            if oracle.closed:
                checks += oracle.checks(kernels, chain, kernel, projection_of_tip)
    return checks
