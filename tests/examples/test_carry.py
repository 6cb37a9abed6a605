# SPDX-License-Identifier: MIT
"""Follow with an object that two hands hold: one straight way, on which they keep their places in it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from examples import two_arms
from stiffgen.control.companions import CARRY
from support.c_library import check_contained
from support.project import ROOT

Array = np.ndarray[Any, np.dtype[Any]]
START = two_arms.wanted(0.0)


@pytest.fixture(scope="module")
def arms(two_arms_folder: Path) -> ModuleType:
    return stiffgen.open_robot(two_arms_folder / "two_arms").module


def turned(shift: tuple[float, float, float], axis: int, angle: float) -> Array:
    """Return the pose of the object after a shift of 0.3 m and a turn."""
    assert np.isclose(np.linalg.norm(shift), 0.3)
    return START @ two_arms.placed(*shift) @ two_arms.turned(axis, angle)


def carried(arms: ModuleType, follow: Any, goal: Array, seconds: float) -> tuple[Array, Array, Array]:
    """Return the objects that both hands have (2, steps, 4, 4), their distances [m] and angles [rad], the status."""
    grasp = two_arms.grasps()
    q0, status = follow.run(object_pose=np.tile(goal, (round(1e3 * seconds), 1, 1)), grasp=grasp)
    hands = [getattr(arms, f"{side}_{two_arms.IIWA.tip}") for side in two_arms.SIDES]
    seen = np.array([hand.forward_kinematics(q0) @ np.linalg.inv(g) for hand, g in zip(hands, grasp, strict=True)])
    apart = np.linalg.inv(seen[0]) @ seen[1]
    cosine = (np.trace(apart[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    return seen, np.array([np.linalg.norm(apart[:, :3, 3], axis=1), np.arccos(np.clip(cosine, -1.0, 1.0))]), status


def ready(arms: ModuleType) -> Any:
    return arms.Follow(arms.find_posture(START @ two_arms.grasps(), two_arms.IIWA.start), sample_time=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shift", "axis", "sign"),
    [((0, 0, 0.3), 1, 1), ((-0.3, 0, 0), 0, -1), ((-0.2, 0.1, 0.2), 0, -1)],
    ids=["up, about y", "back, about x", "askew, about x"],
)
def test_the_hands_keep_their_distance(
    shift: tuple[float, float, float], axis: int, sign: int, arms: ModuleType
) -> None:
    """Carry by 0.3 m and 90 degrees in one command: within 1 mm and 0.2 degrees of the grasp, straight, and there."""
    follow, goal = ready(arms), turned(shift, axis, sign * np.pi / 2)
    seen, apart, status = carried(arms, follow, goal, 5.0)
    assert apart[0].max() < 1e-3 and np.degrees(apart[1].max()) < 0.2
    way = seen.mean(axis=0)[:, :3, 3] - START[:3, 3]
    line = (goal - START)[:3, 3] / 0.3
    assert np.linalg.norm(way - np.outer(way @ line, line), axis=1).max() < 1e-3
    assert (way @ line).max() < 0.3 + 1e-3
    assert not status[-1] and follow.error[:, 0].max() < 1e-4 and follow.error[:, 1].max() < 1e-3


@pytest.mark.slow
def test_by_themselves_they_do_not(arms: ModuleType) -> None:
    """Move each hand to its own pose: they come off the grasp by centimetres, as they must not with Carry."""
    follow, goal = ready(arms), turned((-0.3, 0, 0), 0, -np.pi / 2)
    q0, _ = follow.run(pose=np.tile(goal @ two_arms.grasps(), (5000, 1, 1, 1)))
    a, b = (getattr(arms, f"{side}_{two_arms.IIWA.tip}").forward_kinematics(q0)[:, :3, 3] for side in two_arms.SIDES)
    away = np.linalg.norm(a - b, axis=1)
    assert away.max() - away.min() > 0.02


@pytest.mark.slow
def test_out_of_reach_they_wait_together_and_come_back(arms: ModuleType) -> None:
    """Carry an object out of reach: both arms stop with it between them (2 mm, 0.3 deg), and come back."""
    follow, goal = ready(arms), turned((0, 0, 0.3), 2, np.pi / 2)
    _, apart, status = carried(arms, follow, goal, 6.0)
    assert status[-1] & arms.FollowStatus.UNREACHABLE and follow.error[:, 0].min() > 0.1
    assert apart[0].max() < 2e-3 and np.degrees(apart[1].max()) < 0.3
    _, apart, status = carried(arms, follow, START, 6.0)
    assert apart[0].max() < 2e-3 and not status[-1] and follow.error.max() < 1e-4


@pytest.mark.slow
def test_what_is_wrong_is_refused(arms: ModuleType) -> None:
    """Give wrong poses on the way: refused, and the way goes on to the last good one."""
    follow, goal, grasp = ready(arms), turned((0, 0, 0.3), 1, 0.0), two_arms.grasps()
    carried(arms, follow, goal, 0.5)
    before = follow.q0
    for wrong in ({"object_pose": 2 * np.eye(4)}, {"grasp": np.zeros((2, 4, 4))}):
        with pytest.raises(ValueError, match="pose"):
            follow.step(**{"object_pose": goal, "grasp": grasp} | wrong)
    assert np.abs(follow.q0 - before).max() > 1e-5  # [rad] it went on
    carried(arms, follow, goal, 4.0)
    assert follow.error.max() < 1e-4
    for given in ({}, {"pose": goal @ grasp, "object_pose": goal, "grasp": grasp}, {"object_pose": goal}):
        with pytest.raises(TypeError, match="give pose, or object_pose and grasp"):
            follow.step(**given)


@pytest.mark.slow
def test_only_several_tips_have_the_c(arms: ModuleType) -> None:
    check_contained(CARRY, (Path(str(arms.__file__)).parent / "two_arms_follow.c").read_text())
    assert "carry" not in (ROOT / "generated" / "iiwa14" / "iiwa14_follow.c").read_text()


def test_one_tip_holds_no_object_alone(robot: ModuleType) -> None:
    follow = robot.Follow(np.zeros(7), sample_time=1e-3)
    with pytest.raises(TypeError, match="this robot has no object_pose"):
        follow.step(object_pose=np.eye(4), grasp=np.eye(4))
