# SPDX-License-Identifier: MIT
"""Runs of ``stiffgen analyze`` on a drawn recording, and what they should give."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stiffgen.cli import main
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import Representation
from stiffgen.lab.analyze import measures as ms
from stiffgen.lab.analyze.analysis import checked_stiffness
from stiffgen.lab.analyze.task import Task
from support import recordings

K = (700, 700, 800, 30, 30, 30)
JOINTS = tuple(f"A{i}" for i in range(1, 8))
ROWS = recordings.draw(300)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run the command; return its exit code, output and errors."""
    code = main(["analyze", *(str(a) for a in arguments)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def command(robot_folder: Path, log: Path, *options: object, stiffness: Sequence[float] = K) -> tuple[object, ...]:
    return log, "--robot", robot_folder, "--task-stiffness", *stiffness, *options


def measured(robot: Any, rows: FloatArray, representation: Representation = "hybrid") -> dict[str, FloatArray]:
    """Return the measures of rows, without those that only a sensor has."""
    limits = np.full(7, np.inf)
    task = Task(representation, checked_stiffness(K), False, -limits, limits)
    found = zip(ms.MEASURES, ms.measured(robot, task, rows[:, 1:8], rows[:, 8:]).T, strict=True)
    return {name: values for name, values in found if not np.isnan(values).all()}


def assert_same(one: Any, other: Any, *, exact: bool = False) -> None:
    """Compare two summaries; sums may differ in the last digits where rows were added up in other groups."""
    for name, value in vars(one).items():
        if name in ("total", "squares") and not exact:
            np.testing.assert_allclose(value, getattr(other, name), rtol=1e-12, atol=1e-10)
        elif name == "envelope":
            for field, part in vars(value).items():
                tolerance = 0 if exact or field != "total" else 1e-10
                np.testing.assert_allclose(part, getattr(other.envelope, field), rtol=tolerance, atol=tolerance)
        else:
            np.testing.assert_array_equal(value, getattr(other, name), err_msg=name)


BAD = {  # line: (what stands there, category, words of the reason)
    12: ("abc", "text", "q_0 is 'abc'"),
    13: ("", "missing value", "q_0 is missing"),
    14: ("nan", "not a number", "q_0 is not a number"),
    15: ("-inf", "infinite", "q_0 is infinite"),
    16: ("1e400", "infinite", "q_0 is infinite"),
    17: ("3.8", "beyond joint limits", "q_0 is 3.8, far beyond the joint's limits -2.96706 ... 2.96706"),
    18: ("1_0", "text", "q_0 is '1_0'"),
}


def bad_csv(path: Path) -> Path:
    """Write a CSV file with one bad row of each kind, and return its path."""
    lines = recordings.write_csv(path, ROWS).read_text().split("\n")
    for line, (cell, _, _) in BAD.items():
        cells = lines[line - 1].split(",")
        lines[line - 1] = ",".join([cells[0], cell, *cells[2:]])
    lines[20 - 1] = "1,2,3"
    lines[22 - 1] = ""
    lines[24 - 1] += ",9"
    cells = lines[26 - 1].split(",")
    lines[26 - 1] = ",".join([*cells[:8], "1e308", *cells[9:]])
    path.write_text("\n".join(lines))
    return path
