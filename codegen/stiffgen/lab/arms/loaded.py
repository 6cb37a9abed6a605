# SPDX-License-Identifier: MIT
"""Loaded arms on joint springs: where they come to rest, and the force under which they buckle.

The springs rest at q0 and have the stiffness Kth. The wrench F = (f, m) is that of the environment on the robot at the
tip in base axes (hybrid). It has these components at the posture that is looked for: the force is fixed in the world,
as a weight is. At rest

    Kth (q - q0) = J(q)^T F        H = Kth - dJ^T/dq . F - J^T (Gamma F) J

The posture is stable if H is positive definite. A moment then turns along geodesics of the tip (docs/compliance.md).
Joint limits are not considered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.measured import symmetric

_LONGEST = 0.3
"""[rad] or [m] that a joint moves in one step."""
_HALVINGS = 8
"""Largest number of halvings of a step that passes the minimum."""
_STEEPER = 0.9
"""Share of the slope that a step may leave on the other side of a minimum."""
_FLAT = 1e-8
"""Smallest divisor relative to the largest eigenvalue, where H is not positive definite."""
_TOLERANCE = 1e-10
"""[rad] or [m] largest entry of the last Newton step along a loaded path."""
_STEPS = 100
"""Steps of Newton's method towards one posture."""
_NEAR = 0.1
"""[rad] or [m] that a joint may move between two loads of the loaded path."""
_PATH_STEPS = 30
"""Steps of Newton's method from one load of the path to the next."""
_SECTIONS = 45
"""Sections of the interval around the softest load: 4e-10 of it is left."""
_GOLDEN = (np.sqrt(5) - 1) / 2
_SOFTER = 1 - 1e-9
"""Factor by which a smaller eigenvalue is less than rounding can make it."""
_EXACT = 1e-10
"""Relative width of the last bracket of a buckling load."""
_TINY = 1e-300
"""Divisor in place of zero, where the dividend is zero, too."""


@dataclass(frozen=True)
class Settled:
    """Postures under a load.

    Attributes:
        q: joint positions (..., n) [rad or m]; NaN where an argument is not finite.
        residual: largest entry of Kth (q - q0) - J^T F (...) [N m or N].
        converged: whether the last Newton step is below the tolerance (...).
        stability: smallest eigenvalue of H (...) [N m/rad]. Where it is not positive, the arm does not stay at q.

    """

    q: FloatArray
    residual: FloatArray
    converged: np.ndarray[Any, np.dtype[np.bool_]]
    stability: FloatArray


@dataclass(frozen=True)
class BucklingLoad:
    """Limits of stability along loaded paths.

    Attributes:
        load: force at which H loses definiteness (...) [N]; infinite where none is found.
        q: joint positions under this load (..., n) [rad or m], or under the largest load of the search.
        mode: unit vector of the smallest eigenvalue of H (..., n): the motion in which the arm gives way.
        stability: smallest eigenvalue of H at q (...) [N m/rad]: almost zero if the path is followed to its end.
        softest_load: force at which the smallest eigenvalue of H is least along the path (...) [N]: ``load`` where that
            is finite. A posture that is almost straight does not buckle, but gives way near this force.
        softest_stability: smallest eigenvalue of H under this force (...) [N m/rad].

    """

    load: FloatArray
    q: FloatArray
    mode: FloatArray
    stability: FloatArray
    softest_load: FloatArray
    softest_stability: FloatArray


def arm_on_springs(
    name: str, robot: GeneratedRobot | ModuleType, q: ArrayLike, joint_stiffness: ArrayLike
) -> tuple[Any, FloatArray, FloatArray]:
    """Return a robot's functions, joint positions (..., n) and springs (..., n, n).

    Raises:
        StiffgenError: the function of this name cannot take the robot, or a shape does not fit.

    """
    module: Any = robot.module if isinstance(robot, GeneratedRobot) else robot
    position, springs = np.asarray(q, dtype=float), np.asarray(joint_stiffness, dtype=float)
    if hasattr(module, "close") or hasattr(module, "motors"):
        raise StiffgenError(f"{name}: the robot has closed loops; its functions in motor coordinates are in 'motors'")
    try:
        with np.errstate(invalid="ignore"):
            shape = module.hybrid.jacobian(position).shape
    except (AttributeError, TypeError, ValueError) as error:
        raise StiffgenError(
            f"{name}: takes a robot with a fixed base and no tool at run time, or the part of one of its tips, and its "
            "joint positions"
        ) from error
    if shape[-1] != position.shape[-1]:
        raise StiffgenError(f"{name}: takes a robot without ball joints")
    if springs.shape == position.shape[-1:]:
        springs = np.diag(springs)
    return module, position, symmetric(f"{name}: joint_stiffness", springs, position.shape[-1])


def settle(
    robot: GeneratedRobot | ModuleType,
    q0: ArrayLike,
    joint_stiffness: ArrayLike,
    wrench: ArrayLike,
    *,
    start: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    tolerance: float = _TOLERANCE,
    steps: int = 100,
) -> Settled:
    """Return where an arm on joint springs rests under a wrench at its tip.

    Newton's method with H, in steps of at most 0.3 rad that go downhill: it ends in a stable posture if one is near.
    A load may have several postures. An arm that a load holds exactly at a saddle, such as a straight arm that is
    pressed along itself, stays there; its ``stability`` is then negative. Leading dimensions broadcast.

    Args:
        robot: a robot with a fixed base, from ``stiffgen.load`` or ``open_robot``, its module, or the part of one tip.
        q0: (..., n) joint positions where the springs rest [rad or m], such as the commanded ones.
        joint_stiffness: Kth (..., n, n), or (n) for independent springs [N m/rad, N/m for sliding joints].
        wrench: (..., 6) wrench of the environment on the robot at the tip, hybrid: base axes [N, N m].
        start: (..., n) joint positions where the search starts [rad or m]; default q0.
        gravity: (3) acceleration of gravity in base axes [m/s^2], such as (0, 0, -9.81), of an arm whose controller
            does not compensate its weight. The residual and H then contain the weight.
        tolerance: largest entry of the last Newton step [rad or m].
        steps: largest number of steps.

    Returns:
        Postures, residuals, convergence and stability.

    Raises:
        StiffgenError: the robot has a moving base, closed loops, ball joints or a tool at run time, it has no masses
            for gravity, or a shape does not fit.

    """
    arm, rest, (F, first) = _Arm.of(
        "settle", robot, q0, joint_stiffness, gravity, wrench, q0 if start is None else start
    )
    if F.shape[-1] != 6 or first.shape[-1] != rest.shape[-1]:
        raise StiffgenError("settle: takes a wrench (..., 6) and, as start, joint positions of the robot")
    # all leading dimensions as one row of arms
    lead = np.broadcast_shapes(rest.shape[:-1], arm.stiffness.shape[:-2], F.shape[:-1], first.shape[:-1])
    arm, (rest, F, first) = arm.broadcast(lead), (_rows(each, lead) for each in (rest, F, first))
    q, converged, state = arm.newton(first, rest, F, tolerance, steps)
    return Settled(
        q=q.reshape(*lead, -1),
        residual=np.abs(state.residual).max(axis=-1).reshape(lead),
        converged=converged.reshape(lead),
        stability=state.stability.reshape(lead),
    )


def buckling_load(
    robot: GeneratedRobot | ModuleType,
    q: ArrayLike,
    joint_stiffness: ArrayLike,
    direction: ArrayLike,
    *,
    gravity: ArrayLike | None = None,
    most: float = 1e5,
) -> BucklingLoad:
    """Return the force along a direction under which an arm on joint springs gives way.

    The force grows from zero and keeps its direction in the world; :func:`settle` follows the posture. The load where
    H loses definiteness is bracketed and halved to 1e-10 of it. Beyond this load the arm jumps to another posture, or
    leaves a straight one sideways. Most bent arms do not buckle: they give way gradually, and H remains positive
    definite. So does an arm that is bent by 1e-12 rad only, although it falls over near the load of the straight one:
    take ``softest_load`` for a posture that was measured, and ``load`` for one that is exactly straight. Compare ``q``
    with the joint limits. Leading dimensions broadcast.

    Args:
        robot: as in :func:`settle`.
        q: (..., n) joint positions without the force, where the springs rest [rad or m].
        joint_stiffness: Kth (..., n, n), or (n) for independent springs [N m/rad, N/m for sliding joints].
        direction: (..., 3) direction of the force of the environment on the robot, base axes; its length has no effect.
        gravity: as in :func:`settle`.
        most: largest force of the search [N].

    Returns:
        Loads, postures and modes. The load is zero where the arm is unstable without it, and NaN where an argument is
        not finite.

    Raises:
        StiffgenError: as in :func:`settle`, or a direction is zero.

    """
    arm, rest, (u,) = _Arm.of("buckling_load", robot, q, joint_stiffness, gravity, direction)
    if u.shape[-1] != 3 or (np.abs(u).max(axis=-1) == 0).any():
        raise StiffgenError("buckling_load: takes directions (..., 3) that are not zero")
    lead = np.broadcast_shapes(rest.shape[:-1], arm.stiffness.shape[:-2], u.shape[:-1])
    unit = np.concatenate([u / np.linalg.norm(u, axis=-1, keepdims=True), np.zeros_like(u)], axis=-1)
    arm, (rest, unit) = arm.broadcast(lead), (_rows(each, lead) for each in (rest, unit))
    load, at, trace = _follow(arm, rest, unit, most)
    state = arm.at(at, rest, np.where(np.isfinite(load), load, most)[:, None] * unit)
    softest_load, softest_stability = _softest(arm, rest, unit, trace).T
    is_end = np.isfinite(load)  # there H loses definiteness: nothing on the path is softer
    return BucklingLoad(
        load=load.reshape(lead),
        q=at.reshape(*lead, -1),
        mode=state.eigenvectors[..., 0].reshape(*lead, -1),
        stability=state.stability.reshape(lead),
        softest_load=np.where(is_end, load, softest_load).reshape(lead),
        softest_stability=np.where(is_end, state.stability, softest_stability).reshape(lead),
    )


class _Point(NamedTuple):
    """Point of a loaded path: force [N], smallest eigenvalue of H [N m/rad], joint positions (n)."""

    load: float
    stability: float
    q: FloatArray


def _softest(arm: _Arm, rest: FloatArray, unit: FloatArray, trace: list[list[_Point]]) -> FloatArray:
    """Return the loads and eigenvalues (k, 2) where paths are softest; NaN for a path without a point.

    The eigenvalue is least between the neighbours of a point that is softer than both. Sections by the golden ratio
    shorten the interval around each such point: beside a straight arm the eigenvalue falls and rises like a wedge. Of
    loads that are equally soft up to rounding, the least one counts.
    """
    found = np.full((len(trace), 2), np.nan)
    for owner, path in enumerate(trace):
        for point in path:
            if not point.stability >= _SOFTER * found[owner, 1]:  # also the first one: NaN compares as false
                found[owner] = point.load, point.stability
    valleys = [_Valley(owner, *valley) for owner, path in enumerate(trace) for valley in _valleys(path)]
    if not valleys:
        return found
    owners = [each.owner for each in valleys]
    low, high = np.array([each.low for each in valleys]), np.array([each.high for each in valleys])
    near = np.array([each.q for each in valleys])
    part = arm.rows(owners)
    for _ in range(_SECTIONS):
        width = _GOLDEN * (high - low)
        loads = np.stack([high - width, low + width])  # (2, k): the two inner points of each interval
        values = np.stack([part.stability_under(each, near, rest[owners], unit[owners]) for each in loads])
        for owner, load, value in zip([*owners, *owners], loads.ravel(), values.ravel(), strict=True):
            if value < _SOFTER * found[owner, 1]:
                found[owner] = load, value
        falls = values[0] > values[1]  # the least eigenvalue is above the lower inner point
        low, high = np.where(falls, loads[0], low), np.where(falls, high, loads[1])
    return found


class _Valley(NamedTuple):
    """Interval of loads [N] of a path, by its number, in which the eigenvalue is least, and a posture in it (n)."""

    owner: int
    low: float
    high: float
    q: FloatArray


def _valleys(path: list[_Point]) -> Iterator[tuple[float, float, FloatArray]]:
    """Yield the loads beside each point of a path that is softer than both neighbours, and its posture.

    An end of the path has itself as neighbour.
    """
    for k, point in enumerate(path):
        before, after = path[max(k - 1, 0)], path[min(k + 1, len(path) - 1)]
        if before.stability * _SOFTER > point.stability <= after.stability:
            yield before.load, after.load, point.q


def _follow(
    arm: _Arm, rest: FloatArray, unit: FloatArray, most: float
) -> tuple[FloatArray, FloatArray, list[list[_Point]]]:
    """Return the loads (k) where paths from rest lose stability, the last stable postures (k, n), and the paths.

    Each load rises by its step while the posture stays stable and near; else its step is halved, until it is exact.
    """
    at, converged, state = arm.newton(rest, rest, 0 * unit, _TOLERANCE, _STEPS)
    load = np.zeros(len(rest))
    load[~np.isfinite(state.eigenvalues).all(axis=1) | ~converged] = np.nan
    trace = [
        [_Point(0.0, value, q)] if is_at_rest and np.isfinite(value) else []
        for value, q, is_at_rest in zip(state.stability, at.copy(), converged, strict=True)
    ]
    step = _first_steps(arm, state, unit, most)
    growth, going = np.full(len(rest), 2.0), np.flatnonzero((state.stability > 0) & converged)
    while len(going):
        trial = load[going] + step[going]
        q, converged, state = arm.rows(going).newton(
            at[going], rest[going], trial[:, None] * unit[going], _TOLERANCE, _PATH_STEPS
        )
        is_near = np.abs(q - at[going]).max(axis=1) <= _NEAR  # on the path of the last posture
        is_next = converged & (state.stability > 0) & is_near
        reached, failed = going[is_next], going[~is_next]
        load[reached], at[reached] = trial[is_next], q[is_next]
        for k, row in zip(reached, np.flatnonzero(is_next), strict=True):
            trace[k].append(_Point(trial[row], state.stability[row], q[row]))
        step[reached] *= growth[reached]
        step[failed] /= 2
        growth[reached], growth[failed] = 2.0, 1.0  # the first success after a failure does not lengthen the step
        step = np.minimum(step, most - load)
        is_exact = step <= _EXACT * load
        load[is_exact & (load >= (1 - _EXACT) * most)] = np.inf
        going = going[~is_exact[going]]
    return load, at, trace


def _first_steps(arm: _Arm, state: _State, unit: FloatArray, most: float) -> FloatArray:
    """Return loads (k) [N] that move no joint by more than half of ``_NEAR``, by the tangent of the path at rest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        motion = np.abs(arm.tangent(state, unit)).max(axis=1)  # [rad/N or m/N]
        return np.asarray(np.minimum(np.where(motion > 0, _NEAR / 2 / motion, most), most))


@dataclass(frozen=True)
class _State:
    """Residual Kth (q - q0) - J^T F (k, n), its derivative with respect to q, J, eigenvalues and vectors of H."""

    residual: FloatArray
    derivative: FloatArray
    J: FloatArray
    eigenvalues: FloatArray
    eigenvectors: FloatArray

    @property
    def stability(self) -> FloatArray:
        """Smallest eigenvalue of H (k) [N m/rad]."""
        return self.eigenvalues[:, 0]


@dataclass(frozen=True)
class _Arm:
    """Functions of a robot, its springs (..., n, n), and the acceleration of gravity, if its weight counts."""

    name: str
    module: Any
    stiffness: FloatArray
    gravity: FloatArray | None

    @staticmethod
    def of(
        name: str,
        robot: GeneratedRobot | ModuleType,
        q0: ArrayLike,
        joint_stiffness: ArrayLike,
        gravity: ArrayLike | None,
        *others: ArrayLike,
    ) -> tuple[_Arm, FloatArray, list[FloatArray]]:
        """Return the arm, q0 and other arguments as arrays; StiffgenError if the function cannot take them."""
        module, rest, springs = arm_on_springs(name, robot, q0, joint_stiffness)
        arrays = [np.atleast_1d(np.asarray(each, dtype=float)) for each in others]
        weight = None if gravity is None else np.asarray(gravity, dtype=float)
        if weight is not None and (weight.shape != (3,) or not hasattr(module, "gravity")):
            raise StiffgenError(f"{name}: takes an acceleration of gravity (3), and a robot that has masses")
        return _Arm(name, module, springs, weight), rest, arrays

    def broadcast(self, lead: tuple[int, ...]) -> _Arm:
        """Return the arm with one stiffness per configuration of a stack."""
        n = self.stiffness.shape[-1]
        stiffness = np.broadcast_to(self.stiffness, (*lead, n, n)).reshape(-1, n, n)
        return _Arm(self.name, self.module, stiffness, self.gravity)

    def rows(self, rows: Any) -> _Arm:
        """Return the arm with the stiffness of some configurations."""
        return _Arm(self.name, self.module, self.stiffness[rows], self.gravity)

    def at(self, q: FloatArray, rest: FloatArray, F: FloatArray) -> _State:
        """Return residual, derivatives and eigenvalues; NaN where an argument is not finite."""
        with np.errstate(invalid="ignore"):
            return self._at(q, rest, F)

    def _at(self, q: FloatArray, rest: FloatArray, F: FloatArray) -> _State:
        """Return residual torque (P, n), its derivative (P, n, n), J, and the eigensystem of H at q (P, n)."""
        hybrid, K = self.module.hybrid, self.stiffness
        J = hybrid.jacobian(q)
        residual = np.einsum("kij,kj->ki", K, q - rest) - np.einsum("kai,ka->ki", J, F)
        derivative = K - hybrid.kinematic_stiffness(q, F)
        H = K - hybrid.joint_stiffness(q, F, np.zeros((6, 6)))  # the load's part: Kq of a tip without a spring
        if self.gravity is not None:
            residual = residual + self.module.gravity.gradient(q, self.gravity)
            weight = self.module.gravity.joint_stiffness(q, self.gravity)
            derivative, H = derivative + weight, H + weight
        is_finite = np.isfinite(H).all(axis=(1, 2)) & np.isfinite(residual).all(axis=1)
        values, vectors = np.linalg.eigh(np.where(is_finite[:, None, None], H, 0.0))
        values[~is_finite], vectors[~is_finite] = np.nan, np.nan
        return _State(residual, derivative, J, values, vectors)

    def tangent(self, state: _State, unit: FloatArray) -> FloatArray:
        """Return the motion of the joints per force: H^-1 J^T u, by H = V diag(values) V^T."""
        torque = np.einsum("kai,ka->ki", state.J, unit)
        along_modes = np.einsum("kji,kj->ki", state.eigenvectors, torque) / state.eigenvalues
        motion: FloatArray = np.einsum("kij,kj->ki", state.eigenvectors, along_modes)
        return motion

    def stability_under(self, load: FloatArray, start: FloatArray, rest: FloatArray, unit: FloatArray) -> FloatArray:
        """Return the smallest eigenvalues of H (k) under loads, near postures; infinite where none is stable."""
        _, converged, state = self.newton(start, rest, load[:, None] * unit, _TOLERANCE, _STEPS)
        return np.where(converged & (state.stability > 0), state.stability, np.inf)

    def newton(
        self, start: FloatArray, rest: FloatArray, F: FloatArray, tolerance: float, steps: int
    ) -> tuple[FloatArray, Any, _State]:
        """Return postures (k, n), whether they rest (k), and their states; start, rest (k, n), loads F (k, 6)."""
        q = np.array(start)
        converged, going = np.zeros(len(q), dtype=bool), np.arange(len(q))  # rows that still move
        for _ in range(steps):
            state = self.rows(going).at(q[going], rest[going], F[going])
            is_finite = np.isfinite(state.eigenvalues).all(axis=1)
            q[going[~is_finite]] = np.nan  # given up
            going, step, residual = going[is_finite], _step(state, is_finite), state.residual[is_finite]
            is_at_rest = np.abs(step).max(axis=1, initial=0.0) <= tolerance
            q[going[is_at_rest]] += step[is_at_rest]
            converged[going[is_at_rest]] = True
            going, step, residual = going[~is_at_rest], step[~is_at_rest], residual[~is_at_rest]
            if not len(going):
                break
            # the others go on, by a step that is short enough to go downhill
            q[going] += self.rows(going).shortened(q[going], rest[going], F[going], residual, step)
        return q, converged, self.at(q, rest, F)

    def shortened(
        self, q: FloatArray, rest: FloatArray, F: FloatArray, residual: FloatArray, step: FloatArray
    ) -> FloatArray:
        """Return bounded steps that do not end higher up on the other side of a minimum.

        The energy's slope along a step is residual . step: downhill at the start. Where it is uphill by almost as much
        at the end, the step has passed the minimum, and is halved.
        """
        scale = np.minimum(1.0, _LONGEST / np.abs(step).max(axis=1))
        slope = np.abs((residual * step).sum(axis=1))
        for _ in range(_HALVINGS):
            slope_at_end = (self.at(q + scale[:, None] * step, rest, F).residual * step).sum(axis=1)
            too_far = ~(slope_at_end <= _STEEPER * slope)  # also NaN
            if not too_far.any():
                break
            scale[too_far] /= 2
        bounded: FloatArray = scale[:, None] * step
        return bounded


def _step(state: _State, rows: Any) -> FloatArray:
    """Return Newton steps; where H is not positive definite, steps downhill with the sizes of its eigenvalues.

    The latter are -V diag(1 / |values|) V^T residual, with H = V diag(values) V^T: along each mode as far as a spring
    of that stiffness would move.
    """
    values, vectors, residual = state.eigenvalues[rows], state.eigenvectors[rows], state.residual[rows]
    sizes = np.maximum(np.abs(values), _FLAT * np.abs(values).max(axis=1, initial=0.0)[:, None])
    along_modes = np.einsum("kji,kj->ki", vectors, residual) / np.maximum(sizes, _TINY)
    downhill = np.einsum("kij,kj->ki", vectors, along_modes)
    is_stable = (values[:, 0] > sizes[:, -1] * _FLAT)[:, None]
    derivative = np.where(is_stable[:, None], state.derivative[rows], np.eye(values.shape[1]))
    newton = np.linalg.solve(derivative, residual[..., None])[..., 0]
    step: FloatArray = -np.where(is_stable, newton, downhill)
    return step


def _rows(values: FloatArray, lead: tuple[int, ...]) -> FloatArray:
    """Return vectors broadcast to the leading dimensions, as rows."""
    size = values.shape[-1]
    return np.array(np.broadcast_to(values, (*lead, size)).reshape(-1, size))
