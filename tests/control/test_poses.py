# SPDX-License-Identifier: MIT
"""Commands by pose end on their pose, or say that it is out of reach (tests/campaigns/poses.py, short)."""

from __future__ import annotations

import ctypes
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from campaigns.poses import KINDS, Arm, Target, draw, errors
from support.project import ROOT, Once

START = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
SHOULDER = np.array([0.0, 0.0, 0.36])


@pytest.fixture(scope="module")
def arm(robot_folder: Path, once: Once) -> Arm:
    return Arm(once("poses", lambda folder: Arm(folder, robot_folder)), robot_folder)


def elsewhere(arm: Arm, target: Target, start: np.ndarray) -> Target:
    """Return the position that NAME_find_posture finds for a target's pose, to be commanded as q0."""
    posture = arm.find_posture(target.pose, start)
    assert posture is not None
    assert max(errors(arm.pose(posture), target.pose)) < 1e-5
    assert (posture >= arm.lower + 0.1 - 1e-12).all() and (posture <= arm.upper - 0.1 + 1e-12).all()
    return replace(target, posture=posture, by_position=True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS[:3])
def test_the_arm_rests_on_the_commanded_pose(arm: Arm, kind: str) -> None:
    """Within 0.1 mm and 0.02 degrees. Before, up to 0.9 rad away: median 3.7 mm and 1.9 degrees, singular 7 degrees."""
    for seed in range(8):
        target = draw(np.random.default_rng([5, seed]), arm, kind)
        got = arm.run(target, seconds=25.0)
        if kind == "far" and got["last"] & arm.status["UNREACHABLE"]:
            got = arm.run(target, elsewhere(arm, target, got["q"]), seconds=25.0)
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


@pytest.mark.parametrize(("seed", "length"), [(22, 0.01), (28, 0.01)], ids=["posture at its end", "arm elsewhere"])
def test_no_command_by_pose_changes_the_configuration(arm: Arm, seed: int, length: float) -> None:
    """The arm rests short of the pose, and says so; find_posture's result, commanded as q0, has the tip at the pose.

    Before, the controller found another posture by itself, and began again from the arm: up to 3.5 rad in a joint.
    """
    target = replace(draw(np.random.default_rng([9, seed]), arm, "far"), start=START, posture=START)
    got, later = (arm.run(target, seconds=seconds) for seconds in (15.0, 30.0))
    assert got["last"] & arm.status["UNREACHABLE"] and not got["last"] & arm.status["MOVING"]
    assert got["length"] > length
    assert np.abs(later["q"] - got["q"]).max() < 1e-3
    assert arm.run(target, elsewhere(arm, target, got["q"]), seconds=15.0)["reached"]


def test_what_find_posture_refuses(arm: Arm) -> None:
    """No posture, no pose, a number that is not finite, NULL: a code, and the start as the result."""
    name, upper = arm.name, arm.name.upper()
    header = (arm.folder / f"{name}_impedance.h").read_text()
    codes = {word: int(value) for word, value in re.findall(rf"{upper}_(E_\w+) = (-\d+)", header)}
    search = getattr(arm.library, f"{name}_find_posture")
    config, posture = ctypes.byref(arm.config()), np.zeros(arm.n)

    def find(pose: np.ndarray, start: np.ndarray = START) -> int:
        arrays = [np.ascontiguousarray(x, dtype=float) for x in (pose, start)]
        code = search(config, *(x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, posture)))
        assert np.array_equal(posture, start, equal_nan=True) == (code != 0)
        return int(code)

    pose = arm.pose(START + 0.3)
    assert find(pose) == 0
    assert find(out_of_reach(arm, START, 2.0).pose) == codes["E_NO_POSTURE"]
    assert find(np.full((4, 4), np.nan)) == find(2 * pose) == codes["E_POSE"]
    assert find(pose, np.full(arm.n, np.nan)) == find(pose, np.full(arm.n, np.inf)) == codes["E_POSE"]
    assert search(config, None, None, None) == codes["E_NULL"]


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
    target = draw(np.random.default_rng([1, seed]), arm, kind)
    got = arm.run(target, seconds=20.0)
    assert got["reason"] == 0 and got["last"] & arm.status["UNREACHABLE"], got
    got = arm.run(target, elsewhere(arm, target, got["q"]), seconds=20.0)
    assert got["reason"] == 0 and got["reached"], got
