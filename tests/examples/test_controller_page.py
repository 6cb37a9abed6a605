# SPDX-License-Identifier: MIT
"""Code, pictures and numbers of docs/controller.md are right, and the tests that it names exist."""

from __future__ import annotations

import csv
import re
import subprocess
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest

from examples import controller
from support.pages import blocks
from support.project import ROOT, files_of_tests, require_compiler

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
    loaded = controller.loaded(robot)
    assert loaded["deflection"][-1] == pytest.approx(0.05, abs=0.002)
    assert not loaded["fault"].any()
    assert controller.loaded_secant(robot)[-1] > 1.8 * loaded["deflection"][-1]


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
    assert len(rows) == 3
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


def test_c_of_the_page(robot: ModuleType, tmp_path: Path) -> None:
    """The three lines compile in a function that has the structs, and initialise and step the controller."""
    (lines,) = (block.code for block in blocks(ROOT / "docs" / "controller.md") if block.language == "c")
    structs = "".join(
        f"    iiwa14_impedance_{each} {each} = {{0}};\n" for each in ("config", "state", "input", "output")
    )
    started = "code == IIWA14_OK && output.mode == IIWA14_MODE_START"
    source = tmp_path / "main.c"
    source.write_text(
        '#include "iiwa14_impedance.h"\n#include <stddef.h>\n\nint main(void)\n{\n'
        f"{structs}    int code;\n{lines}    return {started} ? 0 : 1;\n}}\n"
    )
    folder = Path(robot.__file__).parent
    sources = [str(folder / f"{name}.c") for name in ("iiwa14_impedance", "iiwa14")]
    flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    subprocess.run([require_compiler("gcc"), *flags, str(source), *sources, "-o", "a", "-lm"], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "a"], check=True)


def test_python_of_the_page(robot: ModuleType) -> None:
    """The policy port accepts each part of the proposal, and the gains are the diagonals within their limits."""
    q = np.full(7, 0.3)
    arm = robot.Impedance()
    names = {"iiwa14": robot, "np": np, "q": q, "q0": q.copy(), "dq": np.zeros(7), "now": 0.02, "stamp": 0.0}
    names |= {"controller": arm, "pose": robot.forward_kinematics(q), "K": np.diag([400, 400, 400, 20, 20, 20])}
    for block in blocks(ROOT / "docs" / "controller.md"):
        if block.what.endswith("::test_python_of_the_page"):
            exec(block.code, names)  # the page's own text
    assert not any(names["refused"])
    assert not names["out"].fault
    assert np.all(names["gains"].kp == 100)
    assert np.all(names["gains"].tau_ff == 1)
    assert 0 < names["joules"] < 0.1


def test_tests_that_the_page_names_exist() -> None:
    """The safety case stands on them: the page, and docs/hazards.csv."""
    tests = "".join(file.read_text() for file in files_of_tests())
    with (ROOT / "docs" / "hazards.csv").open() as file:
        hazards = list(csv.DictReader(file))
    assert len(hazards) == 17
    assert all(all(row.values()) for row in hazards)
    named = set(re.findall(r"\btest_\w+\b(?!\.py)", PAGE)) | set(" ".join(row["tests"] for row in hazards).split())
    assert len(named) > 40
    assert {name for name in named if f"def {name}(" not in tests} == set()
