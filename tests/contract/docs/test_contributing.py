# SPDX-License-Identifier: MIT
"""CONTRIBUTING.md, "Add a kernel", followed in a scratch copy of the package."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.pages import blocks
from support.project import ROOT, URDF

USED = """
import numpy, sys
import stiffgen
model = stiffgen.StiffnessModel(stiffgen.load_chain(sys.argv[1]))
q = numpy.linspace(-1, 1, 7)
assert float(model.tip_height(q)) == float(model.forward_kinematics(q)[2, 3])
folder = stiffgen.generate(sys.argv[1], build=False)
for file in ("iiwa14.h", "iiwa14.hpp", "iiwa14_python.c", "__init__.pyi", "README.md"):
    assert "tip_height" in (folder / file).read_text(), file
"""


def inserted(file: Path, *changes: tuple[str, str]) -> None:
    text = file.read_text()
    for before, new in changes:
        assert text.count(before) == 1, before
        text = text.replace(before, before + new)
    file.write_text(text)


@pytest.mark.slow
def test_add_a_kernel(tmp_path: Path) -> None:
    program, record = (b.code for b in blocks(ROOT / "CONTRIBUTING.md") if b.language == "python" and not b.marker)
    package = tmp_path / "stiffgen"
    shutil.copytree(ROOT / "codegen" / "stiffgen", package, ignore=shutil.ignore_patterns("__pycache__"))
    with (package / "symbolic" / "programs.py").open("a") as file:
        file.write(f"\n\nfrom stiffgen.symbolic.kinematics import Expressions\n\n\n{program}")
    kernels = package / "symbolic" / "kernels.py"
    indented = "".join(f"    {line}" for line in record.splitlines(keepends=True))
    before = "        programs.forward_kinematics,\n    )  # fmt: skip\n"
    inserted(kernels, (before, indented), ("        pose,\n", "        height,\n"))
    inserted(package / "robot" / "chain.py", ("_GROUPS_AND_KERNELS = (\n", '    "tip_height",\n'))
    inserted(package / "symbolic" / "potentials.py", ("_TAKEN = (\n", '    "tip_height",\n'))
    done = subprocess.run(
        [sys.executable, "-c", USED, str(URDF)], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
