# SPDX-License-Identifier: MIT
"""Stage the site's pages: the repository's files at their own paths, and a reference made from the tables."""

from __future__ import annotations

import base64
import csv
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import stiffgen
from stiffgen.control.core import config, signals, words
from stiffgen.control.core.field import Field
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.lab.play.page import write_page

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "GENERATED_CODE.md", "docs/*.md", "docs/*.svg", "docs/*.png",
    "docs/figures/*.svg", "urdf/README.md", "benchmarks/RESULTS.md", "benchmarks/*.svg", "CITATION.cff", "docs/*.csv",
    "docs/receipts/*.json",
    "codegen/stiffgen/core/emit/README.md", "ros2/stiffgen_ros2/README.md", ".github/*.md",
)  # fmt: skip
CONTENTS = {
    "Begin": (
        "docs/start", "docs/wrench", "docs/robots", "docs/words",
    ),
    "Understand": ("docs/theory", "docs/whole_body", "docs/loops", "docs/compliance"),
    "Use": (
        "docs/embedding", "docs/derivatives", "docs/controller", "docs/policies", "docs/ros2", "docs/fri",
        "docs/analyze",
    ),
    "Evidence": ("docs/results", "docs/performance", "docs/guarantees"),
    "Reference": ("reference/python", "reference/command_line", "reference/functions"),
    "Change the generator": ("docs/design", "CONTRIBUTING", "CHANGELOG"),
}  # fmt: skip
"""The sidebar, in the order of docs/README.md."""
BELOW = {
    "docs/theory": ("docs/flutter",),
    "docs/start": (
        "notebooks/first_steps", "notebooks/my_robot", "notebooks/springs_and_orbits", "notebooks/tuning",
    ),
    "docs/robots": ("urdf/README",),
    "docs/controller": ("docs/energy", "reference/hazards"),
    "docs/ros2": ("ros2/stiffgen_ros2/README",),
    "docs/performance": ("benchmarks/RESULTS",),
    "docs/guarantees": ("reference/misra",),
    "reference/functions": ("reference/controller", "reference/faults", "reference/cpp"),
    "docs/design": (
        "docs/README", "codegen/stiffgen/core/emit/README", "GENERATED_CODE", ".github/SUPPORT", ".github/SECURITY",
        ".github/CODE_OF_CONDUCT",
    ),
}  # fmt: skip
"""Pages that the sidebar shows below another page."""
GROUPS = {
    "body": "Body representation: tip axes, at the tip's origin",
    "spatial": "Spatial representation: base axes, at the base's origin",
    "hybrid": "Hybrid representation: base axes, at the tip's origin",
}


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    """Return a Markdown table; bars in cells are escaped."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def shape(argument: Argument, chain: Chain) -> str:
    """Return the shape as ``6 x 7``, or ``1`` for a number."""
    return " x ".join(map(str, argument.array(chain).shape)) or "1"


def function(kernel: Kernel, chain: Chain) -> str:
    """Return a kernel's section: meaning, equation, names in C and Python, arguments and results."""
    names = ", ".join(argument.name for argument in kernel.arguments)
    path = ".".join(("iiwa14", *kernel.path, kernel.name))
    results = ", ".join(argument.name for argument in kernel.results)
    rows = [
        (way, f"`{argument.name}`", shape(argument, chain), argument.unit, argument.meaning)
        for way, arguments in (("in", kernel.arguments), ("out", kernel.results))
        for argument in arguments
    ]
    note = f"\n{kernel.note}\n" if kernel.note else ""
    many = " and ".join(f"`iiwa14_{kernel.qualified_name}{each.suffix}`" for each in kernel.batches)
    batch = f"; for many configurations {many}" if many else ""
    packed = f", for upper triangles `iiwa14.packed.{kernel.qualified_name}`" if kernel.packed else ""
    return (
        f"### {kernel.qualified_name}\n\n{kernel.summary}\n\n`{kernel.equation}`\n{note}\n"
        f"Python: `{path}({names})`{packed}, C: `iiwa14_{kernel.qualified_name}({names}, {results})`{batch}.\n\n"
        + table(("", "name", "shape", "unit", "meaning"), rows)
    )


def functions() -> str:
    """Return the page of functions: the kernel table of a robot with all springs."""
    chain = stiffgen.load_chain(ROOT / "urdf" / "iiwa14.urdf")
    springs = KernelOptions(springs=KINDS)
    parts = [
        "# Functions of a robot\n\n"
        "Of the iiwa 14, with every spring that `--spring` knows; another robot has another number of joints, and its "
        "own name for `iiwa14`. Units are SI and radians, matrices row-major. Wrenches are those that **the "
        "environment applies to the robot**. In Python leading dimensions broadcast, in C one call takes one "
        "configuration. NaN or infinity in an argument gives NaN in every entry that depends on it.\n"
    ]
    group: str | None = ""
    for kernel in sorted(chain_kernels(chain, springs), key=lambda kernel: kernel.group is not None):
        if kernel.group != group:
            group = kernel.group
            parts.append(f"## {GROUPS.get(group or '', f'`{group}`') if group else 'Pose and masses'}\n")
        parts.append(function(kernel, chain))
    return "\n".join(parts)


def extent(field: Field) -> str:
    """Return the shape as ``tips x 3 x 3``, or ``1`` for a number."""
    return " x ".join(map(str, field.shape)) or "1"


def controller() -> str:
    """Return the page of the controller's fields: configuration, input and output of a step."""

    def row(field: Field) -> tuple[str, ...]:
        default = f"default `{field.default.format(name='NAME', i='i')}`" if field.default else "must be stated"
        rule = f"; {field.rule}; {default}; {field.reason}" if field.reason else ""
        return f"`{field.name}`", extent(field), field.unit, field.meaning + rule

    def tables(sections: Iterable[tuple[str, Sequence[Field]]]) -> str:
        return "\n".join(
            f"{heading}\n\n{table(('field', 'shape', 'unit', 'meaning'), map(row, which))}"
            for heading, which in sections
        )

    settings, results = tables(config.CONFIG_SECTIONS), tables(signals.OUTPUT_SECTIONS)
    given = table(("field", "shape", "unit", "meaning"), map(row, signals.INPUT))
    return (
        "# Fields of the controller\n\n"
        "The members of `NAME_impedance_config`, `NAME_impedance_input` and `NAME_impedance_output`; in Python the "
        "same names, by keyword. n is the number of coordinates; the extent `tips` is left out where there is one. "
        "[The controller's page](../docs/controller.md) has the law.\n\n"
        f"## Configuration\n\n{settings}\n## Input of a step\n\n{given}\n## Output of a step\n\n{results}"
    )


def faults() -> str:
    """Return the page of modes, faults with their reasons, status bits and errors."""
    reasons = [
        (f"`{name}`", cause, dict(words.FAULTS)[cause], meaning)
        for name, cause, meaning in words.REASONS
        if name != "none"
    ]
    pairs = {
        title: [(f"`{name}`", meaning) for name, meaning in which]
        for title, which in (
            ("Modes", words.MODES), ("Status bits", words.STATUS),
            ("Errors beyond single fields", words.ERRORS),
        )
    }  # fmt: skip
    sections = "\n".join(f"## {title}\n\n{table(('name', 'meaning'), rows)}" for title, rows in pairs.items())
    return (
        "# Status, faults, errors\n\n"
        "In C each name has the robot's prefix (`IIWA14_STATUS_MOVING`); in Python they are members of enumerations."
        "\n\n"
        f"## Reasons of faults\n\n{table(('reason', 'class', 'class means', 'meaning'), reasons)}\n{sections}"
    )


def declarations(text: str) -> Iterator[tuple[str, list[str], str]]:
    """Yield the declarations of a C++ header: namespace, comment, and declaration without its body."""
    place: list[str] = []
    comment: list[str] = []
    declared, inside = "", False
    for line in map(str.strip, text.splitlines()):
        if line.startswith("/**"):
            comment, inside = [], True
        elif inside:
            comment.append(line.removeprefix("*").removeprefix(" "))
            inside = "*/" not in line
        elif line.startswith("/// "):
            comment.append(line.removeprefix("/// "))
        elif comment and comment[0].startswith("@file"):
            comment = []
        elif comment:
            declared = f"{declared} {line}".strip()
            if end := re.search(r"[;{]|(?<=noexcept) : ", declared):
                yield "::".join(place), [each for each in comment if each != "/"], declared[: end.start()].strip()
                comment, declared = [], ""
        elif re.match(r"(inline constexpr|explicit) ", line):  # under the comment of the one before it
            yield "::".join(place), [], re.split(r"[;{]|(?<=noexcept) : ", line)[0].strip()
        elif found := re.match(r"namespace ([\w:]+) \{$", line):
            place.append(found[1])
        elif line.startswith("} // namespace"):
            place.pop()


def cpp() -> str:
    """Return the page of NAME.hpp: every comment of the header with the declaration that follows."""
    text = (ROOT / "generated" / "iiwa14" / "iiwa14.hpp").read_text()
    text = re.sub(r"^/// Implementation of Input.*?^\} // namespace detail$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^private:\n.*?^\};$", "", text, flags=re.MULTILINE | re.DOTALL)
    about = re.search(r" \* Every function has two overloads.*?(?=^ \*/)", text, re.MULTILINE | re.DOTALL)
    assert about is not None
    intro = re.sub(r"^ [*] ?", "", about[0], flags=re.MULTILINE).replace("  - ", "- ")
    parts = [
        "# C++: NAME.hpp\n\nOf the iiwa 14; another robot has its own name for `iiwa14`. "
        f"[Embedding](../docs/embedding.md) has a program.\n\n{intro}"
    ]
    sections: dict[str, list[str]] = {}
    for place, comment, declaration in declarations(text):
        section = sections.setdefault(place, [f"## `{place}`\n"])
        said, *given = re.split(r"^@param", "\n".join(comment).replace("@brief ", ""), flags=re.MULTILINE)
        rows = []
        for each in given:
            way, name, extents, unit, meaning = re.findall(  # [in] q (7) [rad]: meaning
                r"\[(\w+)\] (\w+)(?: \(([^)]*)\))?(?: \[([^]]*)\])?: (.*)", " ".join(each.split())
            )[0]
            rows.append((way, f"`{name}`", extents or "1", unit, meaning))
        section.append(f"```cpp\n{declaration}\n```\n\n{said.strip()}\n")
        section += [table(("", "name", "shape", "unit", "meaning"), rows)] if rows else []
    return "\n".join([*parts, *itertools.chain(*sections.values())])


def python() -> str:
    """Public names of the package, for Sphinx' autodoc."""
    parts = ["# The generator in Python\n"]
    for name in (name for name in stiffgen.__all__ if not name.startswith("__")):
        kind, members = ("class", "   :members:\n") if isinstance(getattr(stiffgen, name), type) else ("function", "")
        parts.append(f"```{{eval-rst}}\n.. auto{kind}:: stiffgen.{name}\n{members}```\n")
    return "\n".join(parts)


def records(name: str) -> list[dict[str, str]]:
    """Return the rows of a CSV file of docs/."""
    with (ROOT / "docs" / name).open() as file:
        return list(csv.DictReader(file))


def hazards() -> str:
    """Return the page of the controller's hazards: a section each, since names of tests are wide."""
    parts = [
        "# Hazards of the controller\n\n"
        "[The controller's page](../docs/controller.md#faults) has the classes of faults.\n"
    ]
    for row in records("hazards.csv"):
        tests = ", ".join(f"`{test}`" for test in row["tests"].split())
        parts.append(
            f"## {row['hazard'].capitalize()}\n\n- *Cause*: {row['cause']}\n- *What the code does*: {row['control']}\n"
            f"- *Tests*: {tests}\n- *Left to the integrator*: {row['left to the integrator']}\n"
        )
    return "\n".join(parts)


def misra() -> str:
    """Return the page of MISRA's findings: the table that the tests compare with cppcheck."""
    return (
        "# Findings of MISRA C:2012\n\n"
        "In the C of a folder, with the reason why each kind is accepted "
        "([guarantees](../docs/guarantees.md#misra-c-2012)). "
        "Numbers are the standard's rules; words are cppcheck's own checks.\n\n"
        + table(("kind", "file", "finding", "reason"), (tuple(row.values()) for row in records("misra.csv")))
    )


def help_of(*command: str) -> str:
    """Return the page of the command line: the help of every command."""
    environment = os.environ | {"COLUMNS": "96", "NO_COLOR": "1"}
    run = [sys.executable, "-m", "stiffgen.cli", *command, "--help"]
    return subprocess.run(run, check=True, capture_output=True, text=True, env=environment).stdout


def command_line() -> str:
    """Help of every command."""
    overview = help_of()
    names = re.findall(r"^ {4}([a-z]+) ", overview, re.MULTILINE)
    parts = [f"# Command line\n\n```text\n{overview}```\n"]
    parts += [f"## stiffgen {name}\n\n```text\n{help_of(name)}```\n" for name in names]
    return "\n".join(parts)


def contents(pages: Iterable[str], caption: str = "") -> str:
    """Return a part of the sidebar."""
    entries = "".join(f"/{page}\n" for page in pages)
    return f"```{{toctree}}\n:hidden:\n{caption}\n{entries}```\n"


def index() -> str:
    """Return the first page: the README and the table of contents."""
    parts = [(ROOT / "README.md").read_text()]
    parts += [contents(pages, f":caption: {part}\n") for part, pages in CONTENTS.items()]
    return "\n".join(parts)


def notebook(file: Path, folder: Path) -> str:
    """Return a notebook as a page: its texts, code and outputs; pictures go into the folder."""
    book, parts = json.loads(file.read_text()), []
    for number, cell in enumerate(book["cells"]):
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        for output in cell.get("outputs", ()):
            if "text" in output:
                parts.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
            elif "image/png" in output["data"]:
                picture = f"{file.stem}_{number}.png"
                (folder / picture).write_bytes(base64.b64decode("".join(output["data"]["image/png"])))
                parts.append(f"![Output of the cell above]({picture})")
    return "\n\n".join([*parts, f"*This page is the notebook `{file.relative_to(ROOT)}` with its outputs.*\n"])


def playground(folder: Path) -> None:
    """Put the iiwa 14's page among what goes into the site as it is, with a link to it, where it can be compiled."""
    if not (shutil.which("clang") and shutil.which("wasm-ld")):
        print("no clang or wasm-ld: the site goes without the playground itself")
        return
    page = write_page(ROOT / "generated" / "iiwa14", folder / "as_it_is" / "playground" / "iiwa14.html")
    with (folder / "docs" / "start.md").open("a") as text:
        text.write(f'\n<p><a href="../playground/{page.name}">The iiwa 14 to play with</a></p>\n')


def stage(folder: Path) -> None:
    """Write every page into a folder, which is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    for pattern in PAGES:
        for file in sorted(ROOT.glob(pattern)):
            target = folder / file.relative_to(ROOT)
            target.parent.mkdir(parents=True, exist_ok=True)
            if file.suffix == ".md":
                target.write_text(file.read_text().replace("(../README.md", "(../index.md"))
            else:
                shutil.copyfile(file, target)
    (folder / "index.md").write_text(index())
    (folder / "notebooks").mkdir()
    for file in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        (folder / "notebooks" / f"{file.stem}.md").write_text(notebook(file, folder / "notebooks"))
    (folder / "reference").mkdir()
    for page in (functions, controller, faults, cpp, python, hazards, misra, command_line):
        (folder / "reference" / f"{page.__name__}.md").write_text(page())
    for above, below in BELOW.items():
        with (folder / f"{above}.md").open("a") as text:
            text.write(f"\n{contents(below)}")
    playground(folder)
