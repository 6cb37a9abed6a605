# SPDX-License-Identifier: MIT
"""The pictures of docs/controller.md show what the page says, and the page names tests that exist."""

from __future__ import annotations

import re
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest

from examples import controller
from support.project import ROOT

PAGE = (ROOT / "docs" / "controller.md").read_text()


def words(svg: str) -> list[str]:
    return ["".join(each.itertext()) for each in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


def test_jump_and_load(robot: ModuleType) -> None:
    moved = controller.jump(robot)
    assert not moved["fault"].any()
    assert moved["energy"].max() == pytest.approx(0.05, abs=0.005)
    at_once = robot.spring.energy(
        controller.Q0,
        robot.forward_kinematics(controller.Q0 + controller.JUMP),
        controller.TRANSLATION,
        controller.ROTATION,
    )
    assert at_once == pytest.approx(26.3, abs=0.1)
    assert np.abs(moved["dq"][:, 1]).max() < 0.5 * robot.VELOCITY[1]
    potential, paper = (controller.loaded(robot, law) for law in ("potential", "paper"))
    assert potential["deflection"][-1] == pytest.approx(0.05, abs=0.002)
    assert not potential["fault"].any()
    assert paper["fault"][-1]
    assert paper["deflection"][-1] > 0.1


def test_figures_are_those_of_the_page(robot: ModuleType) -> None:
    """Text; coordinates may differ in the last digits from machine to machine."""
    pytest.importorskip("matplotlib")
    for name, svg in controller.draw(robot).items():
        committed = (ROOT / "docs" / name).read_text()
        assert words(svg) == words(committed), f"{name}: python -m examples.controller --figures"
        assert "prefers-color-scheme" in committed
        assert f"]({name})" in PAGE


def test_what_a_tank_covers(robot: ModuleType) -> None:
    """The page's table, from R <= 0.7 tank with three missed samples a fault; the controller agrees just beside it."""
    rows = re.findall(r"^\| (\d+)(?: \(default\))? \| (\d+) \| (\d+) \| (\d+) \|$", PAGE, re.MULTILINE)
    assert len(rows) == 6
    rate, m = 10 * robot.EFFORT, 3

    def covered(tank: float, joints: list[int], slow: float) -> float:
        a = sum(robot.VELOCITY[j] * m / (2 * slow * rate[j]) for j in joints)
        b = sum(robot.VELOCITY[j] * m * m * 1e-3 for j in joints)
        return float((-b + np.sqrt(b * b + 4 * a * 0.7 * tank)) / (2 * a))

    for tank, *torques in rows:
        for torque, (joints, slow) in zip(torques, (([1], 1.0), ([1, 3], 1.0), ([1], 0.1)), strict=True):
            assert round(covered(float(tank), joints, slow)) == int(torque)
    q = np.array([0.0, 0.5, 0, -1.0, 0, 0.5, 0])
    soft, k = {"translation_stiffness": np.eye(3) * 1e-9, "rotation_stiffness": np.eye(3) * 1e-9}, 10_000.0
    for share, limited in ((0.98, False), (1.3, True)):
        arm = robot.Impedance(
            posture_stiffness=k * np.eye(7)[1],
            motor_inertia=1.0,
            energy_limit=100.0,
            engagement_limit=100.0,
            tank_initial=10.0,
        )
        away = share * covered(10.0, [1], 1.0) / k
        for _ in range(1500):
            out = arm.step(q=q, dq=np.zeros(7), q0=q + away * np.eye(7)[1], **soft)
        assert bool(out.status & robot.Status.RESERVE) == limited
        assert not out.fault
