# SPDX-License-Identifier: MIT
"""Compare the functions of closed loops with projections of the tree's functions.

The equations c(q) are products of 4x4 matrices, differentiated twice by CasADi; NumPy solves the linear systems. The
gradient and Hessian of each energy are those of the tree's own functions, which have references of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffgen.robot.chain import Chain, LoopEnd
from stiffgen.robot.geometry import FloatArray
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.verify.poses import homogeneous, moved_pose
from stiffgen.verify.result import Check, Kernels
from stiffgen.verify.rounding import in_doubles
from stiffgen.verify.samples import Samples, joint_potential_arguments

_BOUND = 1e-10
"""Relative bound: the passive joints are solved from equations with condition numbers up to about 1e3."""


def _end_pose(chain: Chain, end: LoopEnd, q: ca.SX) -> ca.SX:
    pose = ca.SX.eye(4)
    for joint in end.joints:
        pose = moved_pose(pose, joint, q[joint.coordinate - chain.base_joints])
    return pose @ homogeneous(end.rotation, end.translation)


@dataclass(frozen=True)
class _Projection:
    """Closed configurations, G = dq/da, and the equations' derivatives there."""

    chain: Chain
    q: FloatArray
    derivatives: Callable[..., tuple[FloatArray, FloatArray, FloatArray]]

    @staticmethod
    def of(chain: Chain, q: FloatArray) -> _Projection:
        symbol, weights, rates = (
            ca.SX.sym(name, size)
            for name, size in (
                ("q", len(chain.coordinates)),
                ("w", sum(len(loop.rows) for loop in chain.loops)),
                ("dq", len(chain.coordinates)),
            )
        )
        rows = []
        for loop in chain.loops:
            first, second = (_end_pose(chain, end, symbol) for end in (loop.first, loop.second))
            turn = (first[:3, :3] @ second[:3, :3].T - second[:3, :3] @ first[:3, :3].T) / 2
            whole = ca.vertcat(first[:3, 3] - second[:3, 3], turn[2, 1], turn[0, 2], turn[1, 0])
            rows += [whole[row] for row in loop.rows]
        c = in_doubles(ca.vertcat(*rows))
        C = ca.jacobian(c, symbol)
        hessian, _ = ca.hessian(ca.dot(weights, c), symbol)
        moving = ca.jacobian(C @ rates, symbol) @ rates
        function = ca.Function("c", [symbol, weights, rates], [C, hessian, moving])

        def derivatives(*values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            C, hessian, moving = (np.asarray(each) for each in function(*values))
            return C, hessian, moving[:, 0]

        return _Projection(chain, q, derivatives)

    def solved(self, k: int) -> tuple[FloatArray, FloatArray, list[int]]:
        """Return C_p, G over the velocity coordinates, and the passive entries of q."""
        chain, base = self.chain, self.chain.base_joints
        zeros = np.zeros(sum(len(loop.rows) for loop in chain.loops)), np.zeros(len(chain.coordinates))
        C, _, _ = self.derivatives(self.q[k], *zeros)
        passive = [i for i in range(len(chain.coordinates)) if i not in chain.actuated]
        G = np.zeros((chain.dof, len(chain.motors)))
        G[list(chain.motors), range(len(chain.motors))] = 1
        right = C[:, list(chain.actuated)]
        G[np.ix_([base + i for i in passive], range(base, len(chain.motors)))] = -np.linalg.solve(C[:, passive], right)
        return C[:, passive], G, passive

    def reduced(self, gradient: FloatArray, hessian: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return dU/da and d2U/da2 (without a Hessian: zeros) from gradients and Hessians of the tree."""
        base, firsts, seconds = self.chain.base_joints, [], []
        for k, g in enumerate(gradient):
            C_p, G, passive = self.solved(k)
            multipliers = np.linalg.solve(C_p.T, g[base:][passive])
            _, curvature, _ = self.derivatives(self.q[k], multipliers, np.zeros(self.q.shape[1]))
            firsts.append(G.T @ g)
            H = np.zeros((len(g), len(g))) if hessian is None else hessian[k].copy()
            H[base:, base:] -= curvature
            seconds.append(G.T @ H @ G)
        return np.array(firsts), np.array(seconds)

    def rates(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rates and accelerations of the tree at constant rates of the motors."""
        base, rates, accelerations = self.chain.base_joints, [], []
        for k, each in enumerate(velocity):
            C_p, G, passive = self.solved(k)
            rate = G @ each
            _, _, moving = self.derivatives(self.q[k], np.zeros(len(C_p)), rate[base:])
            acceleration = np.zeros(len(rate))
            acceleration[[base + i for i in passive]] = -np.linalg.solve(C_p, moving)
            rates.append(rate)
            accelerations.append(acceleration)
        return np.array(rates), np.array(accelerations)


def check_loops(kernels: Kernels, chain: Chain, count: int, seed: int, options: SpringOptions) -> list[Check]:
    """Compare the functions in motor coordinates with projections of the tree's functions; nothing without loops."""
    if not chain.loops:
        return []
    samples = Samples.draw(chain, count, seed)
    actuated, start = samples.q_of_motors(seed)
    q = np.asarray(kernels["close"](actuated, start), dtype=float)
    closes = np.isfinite(q).all(axis=1)
    residual = np.abs(kernels["motors_residual"](q[closes])).max(initial=0.0)
    moved = np.abs(q[closes][:, chain.actuated] - actuated[closes]).max(initial=0.0)
    checks = [
        Check("close", "share of starts that do not close", 1 - float(closes.mean()), 0.5),
        Check("close", "residual", float(residual), 1e-9),
        Check("close", "motors where asked for", float(moved), 0.0),
    ]
    if not closes.any():
        return checks
    q = q[closes]
    samples = Samples.draw(chain, len(q), seed).at(q)
    return [*checks, *_compared(kernels, chain, samples, options, _Projection.of(chain, q), seed)]


def _compared(
    kernels: Kernels, chain: Chain, samples: Samples, options: SpringOptions, projection: _Projection, seed: int
) -> list[Check]:
    checks = []

    def add(name: str, value: FloatArray, reference: FloatArray) -> None:
        scale = np.abs(reference).max(initial=0.0) or 1.0
        checks.append(Check(name, "projection of the tree", float(np.abs(value - reference).max() / scale), _BOUND))

    def add_both(at: str, group: str, given: tuple[FloatArray, ...]) -> None:
        """Compare torque and stiffness of a group of the tree with its counterparts of the motors."""
        torque, hessian = (kernels[f"{at}{group}_{result}"](*given) for result in ("torque", "joint_stiffness"))
        first, second = projection.reduced(-torque, hessian)
        for name, reference in (("torque", -first), ("joint_stiffness", second)):
            function = f"{at}motors_{group}_{name}"
            add(function, kernels[function](*given), reference)

    q = samples.q
    add("motors_jacobian", kernels["motors_jacobian"](q), np.array([projection.solved(k)[1] for k in range(len(q))]))
    where, wrench, task = tuple(samples[name] for name in samples.configuration), samples.wrench, samples.task_stiffness
    for tip in chain.tips:
        at = f"{tip.name}_" if len(chain.tips) > 1 else ""
        J, Kq = kernels[f"{at}hybrid_jacobian"](*where), kernels[f"{at}hybrid_joint_stiffness"](*where, wrench, task)
        first, second = projection.reduced(np.einsum("skj,sk->sj", J, wrench), Kq)
        add(f"{at}motors_torque", kernels[f"{at}motors_torque"](*where, wrench), -first)
        add(f"{at}motors_joint_stiffness", kernels[f"{at}motors_joint_stiffness"](*where, wrench, task), second)
        for spring in options.springs():
            parameters = (samples.of(each, seed + k) for k, each in enumerate(spring.parameters))
            add_both(at, spring.name, (*where, *parameters))
    for group, given in joint_potential_arguments(samples).items():
        add_both("", group, given)
    if chain.masses:
        _add_dynamics(kernels, chain, samples, projection, add)
    return checks


def _add_dynamics(
    kernels: Kernels,
    chain: Chain,
    samples: Samples,
    projection: _Projection,
    add: Callable[[str, FloatArray, FloatArray], None],
) -> None:
    q, gravity = samples.q, samples.gravity
    where = (samples.base_pose, q) if chain.floating else (q,)
    first, second = projection.reduced(
        kernels["gravity_gradient"](*where, gravity), kernels["gravity_joint_stiffness"](*where, gravity)
    )
    add("motors_gravity_gradient", kernels["motors_gravity_gradient"](*where, gravity), first)
    add("motors_gravity_joint_stiffness", kernels["motors_gravity_joint_stiffness"](*where, gravity), second)
    M, G = kernels["mass_matrix"](q), np.array([projection.solved(k)[1] for k in range(len(q))])
    add("motors_mass_matrix", kernels["motors_mass_matrix"](q), np.swapaxes(G, 1, 2) @ M @ G)
    velocity = samples.velocity[:, list(chain.motors)]
    rates, accelerations = projection.rates(velocity)
    forces = np.einsum("sij,sj->si", M, accelerations) + kernels["bias_forces"](*where, rates, gravity)
    value = kernels["motors_bias_forces"](*where, velocity, gravity)
    add("motors_bias_forces", value, np.einsum("sij,si->sj", G, forces))
