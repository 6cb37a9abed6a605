# SPDX-License-Identifier: MIT
"""MISRA C:2012 through cppcheck's add-on: no finding of a kind that docs/misra.csv does not argue, and no idle row."""

from __future__ import annotations

import csv
import re
import subprocess
from pathlib import Path

import pytest

from support.project import ROOT, require_program

FOLDER = ROOT / "generated" / "iiwa14"
KERNELS, CONTROLLER, PAPER = "iiwa14.c", "iiwa14_impedance.c", "iiwa14_paper.c"
NAMES = {KERNELS: "kernels", CONTROLLER: "controller", PAPER: "paper"}
# cppcheck does not read the compiler's own headers; the plain C is checked, without vectors.
DEFINED = ("STIFFGEN_NO_VECTORS", "FLT_RADIX=2", "DBL_MANT_DIG=53", "FLT_EVAL_METHOD=0")


def argued(file: str) -> set[str]:
    """The kinds of findings that the table argues for a file."""
    where = {"all", NAMES[file]}
    with (ROOT / "docs" / "misra.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert all(row["reason"] and {*row["file"].split()} <= {"all", *NAMES.values()} for row in rows)
    return {row["kind"] for row in rows if where & {*row["file"].split()}}


def found(source: Path, dump: Path) -> set[str]:
    """Return the kinds of findings in a source and the headers that it includes."""
    require_program("cppcheck", "cppcheck")
    command = ["cppcheck", "--addon=misra", "--std=c99", "--enable=warning,portability", "--inconclusive", "--quiet"]
    command += [f"--cppcheck-build-dir={dump}", "--suppress=missingIncludeSystem", "-U__GNUC__"]
    command += [*(f"-D{each}" for each in DEFINED), "--template={id}:{file}:{line}", str(source)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    kinds = set(re.findall(r"^([\w.-]+):", result.stderr, re.MULTILINE))
    return {kind.removeprefix("misra-c2012-") for kind in kinds}


@pytest.mark.slow
@pytest.mark.parametrize(
    "file",
    [pytest.param(file, marks=pytest.mark.wide if file == KERNELS else (), id=name) for file, name in NAMES.items()],
)
def test_every_finding_is_argued(file: str, tmp_path: Path) -> None:
    """Compare the findings of the MISRA checker with docs/misra.csv: no new kind, and no row without a finding."""
    files = [KERNELS, "iiwa14_batch.c"] if file == KERNELS else [file]
    kinds = set().union(*(found(FOLDER / each, tmp_path) for each in files))
    assert kinds - argued(file) == set(), "a new kind of finding: mend it, or argue it in docs/misra.csv"
    assert argued(file) - kinds == set(), "a row of docs/misra.csv that no finding has"


def test_a_new_kind_is_seen(tmp_path: Path) -> None:
    """A goto is one: the add-on is there, and does look."""
    source = tmp_path / "jump.c"
    source.write_text(
        "int jump(int x);\nint jump(int x)\n{\n    if (x > 0) { goto end; }\n    x = 1;\nend:\n    return x;\n}\n"
    )
    assert "15.1" in found(source, tmp_path) - argued(CONTROLLER)
