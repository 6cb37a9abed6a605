"""What the pages say: programs run and print what stands below them, commands and links exist."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from stiffgen.cli import _parser as stiffgen_parser
from support.project import ROOT, require_compiler

PAGES = sorted(
    ROOT / page for page in ("README.md", "CONTRIBUTING.md", "codegen/stiffgen/emit/README.md", "urdf/README.md")
) + sorted((ROOT / "docs").glob("*.md"))
TEXTS = {page: page.read_text() for page in PAGES}
GIVEN = {
    "analyze.md": "from generated import iiwa14\nimport dask.array, numpy\nq = dask.array.zeros((4, 7))\n",
}
"""What a page's programs take for granted."""
RUN = ("frames.md", "springs.md", "embedding.md", "conventions.md", "analyze.md")
"""Pages whose Python runs here; tests of their own have start.md, README.md, derivatives.md and experiment.md."""


def programs(text: str) -> list[tuple[str, str]]:
    """Language and text of each program."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def printed(text: str, language: str) -> str:
    """What the programs in a language print, one after the other: the text that follows "prints"."""
    pattern = rf"^```{language}\n(?:(?!```).)*^```\n(?:(?!```).)*prints\n\n```text\n(.*?)^```$"
    return "".join(re.findall(pattern, text, re.MULTILINE | re.DOTALL))


def run(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_is_python_and_data_is_data(page):
    for language, code in programs(TEXTS[page]):
        assert language in ("python", "c", "cpp", "text", "console", "toml", "bash", "sh", "cmake", "json"), language
        if language == "python":
            ast.parse(code)


@pytest.mark.parametrize("name", RUN)
def test_python_runs_and_prints_what_the_page_says(name, robot_folder, tmp_path):
    text = TEXTS[ROOT / "docs" / name]
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    (tmp_path / "urdf").symlink_to(ROOT / "urdf")
    code = GIVEN.get(name, "") + "\n".join(code for language, code in programs(text) if language == "python")
    if code:
        assert run([sys.executable, "-c", code], tmp_path) == printed(text, "python")


@pytest.mark.parametrize(("language", "compiler"), [("c", "gcc"), ("cpp", "g++")])
def test_c_and_cpp_of_the_embedding_page(language, compiler, robot_folder, tmp_path):
    text = TEXTS[ROOT / "docs" / "embedding.md"]
    folder = robot_folder
    standard = {"c": "-std=c99", "cpp": "-std=c++17"}[language]
    run(["cc", "-std=c99", "-O0", "-c", str(folder / "iiwa14.c"), "-o", "kernels.o"], tmp_path)
    out = ""
    for found, code in programs(text):
        if found == language:
            (tmp_path / f"main.{language}").write_text(code)
            flags = [standard, "-Wall", "-Wextra", "-Werror", f"-I{folder}", "-isystem", "/usr/include/eigen3"]
            command = [require_compiler(compiler), *flags, f"main.{language}", "kernels.o", "-o", "a", "-lm"]
            run(command, tmp_path)
            out += run([str(tmp_path / "a")], tmp_path)
    assert out and out == printed(text, language)


def test_the_ros_page_says_that_nobody_compiled_it():
    assert "not compiled by us" in TEXTS[ROOT / "docs" / "ros2.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", TEXTS[page]):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            headings = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE)
            slugs = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in slugs, link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_targets_exist(page):
    """Every line ``stiffgen ...`` is one that the command line takes; every ``make ...`` is a target."""
    makefile = (ROOT / "Makefile").read_text()
    for line in re.findall(r"^    (?:\.venv/bin/)?(stiffgen .*|make [a-z].*)$", TEXTS[page], re.MULTILINE):
        if "..." in line:  # the rest is on the page before
            continue
        words = shlex.split(line, comments=True)
        if words[0] == "stiffgen":
            stiffgen_parser().parse_args(words[1:])
        else:
            target = next(word for word in words[1:] if "=" not in word)
            assert re.search(rf"^[^\n]*\b{re.escape(target)}\b[^\n]*:", makefile, re.MULTILINE), target
