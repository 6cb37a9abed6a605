# SPDX-License-Identifier: MIT
"""Postures of a pose that stiffgen.find_postures finds: Pinocchio has the tip there."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace

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
    """Search postures of poses that have one: found, within limits, apart, the nearest first."""
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


def test_what_has_no_posture(robot: ModuleType) -> None:
    """A pose out of reach has none."""
    far = np.eye(4)
    far[0, 3] = 3.0
    assert stiffgen.find_postures(robot, far, near=np.zeros(7)).shape == (0, 7)


NARROW = """<robot name="narrow"><link name="b"/><link name="l1"/><link name="l2"/><link name="l3"/><link name="t"/>
<joint name="turn" type="revolute"><parent link="b"/><child link="l1"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="20" velocity="2"/></joint>
<joint name="slide" type="prismatic"><parent link="l1"/><child link="l2"/><origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="20" velocity="1"/></joint>
<joint name="finger" type="prismatic"><parent link="l2"/><child link="l3"/><origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="1"/></joint>
<joint name="f" type="fixed"><parent link="l3"/><child link="t"/><origin xyz="0.1 0 0"/></joint></robot>
"""


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """Return an arm with a finger of 0.04 m range, narrower than two margins."""
    folder = tmp_path_factory.mktemp("narrow")
    (folder / "narrow.urdf").write_text(NARROW)
    options = {"batches": False, "controller": False, "kernels": "hybrid"}
    return stiffgen.open_robot(stiffgen.generate(folder / "narrow.urdf", output=folder, tip="t", **options)).module


@pytest.mark.parametrize("margin", [0.0, 0.01, 0.1, 3.0])
def test_a_range_narrower_than_two_margins(narrow: ModuleType, margin: float) -> None:
    """Search with a finger of 0 to 0.04 m: it stays inside. Before: -0.06 m."""
    goal = np.array([0.3, 0.5, 0.015])
    found = stiffgen.find_postures(narrow, narrow.forward_kinematics(goal), near=goal, margin=margin)
    assert len(found)
    assert (found >= narrow.LOWER).all() and (found <= narrow.UPPER).all()
    quarter = np.minimum(margin, (narrow.UPPER - narrow.LOWER) / 4)
    assert (found >= narrow.LOWER + quarter).all() and (found <= narrow.UPPER - quarter).all()


@pytest.mark.parametrize("margin", [-0.1, np.nan, np.inf])
def test_a_margin_is_a_distance_within_the_limits(narrow: ModuleType, margin: float) -> None:
    """Before: a negative margin led beyond the limits, one that is no number to no posture."""
    near = np.array([0.3, 0.5, 0.02])
    with pytest.raises(stiffgen.StiffgenError, match="find_postures: margin is"):
        stiffgen.find_postures(narrow, narrow.forward_kinematics(near), near=near, margin=margin)


def test_a_start_far_beyond_the_only_limit_of_a_joint(narrow: ModuleType) -> None:
    """Start far beyond a joint's only limit: the search comes back. Before, it stayed there."""
    one_sided = SimpleNamespace(
        forward_kinematics=narrow.forward_kinematics, hybrid=narrow.hybrid,
        LOWER=np.array([-2.0, 5.0, 0.0]), UPPER=np.array([2.0, np.inf, 0.04]),
    )  # fmt: skip
    goal, near = np.array([0.3, 6.0, 0.02]), np.array([0.3, 0.0, 0.02])
    found = stiffgen.find_postures(one_sided, narrow.forward_kinematics(goal), near=near)
    assert len(found)
    assert (found >= one_sided.LOWER).all()
