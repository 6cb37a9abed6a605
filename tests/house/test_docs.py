# SPDX-License-Identifier: MIT
"""Run every block of code of the pages, compare what it prints with the page, and follow every link."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import stiffgen
from campaigns.__main__ import CAMPAIGNS
from stiffgen.cli import main, parser
from stiffgen.core.symbolic.kernels import chain_kernels
from support.chains import chain_urdf
from support.pages import PAGES, Block, blocks, commands
from support.project import ROOT, files_of_tests, require_compiler, require_program

BLOCKS = {page: blocks(page) for page in PAGES}
ALL = [block for page in PAGES for block in BLOCKS[page]]
LANGUAGES = ("python", "c", "cpp", "java", "cmake", "sh", "console", "text")
MAKEFILE = (ROOT / "Makefile").read_text()
SHOWN_FIRST = ("README", "start", "embedding")
"""Pages whose commands CI runs; of the others it looks the words up."""


def of(page: Path, *languages: str) -> list[Block]:
    """The blocks of a page that run here."""
    return [block for block in BLOCKS[page] if block.language in languages and not block.marker]


def having(*languages: str) -> list[Path]:
    return [page for page in PAGES if any(block.shown for block in of(page, *languages))]


def pages(which: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("page", which, ids=lambda page: str(page.relative_to(ROOT)))


def printed(page: Path, *languages: str) -> str:
    """Return what the programs of these languages print, one after the other."""
    out, last = "", ""
    for block in BLOCKS[page]:
        if block.prints and last in languages:
            out += block.code
        last = block.language if block.shown else last
    return out


def run(command: list[str], folder: Path, **environment: str) -> str:
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
        env=os.environ | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def bare(code: str) -> str:
    """Code without comments, white space, and commas before a bracket."""
    code = re.sub(r"/\*.*?\*/|(?://|#)\s.*?$", "", code, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r",(?=[)}\]])", "", re.sub(r"\s+", "", code))


def words(text: str) -> int:
    """The number of words, those of programs and tables among them: a word has a letter or a digit."""
    return sum(
        bool(re.search("[A-Za-z0-9]", word)) for word in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).split()
    )


def test_pages_stay_few_and_short() -> None:
    """One question has one page; results, which commands write, may be long."""
    pages = [*(ROOT / "docs").glob("*.md"), ROOT / "CONTRIBUTING.md"]
    counts = {page.name: words(page.read_text()) for page in pages}
    assert len(counts) <= 23
    assert {name: count for name, count in counts.items() if count > 2500} == {"results.md": counts["results.md"]}
    assert counts["controller.md"] <= 2000 and counts["energy.md"] <= 700
    assert sum(counts.values()) + words((ROOT / "README.md").read_text()) <= 38000


def test_the_readme_shows_a_program_before_its_120th_word() -> None:
    text = (ROOT / "README.md").read_text()
    assert words(text) <= 700
    assert words(text.partition("```")[0]) < 120 and "](docs/" in text.partition("```")[0]


def test_the_readme_names_both_commands_with_needs_and_times() -> None:
    """`make test` takes the same time wherever a page or the Makefile states one."""
    readme = (ROOT / "README.md").read_text()
    for target in ("generate", "test"):
        assert re.search(rf"^\| `make {target}` \|.*\| \d+ minutes? \|$", readme, re.MULTILINE), target
    texts = {str(page.relative_to(ROOT)): page.read_text() for page in PAGES} | {"Makefile": MAKEFILE}
    stated = r"`make test`[^`\n]*?\b(\d+) minutes|^test:.*\((\d+) minutes\)"
    found = {name: [*map("".join, re.findall(stated, text, re.MULTILINE))] for name, text in texts.items()}
    times = {name: times for name, times in found.items() if times}
    assert len(times) > 2 and len({time for each in times.values() for time in each}) == 1, times


@pages(PAGES)
def test_every_block_says_its_language(page: Path) -> None:
    """Otherwise no test would run it."""
    fences = re.findall(r"^ *```(.*)$", page.read_text(), re.MULTILINE)
    assert len(fences) == 2 * sum(block.shown for block in BLOCKS[page])
    assert set(fences[::2]) <= set(LANGUAGES) and set(fences[1::2]) <= {""}


def test_a_marker_names_what_is_there() -> None:
    for block in ALL:
        if block.marker == "held by":
            file, _, test = block.what.partition("::")
            assert f"def {test}(" in (ROOT / file).read_text(), block
        elif block.marker == "quoted from":
            assert bare(block.code) in bare((ROOT / block.what).read_text()), block


@pytest.mark.slow
@pages([page for page in having("python") if page.name != "CONTRIBUTING.md"])  # tests/house/test_contributing.py
def test_python_prints_what_the_page_says(page: Path, robot_folder: Path, tmp_path: Path, request) -> None:
    """Run the Python of a page: it prints what the page shows."""
    code = "\n".join(block.code for block in of(page, "python"))
    folder = request.getfixturevalue("derived") if re.search(r"_vjp|\.jax|\.casadi", code) else robot_folder
    (tmp_path / "generated").symlink_to(folder.parent)
    for name in ("urdf", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    out = run([sys.executable, "-c", code], tmp_path, PYTHONPATH=os.pathsep.join([*sys.path, str(tmp_path)]))
    expected = printed(page, "python")
    assert out == expected or not expected


@pytest.mark.slow
@pytest.mark.parametrize(("language", "compiler"), [("c", "gcc"), ("cpp", "g++")])
def test_c_and_cpp_print_what_the_page_says(language, compiler, robot_folder, derived, tmp_path) -> None:
    """Programs are compiled and run; declarations and fragments are parts of what is generated."""
    standard = {"c": "-std=c99", "cpp": "-std=c++17"}[language]
    flags = [standard, "-Wall", "-Wextra", "-Werror", f"-I{robot_folder}", "-isystem", "/usr/include/eigen3"]
    for name in ("iiwa14", "iiwa14_batch", "iiwa14_impedance"):
        run(["cc", "-std=c99", "-O0", "-c", str(robot_folder / f"{name}.c"), "-o", f"{name}.o"], tmp_path)
    generated = bare("".join(file.read_text() for file in sorted(derived.rglob("*")) if file.suffix in (".c", ".h")))
    compiled = 0
    for page in having(language):
        out, code = "", ""
        for block in of(page, language):
            code += block.code
            if code.count("{") == code.count("}") and "int main" in code:
                (tmp_path / f"main.{language}").write_text(code)
                objects = ["iiwa14_impedance.o", "iiwa14_batch.o", "iiwa14.o", "-o", "a", "-lm"]
                run([require_compiler(compiler), *flags, f"main.{language}", *objects], tmp_path)
                out, code, compiled = out + run(["./a"], tmp_path), "", compiled + 1
            elif "int main" not in code:
                assert bare(code.replace("NAME", "iiwa14")) in generated, block
                code = ""
        assert not code
        assert out == printed(page, language)
    assert compiled >= 1


def test_c_example_is_built_as_the_page_says(robot_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    page = ROOT / "README.md"
    (tmp_path / "example.c").write_text(of(page, "c")[0].code)
    command = re.search(r"`(cc -std=c99 .*?)`", page.read_text())[1].split()
    run([*command, "-O0"], tmp_path)
    assert run(["./a.out"], tmp_path) == printed(page, "c")


def project(folder: Path, robot_folder: Path) -> None:
    """Return a scratch copy of the repository, with the files that the pages' reader is said to have."""
    shutil.copytree(robot_folder.parent, folder / "generated")
    for name in ("urdf", "tests", "examples"):
        (folder / name).symlink_to(ROOT / name)
    arm = chain_urdf("rrrrrr")
    names = re.findall(r'<link name="([^"]+)"', arm)
    for old, new in ((names[0], "base_link"), (names[-1], "tool0")):
        arm = arm.replace(f'"{old}"', f'"{new}"')
    for name in ("my_arm", "my_robot"):
        (folder / f"{name}.urdf").write_text(re.sub('<robot name="[^"]*"', f'<robot name="{name}"', arm))
    dual = (ROOT / "tests" / "data" / "dual_arm.urdf").read_text()
    soles = dual.replace('"left hand"', '"left_sole_link"').replace('"right-hand"', '"right_sole_link"')
    (folder / "robot.urdf").write_text(soles)
    columns = ["time", *(f"q_{k}" for k in range(7)), *(f"wrench_{k}" for k in range(6))]
    rows = np.random.default_rng(0).uniform(-1, 1, (50, 14))
    rows[:, 0] = 0.01 * np.arange(50)
    np.savetxt(folder / "log.csv", rows, delimiter=",", header=",".join(columns), comments="")


def check_targets(words: list[str]) -> None:
    """Words behind make: every target stands in the Makefile, and every campaign in the table of campaigns."""
    assert {word.removeprefix("NAME=") for word in words if word.startswith("NAME=")} <= {*CAMPAIGNS}
    for target in (word for word in words if "=" not in word):
        assert re.search(rf"^(?:[^\n:]* )?{re.escape(target)}\b[^\n=]*:", MAKEFILE, re.MULTILINE), target


def check_packages(words: list[str]) -> None:
    """Words behind pip or apt-get: the extras are declared; Debian's packages are those that CI installs.

    CI looks for clang beside other programs, and cmake comes from pip.
    """
    extras = re.findall(r"\[(\w+)\]", " ".join(words))
    assert all(re.search(rf"^{extra} = \[", (ROOT / "pyproject.toml").read_text(), re.MULTILINE) for extra in extras)
    if words[0] == "install" and not extras:
        installed = re.findall(r"missing\+=\((.*?)\)", (ROOT / ".ci" / "run").read_text())
        assert {"cmake", "clang", *" ".join(installed).split()} >= set(words[1:]), words


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised")
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=str(page.relative_to(ROOT)), marks=() if page.stem in SHOWN_FIRST else pytest.mark.wide)
        for page in having("sh")
    ],
)
def test_commands(page: Path, robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run each command line of the pages; those of make, pip and apt-get are looked up."""
    seen = [line for other in PAGES[: PAGES.index(page)] for block in of(other, "sh") for line in commands(block)]
    lines = [line for block in of(page, "sh") for line in commands(block) if line not in seen]
    if any(not re.match(r"make |(\S*/)?pip |apt-get ", line) for line in lines):
        project(tmp_path, robot_folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BROWSER", "true")  # that program is the browser
    monkeypatch.delenv("CFLAGS")  # a page's own flags ask for a build
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    for line in lines:
        words = shlex.split(line)
        while "=" in words[0]:
            monkeypatch.setenv(*words.pop(0).split("=", 1))
        program = Path(words[0]).name
        if program == "make":
            check_targets(words[1:])
        elif program in ("pip", "apt-get"):
            check_packages(words[1:])
        elif program == "stiffgen":
            quick = words[1] in ("generate", "new") and "CFLAGS" not in os.environ
            assert main([*words[1:], *(["--no-build"] if quick and "--no-build" not in words else [])]) == 0, line
        else:
            run([require_program(words[0], "gcc-arm-none-eabi"), *words[1:]], tmp_path / "generated" / "iiwa14")


@pages(PAGES)
def test_commands_in_sentences_exist(page: Path) -> None:
    """Commands that are held elsewhere, and those within sentences, are ones that the command line takes."""
    text = page.read_text()
    for block in BLOCKS[page]:
        for line in commands(block) if block.language == "sh" and block.marker else ():
            words = shlex.split(line)
            if Path(words[0]).name == "stiffgen" and "..." not in words:
                parser().parse_args(words[1:])
            elif words[0] == "make":
                check_targets(words[1:])
    for target, name in re.findall(r"`make ([a-z-]+)( NAME=[a-z-]+)?[` ]", text):
        check_targets([target, *name.split()])


@pages(PAGES)
def test_links_lead_somewhere(page: Path) -> None:
    """Follow the links of a page: each file and section exists."""
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        file, _, anchor = link.partition("#")
        assert file != page.name and link != "#", f"{link}: a page that links to itself names the section alone"
        target = page.parent / file if file else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            headings = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in slugs, link


def test_pages_that_the_package_names_exist():
    """Help, messages and docstrings of the package, generated texts among them."""
    named = {
        (file, page)
        for file in (ROOT / "codegen").rglob("*")
        if file.suffix in (".py", ".j2", ".c", ".h", ".html", ".js")
        for page in re.findall(r"\bdocs/[\w/]+\.md\b", file.read_text())
    }
    assert len(named) > 10
    assert [(str(file), page) for file, page in sorted(named) if not (ROOT / page).is_file()] == []


def test_an_entry_of_the_changelog_has_at_most_fifteen_words() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    entries = re.findall(r"^- (.+(?:\n  .+)*)", text, re.MULTILINE)
    assert len(entries) > 80
    assert [entry for entry in entries if len(entry.split()) > 15] == []


def test_every_test_that_the_design_names_exists():
    """Look up each test that docs/design.md names."""
    design = (ROOT / "docs" / "design.md").read_text()
    file = ""
    for named_file, test in re.findall(r"`(test_\w+\.py)?(?:::(test_\w+))?`", design):
        file = named_file or file
        if file:
            [found] = files_of_tests(file)
            source = found.read_text()
            assert not test or f"def {test}(" in source, (file, test)


def test_the_cpp_reference_has_every_function(monkeypatch: pytest.MonkeyPatch, chain: stiffgen.Chain) -> None:
    """Compare the C++ reference with the kernel table: each function and argument."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    text = import_module("pages").cpp()
    sections = dict(re.findall(r"^## `iiwa14(?:::)?(.*?)`\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    for kernel in chain_kernels(chain):
        section = sections["::".join(filter(None, (kernel.tip, kernel.group)))]
        for argument in (*kernel.arguments, *kernel.results):
            assert f"`{argument.name}`" in section, kernel.name
        assert len(re.findall(rf"\b{kernel.name}\(", section)) >= 2, kernel.name
