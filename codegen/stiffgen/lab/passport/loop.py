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
_LADDER = np.geomspace(1.0, 1e8, 41)
"""Stiffnesses [N/m] among which a limit is looked for, each 1.58 times the one before."""
_HALVINGS = 11
"""Halvings of the interval between two of them, which leave 0.02 % of the stiffness."""


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
        """Return the tangents Kq (P, n, n) [N m/rad] of springs of translational stiffnesses (P) [N/m].

        Kq = k J^T diag(1, 1, 1, r, r, r) J + ``POSTURE_STIFFNESS`` 1, with r = ``rotation``.
        """
        weights = np.array([1.0] * 3 + [self.rotation] * 3)
        per_stiffness = np.einsum("pki,k,pkj->pij", self.jacobian, weights, self.jacobian)
        posture_spring = POSTURE_STIFFNESS * np.eye(per_stiffness.shape[-1])
        return np.asarray(stiffness[:, None, None] * per_stiffness + posture_spring)


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

    With M = L L^T, the eigenvectors W of L^-1 Kq L^-T give V = L^-T W, so that V^T M V = 1 and M V = L W.

    Args:
        arms: P postures.
        stiffness: translational stiffnesses (P) [N/m].
        timing: of the loop.

    """
    L = np.linalg.cholesky(arms.mass)
    half = np.linalg.solve(L, arms.springs(stiffness))  # L^-1 Kq; its transpose is Kq L^-T
    values, W = np.linalg.eigh(np.linalg.solve(L, np.swapaxes(half, 1, 2)))
    V = np.linalg.solve(np.swapaxes(L, 1, 2), W)
    squares = (V**2).sum(axis=1)  # v^T v of each mode (P, n): d 1 damps it by d v^T v
    trace = squares.sum(axis=1)  # of M^-1 (P): no eigenvalue of M^-1 d is above d times that
    most = _largest_damping(timing)
    d = np.minimum(JOINT_DAMPING, 0.5 * most / trace)
    b = np.minimum(_of_ratio(values, timing), (most - d * trace)[:, None])
    MV = L @ W
    B = np.einsum("pik,pk,pjk->pij", MV, b, MV) + d[:, None, None] * np.eye(arms.mass.shape[-1])
    of_joints = d[:, None] * squares
    return Modes(stiffness=values, damping=b + of_joints, matrix=B, tip=values - POSTURE_STIFFNESS * squares)


def _largest_damping(timing: LoopTiming) -> float:
    """Return the largest eigenvalue of M^-1 B [1/s]."""
    return min(LARGEST_DAMPING, DELAYED_DAMPING / (1 + timing.delay)) / timing.period


def _of_ratio(values: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the damping b (P, n) [1/s] that gives each mode its ratio; no less than lambda late.

    Torques that are late by h take damping and inertia: 2 zeta sqrt(lambda (1 - b h)) = b - lambda h. Squared, that is
    b^2 + 2 p b - (4 zeta^2 lambda - (lambda h)^2) = 0 with p = lambda h (2 zeta^2 - 1).
    """
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
    the velocity is (x_k - x_k-1)/T = (1 - z^-1)/T x. Times D and all powers of z that are below a fraction's line:

        measured velocity    z^delay D + lambda (1 - cos wT)/w^2 (z + 1) + b sin wT/w (z - 1)
        encoder step         z^(delay + 1) D + (1 - cos wT)/w^2 (lambda z (z + 1) + b/T (z^2 - 1))

    Args:
        stiffness: lambda (...) [1/s^2].
        damping: b (...) [1/s].
        timing: of the loop.
        environment: w^2 (...) [1/s^2], not negative.

    """
    T, w = timing.period, np.sqrt(environment)
    to_position = 0.5 * (T * np.sinc(w * T / (2 * np.pi))) ** 2  # (1 - cos wT)/w^2
    to_velocity = T * np.sinc(w * T / np.pi)  # sin wT/w
    ones, position_gain = np.ones_like(w), stiffness * to_position
    free = np.stack([ones, -2.0 * np.cos(w * T), ones], axis=-1)  # D
    if timing.quantum > 0:
        difference_gain = damping * to_position
        result = _padded(free, timing.delay + 1)
        result[..., -3:-1] += np.multiply.outer(position_gain, [1.0, 1.0])  # z (z + 1)
        result[..., -3:] += np.multiply.outer(difference_gain, [1.0 / T, 0.0, -1.0 / T])
        return result
    result = _padded(free, timing.delay)
    result[..., -2:] += np.multiply.outer(position_gain, [1.0, 1.0])
    result[..., -2:] += np.multiply.outer(damping * to_velocity, [1.0, -1.0])
    return result


def _padded(polynomial: FloatArray, power: int) -> FloatArray:
    """Return polynomials (..., degree + 1), highest power first, times z^power."""
    return np.concatenate([polynomial, np.zeros((*polynomial.shape[:-1], power))], axis=-1)


def slowest_roots(modes: Modes, timing: LoopTiming, environment: FloatArray | None = None) -> np.ndarray:
    """Return the root of largest magnitude of each mode's loop (P, n), complex; environment: w^2 of each mode."""
    held = np.zeros_like(modes.stiffness) if environment is None else environment
    polynomial = characteristic(modes.stiffness, modes.damping, timing, held)
    # companion matrix (P, n, degree, degree), whose eigenvalues are the roots: it maps (z^k, ..., 1) to z times that
    degree = polynomial.shape[-1] - 1
    companion = np.zeros((*polynomial.shape[:-1], degree, degree))
    companion[..., 0, :] = -polynomial[..., 1:] / polynomial[..., :1]
    companion[..., range(1, degree), range(degree - 1)] = 1.0
    roots = np.linalg.eigvals(companion)
    largest_root = np.abs(roots).argmax(axis=-1)[..., None]
    return np.asarray(np.take_along_axis(roots, largest_root, -1)[..., 0])


def damping_attained(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the least damping ratio of all modes (P), from the loop's roots; negative where it is unstable.

    A root z = exp(s T) has the ratio -Re(s)/|s|, and s T = log z.
    """
    exponent = np.log(slowest_roots(find_modes(arms, stiffness, timing), timing))
    return np.asarray((-exponent.real / np.abs(exponent)).min(axis=1))


def step_torque(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the largest torque (P) [N m or N] by which one encoder step of every joint moves the damping torque."""
    B = find_modes(arms, stiffness, timing).matrix
    return np.asarray(np.abs(B).sum(axis=2).max(axis=1) * timing.quantum / timing.period)


def rendered_limit(arms: Arms, timing: LoopTiming) -> FloatArray:
    """Return the stiffnesses (P) [N/m] up to which the controller renders a spring in full, and accepts it.

    The largest eigenvalue lambda of M^-1 Kq must stay below two bounds [1/s^2]: that of the sampled loop, and that of
    damping. With torques late by h [s], a damping ratio r takes b = 2 r sqrt(lambda) + h lambda [1/s]. The second bound
    is lambda for the largest b and the least r: sqrt(lambda) = (sqrt(r^2 + h b) - r) / h.
    """
    of_loop = LARGEST_STIFFNESS / (timing.period**2 * (1 + 2 * timing.delay))
    b, r, h = _largest_damping(timing), LEAST_RATIO, timing.late
    of_damping = ((np.sqrt(r**2 + h * b) - r) / h) ** 2

    def is_rendered(stiffness: FloatArray) -> np.ndarray:
        largest_eigenvalue = find_modes(arms, stiffness, timing).stiffness[:, -1]
        return np.asarray(largest_eigenvalue <= min(of_loop, of_damping))

    return np.minimum(largest(is_rendered, len(arms.mass)), MOST_STIFFNESS)


def passive_limit(arms: Arms, timing: LoopTiming) -> FloatArray:
    """Return the stiffnesses (P) [N/m] up to which late torques put out no work in slow motion: b >= lambda h."""

    def is_passive(stiffness: FloatArray) -> np.ndarray:
        modes = find_modes(arms, stiffness, timing)
        return np.asarray((modes.damping >= modes.stiffness * timing.late).all(axis=1))

    return largest(is_passive, len(arms.mass))


def stable_limit(arms: Arms, timing: LoopTiming) -> FloatArray:
    """Return the stiffnesses (P) [N/m] up to which every root of the sampled loop is inside the unit circle."""

    def is_stable(stiffness: FloatArray) -> np.ndarray:
        roots = slowest_roots(find_modes(arms, stiffness, timing), timing)
        return np.asarray((np.abs(roots) < 1).all(axis=1))

    return largest(is_stable, len(arms.mass))


def contact_limit(arms: Arms, stiffness: FloatArray, timing: LoopTiming) -> FloatArray:
    """Return the stiffest environments (P) [N/m] that may hold the tip while the loop renders a stiffness (P).

    The environment is a spring without damping, in the proportions of the tip's own one, so that the modes stay. Every
    softer one leaves the loop stable, too.
    """
    modes = find_modes(arms, stiffness, timing)
    per_stiffness = np.maximum(modes.tip, 0.0) / stiffness[:, None]  # eigenvalue per stiffness at the tip [1/kg]

    def is_stable(environment: FloatArray) -> np.ndarray:
        roots = slowest_roots(modes, timing, per_stiffness * environment[:, None])
        return np.asarray((np.abs(roots) < 1).all(axis=1))

    return largest(is_stable, len(arms.mass))


def largest(holds: Callable[[FloatArray], np.ndarray], count: int) -> FloatArray:
    """Return the last of ascending stiffnesses (P) before a condition first fails; 0 where none holds.

    Args:
        holds: returns for stiffnesses (P) whether the condition holds in each posture.
        count: number of postures.

    """
    low, high = _bracket(holds, count)
    for _ in range(_HALVINGS):
        # the geometric mean; below the first stiffness of the ladder the arithmetic one
        middle = np.where(low > 0, np.sqrt(np.maximum(low, 1e-9) * high), 0.5 * high)
        passed = holds(middle)
        low, high = np.where(passed, middle, low), np.where(passed, high, middle)
    return np.asarray(low)


def _bracket(holds: Callable[[FloatArray], np.ndarray], count: int) -> tuple[FloatArray, FloatArray]:
    """Return the stiffnesses (P) of the ladder before the condition first fails, and those where it fails.

    They are 0 and the first one where it fails at once, and the last one twice where it never fails.
    """
    low, high, is_climbing = np.zeros(count), np.full(count, _LADDER[0]), np.ones(count, dtype=bool)
    for stiffness in _LADDER:
        passed = holds(np.full(count, stiffness)) & is_climbing
        low[passed] = stiffness
        high = np.where(is_climbing, stiffness, high)
        is_climbing = passed
        if not is_climbing.any():
            break
    return low, high
