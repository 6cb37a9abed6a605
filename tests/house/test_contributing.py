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
KINDS = """
import sys
import stiffgen
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_robot
from stiffgen.cli.kinds import check_kinds
failed = [check for check in check_kinds(["load_stiffness"]) if not check.passed]
print("\\n".join(sorted({check.kernel.partition(":")[0] for check in failed})))
chain = stiffgen.load_chain(sys.argv[1])
(kernel,) = [each for each in chain_kernels(chain) if each.name == "load_stiffness"]
checks = check_robot({"load_stiffness": function_of_stacks(chain, kernel)}, chain, 3, 0, None, [kernel])
print("" if all(check.passed for check in checks) else "iiwa")
"""
ORACLE = re.compile(r"^ORACLES = .*\n", re.MULTILINE)
KERNEL = "stiffgen/families/loads/kernels.py"
SUM = """
        m, rows = len(chain.joints), [joint.coordinate for joint in chain.joints]
        of_joints, S = Array("of_joints", (m, m)), ca.DM.zeros(chain.dof, m)
        for k, row in enumerate(rows):
            S[row, k] = {weight}
        return *steps(of_joints), Map("sum", Over.ONCE, Operand(result.array(chain), ""), (Operand(of_joints, ""),),
            lambda x: S @ x @ S.T)
"""
WHOLE = "    return over_joints(chain, result, steps, mirror=True)\n"
FAULTS = {
    "sign": ("ca.cross(c[:3], f)", "ca.cross(f, c[:3])"),
    "order of the pairs": ("Over.UPPER", "Over.LOWER"),
    "half of the pairs": (", mirror=True),\n", "),\n"),
    "a slide taken for a turn": (
        "ca.dot(c[3:], u)", "ca.dot(c[3:] + (1 - ca.dot(c[3:], c[3:])) * c[:3], u)"
    ),
    "multiplier of mimic joints": (WHOLE, SUM.format(weight="1").replace("        ", "    ").lstrip("\n")),
    "joints taken for coordinates": (WHOLE, "    return steps(result.array(chain))\n"),
    "the base's connection": ("*torque\n", "*pairs(output)\n"),
    "the base's twist": ("lambda c, f: ca.dot(c[:3], f))", "lambda c, f: -ca.dot(c[:3], f))"),
    "tool at run time": ('columns_of(chain, "hybrid")', 'columns_of(replace(chain, runtime_tool=False), "hybrid")'),
}  # fmt: skip
"""Faults in the recipe's program: text and its replacement. An iiwa shows the first three."""
IN_CI = ("sign", "a slide taken for a turn", "multiplier of mimic joints", "the base's twist", "tool at run time")
"""One that every arm shows, and one for each kind of robot that an iiwa is not."""


def with_fault(folder: Path, fault: str) -> None:
    """Make a fault in the recipe's program."""
    program = folder / KERNEL
    text = program.read_text().replace("from functools", "from dataclasses import replace\nfrom functools")
    old, new = FAULTS[fault]
    assert text.count(old) >= 1, fault
    program.write_text(text.replace(old, new))


def kinds_with_fault(folder: Path, fault: str) -> set[str]:
    """Return the kinds of robots on which the recipe's kernel is found wrong; with no fault for an empty name."""
    changed_package("Add a kernel", folder)
    if fault:
        with_fault(folder, fault)
    done = run(folder, "-c", KINDS, str(URDF))
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split("\n")) - {""}


@pytest.mark.slow
def test_the_recipes_kernel_is_right_on_the_smallest_robots_of_every_kind(tmp_path: Path) -> None:
    assert kinds_with_fault(tmp_path, "") == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault", [pytest.param(name, marks=() if name in IN_CI else pytest.mark.wide) for name in FAULTS]
)
def test_faults_that_one_arm_does_not_have_are_seen_on_the_smallest_robots_of_every_kind(
    fault: str, tmp_path: Path
) -> None:
    """Seed faults that an iiwa does not show (slide, mimic, moving base, tool): the smallest robots do."""
    kinds = kinds_with_fault(tmp_path, fault)
    assert kinds and ("iiwa" in kinds) == (fault in list(FAULTS)[:3])


@pytest.mark.wide(instead="test_recipe")
def test_a_kernel_with_a_new_argument_is_verified_to_the_end(tmp_path: Path) -> None:
    """The page's kernel: one folder and a line; verify and tests pass; wrong or without its oracle, verify fails.

    No file of tests has an entry for the kernel. Before, test_smallest_scope.py asked for one.
    Before, verify passed a kernel that returned y for z, since nothing asked for its oracle.
    """
    section = changed_package("Add a kernel", tmp_path)
    files = {block.what.split()[0] for block in section if block.marker == "edit"}
    assert {file.removeprefix("codegen/stiffgen/").rpartition("/")[0] for file in files} == {"core", "families/loads"}
    program, oracles = tmp_path / KERNEL, tmp_path / "stiffgen/families/loads/oracles.py"

    def verified() -> tuple[int, str]:
        chosen = ["--kernels", "load_stiffness", "--no-controller", "--output", str(tmp_path / "out")]
        made = run(tmp_path, "-c", VERIFY, "generate", str(URDF), *chosen)
        assert made.returncode == 0, made.stderr
        done = run(tmp_path, "-c", VERIFY, "verify", str(tmp_path / "out" / "iiwa14"), "--samples", "10")
        return done.returncode, done.stdout

    code, table = verified()
    assert code == 0, table
    assert re.search(r"load_stiffness +. differentiated Jacobian +.+ok", table)
    assert "certified bound of rounding" in table and "Not of this robot: slide, " in table
    chosen = (
        ["tests/core/test_ufunc.py", "-k", "load_stiffness"],
        ["tests/families/loops/test_smallest_scope.py", "-k", "kernels_of"],
        ["tests/core/test_exact_values.py"],
    )
    for tests in chosen:
        tests += ["-m", "not slow and not wide"]
        done = run(tmp_path, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests, cwd=ROOT)
        assert done.returncode == 0 and " passed" in done.stdout, done.stdout
    right = oracles.read_text()
    oracles.write_text(ORACLE.sub("ORACLES = {}\n", right))
    code, table = verified()
    assert code == 1 and re.search(r"load_stiffness +. no oracle +.+FAILED", table), table
    oracles.write_text(right)
    with_fault(tmp_path, "sign")
    assert program.read_text()
    code, table = verified()
    assert code == 1 and re.search(r"load_stiffness +. differentiated Jacobian +.+FAILED", table), table
