# SPDX-License-Identifier: MIT
"""Wrenches at the tip come from generated functions: nobody moves a sensor's wrench or solves J^T F = torque anew."""

from __future__ import annotations

import re

import pytest

from support.project import ROOT

OWN = {
    "fri/client": r"jacobian",
    "fri/robot": r"\blstsq\b|linalg\.(solve|inv|pinv)\b|\bcross\(|mj_object",
    "examples/experiments": r"\blstsq\b|mj_object",
    "examples/bowl_wiping": r"\blstsq\b|linalg\.(solve|inv|pinv)\b|mj_object",
    "examples/parkour": r"\blstsq\b|linalg\.(inv|pinv)\b|mj_object",
    "codegen/stiffgen/lab/analyze": r"\blstsq\b|linalg\.(solve|inv|pinv)\b|\bcross\(",
}
"""Words of an estimate or a shift of one's own, by folder. robot.h.in passes the Jacobian to NAME_external_wrench."""
CALLS = {
    "fri/client/robot.h.in": ("_sensor_tip_wrench(", "_external_wrench("),
    "fri/client/wrench.cpp": ("robot::tip_wrench(", "robot::external_wrench("),
    "examples/experiments/plant.py": ("sensor.tip_wrench_dynamic(",),
    "codegen/stiffgen/lab/analyze/task.py": ("sensor.tip_wrench(",),
    "codegen/stiffgen/lab/calibrate/check.py": ("sensor.tip_wrench(",),
}


@pytest.mark.parametrize("folder", OWN)
def test_no_wrench_is_computed_anew(folder: str) -> None:
    files = [file for file in sorted((ROOT / folder).rglob("*")) if file.suffix in (".py", ".cpp", ".h", ".c")]
    assert len(files) >= 3
    found = [f"{file.name}: {line}" for file in files for line in file.read_text().splitlines()
             if re.search(OWN[folder], line)]  # fmt: skip
    assert found == []


@pytest.mark.parametrize("file", CALLS)
def test_the_generated_functions_are_called(file: str) -> None:
    text = (ROOT / file).read_text()
    assert all(text.count(call) == 1 for call in CALLS[file])
