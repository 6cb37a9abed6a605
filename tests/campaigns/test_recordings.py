# SPDX-License-Identifier: MIT
"""The asymmetry in recordings of a real arm: on made-up recordings with known answers, and the page's table."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import stiffgen
from campaigns import recordings
from support.pictures import difference
from support.project import ROOT, URDF

FOLDER = ROOT.parent / "shared" / "data" / "recordings"
NEAR = np.array([0.3, 1.3, 0.25, -1.5, 0.1, 0.2, 0.3])
BIAS = np.array([-0.2, 0.1, 0.15, -0.5, -0.4, 0.1])
PAYLOAD = np.array([0.3, 0.004, -0.006, 0.02])
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def arm() -> ModuleType:
    return stiffgen.load(URDF, sensor=stiffgen.Sensor("link_ee", sign="environment")).module


def wrenches(time: np.ndarray) -> np.ndarray:
    """From 2 s on a wrench at the flange, base axes; the largest moment is 5 N m."""
    grown = np.clip(time - 2.0, 0.0, 1.0)[:, None]
    return np.asarray(grown * np.array([8.0, -3.0, 15.0, 0.0, -4.0, 3.0]))


def closed_form(q: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """J_r^T [m]x J_r / 2, with Pinocchio's Jacobian."""
    model = pin.buildModelFromUrdf(str(URDF))
    J = pin.computeFrameJacobian(
        model, model.createData(), q, model.getFrameId("link_ee"), pin.LOCAL_WORLD_ALIGNED
    )[3:]  # fmt: skip
    x, y, z = moment
    return np.asarray(J.T @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ J / 2)


def write(file: Path, arm: ModuleType, q: np.ndarray, contact: bool) -> None:
    """Write a recording as the group does: less the first sample, in base axes. Weight and lever by hand."""
    time = 0.005 * np.arange(len(q))
    poses = arm.forward_kinematics(q)
    R = poses[:, :3, :3]
    weight = np.einsum("kji,j->ki", R, [0.0, 0.0, -9.81])
    force, moment = PAYLOAD[0] * weight, np.cross(PAYLOAD[1:], weight)
    pressed = wrenches(time) if contact else np.zeros((len(q), 6))
    force = force + np.einsum("kji,kj->ki", R, pressed[:, :3])
    moment = moment + np.einsum("kji,kj->ki", R, pressed[:, 3:])
    reading = np.concatenate([force, moment], axis=1) + BIAS
    reading[0] += [0.1, 0.0, -0.2, 0.5, -0.3, 0.1]  # a filter that has not settled
    reading -= reading[0]
    base = np.concatenate([np.einsum("kij,kj->ki", R, part) for part in (reading[:, :3], reading[:, 3:])], axis=1)
    turns = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    head = "time f_x f_y f_z m_x m_y m_z x y z u_x u_y u_z theta".replace(" ", "\t")
    rows = np.concatenate([time[:, None], base, poses[:, :3, 3], turns / angle, angle], axis=1)
    np.savetxt(file, rows, header=head, comments="", delimiter="\t")


@pytest.fixture(scope="module")
def folder(arm: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a free and a pressed recording of 4 s (800 rows of 5 ms), with known payload and wrench."""
    path = tmp_path_factory.mktemp("recordings")
    at = 0.005 * np.arange(800)
    q = NEAR + 0.3 * np.sin(2.0 * at[:, None] * np.array([0.7, 0.5, 0.9, 0.6, 1.1, 1.3, 0.8]))
    write(path / "RobotData_Free_1.txt", arm, q, contact=False)
    write(path / "RobotData_Pressed_1.txt", arm, q, contact=True)
    return path


def test_payload_and_asymmetry_are_those_put_in(arm: ModuleType, folder: Path) -> None:
    """Recover the payload of the free recording and the asymmetry of the pressed one, both known."""
    free, pressed = (recordings.read_recording(folder / f"RobotData_{name}_1.txt") for name in ("Free", "Pressed"))
    q = recordings.solve_postures(arm, free.poses, NEAR)
    np.testing.assert_allclose(arm.forward_kinematics(q), free.poses, rtol=0, atol=1e-8)
    payload = recordings.estimate_payload(arm.sensor, q[free.settled :], free.reading[free.settled :])
    np.testing.assert_allclose(payload.values, PAYLOAD, rtol=0, atol=1e-9)
    found = recordings.analyse(arm, pressed, payload, NEAR[None])
    assert found.moment.max() == pytest.approx(5.0, abs=1e-6)  # [N m], as written by `wrenches`
    expected = closed_form(q[-1], wrenches(pressed.time)[-1, 3:])
    assert found.value[-1] == pytest.approx(np.linalg.norm(expected, 2), abs=1e-6)


def test_work_of_a_lap_is_that_of_its_area(arm: ModuleType) -> None:
    """Go round a small circle of two joints: the work is 2 pi r^2 A_ij."""
    q, angle, radius = NEAR, np.linspace(0.0, 2.0 * np.pi, 400), 1e-3
    wrench = np.array([0.0, 0.0, 0.0, 2.0, -4.0, 1.0])
    path = np.tile(q, (len(angle), 1))
    path[:, 1] += radius * np.cos(angle)
    path[:, 4] += radius * np.sin(angle)
    A = closed_form(q, wrench[3:])
    assert recordings.lap_work(arm, path, wrench) == pytest.approx(2 * np.pi * radius**2 * A[1, 4], rel=1e-3)
    assert abs(A[1, 4]) > 0.1


@pytest.mark.wide(instead="test_payload_and_asymmetry_are_those_put_in")
def test_the_page_has_what_the_recordings_show(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arm: ModuleType
) -> None:
    """Recompute the table and the figure of docs/results.md from the recordings."""
    if not FOLDER.exists():
        pytest.skip("the recordings are not committed")
    assert recordings.main([str(FOLDER), "--figure", str(tmp_path / "figure.svg")]) == 0
    page = (ROOT / "docs" / "results.md").read_text()
    (shown,) = re.findall(r"<!-- recordings -->\n(.*?)<!-- end of recordings -->", page, re.DOTALL)
    assert shown in capsys.readouterr().out
    assert (
        difference((tmp_path / "figure.svg").read_text(), (ROOT / "docs/figures/recordings.svg").read_text(), 1.0) == ""
    )


def test_without_a_folder_nothing_is_done(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert recordings.main([]) == 0
    assert recordings.main([str(tmp_path / "absent")]) == 0
    assert recordings.main([str(tmp_path)]) == 2
    assert "not committed" in capsys.readouterr().err
