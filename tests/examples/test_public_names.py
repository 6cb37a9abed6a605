# SPDX-License-Identifier: MIT
"""Examples are programs of users: they import public names, and what they write is not committed."""

from __future__ import annotations

import ast
import json
import subprocess

import pytest

import stiffgen
from support.project import ROOT

PUBLIC = {"stiffgen": {*stiffgen.__all__, "drive"}, "stiffgen.style": None}  # drive and style are modules
EXAMPLES = sorted([*ROOT.glob("examples/**/*.py"), *ROOT.glob("examples/**/*.ipynb")])


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: str(file.relative_to(ROOT / "examples")))
def test_examples_import_public_names(file):
    """Parse each example: it imports public names only, as a user can."""
    text = file.read_text()
    if file.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.split(".")[0] == "stiffgen"]
            assert set(names) <= set(PUBLIC), names
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "stiffgen":
            assert node.module in PUBLIC, node.module
            public = PUBLIC[node.module]
            assert public is None or {alias.name for alias in node.names} <= public


@pytest.mark.parametrize("example", ["bowl_wiping", "experiments", "parkour", "whole_body"])
def test_what_examples_write_is_not_committed(example):
    files = subprocess.run(
        ["git", "ls-files", f"examples/{example}"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert {file.rpartition(".")[2] for file in files} <= {"py", "md", "csv"}


def test_results_of_the_experiments_go_to_build():
    """Git ignores build/."""
    from examples.bowl_wiping.experiment import EXPERIMENT as BOWL
    from examples.parkour.experiment import EXPERIMENT as PARKOUR

    assert [str(each.results) for each in (BOWL, PARKOUR)] == ["build/bowl_wiping", "build/parkour"]
    assert 'RESULTS = Path("build/whole_body")' in (ROOT / "examples" / "whole_body" / "__main__.py").read_text()
