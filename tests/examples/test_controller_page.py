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


def test_figures_are_those_of_the_page() -> None:
    """Text; coordinates may differ in the last digits from machine to machine."""
    pytest.importorskip("matplotlib")
    for name, svg in controller.draw().items():
        committed = (ROOT / "docs" / name).read_text()
        assert words(svg) == words(committed), f"{name}: python -m examples.controller"
        assert "prefers-color-scheme" in committed
        assert f"]({name})" in PAGE


def test_c_of_the_page(robot: ModuleType, tmp_path: Path) -> None:
    """Compile the page's three lines of C, and run them."""
    (lines,) = (block.code for block in blocks(ROOT / "docs" / "controller.md") if block.language == "c")
    structs = "".join(
        f"    iiwa14_impedance_{each} {each} = {{0}};\n" for each in ("config", "state", "input", "output")
    )
    started = "code == IIWA14_OK && output.mode == IIWA14_MODE_START"
    stated = "".join(
        f"    config.{name} = {value};\n"
        for name, value in (
            ("sample_time", 1e-3), ("delay_samples", 0), ("heaviest_wrench[0]", 80), ("heaviest_wrench[1]", 15),
            *((f"motor_inertia[{i}]", 0.3) for i in range(7)),
        )
    )  # fmt: skip
    first, rest = lines.split("\n", 1)
    source = tmp_path / "main.c"
    source.write_text(
        '#include "iiwa14_impedance.h"\n#include <stddef.h>\n\nint main(void)\n{\n'
        f"{structs}    int code;\n{first}\n{stated}{rest}    return {started} ? 0 : 1;\n}}\n"
    )
    folder = Path(robot.__file__).parent
    sources = [str(folder / f"{name}.c") for name in ("iiwa14_impedance", "iiwa14")]
    flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    subprocess.run([require_compiler("gcc"), *flags, str(source), *sources, "-o", "a", "-lm"], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "a"], check=True)


def test_python_of_the_page(robot: ModuleType) -> None:
    """Run the page's ten lines: the arm stays, and Follow rests at its pose."""
    q, sent = np.full(7, 0.3), []
    names = {
        "iiwa14": robot,
        "np": np,
        "q": q,
        "q0": q.copy(),
        "pose": robot.forward_kinematics(q),
        "send": sent.append,
    }
    names["send"] = sent.append
    names |= {"Kt": np.diag([400.0] * 3), "Ko": np.diag([20.0] * 3), "gravity_torque": np.full(7, 0.25)}
    names["samples"] = [(q, np.zeros(7))] * 50
    for block in blocks(ROOT / "docs" / "controller.md"):
        if block.what.endswith("::test_python_of_the_page"):
            exec(block.code, names)  # the page's own text
    assert not names["out"].fault
    np.testing.assert_allclose(sent[-1], 0.25, atol=1e-9)
    np.testing.assert_allclose(names["q0"], q, atol=1e-9)


def test_length() -> None:
    assert len(PAGE.split()) <= 2000


def test_tests_that_the_page_names_exist() -> None:
    """Look up the tests that the safety case names, on the page and in docs/hazards.csv."""
    tests = "".join(file.read_text() for file in files_of_tests())
    with (ROOT / "docs" / "hazards.csv").open() as file:
        hazards = list(csv.DictReader(file))
    assert len(hazards) == 18
    assert all(all(row.values()) for row in hazards)
    named = set(re.findall(r"\btest_\w+\b(?!\.py)", PAGE)) | set(" ".join(row["tests"] for row in hazards).split())
    assert len(named) > 2 * len(hazards)
    assert {name for name in named if f"def {name}(" not in tests} == set()
