# SPDX-License-Identifier: MIT
"""Follow the recipes of CONTRIBUTING.md in a scratch copy of the package: make the edits, then run the check."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

import pytest

from support.pages import Block, blocks
from support.project import ROOT, URDF
from support.pythons import IN_A_CHILD

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
    # Compiled modules, too: each is valid while its file is. Other processes write further ones, and rename them.
    unfinished = shutil.ignore_patterns("*.pyc.*", "*.tmp")
    shutil.copytree(ROOT / "codegen" / "stiffgen", package, ignore=unfinished)
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
from pathlib import Path
sys.dont_write_bytecode = True  # two programs may have the same size and time

def write_failing(written, urdf, kind):
    import stiffgen
    from stiffgen.cli import kinds
    from stiffgen.core.symbolic.kernels import chain_kernels
    from stiffgen.core.verify.kernels.missing import function_of_stacks
    from stiffgen.core.verify.kernels.oracles import check_robot
    if kind:
        kinds.KINDS = {kind: kinds.KINDS[kind]}
    failed = {check.kernel.partition(":")[0] for check in kinds.check_kinds(["load_stiffness"]) if not check.passed}
    chain = stiffgen.load_chain(urdf)
    (kernel,) = [each for each in chain_kernels(chain) if each.name == "load_stiffness"]
    checks = check_robot({"load_stiffness": function_of_stacks(chain, kernel)}, chain, 3, 0, None, [kernel])
    failed |= set() if all(check.passed for check in checks) else {"iiwa"}
    written.write_text("\\n".join(sorted(failed)))

urdf, kernel, *programs = sys.argv[1:]
for program, kind in zip(map(Path, programs[::2]), programs[1::2]):
    Path(kernel).write_text(program.read_text())
    in_a_child(write_failing, program.with_suffix(".txt"), urdf, kind)
"""
"""Write, of a kind of robot (or all) and the iiwa, those on which each program is found wrong."""
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
SEEN_ON = {
    "": "",
    "sign": "turning joint",
    "order of the pairs": "turning joint",
    "half of the pairs": "turning joint",
    "a slide taken for a turn": "slide before a turning joint",
    "multiplier of mimic joints": "mimic on the path",
    "joints taken for coordinates": "mimic on the path",
    "the base's connection": "floating base",
    "the base's twist": "floating base",
    "tool at run time": "tool at run time",
}
"""Kind of robot on which each fault is seen; without a fault, every kind is asked."""
FURTHER = ("order of the pairs", "half of the pairs", "joints taken for coordinates", "the base's connection")
"""Faults beyond one that every arm shows, and one for each kind of robot that an iiwa is not."""


def with_fault(text: str, fault: str) -> str:
    """Return the recipe's program with a fault; for an empty name, without one."""
    if not fault:
        return text
    old, new = FAULTS[fault]
    assert text.count(old) >= 1, fault
    return text.replace("from functools", "from dataclasses import replace\nfrom functools").replace(old, new)


@pytest.mark.slow
@pytest.mark.parametrize(
    "faults",
    [
        pytest.param([fault for fault in SEEN_ON if fault not in FURTHER], id="in CI"),
        pytest.param(FURTHER, marks=pytest.mark.wide, id="further"),
    ],
)
def test_faults_that_one_arm_does_not_have_are_seen_on_the_smallest_robots_of_every_kind(
    faults: Sequence[str], tmp_path: Path
) -> None:
    """Seed faults that an iiwa does not show (slide, mimic, moving base, tool): the smallest robots do."""
    changed_package("Add a kernel", tmp_path)
    text = (tmp_path / KERNEL).read_text()
    programs = [tmp_path / f"program{k}.py" for k in range(len(faults))]
    for program, fault in zip(programs, faults, strict=True):
        program.write_text(with_fault(text, fault))
    asked = [word for program, fault in zip(programs, faults, strict=True) for word in (str(program), SEEN_ON[fault])]
    done = run(tmp_path, "-c", IN_A_CHILD + KINDS, str(URDF), KERNEL, *asked)
    assert done.returncode == 0, done.stderr
    for program, fault in zip(programs, faults, strict=True):
        found = set(program.with_suffix(".txt").read_text().splitlines())
        assert found - {"iiwa"} == {SEEN_ON[fault]} - {""}, fault
        assert ("iiwa" in found) == (fault in list(FAULTS)[:3]), fault


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
    program.write_text(with_fault(program.read_text(), "sign"))
    code, table = verified()
    assert code == 1 and re.search(r"load_stiffness +. differentiated Jacobian +.+FAILED", table), table
