# SPDX-License-Identifier: MIT
"""Commands by pose end on their pose, or say that it is out of reach (tests/campaigns/poses.py, short)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from campaigns.poses import KINDS, Arm, Target, draw
from support.project import ROOT, Once

START = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
SHOULDER = np.array([0.0, 0.0, 0.36])


@pytest.fixture(scope="module")
def arm(robot_folder: Path, once: Once) -> Arm:
    return Arm(once("poses", lambda folder: Arm(folder, robot_folder)), robot_folder)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS[:3])
def test_the_arm_rests_on_the_commanded_pose(arm: Arm, kind: str) -> None:
    """Within 0.1 mm and 0.02 degrees. Before, up to 0.9 rad away: median 3.7 mm and 1.9 degrees, singular 7 degrees."""
    for seed in range(8):
        got = arm.run(draw(np.random.default_rng([5, seed]), arm, kind), seconds=25.0)
        assert got["reached"], (seed, got)
        assert not got["last"] & (arm.status["UNREACHABLE"] | arm.status["MOVING"])


def test_posture_energy_is_no_part_of_the_energy_limit(arm: Arm) -> None:
    """A stiff posture far from the pose changes nothing. Before, at 10 N m/rad: 42 mm, at worst 357 mm."""
    target = draw(np.random.default_rng([5, 3]), arm, "near")
    far = Target("near", target.start, target.pose, np.clip(target.start + 1.0, arm.lower + 0.2, arm.upper - 0.2))
    for stiffness in (10.0, 100.0):
        assert arm.run(far, seconds=12.0, posture_stiffness=stiffness)["reached"]


def out_of_reach(arm: Arm, start: np.ndarray, farther: float) -> Target:
    """Return a pose at several times the start's distance from the shoulder."""
    pose = arm.pose(start)
    pose[:3, 3] = SHOULDER + farther * (pose[:3, 3] - SHOULDER) / np.linalg.norm(pose[:3, 3] - SHOULDER)
    return Target("far", start, pose, start)


def test_a_pose_out_of_reach_says_so(arm: Arm) -> None:
    """The tip ends at rest at the nearest point, which lies on the line from the shoulder."""
    got = arm.run(out_of_reach(arm, START, 2.0), seconds=40.0)
    assert got["last"] & arm.status["UNREACHABLE"] and not got["last"] & arm.status["MOVING"]
    assert got["speed"] < 1e-3
    assert np.abs(got["q"] - got["reference"]).max() < 1e-3
    assert np.linalg.norm(arm.pose(got["q"])[:3, 3] - SHOULDER) > 0.8


def test_a_stream_beyond_the_reach_leads_the_arm_on(arm: Arm) -> None:
    """The arm follows the direction of poses out of reach, and comes back. Before, it stood still until they did."""
    start = arm.pose(START)
    way = start[:3, 3] - SHOULDER

    def pose(time: float) -> np.ndarray:
        farther = 1.0 + 0.5 * min(time, 1.5) - 0.375 * np.clip(time - 3.5, 0.0, 2.0)
        angle = 0.4 * np.clip(time - 1.5, 0.0, 2.0)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        moved = start.copy()
        moved[:3, :3], moved[:3, 3] = turn @ start[:3, :3], SHOULDER + farther * turn @ way
        return moved

    for seconds, degrees in ((2.5, 4.0), (3.5, 4.0), (7.5, 0.1)):
        stream = [Target("far", START, pose(time), START) for time in np.arange(0.0, seconds, 0.001)]
        tip = arm.pose(arm.run(*stream, seconds=0.001)["q"])[:3, 3] - SHOULDER
        goal = stream[-1].pose[:3, 3] - SHOULDER
        cosine = tip @ goal / (np.linalg.norm(tip) * np.linalg.norm(goal))
        assert np.degrees(np.arccos(min(cosine, 1.0))) < degrees, seconds
    assert np.linalg.norm(tip - goal) < 1e-3


def test_each_pose_is_searched_for_anew(arm: Arm) -> None:
    """After a pose that is out of reach, another one is found that needs another configuration of the arm."""
    first = out_of_reach(arm, START, 2.0)
    second = draw(np.random.default_rng([9, 39]), arm, "far")
    got = arm.run(first, replace(second, posture=START), seconds=30.0)
    assert got["statuses"][0] & arm.status["UNREACHABLE"]
    assert got["reached"]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "kind"), [(17, "far"), (39, "half turn")])
def test_springs_push_no_joint_beyond_its_limit(once: Once, seed: int, kind: str) -> None:
    """Before, the springs pushed a wrist of the Panda through its soft limit zone: a position fault."""

    def make(folder: Path) -> None:
        urdf = ROOT / "tests" / "data" / "panda.urdf"
        stiffgen.generate(urdf, name="panda", tip="panda_hand", output=folder, build=False)
        Arm(folder, folder / "panda")

    folder = once("poses_panda", make)
    arm = Arm(folder, folder / "panda")
    got = arm.run(draw(np.random.default_rng([1, seed]), arm, kind), seconds=20.0)
    assert got["reason"] == 0 and got["reached"], got
