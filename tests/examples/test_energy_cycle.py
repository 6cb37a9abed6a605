# SPDX-License-Identifier: MIT
"""Work round closed orbits: the closed form, the gradient's zero, and what the secant law of one energy is."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from examples import energy_cycle as cycle
from stiffgen import open_robot
from support.pictures import texts_of
from support.playground import Scripts

KT, KO = cycle.TASK_STIFFNESS[:3, :3], cycle.TASK_STIFFNESS[3:, 3:]


@pytest.mark.parametrize("plane", cycle.PLANES)
def test_held_stiffness_does_the_area_integral(robot: ModuleType, plane: tuple[int, int]) -> None:
    q = cycle.centre()
    assert abs(cycle.held(robot, q, plane, 0.1, "corrected")[-1]) < 1e-12
    net = cycle.held(robot, q, plane, 0.1, "conventional")[-1]
    assert abs(net) > 0.01
    assert net == pytest.approx(cycle.area_integral(robot, q, plane, 0.1, "conventional"), rel=1e-6)


@pytest.mark.parametrize("plane", cycle.PLANES)
@pytest.mark.parametrize("radius", [0.01, 0.1, 1.0])
def test_the_gradient_does_no_work(robot: ModuleType, plane: tuple[int, int], radius: float) -> None:
    """To rounding; on the way it does."""
    done = cycle.following(robot, cycle.centre(), plane, radius, "gradient")
    assert np.abs(done).max() > 10 * radius**2
    assert abs(done[-1]) < 1e-11


def test_a_measured_wrench_works_with_the_third_power(robot: ModuleType) -> None:
    """Conventional: with the second."""
    q, radii = cycle.centre(), (0.001, 0.002)
    for law, power in (("corrected", 8), ("conventional", 4)):
        small, large = (cycle.following(robot, q, cycle.PLANES[0], radius, law)[-1] for radius in radii)
        assert large / small == pytest.approx(power, rel=0.02)


def test_the_spring_has_the_wrench_that_is_held(robot: ModuleType) -> None:
    q = cycle.centre()
    spring = (cycle.rest(robot, q), KT, KO)
    np.testing.assert_allclose(robot.spring.wrench(q, *spring), cycle.WRENCH, atol=1e-12)
    np.testing.assert_allclose(robot.spring.torque(q, *spring), -robot.hybrid.jacobian(q).T @ cycle.WRENCH, atol=1e-12)


def test_the_secant_of_one_energy_is_the_gradient_of_another(robot: ModuleType) -> None:
    """Check docs/theory.md: with F and K of U at each q, Kq (q - q0) = d((q - q0) . dU - U); not U's own gradient."""
    q0 = cycle.centre()
    spring = (robot.forward_kinematics(q0), KT, KO)

    def secant(q: np.ndarray) -> np.ndarray:
        F, K = robot.spring.wrench(q, *spring), robot.spring.task_stiffness(q, *spring)
        return np.einsum("...ij,...j->...i", robot.hybrid.joint_stiffness(q, F, K), q - q0)

    def other(q: np.ndarray) -> float:
        return float(-(q - q0) @ robot.spring.torque(q, *spring) - robot.spring.energy(q, *spring))

    q = q0 + np.array([0.3, -0.2, 0.25, 0.4, -0.3, 0.2, 0.5])
    slope = [(other(q + step) - other(q - step)) / 2e-5 for step in 1e-5 * np.eye(7)]
    np.testing.assert_allclose(secant(q), slope, atol=1e-6)
    displacement = cycle.orbit((0, 2), 0.5)
    assert abs(cycle.work(-secant(q0 + displacement), displacement)[-1]) < 1e-11
    assert np.abs(-secant(q) - robot.spring.torque(q, *spring)).max() > 5  # [N m]


def test_the_page_shows_every_law_in_both_themes() -> None:
    committed = (cycle.ROOT / "docs" / "energy_cycle.svg").read_text()
    assert "prefers-color-scheme" in committed
    assert all(law in texts_of(committed) for law in cycle.LAWS)


@pytest.mark.slow
def test_a_laps_work_on_the_playground(robot: ModuleType, robot_folder: Path, tmp_path: Path) -> None:
    """Net work of the four laws: closed form and sums of examples/energy_cycle.py."""
    scripts = Scripts(open_robot(robot_folder), tmp_path)
    q, radius = cycle.centre(), cycle.RADIUS
    tasks = [
        {"do": "loop", "q": q, "wrench": cycle.WRENCH, "gains": np.diag(cycle.TASK_STIFFNESS),
         "chosen": True, "loop": {"kind": "joints", "joints": plane, "radius": radius}}
        for plane in cycle.PLANES
    ]  # fmt: skip
    for plane, works in zip(cycle.PLANES, scripts.run(tasks), strict=True):
        conventional = cycle.area_integral(robot, q, plane, radius, "conventional")
        secant = cycle.following(robot, q, plane, radius, "corrected")[-1]
        assert works["conventional"][-1] == pytest.approx(conventional, abs=1e-12)
        assert works["secant"][-1] == pytest.approx(secant, rel=1e-5, abs=1e-8)
        assert abs(works["corrected"][-1]) < 1e-13
        assert abs(works["exact"][-1]) < 1e-13
