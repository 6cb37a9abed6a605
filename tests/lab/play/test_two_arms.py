# SPDX-License-Identifier: MIT
"""The playground's two arms on a box: postures and work of a lap, held against the Python kernels and SciPy's law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import stiffgen
from stiffgen import open_robot
from stiffgen.lab.play.page import page_data
from support.playground import Scripts
from support.project import ROOT

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

KT, KO, POINTS = np.diag([400.0, 300, 500]), np.diag([30.0, 20, 10]), 240
START = np.array([0.2, 0.5, 0.7, -0.4, 0.6])
HANDS = ("left hand", "right-hand")


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Scripts:
    """Return the page's scripts for a dual arm with a spring between its hands."""
    folder = tmp_path_factory.mktemp("pair")
    (folder / "scripts").mkdir()
    made = stiffgen.generate(
        ROOT / "tests" / "data" / "dual_arm.urdf", output=folder, name="dual", tip=HANDS, pairs=[":".join(HANDS)],
        batches=False, controller=False,
    )  # fmt: skip
    return Scripts(open_robot(made), folder / "scripts")


@pytest.fixture(scope="module")
def held(scripts: Scripts) -> dict[str, Any]:
    (found,) = scripts.run([{"do": "grasp", "q": START, "reach": 1.0}])
    box, grasps = np.reshape(found["box"], (4, 4)), np.reshape(found["grasps"], (2, 4, 4))
    return {"q": np.array(found["q"]), "box": box, "grasps": grasps, "rest": np.linalg.inv(grasps[0]) @ grasps[1]}


def test_hands_rest_where_the_springs_have_no_torque(scripts: Scripts, held: dict[str, Any]) -> None:
    """The box is carried and turned: both hands follow to a minimum of the energy of absolute and pair."""
    robot, box = scripts.robot.module, held["box"].copy()
    box[:3, :3] = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix() @ box[:3, :3]
    box[:3, 3] += 0.05, -0.03, 0.02
    (q,) = scripts.run([{"do": "rest", "q": held["q"], "box": box.ravel(), "grasps": held["grasps"].reshape(2, 16)}])
    equilibrium = box @ held["grasps"][0]
    equilibrium[:3, 3] = (box @ held["grasps"])[:, :3, 3].mean(axis=0)
    springs = (equilibrium, held["rest"], 800 * np.eye(3), 40 * np.eye(3), KT, KO)
    assert np.abs(robot.bimanual.torque(held["q"], *springs)).max() > 1
    torque, at = robot.bimanual.torque(np.array(q), *springs), np.array(q)
    lower, upper = limits(scripts)
    bound = ((at <= lower) & (torque < 0)) | ((at >= upper) & (torque > 0))  # a limit bears what presses towards it
    assert bound.sum() <= 1
    assert np.abs(torque[~bound]).max() < 1e-5
    free = robot.bimanual.joint_stiffness(at, *springs)[np.ix_(~bound, ~bound)]
    assert np.linalg.eigvalsh(free)[0] > 0


def limits(scripts: Scripts) -> Array:
    """Return lower and upper limits of the joints (2, n)."""
    return np.array([[getattr(each, end) for each in scripts.robot.chain.coordinates] for end in ("lower", "upper")])


def usual_torque(robot: Any, q: Array, rest: Array) -> Array:
    """Return the torque of K times displacement and rotation vector of B seen from A, in the axes of rest."""
    a, b = robot.left_hand.forward_kinematics(q), robot.right_hand.forward_kinematics(q)
    seen, axes = np.linalg.inv(a @ rest) @ b, (a @ rest)[:3, :3]
    f, m = axes @ KT @ seen[:3, 3], axes @ KO @ Rotation.from_matrix(seen[:3, :3]).as_rotvec()
    on_a = np.concatenate([-f, -m - np.cross(b[:3, 3] - a[:3, 3], f)])
    J = robot.left_hand.hybrid.jacobian(q), robot.right_hand.hybrid.jacobian(q)
    return np.asarray(-J[0].T @ on_a - J[1].T @ np.concatenate([f, m]))


@pytest.mark.parametrize("radius", [0.3, 0.6])
def test_work_of_a_lap_is_that_of_the_kernels(scripts: Scripts, held: dict[str, Any], radius: float) -> None:
    """Summed in Python from torques, with velocities by Fourier; the pair's spring gives back what it took."""
    robot, rest = scripts.robot.module, held["rest"]
    task = {"do": "works", "q": held["q"], "radius": radius, "grasps": held["grasps"].reshape(2, 16), "points": POINTS}
    (found,) = scripts.run([task])
    way = np.array(found["way"])
    np.testing.assert_allclose(way[0], held["q"], atol=1e-14)
    lower, upper = limits(scripts)
    assert (way >= lower - 1e-12).all() and (way <= upper + 1e-12).all()
    waves = np.fft.rfft(way, axis=0)
    rates = np.fft.irfft(waves * 1j * np.arange(len(waves))[:, None], POINTS, axis=0)
    step = 2 * np.pi / POINTS
    usual = step * sum(usual_torque(robot, q, rest) @ dq for q, dq in zip(way, rates, strict=True))
    spent = [robot.pair.torque(q, rest, KT, KO) @ dq for q, dq in zip(way, rates, strict=True)]
    works = {law: np.array(work) for law, work in found["works"].items()}
    most = np.abs(works["exact"]).max()
    assert works["conventional"][-1] == pytest.approx(usual, abs=1e-10 * most)
    assert abs(usual) > 0.01
    assert abs(works["exact"][-1]) < 1e-12 * most
    assert abs(step * sum(spent)) < 1e-12 * most
    energy = [float(robot.pair.energy(q, rest, KT, KO)) for q in way]
    np.testing.assert_allclose(works["exact"][:-1], energy[0] - np.array(energy), atol=2e-3 * most)


def test_only_a_pair_has_the_panel(scripts: Scripts, robot_folder: Path) -> None:
    assert scripts.data["pair"]["tips"] == [0, 1]
    other = page_data(open_robot(robot_folder))
    assert "pair" not in other
    assert not any("bimanual" in name for name in other["functions"])
