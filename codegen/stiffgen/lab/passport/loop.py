# SPDX-License-Identifier: MIT
"""Sampled control loop of springs and modal damping: its rules, and the eigenvalues that say where it is stable.

The damping is that of the impedance controller (docs/controller.md): M V diag(b) V^T M + d I with Kq v = lambda M v and
V^T M V = I. In the coordinates of its modes the loop falls apart into one scalar loop per mode, up to d I.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stiffgen.core.robot.geometry import FloatArray

LARGEST_STIFFNESS, LEAST_RATIO = 0.0625, 0.25
"""Largest eigenvalue of M^-1 Kq T^2 (1 + 2 delay) that the controller renders in full, and the damping ratio that its
largest damping has to leave there."""
LARGEST_DAMPING, DELAYED_DAMPING = 0.25, 0.75
"""Largest eigenvalue of M^-1 B T; from a delay of 2 samples on, the second over 1 + delay."""
DAMPING_RATIO, JOINT_DAMPING, POSTURE_STIFFNESS = 0.7, 0.1, 1.0
"""Damping ratio of each mode (default), d [N m s/rad], posture spring [N m/rad] (default in Python)."""
MOST_DELAY = 5
"""Largest delay of the controller [samples]."""
MOST_STIFFNESS = 5000.0
"""Largest entry of a commanded translation stiffness [N/m]; the controller refuses more."""


@dataclass(frozen=True)
class LoopTiming:
    """Rate of the loop [Hz], delay of its torques [samples], and encoder step [rad or m].

    Without an encoder step the velocity is measured; with one the caller passes the difference of two positions.
    """

    rate: float = 1000.0
    delay: int = 0
    quantum: float = 0.0

    @property
    def period(self) -> float:
        """Sample time T [s]."""
        return 1.0 / self.rate

    @property
    def late(self) -> float:
        """Mean age of the torque in force [s]: the delay, and half a sample for which it is held."""
        return (self.delay + 0.5) * self.period

    @property
    def text(self) -> str:
        """The loop in words."""
        sensor = f"encoder steps of {self.quantum:g}" if self.quantum > 0 else "measured velocity"
        samples = "1 sample" if self.delay == 1 else f"{self.delay} samples"
        return f"{self.rate:g} Hz, a delay of {samples} and {sensor}"


@dataclass(frozen=True)
class Arms:
    """Postures of an arm: mass matrices with rotors (P, n, n), and hybrid Jacobians (P, 6, n).

    The spring's stiffness is k in each direction, and ``rotation`` k about each axis [m^2].
    """

    mass: FloatArray
    jacobian: FloatArray
    rotation: float

    def springs(self, stiffness: FloatArray) -> FloatArray:
        """Return the tangents Kq (P, n, n) [N m/rad] of springs of translational stiffnesses (P) [N/m]."""
        weights = np.array([1.0] * 3 + [self.rotation] * 3)
        of_tip = np.einsum("pki,k,pkj->pij", self.jacobian, weights, self.jacobian)
        return np.asarray(stiffness[:, None, None] * of_tip + POSTURE_STIFFNESS * np.eye(of_tip.shape[-1]))


@dataclass(frozen=True)
class Modes:
    """Modes of springs under their damping.

    Attributes:
        stiffness: eigenvalues lambda of M^-1 Kq (P, n), ascending [1/s^2].
        damping: damping of each mode with the joint damping's share (P, n) [1/s].
        matrix: damping matrix B (P, n, n) [N m s/rad].
        tip: part of the eigenvalues by the tip's spring, the rest by the posture spring (P, n) [1/s^2].

    """

    stiffness: FloatArray
    damping: FloatArray
    matrix: FloatArray
    tip: FloatArray


def find_modes(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> Modes:
    """Design the damping of springs by the controller's rules, and return the modes.

    Args:
        arms: P postures.
        stiffness: translational stiffnesses (P) [N/m].
        timing: of the loop.

    """
    L = np.linalg.cholesky(arms.mass)
    half = np.linalg.solve(L, arms.springs(stiffness))
    values, vectors = np.linalg.eigh(np.linalg.solve(L, np.swapaxes(half, 1, 2)))
    V = np.linalg.solve(np.swapaxes(L, 1, 2), vectors)
    squares = (V**2).sum(axis=1)  # of each mode: joint_damping I counts with them
    rows = L @ vectors  # M V
    most = _largest_damping(timing)
    d = np.minimum(JOINT_DAMPING, 0.5 * most / squares.sum(axis=1))
    b = np.minimum(_of_ratio(values, timing), (most - d * squares.sum(axis=1))[:, None])
    B = np.einsum("pik,pk,pjk->pij", rows, b, rows) + d[:, None, None] * np.eye(arms.mass.shape[-1])
    return Modes(values, b + d[:, None] * squares, B, values - POSTURE_STIFFNESS * squares)


def _largest_damping(timing: LoopTiming) -> float:
    """Return the largest eigenvalue of M^-1 B [1/s]."""
    return min(LARGEST_DAMPING, DELAYED_DAMPING / (1 + timing.delay)) / timing.period


def _of_ratio(values: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the damping that gives each mode its ratio, with torques that are late; no less than lambda late."""
    size, h, zeta = np.abs(values), timing.late, DAMPING_RATIO
    p = size * h * (2 * zeta**2 - 1)
    root = np.sqrt(np.maximum(p * p + 4 * zeta**2 * size - (size * h) ** 2, 0.0))
    return np.maximum(root - p, size * h)


def characteristic(
    stiffness: FloatArray, damping: FloatArray, timing: LoopTiming, environment: FloatArray
) -> FloatArray:
    """Return the characteristic polynomials of scalar loops, highest power first (..., degree + 1).

    A unit mass on an environment's spring w^2 has x(z) = (1 - cos wT)/w^2 (z + 1)/D(z) u(z) and v(z) = sin wT/w
    (z - 1)/D(z) u(z), with D = z^2 - 2 z cos wT + 1; the torque is u = -z^-delay (lambda x + b v). With an encoder step
    the velocity is (x_k - x_k-1)/T.

    Args:
        stiffness: lambda (...) [1/s^2].
        damping: b (...) [1/s].
        timing: of the loop.
        environment: w^2 (...) [1/s^2], not negative.

    """
    T, order = timing.period, int(timing.quantum > 0)  # samples that the velocity looks back
    w = np.sqrt(environment)
    to_position = 0.5 * (T * np.sinc(w * T / (2 * np.pi))) ** 2  # (1 - cos wT)/w^2
    to_velocity = T * np.sinc(w * T / np.pi)
    ones = np.ones_like(w)
    result = np.zeros((*w.shape, 3 + timing.delay + order))
    result[..., :3] = np.stack([ones, -2.0 * np.cos(w * T), ones], axis=-1)
    result[..., -order - 2 : len(result.T) - order] += np.multiply.outer(stiffness * to_position, [1.0, 1.0])
    if order:
        result[..., -3:] += np.multiply.outer(damping * to_position, [1.0 / T, 0.0, -1.0 / T])
    else:
        result[..., -2:] += np.multiply.outer(damping * to_velocity, [1.0, -1.0])
    return result


def slowest_roots(modes: Modes, timing: LoopTiming, environment: FloatArray | None = None) -> np.ndarray:
    """Return the root of largest magnitude of each mode's loop (P, n), complex; environment: w^2 of each mode."""
    held = np.zeros_like(modes.stiffness) if environment is None else environment
    polynomial = characteristic(modes.stiffness, modes.damping, timing, held)
    degree = polynomial.shape[-1] - 1
    companion = np.zeros((*polynomial.shape[:-1], degree, degree))
    companion[..., 0, :] = -polynomial[..., 1:] / polynomial[..., :1]
    companion[..., range(1, degree), range(degree - 1)] = 1.0
    roots = np.linalg.eigvals(companion)
    return np.asarray(np.take_along_axis(roots, np.abs(roots).argmax(axis=-1)[..., None], -1)[..., 0])


def damping_attained(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the least damping ratio of all modes (P), from the loop's roots; negative where it is unstable."""
    z = slowest_roots(find_modes(arms, stiffness, timing), timing)
    exponent = np.log(z)
    return np.asarray((-exponent.real / np.abs(exponent)).min(axis=1))


def step_torque(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the largest torque (P) [N m or N] by which one encoder step of every joint moves the damping torque."""
    B = find_modes(arms, stiffness, timing).matrix
    return np.asarray(np.abs(B).sum(axis=2).max(axis=1) * timing.quantum / timing.period)


def rendered_limit(arms: Arms, timing: LoopTiming) -> FloatArray:
    """Return the stiffnesses (P) [N/m] up to which the controller renders a spring in full, and accepts it.

    The largest eigenvalue lambda of M^-1 Kq must stay below two bounds [1/s^2]: that of the sampled loop, and that of
    damping. With torques late by ``timing.late`` [s], a damping ratio r takes b = 2 r sqrt(lambda) + late lambda [1/s].
    """
    stable = LARGEST_STIFFNESS / (timing.period**2 * (1 + 2 * timing.delay))
    b = _largest_damping(timing)
    # lambda from that quadratic in sqrt(lambda), with the largest b and the least ratio.
    damped = ((np.sqrt(LEAST_RATIO**2 + timing.late * b) - LEAST_RATIO) / timing.late) ** 2

    def is_rendered(stiffness: FloatArray) -> np.ndarray:
        return np.asarray(find_modes(arms, stiffness, timing).stiffness[:, -1] <= min(stable, damped))

    return np.minimum(largest(is_rendered, len(arms.mass)), MOST_STIFFNESS)


def passive_limit(arms: Arms, timing: LoopTiming) -> FloatArray:
    """Return the stiffnesses (P) [N/m] up to which late torques put out no work in slow motion: b >= lambda h."""

    def is_passive(stiffness: FloatArray) -> np.ndarray:
        modes = find_modes(arms, stiffness, timing)
        return np.asarray((modes.damping >= modes.stiffness * timing.late).all(axis=1))

    return largest(is_passive, len(arms.mass))


def stable_limit(arms: Arms, timing: LoopTiming) -> FloatArray:
    """Return the stiffnesses (P) [N/m] up to which every root of the sampled loop is inside the unit circle."""
    return largest(
        lambda k: np.asarray((np.abs(slowest_roots(find_modes(arms, k, timing), timing)) < 1).all(axis=1)),
        len(arms.mass),
    )


def contact_limit(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the stiffest environments (P) [N/m] that may hold the tip while the loop renders a stiffness (P).

    The environment is a spring without damping, in the proportions of the tip's own one, so that the modes stay. Every
    softer one leaves the loop stable, too.
    """
    modes = find_modes(arms, stiffness, timing)
    per_newton = np.maximum(modes.tip, 0.0) / stiffness[:, None]

    def is_stable(environment: FloatArray) -> np.ndarray:
        roots = slowest_roots(modes, timing, per_newton * environment[:, None])
        return np.asarray((np.abs(roots) < 1).all(axis=1))

    return largest(is_stable, len(arms.mass))


def largest(holds: Callable[[FloatArray], np.ndarray], count: int) -> FloatArray:
    """Return the last of ascending stiffnesses (P) before a condition first fails; 0 where none holds.

    Args:
        holds: returns for stiffnesses (P) whether the condition holds in each posture.
        count: number of postures.

    """
    ladder = np.geomspace(1.0, 1e8, 41)  # ratio 1.58
    low, high, climbing = np.zeros(count), np.full(count, ladder[0]), np.ones(count, dtype=bool)
    for stiffness in ladder:
        passed = holds(np.full(count, stiffness)) & climbing
        low[passed] = stiffness
        high = np.where(climbing, stiffness, high)
        climbing = passed
        if not climbing.any():
            break
    for _ in range(11):
        middle = np.where(low > 0, np.sqrt(np.maximum(low, 1e-9) * high), 0.5 * high)
        passed = holds(middle)
        low, high = np.where(passed, middle, low), np.where(passed, high, middle)
    return np.asarray(low)
