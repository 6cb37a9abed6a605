# SPDX-License-Identifier: MIT
"""The playground's arm on joint springs and its ball joint, held against NumPy, SciPy and MuJoCo's figures."""

from __future__ import annotations

import copy
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root

from stiffgen import open_robot
from support.playground import Scripts

Array = NDArray[np.float64]

POSTURE = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
GAINS = np.array([150.0, 180, 120, 160, 60, 40, 30])  # N m/rad


@pytest.fixture(scope="module")
def scripts(robot_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Scripts:
    return Scripts(open_robot(robot_folder), tmp_path_factory.mktemp("scripts"))


def rest(robot: ModuleType, force: Array, start: Array = POSTURE) -> Array:
    """Return the positions (7,) [rad] at which springs with GAINS, slack at POSTURE, bear a force (3,) [N]."""
    found = root(lambda q: GAINS * (q - POSTURE) - robot.hybrid.jacobian(q)[:3].T @ force, start, tol=1e-13)
    assert np.abs(found.fun).max() < 1e-9
    return np.asarray(found.x)


def test_compliance_is_that_of_equilibria(scripts: Scripts, robot: ModuleType) -> None:
    """Compare C with differences of places at rest, no Hessian of ours; without the load's terms it is another one."""
    force, step = np.array([15.0, -20.0, 25.0]), 1e-3  # [N]
    q = rest(robot, force)
    task = {"do": "softness", "q": q, "wrench": [*force, 0, 0, 0], "gains": GAINS}
    (found,) = scripts.run([task])

    def place(at: Array) -> Array:
        return np.asarray(robot.forward_kinematics(rest(robot, at, q)))[:3, 3]

    right = np.array([(place(force + step * axis) - place(force - step * axis)) / (2 * step) for axis in np.eye(3)]).T
    np.testing.assert_allclose(np.reshape(found["loaded"], (3, 3)), right, atol=1e-6 * np.abs(right).max())
    J = robot.hybrid.jacobian(q)[:3]
    np.testing.assert_allclose(np.reshape(found["usual"], (3, 3)), J / GAINS @ J.T, rtol=1e-12, atol=1e-15)
    assert np.abs(np.reshape(found["usual"], (3, 3)) - right).max() > 0.02 * np.abs(right).max()
    assert found["stability"] > 0


def test_an_arm_that_holds_comes_to_rest_where_the_springs_bear_the_force(scripts: Scripts, robot: ModuleType) -> None:
    force = np.array([5.0, -8.0, -12.0])
    (found,) = scripts.run([{"do": "press", "q": POSTURE, "force": force, "gains": GAINS, "seconds": 4}])
    np.testing.assert_allclose(found["q"], rest(robot, force), atol=1e-6)
    assert found["gaveWay"] is None
    moved = np.subtract(*(np.asarray(robot.forward_kinematics(q))[:3, 3] for q in (np.array(found["q"]), POSTURE)))
    assert found["ways"]["loaded"] == pytest.approx(np.linalg.norm(moved), rel=1e-12)


def test_a_straight_arm_gives_way_where_its_stiffness_is_used_up(scripts: Scripts, robot: ModuleType) -> None:
    """With a part of the gains at which it just holds, it gives way at that part of the force, and falls."""
    load = 80  # [N], towards the base
    (straight,) = scripts.run([{"do": "straight", "q": POSTURE, "strength": load}])
    q, force = np.array(straight["q"]), np.array(straight["force"])
    assert np.abs(np.degrees(q[[1, 3, 5]])).max() < 3  # [deg] nearly straight
    place = np.asarray(robot.forward_kinematics(q))[:3, 3]
    np.testing.assert_allclose(force[:3], -load * place / np.linalg.norm(place), rtol=1e-12)
    of_load = robot.hybrid.joint_stiffness(q, force, np.zeros((6, 6)))
    assert straight["critical"] == pytest.approx(np.linalg.eigvalsh(of_load)[-1], rel=1e-12)  # [N m/rad]
    share = 0.7
    gains = np.full(7, share * straight["critical"])
    (found,) = scripts.run([{"do": "press", "q": q, "force": force[:3], "gains": gains, "seconds": 4}])
    assert found["gaveWay"] == pytest.approx(share, abs=0.01)
    # Ways of the tip [m]: solved, where it falls; and by the usual formula, which sees no fall.
    assert found["ways"]["loaded"] > 0.5 and found["ways"]["usual"] < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "ratio", "angle"),
    [(0.3, 0.05, 1.15), (0.3, 0.086, 0.0017), (0.9, 0.2, 1.23), (1.8, 0.05, 3.14), (1.8, 0.2, 2.74)],
)
def test_three_drives_flutter_as_in_mujoco(scripts: Scripts, target: float, ratio: float, angle: float) -> None:
    """Angles after 6 s that MuJoCo 4.0 gave with Runge-Kutta steps of 0.2 ms; the gradients of energies rest."""
    (found,) = scripts.run([{"do": "drives", "target": target, "ratio": ratio, "seconds": 6}])
    angles = {each["law"]: each["angle"] for each in found}
    assert angles["conventional"] == pytest.approx(angle, rel=0.2)
    assert max(angles["exact"], angles["secant"]) < 1e-3


def test_the_limit_of_flutter_is_where_it_begins(scripts: Scripts) -> None:
    (limit,) = scripts.run([{"do": "limit", "target": 1.2}])
    below, above = scripts.run(
        [{"do": "drives", "target": 1.2, "ratio": share * limit, "seconds": 6} for share in (0.9, 1.1)]
    )
    assert below[0]["angle"] > 0.1
    assert above[0]["angle"] < 0.027


@pytest.mark.parametrize(("lower", "upper"), [(4.0, None), (None, -4.0), (4.0, 4.5)])
def test_a_stretched_arm_stays_within_limits_beyond_half_a_turn(scripts: Scripts, lower: Any, upper: Any) -> None:
    """Before: a range from 4 rad on ended at pi, so that the arm was stretched at pi, beyond its only limit."""
    joints = [dict(each) for each in scripts.data["coordinates"]]
    joints[1] |= {"lower": lower, "upper": upper}
    other = copy.copy(scripts)
    other.data = scripts.data | {"coordinates": joints}
    start = POSTURE.copy()
    start[1] = lower if lower is not None else upper
    (found,) = other.run([{"do": "straight", "q": start, "strength": 80}])
    assert (lower if lower is not None else -np.inf) <= found["q"][1] <= (upper if upper is not None else np.inf)
