# SPDX-License-Identifier: MIT
"""Search for a posture of a pose: found postures have the tip there within bounds, and refusals are named."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from support.pinocchio_oracle import PinocchioChain
from support.project import ROOT

START = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])


def test_found_postures_have_the_tip_at_the_pose(robot: ModuleType) -> None:
    """Search 60 random poses far from the start: all found, within 1e-5 by Pinocchio, inside the bounds."""
    arm, random = PinocchioChain((ROOT / "urdf" / "iiwa14.urdf").read_bytes(), "link_ee"), np.random.default_rng(1)
    low, high = robot.LOWER + 0.1, robot.UPPER - 0.1
    for _ in range(60):
        goal = arm.at(random.uniform(low, high)).pose
        found = robot.find_posture(goal, random.uniform(low, high))
        np.testing.assert_allclose(arm.at(found).pose, goal, atol=1e-5)
        assert (found >= low - 1e-12).all() and (found <= high + 1e-12).all()


def test_the_nearest_start_comes_first(robot: ModuleType) -> None:
    """From a posture of the pose itself the search ends there; from nearby it ends nearby."""
    near = START + 0.01 * np.arange(7)
    np.testing.assert_allclose(robot.find_posture(robot.forward_kinematics(START), START), START, atol=1e-9)
    assert np.abs(robot.find_posture(robot.forward_kinematics(START), near) - near).max() < 0.1


def test_bounds_are_kept(robot: ModuleType) -> None:
    """Bounds that leave out the elbow's posture lead to another; bounds without a posture to None."""
    pose = robot.forward_kinematics(START)
    low, high = robot.LOWER.copy(), robot.UPPER.copy()
    low[3] = 0.2  # the elbow bends to the other side
    found = robot.find_posture(pose, START, lower=low, upper=high)
    assert found[3] >= 0.2 and np.abs(robot.forward_kinematics(found) - pose).max() < 1e-5
    assert robot.find_posture(pose, START, lower=START + 0.5, upper=START + 0.6) is None


def test_refusals(robot: ModuleType) -> None:
    """Give poses out of reach, matrices that are no pose, and bad starts: None or an error, never a wrong posture."""
    pose = robot.forward_kinematics(START)
    beyond = pose.copy()
    beyond[:3, 3] *= 3.0
    assert robot.find_posture(beyond, START) is None
    for bad in (np.full((4, 4), np.nan), 2 * pose, np.diag([1.0, 1, -1, 1])):
        with pytest.raises(ValueError, match="no pose"):
            robot.find_posture(bad, START)
    for start in (np.nan, np.inf):
        with pytest.raises(ValueError, match="not finite"):
            robot.find_posture(pose, np.where(np.arange(7) == 3, start, START))
    with pytest.raises(ValueError, match="lower must not be above"):
        robot.find_posture(pose, START, lower=START, upper=START - 0.1)
    with pytest.raises(TypeError, match="no tool_pose"):
        robot.find_posture(pose, START, tool_pose=pose)
    with pytest.raises(TypeError, match="both"):
        robot.find_posture(pose, START, lower=START)
