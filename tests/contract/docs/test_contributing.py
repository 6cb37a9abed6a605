# SPDX-License-Identifier: MIT
"""Follow the recipes of CONTRIBUTING.md in a scratch copy of the package: make the edits, then run the check."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from support.pages import Block, blocks
from support.project import ROOT, URDF

PAGE = ROOT / "CONTRIBUTING.md"


def recipes() -> dict[str, list[Block]]:
    """Return the blocks of every section that edits the package, by its heading."""
    headings = [(k, line[3:]) for k, line in enumerate(PAGE.read_text().splitlines(), 1) if line.startswith("## ")]
    sections: dict[str, list[Block]] = {}
    for block in blocks(PAGE):
        heading = [title for line, title in headings if line < block.line][-1]
        sections.setdefault(heading, []).append(block)
    return {title: each for title, each in sections.items() if any(block.marker == "edit" for block in each)}


def edit(package: Path, block: Block) -> None:
    """Make the edit of a block: a new file, text at the end, or text below the only line with the words."""
    name, _, place = block.what.partition(" ")
    file = package / Path(name).relative_to("codegen/stiffgen")
    if place in ("", "at the end"):
        before = file.read_text() if place else ""
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(before + ("\n\n" if place else "") + block.code)
        return
    words = place.removeprefix("after ").strip("`")
    lines = file.read_text().splitlines(keepends=True)
    (at,) = [k for k, line in enumerate(lines) if words in line]
    margin = lines[at][: len(lines[at]) - len(lines[at].lstrip())] + 4 * " " * lines[at].endswith(("{\n", "(\n"))
    code = textwrap.indent(textwrap.dedent(block.code), margin)
    file.write_text("".join([*lines[: at + 1], code, *lines[at + 1 :]]))


def test_there_are_recipes() -> None:
    assert len(recipes()) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("title", recipes())
def test_recipe(title: str, tmp_path: Path) -> None:
    package = tmp_path / "stiffgen"
    shutil.copytree(ROOT / "codegen" / "stiffgen", package, ignore=shutil.ignore_patterns("__pycache__"))
    section = recipes()[title]
    for block in section:
        if block.marker == "edit":
            edit(package, block)
    check = "".join(block.code for block in section if not block.shown)
    assert check, "no code checks the recipe"
    done = subprocess.run(
        [sys.executable, "-c", check, str(URDF)], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
