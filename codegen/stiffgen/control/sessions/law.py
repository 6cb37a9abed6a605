# SPDX-License-Identifier: MIT
"""Compute the terms of the controller's law anew from the equations, for comparison.

The energy of the springs uses the angle of the error rotation and is differentiated with respect to q along the tips'
poses; the controller has closed forms of gradient and tangent. Damping comes from a bisection of the damping ratio's
definition instead of its solved form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.placement import Placement

Poses = Callable[[FloatArray], Any]
"""Poses of the tips at q, (4, 4) or (tips, 4, 4)."""
Pairs = Sequence[tuple[int, int]]
"""Tips of each pair, by number."""

DEFAULT = Placement()
PERIOD = 1e-3
"""Sample time [s] of all comparisons."""


def energy(pose: Any, equilibrium: Any, Kt: Any, Ko: Any, placement: Placement = DEFAULT) -> float:
    """Return U = e^T Kt e / 2 + (1 - cos a) u^T Ko u [J] of one tip.

    e is the displacement of the centre of stiffness, u and a are the axis and angle of R0^T R; e and u are seen in the
    placement's axes.
    """
    centre = np.array(placement.centre)
    axes = {"base": np.eye(3), "tip": pose[:3, :3], "equilibrium": equilibrium[:3, :3]}
    e = (pose[:3, 3] + pose[:3, :3] @ centre) - (equilibrium[:3, 3] + equilibrium[:3, :3] @ centre)
    e = axes[placement.translation_axes or "base"].T @ e
    R = equilibrium[:3, :3].T @ pose[:3, :3]
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    w = axes[placement.rotation_axes].T @ equilibrium[:3, :3] @ w
    cosine = (np.trace(R) - 1) / 2
    # (1 - cos a) u^T Ko u = w^T Ko w / (1 + cos a), without dividing by a small sine
    return float(e @ Kt @ e / 2 + w @ Ko @ w / (1 + cosine))


def pair_energy(a: Any, b: Any, rests: tuple[Any, Any], Kt: Any, Ko: Any) -> float:
    """Return the energy [J] of the spring between tips at poses a and b, at rest at ``rests``.

    Its centre is half-way between the tips, its stiffness half in the axes of each: the displacement there is
    pb - pa - (A + B) d0/2, with the pose (E0, d0) of B in A at rest, A = Ra and B = Rb E0^T.
    """
    rest = np.linalg.inv(rests[0]) @ rests[1]
    A, B = a[:3, :3], b[:3, :3] @ rest[:3, :3].T
    e = b[:3, 3] - a[:3, 3] - (A + B) @ rest[:3, 3] / 2  # displacement at the centre [m]
    turned, fixed = np.eye(4), np.eye(4)  # the rotational part is that of a single spring between A and B
    turned[:3, :3] = A.T @ B
    translation = sum((R.T @ e) @ Kt @ (R.T @ e) for R in (A, B)) / 4
    return float(translation) + energy(turned, fixed, np.zeros((3, 3)), Ko)


def absolute_energy(a: Any, b: Any, rests: tuple[Any, Any], Kt: Any, Ko: Any) -> float:
    """Return the energy [J] of the absolute spring of tips at poses a and b: the middle, and half on each rotation."""
    e = (a[:3, 3] + b[:3, 3] - rests[0][:3, 3] - rests[1][:3, 3]) / 2
    rest = np.linalg.inv(rests[0]) @ rests[1]
    seen = np.array(b, dtype=float)
    seen[:3, :3] = b[:3, :3] @ rest[:3, :3].T
    none = np.zeros((3, 3))
    halves = (energy(pose, rests[0], none, Ko) / 2 for pose in (a, seen))
    return float(e @ Kt @ e / 2) + sum(halves)


def energy_of_all(
    poses: Any, equilibria: Any, Kt: Any, Ko: Any, placement: Placement = DEFAULT, pairs: Pairs = ()
) -> float:
    """Return the energy [J] of all springs: poses, equilibria (tips, 4, 4), stiffnesses in the controller's order."""
    tips = np.reshape(poses, (-1, 4, 4)), np.reshape(equilibria, (-1, 4, 4))
    stiffness = list(zip(np.reshape(Kt, (-1, 3, 3)), np.reshape(Ko, (-1, 3, 3)), strict=True))
    count = len(tips[0])
    of_tips = zip(*tips, stiffness[:count], strict=True)
    whole = sum((energy(pose, rest, *K, placement) for pose, rest, K in of_tips), 0.0)
    for k, (i, j) in enumerate(pairs):
        rests = tips[1][i], tips[1][j]
        whole += pair_energy(tips[0][i], tips[0][j], rests, *stiffness[count + k])
        whole += absolute_energy(tips[0][i], tips[0][j], rests, *stiffness[count + len(pairs) + k])
    return whole


def wrench(energy_at: Callable[[FloatArray], float], pose: Any) -> FloatArray:
    """Return the gradient [N, N m] of an energy of a tip's pose, hybrid axes, by differences along the unit twists."""
    h, result = 1e-3, np.empty(6)
    for k in range(6):
        values = []
        for step in (h, -h, 2 * h, -2 * h):
            moved = np.array(pose, dtype=float)
            if k < 3:
                moved[k, 3] += step
            else:
                i, j = [(1, 2), (2, 0), (0, 1)][k - 3]  # axes that turn about axis k - 3
                turn = np.eye(3)
                turn[i, i] = turn[j, j] = np.cos(step)
                turn[j, i], turn[i, j] = np.sin(step), -np.sin(step)
                moved[:3, :3] = turn @ moved[:3, :3]
            values.append(energy_at(moved))
        result[k] = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h)
    return result


def differences(function: Callable[[FloatArray], Any], q: FloatArray) -> FloatArray:
    """Return the derivative of a function with respect to each joint position, (n, *shape of its value)."""
    h, rows = 1e-3, []
    for step in h * np.eye(len(q)):
        near, far = (np.asarray(function(q + s * step)) - function(q - s * step) for s in (1, 2))
        rows.append((8 * near - far) / (12 * h))
    return np.array(rows)


def wrench_torque(poses: Poses, q: FloatArray, wrenches: Any, pairs: Pairs = ()) -> FloatArray:
    """Return J^T F [N m], (n), by differences of the poses, of wrenches F (tips, then pairs; 6).

    A tip's is in hybrid axes; a pair's acts on B, in the axes of A, and its reaction on A.
    """
    here = np.reshape(poses(q), (-1, 4, 4))
    slopes = np.reshape(differences(poses, q), (len(q), -1, 4, 4))  # dH/dq_i of each tip
    turns = slopes[..., :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)
    spins = np.stack([turns[..., 2, 1], turns[..., 0, 2], turns[..., 1, 0]], axis=-1)
    twists = np.concatenate([slopes[..., :3, 3], spins], axis=-1)  # hybrid Jacobians, (n, tips, 6)
    given = np.reshape(wrenches, (-1, 6))
    tips = np.array(given[: len(here)], dtype=float)
    for (i, j), F in zip(pairs, given[len(here) :], strict=True):
        f, m = here[i, :3, :3] @ F[:3], here[i, :3, :3] @ F[3:]
        tips[j] += np.concatenate([f, m])
        tips[i] -= np.concatenate([f, m + np.cross(here[j, :3, 3] - here[i, :3, 3], f)])
    return np.asarray((twists * tips).sum(axis=(1, 2)))


def potential(
    poses: Poses,
    q: FloatArray,
    equilibrium: Any,
    posture: Any,
    Kt: Any,
    Ko: Any,
    k: Any,
    placement: Placement = DEFAULT,
    pairs: Pairs = (),
) -> float:
    """Return the energy [J] of the springs of tips and pairs and of the posture potential k (q - posture)^2 / 2."""
    springs = energy_of_all(poses(q), equilibrium, Kt, Ko, placement, pairs)
    return springs + float(np.sum(k * (q - posture) ** 2) / 2)


def elastic_torque(poses: Poses, q: FloatArray, *spring: Any) -> FloatArray:
    """Return -dU/dq [N m], (n), of :func:`potential` by differences; ``spring`` are its arguments after q."""
    return -differences(lambda at: potential(poses, at, *spring), q)


def joint_hessian(poses: Poses, q: FloatArray, *spring: Any) -> FloatArray:
    """Return d2U/dq2 [N m/rad], (n, n), by differences of the torque."""
    return -differences(lambda at: elastic_torque(poses, at, *spring), q).T


def friction_side(velocity: FloatArray, trend: FloatArray) -> FloatArray:
    """Return the parts (n) of the joints' friction that are fed forward, from -1 to 1.

    They follow the reference's velocity (n) [rad/s], but one that brakes by what is left of it in 0.09 s. ``trend`` is
    that velocity behind a low-pass of 0.01 s.
    """
    later = velocity + 9.0 * (velocity - trend)
    left = np.clip(later, np.minimum(velocity, 0.0), np.maximum(velocity, 0.0))
    return np.asarray(np.clip(left / 0.02, -1.0, 1.0))


def coriolis(mass_matrix: Callable[[FloatArray], FloatArray], q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the Coriolis and centrifugal forces [N m], (n), by differences of the mass matrix."""
    slopes = differences(mass_matrix, q)  # dM/dq_k in row k
    return np.asarray(np.einsum("kij,j,k->i", slopes, dq, dq) - np.einsum("kij,i,j->k", slopes, dq, dq) / 2)


@dataclass(frozen=True)
class Timing:
    """Sample time [s] and delay [samples], and what they allow."""

    delay: int

    @property
    def late(self) -> float:
        """Time [s] by which a torque is late, on average."""
        return (self.delay + 0.5) * PERIOD

    @property
    def most_damping(self) -> float:
        """Largest eigenvalue of M^-1 B [1/s]."""
        return min(0.25, 0.75 / (1 + self.delay)) / PERIOD

    @property
    def most_eigenvalue(self) -> float:
        """Largest eigenvalue of M^-1 K [1/s^2] beside it."""
        root = (np.sqrt(0.0625 + self.late * self.most_damping) - 0.25) / self.late
        return float(min(0.0625 / (PERIOD**2 * (1 + 2 * self.delay)), root**2))


def damping_torque(
    K: FloatArray, M: FloatArray, timing: Timing, slip: FloatArray, excess: FloatArray, ratio: float
) -> tuple[FloatArray, float]:
    """Return B slip with the brake (n) [N m], and the scale that the stiffest mode allows.

    Args:
        K: tangent (n, n), symmetric.
        M: mass matrix (n, n).
        timing: sample time and delay.
        slip: velocity of the reference less the arm's (n).
        excess: velocity beyond the share of the velocity limit that the reference uses (n).
        ratio: damping ratio of the modes.

    """
    root = np.linalg.inv(np.linalg.cholesky(M))
    values, vectors = np.linalg.eigh(root @ K @ root.T)
    V = root.T @ vectors  # V^T M V = I
    cap = min(1.0, timing.most_eigenvalue / max(values.max(), 1e-300))
    softness = np.diag(np.linalg.inv(M))
    joint = min(0.1, 0.5 * timing.most_damping / softness.sum())
    most = timing.most_damping - joint * softness.sum()  # no eigenvalue of M^-1 d is above d times the trace of M^-1
    b = np.empty(len(values))
    for k, value in enumerate(np.abs(values) * cap):
        # zeta = (b - l h) / (2 sqrt(l (1 - b h))) with l: value, h: late, zeta: ratio, solved for b by bisection
        low, high = value * timing.late, 1 / timing.late
        for _ in range(200):
            middle = (low + high) / 2
            short = (middle - value * timing.late) < 2 * ratio * np.sqrt(value * max(1 - middle * timing.late, 0))
            low, high = (middle, high) if short else (low, middle)
        b[k] = min(low, most)
    brake = (most - b.max()) / softness * excess / max(np.count_nonzero(excess), 1)  # the fast joints share it
    return M @ V @ (b * (V.T @ M @ slip)) + joint * slip - brake, cap


@dataclass(frozen=True)
class Zones:
    """Limit zones: edges (n) [rad or m], stiffness (n) [N m/rad], and largest torque [N m]."""

    lower: FloatArray
    upper: FloatArray
    stiffness: FloatArray
    effort: FloatArray

    def depth(self, q: FloatArray) -> FloatArray:
        """Return how deep each joint is in its zone; negative in the lower one."""
        return np.asarray(q - np.clip(q, self.lower, self.upper))

    def torque(self, q: FloatArray) -> FloatArray:
        """Return the torque of the zones (n) [N m]."""
        return np.asarray(-np.clip(self.stiffness * self.depth(q), -self.effort, self.effort))

    def energy(self, q: FloatArray) -> float:
        """Return the energy of the zones [J]."""
        depth, force = np.abs(self.depth(q)), np.abs(self.torque(q))
        return float(np.sum(force * (depth - force / (2 * self.stiffness))))


def place_zones(config: Any, M: FloatArray, timing: Timing) -> Zones:
    """Return the limit zones of a configuration; M is the mass matrix (n, n) at the first sample."""
    span = config.upper_limit - config.lower_limit
    width = np.minimum(0.1, 0.1 * span)
    inertia = 1 / np.abs(np.linalg.inv(M)).sum(axis=1)  # beside any motion of the other joints
    rate, effort = config.torque_rate_limit, config.effort_limit
    bounds = (
        effort,
        0.5 * timing.most_eigenvalue * inertia,
        rate / config.velocity_limit,
        np.cbrt(inertia * (rate / (2 * width)) ** 2),
    )
    return Zones(config.lower_limit + width, config.upper_limit - width, np.min(bounds, axis=0), effort)
