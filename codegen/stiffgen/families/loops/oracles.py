# SPDX-License-Identifier: MIT
"""Oracles of the functions of closed loops: projections of the references of the tree.

The equations c(q) are products of 4x4 matrices, differentiated twice by CasADi; NumPy solves the linear systems. The
gradient and Hessian of each energy are the references of the tree's own functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

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


class _Equations:
    """Equations c(q) of a chain's loops and their derivatives; ``rows`` has loop and row (of 6) of each equation."""

    def __init__(self, chain: Chain) -> None:
        """Derive gaps, Jacobian, weighted Hessian and velocity products by CasADi's own derivatives."""
        self.sizes = [sum(len(loop.rows) for loop in chain.loops), len(chain.coordinates)]
        q, weights, rates = (ca.SX.sym(name, self.sizes[k]) for name, k in (("q", 1), ("w", 0), ("dq", 1)))
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

    def __call__(
        self, q: FloatArray, weights: FloatArray | None = None, rates: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return c, C = dc/dq, the weighted sum of Hessians, and dC/dt dq/dt."""
        others = zip((weights, rates), self.sizes, strict=True)
        values = (np.zeros(size) if each is None else each for each, size in others)
        c, C, hessian, moving = (np.asarray(each) for each in self._function(q, *values))
        return c[:, 0], C, hessian, moving[:, 0]


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
        return np.array([self.solved(k)[1] for k in range(len(self.q))])

    def solved(self, k: int) -> tuple[FloatArray, FloatArray, list[int]]:
        """Return C_p, G over the velocity coordinates, and the passive entries of q."""
        chain, base = self.chain, self.chain.base_joints
        _, C, _, _ = self.equations(self.q[k])
        passive = [i for i in range(len(chain.coordinates)) if i not in chain.actuated]
        G = np.zeros((chain.dof, len(chain.motors)))
        G[list(chain.motors), range(len(chain.motors))] = 1
        right = C[:, list(chain.actuated)]
        G[np.ix_([base + i for i in passive], range(base, len(chain.motors)))] = -np.linalg.solve(C[:, passive], right)
        return C[:, passive], G, passive

    def multipliers(self, gradient: FloatArray) -> FloatArray:
        """Return the forces that hold the loops closed under a gradient of the tree."""
        base, forces = self.chain.base_joints, []
        for k, g in enumerate(gradient):
            C_p, _, passive = self.solved(k)
            forces.append(np.linalg.solve(C_p.T, g[base:][passive]))
        return np.array(forces)

    def reduced(self, gradient: FloatArray, hessian: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return dU/da and d2U/da2 (without a Hessian: of zeros) from gradients and Hessians of the tree."""
        gradient = np.asarray(gradient, dtype=float).reshape(len(self.q), -1)
        base, firsts, seconds = self.chain.base_joints, [], []
        for k, (g, multipliers) in enumerate(zip(gradient, self.multipliers(gradient), strict=True)):
            _, G, _ = self.solved(k)
            _, _, curvature, _ = self.equations(self.q[k], multipliers)
            firsts.append(G.T @ g)
            H = np.zeros((len(g), len(g))) if hessian is None else np.array(hessian[k], dtype=float)
            H[base:, base:] -= curvature
            seconds.append(G.T @ H @ G)
        return np.array(firsts), np.array(seconds)

    def rates(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rates and accelerations of the tree at constant rates of the motors."""
        base, rates, accelerations = self.chain.base_joints, [], []
        for k, each in enumerate(velocity):
            C_p, G, passive = self.solved(k)
            rate = G @ each
            _, _, _, moving = self.equations(self.q[k], rates=rate[base:])
            acceleration = np.zeros(len(rate))
            acceleration[[base + i for i in passive]] = -np.linalg.solve(C_p, moving)
            rates.append(rate)
            accelerations.append(acceleration)
        return np.array(rates), np.array(accelerations)

    def condition(self) -> FloatArray:
        """Return the largest |C| |C_p^-1| - size + 1 of a block of C_p, lengths in units of its hinges' levers."""
        return np.array([self._condition(self.equations(q)[1]) for q in self.q])

    def _condition(self, C: FloatArray) -> float:
        """Return the condition in one state from C = dc/dq there."""
        largest = 1.0
        slides = np.array([coordinate.type == "prismatic" for coordinate in self.chain.coordinates])
        is_angular = np.array([row >= 3 for _, row in self.equations.rows])
        for rows, columns in self._blocks:
            of_points = [row for row in rows if not is_angular[row]]
            levers = C[of_points][:, self._pattern[of_points].any(axis=0) & ~slides]
            unit = np.sqrt((levers**2).sum() / levers.shape[1]) if levers.size else 1.0  # [m]
            free = C[rows] * np.where(is_angular[rows], 1.0, 1.0 / unit)[:, None] * np.where(slides, unit, 1.0)
            product = np.linalg.norm(free) * np.linalg.norm(np.linalg.inv(free[:, columns]))
            largest = max(largest, float(product) - len(rows) + 1)
        return largest

    @cached_property
    def _pattern(self) -> Any:
        """Entries of C that are not zero in every state."""
        return np.array([np.abs(self.equations(q)[1]) > 1e-12 for q in self.q]).any(axis=0)

    @cached_property
    def _blocks(self) -> list[tuple[list[int], list[int]]]:
        """Rows and passive columns of the blocks: equations that share passive joints."""
        passive = [i for i in range(len(self.chain.coordinates)) if i not in self.chain.actuated]
        blocks: list[tuple[set[int], set[int]]] = []
        for row, pattern in enumerate(self._pattern):
            rows, columns = {row}, {k for k in passive if pattern[k]}
            for block in [each for each in blocks if each[1] & columns]:
                blocks.remove(block)
                rows, columns = rows | block[0], columns | block[1]
            blocks.append((rows, columns))
        return [(sorted(rows), sorted(columns)) for rows, columns in blocks]


def projected(values: Callable[[Projection], Any]) -> tuple[Oracle, ...]:
    """Return the oracle of one kernel, from values at closed configurations."""
    return (Oracle("projection of the tree", values, bound=_BOUND, closed=True),)


def _residual(r: References) -> FloatArray:
    """Return c(q) at random configurations, where loops are open."""
    equations = _Equations(r.chain)
    return np.array([equations(q)[0] for q in r.samples[Q]])


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
    residual = max((float(np.abs(equations(each)[0]).max(initial=0.0)) for each in q), default=0.0)
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
