# SPDX-License-Identifier: MIT
"""Follow the recipes of CONTRIBUTING.md in a scratch copy of the package: make the edits, then run the check."""

from __future__ import annotations

import os
import re
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


def changed_package(title: str, folder: Path) -> list[Block]:
    """Make the edits of a recipe in a copy of the package; return the recipe's blocks."""
    package = folder / "stiffgen"
    shutil.copytree(ROOT / "codegen" / "stiffgen", package, ignore=shutil.ignore_patterns("__pycache__"))
    section = recipes()[title]
    for block in section:
        if block.marker == "edit":
            edit(package, block)
    return section


def run(folder: Path, *command: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python with the copy of the package."""
    return subprocess.run(
        [sys.executable, *command], cwd=cwd or folder, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(folder), "CFLAGS": "-O0"},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("title", recipes())
def test_recipe(title: str, tmp_path: Path) -> None:
    check = "".join(block.code for block in changed_package(title, tmp_path) if not block.shown)
    assert check, "no code checks the recipe"
    done = run(tmp_path, "-c", check, str(URDF))
    assert done.returncode == 0, done.stderr


VERIFY = "import sys; from stiffgen.cli import main; sys.exit(main(sys.argv[1:]))"
ORACLE = re.compile(r'^    "load_energy".*\n', re.MULTILINE)


@pytest.mark.wide(instead="test_recipe")
def test_a_kernel_with_a_new_argument_is_verified_to_the_end(tmp_path: Path) -> None:
    """The page's kernel: at most two files, verify and test_ufunc pass; wrong or without its oracle, verify fails.

    Before, verify passed a kernel that returned y for z, since nothing asked for its oracle.
    """
    section = changed_package("Add a kernel", tmp_path)
    files = {block.what.split()[0] for block in section if block.marker == "edit"}
    assert len(files) <= 2 and "codegen/stiffgen/core/verify/kernels/oracles.py" in files
    program, oracles = tmp_path / "stiffgen/core/symbolic/pose.py", tmp_path / "stiffgen/core/verify/kernels/oracles.py"

    def verified() -> tuple[int, str]:
        chosen = ["--kernels", "load_energy", "--no-controller", "--output", str(tmp_path / "out")]
        made = run(tmp_path, "-c", VERIFY, "generate", str(URDF), *chosen)
        assert made.returncode == 0, made.stderr
        done = run(tmp_path, "-c", VERIFY, "verify", str(tmp_path / "out" / "iiwa14"), "--samples", "10")
        return done.returncode, done.stdout

    code, table = verified()
    assert code == 0, table
    assert re.search(r"load_energy +. product of poses +.+ok", table) and "certified bound of rounding" in table
    tests = ["tests/contract/bindings/test_ufunc.py", "-k", "load_energy"]
    done = run(tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests, cwd=ROOT)
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout
    right = oracles.read_text()
    oracles.write_text(ORACLE.sub("", right))
    code, table = verified()
    assert code == 1 and re.search(r"load_energy +. no oracle +.+FAILED", table), table
    oracles.write_text(right)
    text = program.read_text()
    program.write_text(text.replace("pose[:3, 3])", "pose[[0, 2, 1], 3])"))
    assert program.read_text() != text
    code, table = verified()
    assert code == 1 and re.search(r"load_energy +. product of poses +.+FAILED", table), table
