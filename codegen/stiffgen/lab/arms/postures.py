# SPDX-License-Identifier: MIT
"""Search for postures of a pose, beside a control loop: no controller does so by itself."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import StiffgenError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray

_SQUARED = 0.25**2
"""[m^2] that weighs as much as one squared radian, as in the controller."""
_LONGEST = 0.5
"""[rad] or [m] that a joint moves in one step."""
_REACHED = 1e-8
"""[m] and [rad] from the pose at which a posture is one of it."""
_NO_POSE = 1e-3
"""Largest entry of R R^T - I, and error of the last row, of a pose."""
_ALIKE = 0.1
"""[rad] or [m] up to which two postures are the same."""
_REGULAR = 1e-9
"""Damping relative to the trace of J^T W J, which keeps systems regular."""
_DAMPING = 1e-2
"""Further damping per squared error."""
_CLOSE = 1e-2
"""Squared error below which a step also pulls towards ``near``."""
_PULL = 0.2
"""Share of the way to ``near`` per step."""


def find_postures(
    robot: GeneratedRobot | ModuleType,
    pose: ArrayLike,
    *,
    near: ArrayLike,
    margin: float = 0.1,
    starts: int = 64,
    steps: int = 200,
) -> FloatArray:
    """Search for postures of a tip's pose; the caller decides whether the arm goes to one of them.

    The search starts at ``near`` and at points all over the joints' ranges. On each branch it goes to the posture next
    to ``near``. It is local: a posture that is not found may exist. The same call returns the same postures.

    Args:
        robot: a robot with one tip and a fixed base, from ``stiffgen.load`` or ``open_robot``, or its module.
        pose: (4, 4) pose of the tip in the base.
        near: (n) joint positions to start from, such as the arm's.
        margin: distance from the limits [rad or m], by default the width of the controller's limit zones; at most a
            quarter of a joint's range is kept away from each of its limits.
        starts: number of points to start from.
        steps: number of steps from each.

    Returns:
        (k, n) postures, the one nearest to ``near`` first; none: (0, n).

    Raises:
        StiffgenError: the robot has several tips, a moving base or tools, an argument is not finite or no pose, or the
            margin is negative.

    """
    module = robot.module if isinstance(robot, GeneratedRobot) else robot
    start, goal = np.array(near, dtype=float), np.array(pose, dtype=float)
    finite = np.isfinite(start).all() and np.isfinite(goal).all()
    if goal.shape != (4, 4) or not finite or _function(module, "forward_kinematics", start).shape != (4, 4):
        raise StiffgenError("find_postures: takes a finite pose (4, 4) and finite joint positions near it")
    _check_pose(goal)
    low, high = _searched_ranges(module.LOWER, module.UPPER, start, margin)
    spread = np.random.default_rng(0).random((starts, len(start)))  # the same points in every call
    q = np.clip(np.vstack([start, low + spread[1:] * (high - low)]), low, high)
    for number in range(steps):  # the second half without a pull towards ``near``
        q = np.clip(q + _step(module, q, goal, start if number < steps // 2 else None), low, high)
    left = _errors(_function(module, "forward_kinematics", q), goal)
    return _distinct(q[np.abs(left).max(axis=1) <= _REACHED], start)


def _distinct(postures: FloatArray, near: FloatArray) -> FloatArray:
    """Return postures (k, n) by their distance from another one, without those that are almost the same."""
    ordered = postures[np.argsort(np.linalg.norm(postures - near, axis=1), kind="stable")]
    kept: list[FloatArray] = []
    for posture in ordered:
        if all(np.abs(posture - other).max() > _ALIKE for other in kept):
            kept.append(posture)
    return np.array(kept).reshape(-1, len(near))


def _searched_ranges(
    lower: FloatArray, upper: FloatArray, start: FloatArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the joints' ranges for the search: within the limits, half a turn around the start without.

    A margin takes at most a quarter of a range, so that no range turns round (the controller's rule for its zones). A
    start beyond the only limit of a joint counts as this limit.

    Raises:
        StiffgenError: the margin is negative or not finite.

    """
    if not (np.isfinite(margin) and margin >= 0):
        raise StiffgenError(f"find_postures: margin is {margin:g}; give a distance from the limits of 0 or more")
    kept = np.minimum(margin, (upper - lower) / 4)
    lower, upper = lower + kept, upper - kept
    inside = np.clip(start, lower, upper)
    return np.where(np.isfinite(lower), lower, inside - np.pi), np.where(np.isfinite(upper), upper, inside + np.pi)


def _check_pose(pose: FloatArray) -> None:
    """Raise StiffgenError if a matrix (4, 4) is no pose."""
    R = pose[:3, :3]
    off = max(np.abs(R @ R.T - np.eye(3)).max(), np.abs(pose[3] - [0, 0, 0, 1]).max())
    if off > _NO_POSE or np.linalg.det(R) < 0:
        raise StiffgenError(
            "find_postures: the pose is none: rows (R, p) and (0, 0, 0, 1), with an orthonormal, right-handed R; is it "
            "transposed?"
        )


def _function(module: Any, name: str, q: FloatArray) -> FloatArray:
    """Return values of a kernel at joint positions."""
    try:
        scope = module.hybrid if name == "jacobian" else module
        return np.asarray(getattr(scope, name)(q), dtype=float)
    except (AttributeError, TypeError, ValueError) as error:
        raise StiffgenError(
            "find_postures: takes a robot with one tip, a fixed base and no tool at run time, and its joint positions"
        ) from error


def _errors(poses: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the twists from poses to the goal: difference of the origins, and rotation vector in the base's axes."""
    turn = goal[:3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    axial = np.stack(  # 2 sin(angle) times the axis
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    sine = np.linalg.norm(axial, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(turn, axis1=1, axis2=2) - 1) / 2)
    vectors = axial * np.where(sine > 1e-9, angle / np.maximum(2 * sine, 1e-18), 0.5)[:, None]
    is_half_turn = (sine <= 1e-6) & (angle > 1)  # its axis is lost, and any one will do
    vectors[is_half_turn] = np.array([np.pi, 0.0, 0.0])
    return np.concatenate([goal[:3, 3] - poses[:, :3, 3], vectors], axis=1)


def _step(module: Any, q: FloatArray, goal: FloatArray, near: FloatArray | None) -> FloatArray:
    """Return damped steps (k, n) of least squares, and a motion towards ``near`` that leaves the tip where it is.

    Levenberg-Marquardt: (J^T W J + damping) step = J^T W error, with more damping far from the goal.
    """
    error, J = _errors(_function(module, "forward_kinematics", q), goal), _function(module, "jacobian", q)
    weight = np.array([1 / _SQUARED] * 3 + [1.0] * 3)
    JT = np.swapaxes(J, 1, 2)
    A = JT @ (weight[:, None] * J)
    slope = (JT @ (weight * error)[..., None])[..., 0]
    squared_error = np.einsum("ki,i,ki->k", error, weight, error)
    eye, scale = np.eye(q.shape[1]), np.maximum(np.trace(A, axis1=1, axis2=2), 1e-12)[:, None, None]
    damping = _REGULAR * scale + _DAMPING * squared_error[:, None, None]
    step = np.linalg.solve(A + damping * eye, slope[..., None])[..., 0]
    if near is not None:
        pull = _PULL * (near - q)
        moves_tip = np.linalg.solve(A + _REGULAR * scale * eye, (A @ pull[..., None]))[..., 0]  # its part that does
        step += (pull - moves_tip) * (squared_error < _CLOSE)[:, None]
    longest = np.abs(step).max(axis=1, keepdims=True)
    result: FloatArray = step * np.minimum(1.0, _LONGEST / np.maximum(longest, 1e-12))
    return result
