# SPDX-License-Identifier: MIT
"""The parkour experiment: shift, tool and board by MuJoCo's kinematics, and faults that its bars must find."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

from examples.experiments import report, trial
from examples.experiments.command import read_traces
from examples.experiments.plant import Plant
from examples.parkour import analysis, board, trajectory
from examples.parkour.__main__ import CAPTIONS
from examples.parkour.experiment import EXPERIMENT
from examples.parkour.tool import BALL_RADIUS, TOOL_POINT
from stiffgen import open_robot


def poses(q: np.ndarray) -> np.ndarray:
    """Return the poses (N, 4, 4) [m] of the flange at postures (N, 7), by MuJoCo."""
    plant, result = Plant(), np.tile(np.eye(4), (len(q), 1, 1))
    for k, configuration in enumerate(q):
        plant.data.qpos[:] = configuration
        mujoco.mj_kinematics(plant.model, plant.data)
        site = plant.data.site("tip")
        result[k, :3, :3], result[k, :3, 3] = site.xmat.reshape(3, 3), site.xpos
    return result


def test_the_replayed_trajectory_lies_20_mm_lower(robot: ModuleType) -> None:
    """Replay in MuJoCo: 20 mm lower; the documented inverse kinematics makes the trajectory anew."""
    before, after = trajectory.recorded(), trajectory.zero_force()
    moved = poses(after[::10])[:, :3, 3] - poses(before[::10])[:, :3, 3]
    assert abs(moved[:, 2].mean() + 0.020) < 1e-4  # [m]
    assert moved[:, 2].std() < 1e-4
    made = poses(trajectory.shifted(robot, before, trajectory.DEPTH)[::10])
    np.testing.assert_allclose(made[:, :3, 3], poses(after[::10])[:, :3, 3], atol=4e-4)
    shift = trajectory.compare(robot)
    np.testing.assert_allclose(shift.mean, moved.mean(axis=0), atol=2e-5)
    assert np.degrees(shift.orientation) < 0.35 and np.degrees(shift.joints).max() < 4


def test_the_recorded_board_is_flattest_at_the_tool_point() -> None:
    recorded = poses(trajectory.recorded())
    heights = {distance: trajectory.flatness(recorded, distance) for distance in np.arange(0.0, 0.3, 0.004)}
    assert min(heights, key=lambda distance: heights[distance]) == pytest.approx(TOOL_POINT, abs=0.002)
    assert heights[min(heights, key=lambda distance: heights[distance])] < 1e-3


def test_the_board_lies_under_the_recorded_ball() -> None:
    """Compare the board's surface with the recorded path of the ball: 95 % within 1.2 mm."""
    surface = board.board()
    path = np.array(board.ball_path())
    place = (path[:, :2] - np.array(surface.centre) + surface.half) / (2 * np.array(surface.half))
    rows, columns = surface.height.shape
    column, row = np.rint(place * [columns - 1, rows - 1]).astype(int).T
    gap = path[:, 2] - BALL_RADIUS - surface.height[row, column]
    assert np.percentile(np.abs(gap), 95) < 1.2e-3 and np.abs(np.median(gap)) < 1e-4
    assert np.abs(gap).max() < 6e-3  # at the wall of an obstacle, where the ball was lifted
    wide, narrow = board.board(0.12).height, board.board(0.03).height
    assert np.sum(wide > np.median(wide) + 0.01) > 1.5 * np.sum(narrow > np.median(narrow) + 0.01)


@pytest.fixture(scope="module")
def results(parkour_results: Path) -> Path:
    return parkour_results


@pytest.fixture(scope="module")
def traces(results: Path) -> dict[str, trial.Trace]:
    return read_traces(EXPERIMENT, results)


@pytest.mark.wide(instead="test_the_replayed_trajectory_lies_20_mm_lower")
def test_report(results: Path) -> None:
    """Check the report: all bars hold, and nothing is loaded from elsewhere."""
    page = (results / "report.html").read_text()
    assert "All bars of the experiment hold." in page
    assert page.count("<svg") == len(CAPTIONS) - 2  # picture and film are no SVG
    assert page.count("Missing: ") == 2
    assert not re.search(r"(href|src)=\"(?!#|data:)", page)  # self-contained
    assert not (results / report.PICTURE).exists() and not (results / report.FILM).exists()


@pytest.mark.wide(instead="test_the_replayed_trajectory_lies_20_mm_lower")
def test_each_seeded_fault_breaks_a_bar(ball_folder: Path, traces: dict[str, trial.Trace]) -> None:
    """Mirrored sign of Gamma, wrench in tool axes, moment about the wrong point."""
    robot = open_robot(ball_folder).module
    shift = trajectory.compare(robot)

    def failed(law: str, **columns: np.ndarray) -> list[str]:
        found = analysis.findings(robot, law, {**traces[law], **columns})
        return [bar.split(":")[0] for bar in analysis.failed_bars({law: found}, shift)]

    assert [failed(law) for law in trial.LAWS] == [[]] * 4
    corrected, conventional = traces["corrected"], traces["conventional"]
    q, used = corrected["q"], corrected["wrench_used"]
    half = robot.hybrid.joint_stiffness_uncorrected(q, used, trial.TASK_STIFFNESS)
    mirrored = 2 * half - robot.hybrid.joint_stiffness(q, used, trial.TASK_STIFFNESS)
    assert failed("corrected", stiffness=mirrored) == ["symmetry of the corrected trial"]
    rotation = robot.forward_kinematics(conventional["q"])[:, :3, :3]
    force, moment = np.split(conventional["wrench"], 2, axis=1)
    in_tool_axes = np.concatenate([np.einsum("nji,nj->ni", rotation, each) for each in (force, moment)], axis=1)
    assert failed("conventional", wrench=in_tool_axes) == ["wrench in the conventional trial"]
    lever = TOOL_POINT * rotation[:, :, 2]
    at_flange = np.concatenate([force, moment + np.cross(lever, force)], axis=1)
    assert failed("conventional", wrench=at_flange) == ["wrench in the conventional trial"]
    shallow = replace(shift, mean=shift.mean + np.array([0, 0, 2e-4]))
    assert analysis.failed_bars({}, shallow)[0].startswith("shift")


@pytest.mark.wide(instead="test_the_replayed_trajectory_lies_20_mm_lower")
def test_the_cartesian_law(ball_folder: Path, traces: dict[str, trial.Trace]) -> None:
    """Compare the law at equilibrium with J^T K J and the posture's share, and its torque with the applied one."""
    robot = open_robot(ball_folder).module
    law = trial.CartesianLaw(robot, trial.TASK_STIFFNESS, trial.TASK_DAMPING, 1.0, 0.1)
    q = trajectory.START
    J = robot.hybrid.jacobian(q)
    null = np.eye(7) - np.linalg.pinv(J) @ J
    expected = J.T @ trial.TASK_STIFFNESS @ J + null
    np.testing.assert_allclose(law.stiffness(q, q), expected, atol=1e-4)
    np.testing.assert_allclose(law.torques(q, np.zeros(7), q)[0], 0, atol=1e-9)
    trace = traces["cartesian"]
    spring, damping = law.torques(trace["q"][2000], trace["dq"][2000], trace["q0"][2000])
    np.testing.assert_allclose(trace["torque"][2000], spring + damping, atol=1e-12)
    assert np.all(damping @ trace["dq"][2000] <= 0)
