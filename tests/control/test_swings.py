# SPDX-License-Identifier: MIT
"""Follow comes to rest: swings about a goal, about a posture, and between a fold and a posture; stuck arms.

Each arm is one of ``make campaign NAME=follow``, where it swung for as long as it was watched (20 s).
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from campaigns.follow import LONGEST, UNREACHABLE, Arm, arm_urdf
from support.controller_inputs import Q

Array = np.ndarray[Any, np.dtype[Any]]
UP, DOWN, ALONG = "1.5708 0 0", "-1.5708 0 0", "0 0 0"
FLAT_FOLD = (
    ("0.316 0 0.168", ALONG, -1.528, 1.959, 2.21),
    ("0.053 0 0.040", UP, -2.439, 1.590, 2.03),
    ("0.265 0 0.194", UP, -1.828, 1.724, 2.24),
    ("0.000 0 0.141", DOWN, -1.984, 2.359, 1.96),
    ("0.000 0 0.133", UP, -1.889, 2.174, 1.42),
    ("0.000 0 0.062", ALONG, -2.854, 1.565, 3.14),
    ("0.000 0 0.049", UP, -2.236, 1.975, 1.23),
)
SPARE_JOINT = (
    ("0.219 0 0.069", ALONG, -1.720, 2.662, 2.65),
    ("0.000 0 0.022", DOWN, -1.897, 2.714, 2.89),
    ("0.000 0 0.154", UP, -2.283, 2.178, 2.76),
    ("0.385 0 0.316", UP, -2.562, 2.964, 2.35),
    ("0.000 0 0.085", DOWN, -2.798, 2.711, 3.15),
    ("0.000 0 0.002", DOWN, -1.611, 2.770, 1.00),
    ("0.000 0 0.046", DOWN, -2.337, 2.111, 1.07),
)
NEAR_FOLD = (
    ("0.210 0 0.064", ALONG, -1.601, 1.995, 3.29),
    ("0.260 0 0.219", DOWN, -1.862, 2.357, 1.02),
    ("0.398 0 0.331", UP, -2.685, 2.786, 1.94),
    ("0.294 0 0.200", DOWN, -2.771, 2.657, 2.09),
    ("0.000 0 0.112", DOWN, -2.554, 2.048, 1.19),
    ("0.115 0 0.063", DOWN, -2.141, 2.499, 3.16),
)
"""Joints of three arms: place, turn, lower and upper limit [rad], speed [rad/s]."""
LEGS = {
    # Before, the margin to a fold that bends by 5 cm came and went: 2 to 5 cm about the goal, in silence.
    "flat fold": (
        FLAT_FOLD,
        (0.80, -1.45, -1.47, -0.45, 0.73, -0.12, -1.13),
        (1.49, 0.32, -0.43, 0.62, 0.70, -1.82, 1.18),
        False,
    ),
    # Before, the tip was at its pose, and the joints swung by 0.15 rad/s at 2 Hz.
    "spare joint": (
        SPARE_JOINT,
        (1.97, 1.88, 0.01, 1.78, 0.10, -0.36, -1.20),
        (1.20, 0.55, -0.89, -0.10, -1.21, -0.23, -1.24),
        False,
    ),
    # Before, the way by joints ended 1 mm from the goal, where the margin to the fold took over, 15 mm away again.
    "posture near a fold": (
        NEAR_FOLD,
        (-0.67, -1.00, -0.58, 0.71, 1.52, 0.84),
        (-0.17, -0.84, 0.32, -1.33, 0.42, -1.01),
        True,
    ),
}
"""Joints, start, a posture of the goal, and whether Follow is told it."""


@pytest.mark.parametrize(
    "leg", ["flat fold", *(pytest.param(leg, marks=pytest.mark.slow) for leg in ("spare joint", "posture near a fold"))]
)
def test_an_arm_comes_to_rest(leg: str, tmp_path: Path) -> None:
    """It rests within 2 mm of its goal, and says so where that is not at the goal."""
    joints, start, goal, told = LEGS[leg]
    (tmp_path / "arm.urdf").write_text(arm_urdf(joints))
    arm = Arm(tmp_path / "arm.urdf", "tip", "arm", tmp_path)
    arm.begin(np.array(start))
    end, q = arm.go(arm.pose(np.array(goal)), np.array(goal if told else start))
    assert end.samples < LONGEST
    assert end.distance < 2e-3 and end.angle < 5e-3
    assert bool(end.status & UNREACHABLE) == (end.distance > 1e-3)
    if end.distance > 1e-3:
        posture = arm.find_posture(arm.pose(np.array(goal)), q)
        assert posture is not None
        end, _ = arm.go(arm.pose(np.array(goal)), posture)
        assert end.distance < 1e-6 and not end.status & UNREACHABLE


def out_of_reach(robot: ModuleType) -> tuple[Array, Array]:
    """Return the pose of Q, and one 0.5 m farther out."""
    start: Array = robot.forward_kinematics(Q)
    far = start.copy()
    far[:3, 3] += 0.5 * start[:3, 3] / np.linalg.norm(start[:3, 3])
    return start, far


def test_a_stuck_arm_rests_and_follows_back_at_once(robot: ModuleType) -> None:
    """Within 6 s no joint moves any more; with the next pose all is as at the start."""
    start, far = out_of_reach(robot)
    follow = robot.Follow(Q, sample_time=1e-3)
    _, status = follow.run(pose=np.repeat(far[None], 8000, axis=0))
    assert status[-1] == robot.FollowStatus.UNREACHABLE
    assert np.abs(follow.dq0).max() < 1e-9
    step = follow.step(pose=start)
    assert step.status == robot.FollowStatus.MOVING
    _, status = follow.run(pose=np.repeat(start[None], 2500, axis=0))
    assert max(follow.error) < 1e-4 and not (status & robot.FollowStatus.UNREACHABLE).any()


def test_a_resting_arm_goes_to_another_posture(robot: ModuleType) -> None:
    """A posture that jumps wakes it, noise of 10 mrad does not."""
    _, far = out_of_reach(robot)
    follow, random = robot.Follow(Q, sample_time=1e-3), np.random.default_rng(1)
    poses = np.repeat(far[None], 8000, axis=0)
    follow.run(pose=poses, posture=Q)
    rest, noise = follow.q0.copy(), 0.01 * random.uniform(-1.0, 1.0, 7)
    follow.run(pose=poses[:500], posture=Q + noise)
    assert np.abs(follow.q0 - rest).max() < 1e-9
    posture = Q + np.array([0.0, 0.0, 0.5, 0.0, -0.5, 0.0, 0.0])
    _, status = follow.run(pose=poses, posture=posture)
    assert np.abs(follow.q0 - rest).max() > 0.1
    assert status[-1] == robot.FollowStatus.UNREACHABLE and np.abs(follow.dq0).max() < 1e-9


@pytest.mark.parametrize(("field", "share"), [("velocity_limit", 0.01), ("tip_velocity_limit", 0.01)])
def test_a_slow_arm_is_not_given_up(robot: ModuleType, field: str, share: float) -> None:
    """At a hundredth of the speed a way of 0.2 m takes a minute; after each 5 s there is progress."""
    goal: Array = robot.forward_kinematics(Q)
    goal[:3, 3] += (0.1, 0.15, -0.1)
    slow = share * robot.Follow(Q, sample_time=1e-2).config[field]
    follow = robot.Follow(Q, sample_time=1e-2, **{field: slow})
    path, _ = follow.run(pose=np.repeat(goal[None], 8000, axis=0))
    assert max(follow.error) < 1e-4
    assert (np.abs(np.diff(path[:1500], axis=0)).max(axis=1) > 0.0).all()


@pytest.mark.parametrize("period", [1, 20])
def test_a_slow_stream_is_not_given_up(robot: ModuleType, period: int) -> None:
    """Poses that move by 5 mm/s to the edge of reach, each 10 ms or smoothed each 200 ms, for 20 s."""
    start, far = out_of_reach(robot)
    way = far[:3, 3] - start[:3, 3]
    poses = np.repeat(start[None], 2000, axis=0)
    shares = (np.arange(2000) // period * period) * 5e-5 / np.linalg.norm(way)
    poses[:, :3, 3] += shares[:, None] * way
    follow = robot.Follow(Q, sample_time=1e-2)
    _, status = follow.run(pose=poses)
    assert not (status & robot.FollowStatus.UNREACHABLE).any()
    assert follow.error[0] < 3e-3
