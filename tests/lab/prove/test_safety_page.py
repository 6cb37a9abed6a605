# SPDX-License-Identifier: MIT
"""The page of ``stiffgen verify DIR --report``: targets and certified bounds as they are, or said to be missing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stiffgen.cli import main
from stiffgen.core.errors import OutputError
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.result import NO_ORACLE, Check
from stiffgen.families.rounding.certified import CERTIFIED
from stiffgen.lab.prove.safety_page import targets_for, write_page
from stiffgen.lab.prove.targets import Target, write_targets
from support.project import ROOT

FOLDER = ROOT / "generated" / "iiwa14"
TARGET = Target(
    "aarch64", "aarch64-linux-gnu-gcc 12 -O2", "qemu-aarch64", "golden values", True, 1000,
    {"hybrid_jacobian": (595, 595), "limits_torque": (229, 300)}, (8707, 69187), 264120, 36000, 56, 2736,
)  # fmt: skip


def page_of(tmp_path: Path, *checks: Check, targets: Path | None = None) -> str:
    write_page(FOLDER, checks, tmp_path / "page.html", postures=2, seed=0, urdf=None, targets=targets)
    return (tmp_path / "page.html").read_text()


def test_targets_are_shown_or_said_not_to_have_been_run(tmp_path: Path) -> None:
    """Write the page with results of other machines, one wrong, and without: numbers, or "Not run"."""
    file = tmp_path / "targets.json"
    write_targets(file, open_robot(FOLDER), [TARGET, replace(TARGET, machine="riscv64", right=False)])
    page = page_of(tmp_path, targets=file)
    for text in ("qemu-aarch64", "229 to 300", ">595<", "8707 to 69187", "264120", "golden values"):
        assert text in page, text
    assert page.count(">right<") == page.count(">WRONG<") == 1
    assert "A constant time of limits_torque: how many" in page and "(aarch64, riscv64)" in page
    assert "FAILED: values on riscv64" in page and "FAILED: values on aarch64" not in page
    without = page_of(tmp_path)
    assert "Not run." in without and "qemu" not in without
    assert "Other machines than the one that checked: none were run" in without


def test_targets_of_other_bytes_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Give results of other sources, without --report, or twice: refused (exit code 2) instead of shown."""
    file = tmp_path / "targets.json"
    write_targets(file, open_robot(FOLDER), [TARGET])
    content = json.loads(file.read_text())
    assert set(content["sources"]) == {
        file.relative_to(FOLDER).as_posix() for end in ("c", "h") for file in FOLDER.rglob(f"*.{end}")
    }
    file.write_text(json.dumps(content | {"sources": content["sources"] | {"iiwa14.c": "0" * 64}}))
    with pytest.raises(OutputError, match=r"about another iiwa14\.c"):
        targets_for(open_robot(FOLDER), file)
    assert main(["verify", str(FOLDER), "--report", str(tmp_path / "page.html"), "--evidence", str(file)]) == 2
    assert main(["verify", str(FOLDER), "--evidence", str(file)]) == 2
    assert "add --report" in capsys.readouterr().err
    twice = ["--evidence", str(file), "--evidence", str(file)]
    assert main(["verify", str(FOLDER), "--report", str(tmp_path / "page.html"), *twice]) == 2
    assert "give one of the two" in capsys.readouterr().err


def test_certified_bounds_are_shown_with_what_was_met(tmp_path: Path) -> None:
    met = Check("hybrid_jacobian", CERTIFIED, 0.0506, 1.001, errors=np.array([1e-3, 0.0506]))
    page = page_of(tmp_path, met)
    assert page.count("<rect") == 2 and ">1e0<" in page and ">1e-6<" in page, "an axis about the bound"
    row = next(line for line in page.splitlines() if "<td>hybrid_jacobian</td><td>linear rows</td>" in line)
    assert "m per rad or m" in row and "5.1e-02" in row
    assert "posture_energy" in page.partition("which have no certified bound: ")[2].partition("<")[0].split(", ")


def test_values_without_an_oracle_are_named(tmp_path: Path) -> None:
    """Before, the page said "each against an oracle of its own" of functions that had none."""
    page = page_of(tmp_path, Check("tip_height", NO_ORACLE, np.inf, 0.0, "write one"))
    assert "Values without an oracle, which nothing independent confirms: tip_height." in page
    assert "FAILED: tip_height, no oracle: write one" in page
    assert "Values without an oracle: none." in page_of(tmp_path)
