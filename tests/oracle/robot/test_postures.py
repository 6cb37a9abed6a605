# SPDX-License-Identifier: MIT
"""Postures of a pose that stiffgen.find_postures finds: Pinocchio has the tip there."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from support.project import ROOT


@pytest.fixture(scope="module")
def cases(robot: ModuleType) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return starts, and postures whose poses are wanted, 0.15 rad within the limits."""
    random = np.random.default_rng(3)
    return [tuple(random.uniform(robot.LOWER + 0.15, robot.UPPER - 0.15) for _ in range(2)) for _ in range(12)]


def test_postures_have_the_tip_at_the_pose(robot: ModuleType, cases: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Each pose has a posture: it is found; all are within the limits, and apart; the nearest one comes first."""
    model = pin.buildModelFromUrdf(str(ROOT / "urdf" / "iiwa14.urdf"))
    data, tip = model.createData(), model.getFrameId("link_ee")

    def pose(q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(model, data, q)
        return np.array(data.oMf[tip].homogeneous)

    for near, goal in cases:
        found = stiffgen.find_postures(robot, pose(goal), near=near)
        assert len(found)
        assert max(np.abs(pose(q) - pose(goal)).max() for q in found) < 1e-7
        assert (found >= robot.LOWER + 0.1).all() and (found <= robot.UPPER - 0.1).all()
        away = np.linalg.norm(found - near, axis=1)
        assert (np.diff(away) >= 0).all()
        apart = np.abs(found[:, None] - found).max(axis=2) + np.eye(len(found))
        assert apart.min() > 0.1


def test_a_posture_itself_is_the_nearest(robot: ModuleType, cases: list[tuple[np.ndarray, np.ndarray]]) -> None:
    for _, goal in cases:
        found = stiffgen.find_postures(robot, robot.forward_kinematics(goal), near=goal)
        assert np.abs(found[0] - goal).max() < 1e-6


def test_what_is_no_pose_is_refused(robot: ModuleType) -> None:
    pose = robot.forward_kinematics(np.full(7, 0.4))
    left_handed, stretched = pose.copy(), pose.copy()
    left_handed[:3, 0] *= -1
    stretched[:3, :3] *= 1.01
    for wrong in (pose.T, left_handed, stretched, 1000 * pose):
        with pytest.raises(stiffgen.StiffgenError, match="the pose is none"):
            stiffgen.find_postures(robot, wrong, near=np.full(7, 0.4))


def test_what_has_no_posture(robot: ModuleType) -> None:
    """A pose out of reach has none; arguments of other shapes, or not finite, are refused."""
    far = np.eye(4)
    far[0, 3] = 3.0
    assert stiffgen.find_postures(robot, far, near=np.zeros(7)).shape == (0, 7)
    for pose, near in ((np.eye(3), np.zeros(7)), (far * np.nan, np.zeros(7)), (far, np.zeros(6)), (far, [np.nan] * 7)):
        with pytest.raises(stiffgen.StiffgenError, match="find_postures"):
            stiffgen.find_postures(robot, pose, near=near)
