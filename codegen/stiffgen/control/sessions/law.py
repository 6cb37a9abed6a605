# SPDX-License-Identifier: MIT
"""Compute the terms of the controller's law anew from the equations, for comparison.

The energy of the springs uses the angle of the error rotation and is differentiated with respect to q along the tips'
poses; the controller has closed forms of gradient and tangent. Damping comes from a bisection of the damping ratio's
definition instead of its solved form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.placement import Placement

Poses = Callable[[FloatArray], Any]
"""Poses of the tips at q, (4, 4) or (tips, 4, 4)."""
Energies = Any
"""Energy [J]: one number, or one per element of a stack of poses."""
Pairs = Sequence[tuple[int, int]]
"""Tips of each pair, by number."""

DEFAULT = Placement()
PERIOD = 1e-3
"""Sample time [s] of all comparisons."""
_STEP = 1e-3
"""Step [m or rad] of the differences, which are of fourth order."""
_AHEAD, TREND_TIME, _SLOW = 0.09, 0.01, 0.02
"""Friction: time [s] that a braking reference is looked ahead, time constant [s] of the trend, and speed [rad/s] from
which on friction has its full size."""
_LARGEST_DAMPING, _DELAYED_DAMPING = 0.25, 0.75
"""Largest eigenvalue of M^-1 B T, and that times 1 + delay."""
_LARGEST_STIFFNESS, _LEAST_RATIO = 0.0625, 0.25
"""Largest eigenvalue of M^-1 K T^2 (1 + 2 delay), and damping ratio that the largest damping leaves there."""
_JOINT_DAMPING = 0.1
"""Damping of each joint [N m s/rad], whatever the springs."""
_ZONE = 0.1
"""Width of a limit zone [rad or m], and as a share of a short range."""


class SpringArguments(NamedTuple):
    """Arguments of :func:`potential` after q, in its order: the springs, and where they rest.

    Attributes:
        equilibrium: poses of the tips at which their springs rest.
        posture: joint positions at which the posture spring rests (n) [rad or m].
        Kt, Ko: translational [N/m] and rotational [N m/rad] stiffnesses in the order of :func:`energy_of_all`.
        k: stiffness of the posture spring, one number or (n) [N m/rad].
        placement: axes and centre of the tips' springs.
        pairs: tips of each pair with springs.

    """

    equilibrium: Any
    posture: Any
    Kt: Any
    Ko: Any
    k: Any
    placement: Placement = DEFAULT
    pairs: Pairs = ()


def energy(pose: Any, equilibrium: Any, Kt: Any, Ko: Any, placement: Placement = DEFAULT) -> Energies:
    """Return U = e^T Kt e / 2 + (1 - cos a) u^T Ko u [J] of one tip, at a pose (4, 4) or a stack of them (..., 4, 4).

    e is the displacement of the centre of stiffness, u and a are the axis and angle of R0^T R; e and u are seen in the
    placement's axes.
    """
    centre = np.array(placement.centre)
    turn, turn_at_rest = pose[..., :3, :3], equilibrium[:3, :3]
    axes = {"base": np.eye(3), "tip": turn, "equilibrium": turn_at_rest}
    e = (pose[..., :3, 3] + turn @ centre) - (equilibrium[:3, 3] + turn_at_rest @ centre)
    e = _seen_in(axes[placement.translation_axes or "base"], e)
    R = turn_at_rest.T @ turn
    # w = u sin a, first in the equilibrium's axes: R - R^T = 2 sin a [u]
    w = np.stack([R[..., i, j] - R[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1) / 2
    w = _seen_in(axes[placement.rotation_axes], w @ turn_at_rest.T)
    cosine = (np.trace(R, axis1=-2, axis2=-1) - 1) / 2
    # (1 - cos a) u^T Ko u = w^T Ko w / (1 + cos a), as sin^2 a = (1 - cos a) (1 + cos a): no division by a small sine
    return _square(e, Kt) / 2 + _square(w, Ko) / (1 + cosine)


def _seen_in(axes: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return A^T v of axes A (..., 3, 3) and vectors v (..., 3)."""
    return np.asarray((vectors[..., None, :] @ axes)[..., 0, :])


def _square(vectors: FloatArray, K: FloatArray) -> Energies:
    """Return v^T K v of vectors v (..., 3)."""
    return ((vectors @ K) * vectors).sum(axis=-1)


def pair_energy(a: Any, b: Any, rests: tuple[Any, Any], Kt: Any, Ko: Any) -> Energies:
    """Return the energy [J] of the spring between tips at poses a and b, at rest at ``rests``.

    Its centre is half-way between the tips, its stiffness half in the axes of each: the displacement there is
    pb - pa - (A + B) d0/2, with the pose (E0, d0) of B in A at rest, A = Ra and B = Rb E0^T.
    """
    rest = np.linalg.inv(rests[0]) @ rests[1]
    A, B = a[..., :3, :3], b[..., :3, :3] @ rest[:3, :3].T
    e = b[..., :3, 3] - a[..., :3, 3] - (A + B) @ rest[:3, 3] / 2  # displacement at the centre [m]
    turned = np.zeros_like(a)  # the rotational part is that of a single spring between A and B
    turned[..., :3, :3] = np.swapaxes(A, -2, -1) @ B
    translation = sum(_square(_seen_in(R, e), Kt) for R in (A, B)) / 4
    return translation + energy(turned, np.eye(4), np.zeros((3, 3)), Ko)


def absolute_energy(a: Any, b: Any, rests: tuple[Any, Any], Kt: Any, Ko: Any) -> Energies:
    """Return the energy [J] of the absolute spring of tips at poses a and b: the middle, and half on each rotation."""
    e = (a[..., :3, 3] + b[..., :3, 3] - rests[0][:3, 3] - rests[1][:3, 3]) / 2  # displacement of the middle [m]
    turn_at_rest = (np.linalg.inv(rests[0]) @ rests[1])[:3, :3]  # of B in A
    b_as_a = np.array(b, dtype=float)  # B's turn as one of A: the identity from A where B is turned as at rest
    b_as_a[..., :3, :3] = b[..., :3, :3] @ turn_at_rest.T
    no_translation = np.zeros((3, 3))
    halves = (energy(pose, rests[0], no_translation, Ko) / 2 for pose in (a, b_as_a))
    return _square(e, Kt) / 2 + sum(halves)


def energy_of_all(
    poses: Any, equilibria: Any, Kt: Any, Ko: Any, placement: Placement = DEFAULT, pairs: Pairs = ()
) -> Energies:
    """Return the energy [J] of all springs.

    Args:
        poses: poses of the tips, (4, 4) or (..., tips, 4, 4).
        equilibria: poses at which the springs rest, (4, 4) or (tips, 4, 4).
        Kt: translational stiffnesses [N/m], (3, 3) or (tips + 2 pairs, 3, 3): those of the tips, then those of the
            pairs, then those of the pairs' absolute springs. This is the controller's order.
        Ko: rotational stiffnesses [N m/rad] in this order.
        placement: axes and centre of the tips' springs.
        pairs: tips of each pair with springs.

    """
    rest = np.reshape(equilibria, (-1, 4, 4))
    at = np.moveaxis(np.reshape(poses, (*np.shape(poses)[:-3], -1, 4, 4)), -3, 0)  # (tips, ..., 4, 4)
    stiffness = list(zip(np.reshape(Kt, (-1, 3, 3)), np.reshape(Ko, (-1, 3, 3)), strict=True))
    absolute = len(at) + len(pairs)  # number of the first absolute spring
    of_tips, of_pairs = stiffness[: len(at)], stiffness[len(at) : absolute]
    of_absolute = stiffness[absolute : absolute + len(pairs)]
    tips = zip(at, rest, of_tips, strict=True)
    whole = sum((energy(pose, equilibrium, *K, placement) for pose, equilibrium, K in tips), 0.0)
    for (i, j), K, K_absolute in zip(pairs, of_pairs, of_absolute, strict=True):
        rests = rest[i], rest[j]
        whole += pair_energy(at[i], at[j], rests, *K)
        whole += absolute_energy(at[i], at[j], rests, *K_absolute)
    return whole


def wrench(energy_at: Callable[[FloatArray], float], pose: Any) -> FloatArray:
    """Return the gradient [N, N m] of an energy of a tip's pose, hybrid axes, by differences along the unit twists."""
    result = np.empty(6)
    for k in range(6):
        near, far = (energy_at(_moved(pose, k, s * _STEP)) - energy_at(_moved(pose, k, -s * _STEP)) for s in (1, 2))
        result[k] = _slope(near, far)
    return result


def _moved(pose: Any, k: int, step: float) -> FloatArray:
    """Return a pose after a step along hybrid twist k: along base axis k [m], or about base axis k - 3 [rad]."""
    moved = np.array(pose, dtype=float)
    if k < 3:
        moved[k, 3] += step
        return moved
    i, j = [(1, 2), (2, 0), (0, 1)][k - 3]  # the two axes that turn about axis k - 3, the first one towards the second
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(step)
    turn[j, i], turn[i, j] = np.sin(step), -np.sin(step)
    moved[:3, :3] = turn @ moved[:3, :3]
    return moved


def _slope(near: Any, far: Any) -> Any:
    """Return df/dx up to h^4 from near = f(x + h) - f(x - h) and far = f(x + 2h) - f(x - 2h), with h = ``_STEP``."""
    return (8 * near - far) / (12 * _STEP)


def differences(function: Callable[[FloatArray], Any], q: FloatArray) -> FloatArray:
    """Return the derivative of a function with respect to each joint position, (n, *shape of its value)."""
    rows = []
    for step in _STEP * np.eye(len(q)):
        near, far = (np.asarray(function(q + s * step)) - function(q - s * step) for s in (1, 2))
        rows.append(_slope(near, far))
    return np.array(rows)


def wrench_torque(poses: Poses, q: FloatArray, wrenches: Any, pairs: Pairs = ()) -> FloatArray:
    """Return J^T F [N m], (n), by differences of the poses, of wrenches F (tips, then pairs; 6).

    A tip's is in hybrid axes; a pair's acts on B, in the axes of A, and its reaction on A.
    """
    here = np.reshape(poses(q), (-1, 4, 4))
    given = np.reshape(wrenches, (-1, 6))
    on_tips = np.array(given[: len(here)], dtype=float)
    for (a, b), F in zip(pairs, given[len(here) :], strict=True):
        force, moment = here[a, :3, :3] @ F[:3], here[a, :3, :3] @ F[3:]
        lever = here[b, :3, 3] - here[a, :3, 3]  # the force acts at B's origin, its reaction's moment is about A's
        on_tips[b] += np.concatenate([force, moment])
        on_tips[a] -= np.concatenate([force, moment + np.cross(lever, force)])
    return np.asarray((_tip_jacobians(poses, q, here) * on_tips).sum(axis=(1, 2)))


def _tip_jacobians(poses: Poses, q: FloatArray, here: FloatArray) -> FloatArray:
    """Return the transposed hybrid Jacobians (n, tips, 6) by differences, with the poses at q (tips, 4, 4)."""
    slopes = np.reshape(differences(poses, q), (len(q), -1, 4, 4))  # dH/dq_i of each tip
    spins = slopes[..., :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)  # dR/dq_i R^T = [angular velocity per rate]
    angular = np.stack([spins[..., 2, 1], spins[..., 0, 2], spins[..., 1, 0]], axis=-1)
    return np.concatenate([slopes[..., :3, 3], angular], axis=-1)


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
) -> Energies:
    """Return the energy [J] of the springs of tips and pairs and of the posture potential k (q - posture)^2 / 2.

    A stack of positions q (count, n) has as many energies.
    """
    at = poses(q) if np.ndim(q) == 1 else np.array([np.reshape(poses(each), (-1, 4, 4)) for each in q])
    springs = energy_of_all(at, equilibrium, Kt, Ko, placement, pairs)
    return springs + np.sum(k * (q - posture) ** 2, axis=-1) / 2


def elastic_torque(poses: Poses, q: FloatArray, *spring: Any) -> FloatArray:
    """Return -dU/dq [N m], (n), of :func:`potential` by differences; ``spring`` is a :class:`SpringArguments`."""
    return -differences(lambda at: potential(poses, at, *spring), q)


def joint_hessian(poses: Poses, q: FloatArray, *spring: Any) -> FloatArray:
    """Return d2U/dq2 [N m/rad], (n, n), by differences of differences of :func:`potential`.

    Each pair of joints is moved once. ``spring`` is a :class:`SpringArguments`.
    """
    i, j = np.triu_indices(len(q))
    unit, sizes = np.eye(len(q)), _STEP * np.array([-2, -1, 1, 2])
    moved = q + sizes[:, None, None, None] * unit[i] + sizes[:, None, None] * unit[j]  # (4, 4, pairs of joints, n)
    energies = np.reshape(potential(poses, moved.reshape(-1, len(q)), *spring), moved.shape[:-1])
    for _ in range(2):
        twice_back, back, on, twice_on = energies
        energies = _slope(on - back, twice_on - twice_back)
    hessian = np.empty((len(q), len(q)))
    hessian[i, j] = hessian[j, i] = energies
    return hessian


def friction_side(velocity: FloatArray, trend: FloatArray) -> FloatArray:
    """Return the parts (n) of the joints' friction that are fed forward, from -1 to 1.

    They follow the reference's velocity (n) [rad/s], but one that brakes by what is left of it in 0.09 s. ``trend`` is
    that velocity behind a low-pass of 0.01 s.
    """
    # behind a low-pass of time constant t, the velocity lags by t times its slope: slope = (velocity - trend) / t
    later = velocity + _AHEAD / TREND_TIME * (velocity - trend)
    # a velocity that grows counts as it is, one that changes its sign meanwhile as 0
    left = np.clip(later, np.minimum(velocity, 0.0), np.maximum(velocity, 0.0))
    return np.asarray(np.clip(left / _SLOW, -1.0, 1.0))


def coriolis(mass_matrix: Callable[[FloatArray], FloatArray], q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the Coriolis and centrifugal forces [N m], (n), by differences of the mass matrix.

    They are dM/dt dq - d(dq^T M dq / 2)/dq: Lagrange's equations without acceleration and potential.
    """
    slopes = differences(mass_matrix, q)  # [k, i, j]: dM_ij/dq_k
    momentum_rate = np.einsum("kij,j,k->i", slopes, dq, dq)
    energy_gradient = np.einsum("kij,i,j->k", slopes, dq, dq) / 2
    return np.asarray(momentum_rate - energy_gradient)


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
        return min(_LARGEST_DAMPING, _DELAYED_DAMPING / (1 + self.delay)) / PERIOD

    @property
    def most_eigenvalue(self) -> float:
        """Largest eigenvalue l of M^-1 K [1/s^2]: that of the sampled loop, and that which can still be damped.

        With torques late by h, a damping ratio r takes b = 2 r sqrt(l) + h l: here the largest b, with the least r.
        """
        of_loop = _LARGEST_STIFFNESS / (PERIOD**2 * (1 + 2 * self.delay))
        root = (np.sqrt(_LEAST_RATIO**2 + self.late * self.most_damping) - _LEAST_RATIO) / self.late  # sqrt(l)
        return float(min(of_loop, root**2))


def damping_torque(
    K: FloatArray, M: FloatArray, timing: Timing, slip: FloatArray, excess: FloatArray, ratio: float
) -> tuple[FloatArray, float]:
    """Return B slip with the brake (n) [N m], and the scale that the stiffest mode allows.

    B = M V diag(b) V^T M + d 1, with the modes K v = l M v, V^T M V = 1, and a damping b for each.

    Args:
        K: tangent (n, n), symmetric.
        M: mass matrix (n, n).
        timing: sample time and delay.
        slip: velocity of the reference less the arm's (n).
        excess: velocity beyond the share of the velocity limit that the reference uses (n).
        ratio: damping ratio of the modes.

    """
    root = np.linalg.inv(np.linalg.cholesky(M))  # root M root^T = 1
    values, vectors = np.linalg.eigh(root @ K @ root.T)
    V = root.T @ vectors
    cap = min(1.0, timing.most_eigenvalue / max(values.max(), 1e-300))
    mobility = np.diag(np.linalg.inv(M))  # of each joint [1/(kg m^2)]
    # No eigenvalue of M^-1 d is above d times the trace of M^-1: d takes at most half of the largest damping.
    joint = min(_JOINT_DAMPING, 0.5 * timing.most_damping / mobility.sum())
    most = timing.most_damping - joint * mobility.sum()
    b = np.array([min(_mode_damping(value, timing.late, ratio), most) for value in np.abs(values) * cap])
    # The brake uses what the stiffest mode leaves of the largest damping, and the fast joints share it.
    brake = (most - b.max()) / mobility * excess / max(np.count_nonzero(excess), 1)
    return M @ V @ (b * (V.T @ M @ slip)) + joint * slip - brake, cap


def _mode_damping(value: float, late: float, ratio: float) -> float:
    """Return the damping b [1/s] that gives a mode of eigenvalue l = ``value`` [1/s^2] its damping ratio.

    Torques that are late by h = ``late`` [s] take damping and inertia: ratio = (b - l h) / (2 sqrt(l (1 - b h))). The
    right side rises with b, from 0 at l h to infinity at 1 / h: a bisection finds b.
    """
    low, high = value * late, 1 / late
    for _ in range(200):
        b = (low + high) / 2
        is_short = (b - value * late) < 2 * ratio * np.sqrt(value * max(1 - b * late, 0))
        low, high = (b, high) if is_short else (low, b)
    return float(low)


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
        """Return the energy of the zones [J]: k d^2/2 at depth d, and beyond the largest force f: f d - f^2/(2 k).

        The second formula holds for both, with f = k d in the first case.
        """
        depth, force = np.abs(self.depth(q)), np.abs(self.torque(q))
        return float(np.sum(force * (depth - force / (2 * self.stiffness))))


def place_zones(config: Any, M: FloatArray, timing: Timing) -> Zones:
    """Return the limit zones of a configuration; M is the mass matrix (n, n) at the first sample."""
    width = np.minimum(_ZONE, _ZONE * (config.upper_limit - config.lower_limit))
    inertia = 1 / np.abs(np.linalg.inv(M)).sum(axis=1)  # beside any motion of the other joints
    rate, effort = config.torque_rate_limit, config.effort_limit
    bounds = (  # on the stiffness k [N m/rad]
        effort,  # at a depth of 1 rad
        0.5 * timing.most_eigenvalue * inertia,
        rate / config.velocity_limit,  # an arm at its velocity limit changes the torque by k dq per second
        np.cbrt(inertia * (rate / (2 * width)) ** 2),  # a swing of amplitude 2 width: by k 2 width sqrt(k / inertia)
    )
    return Zones(config.lower_limit + width, config.upper_limit - width, np.min(bounds, axis=0), effort)
