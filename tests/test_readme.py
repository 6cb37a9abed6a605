"""The README's examples print what the README says, and its file names exist."""

from __future__ import annotations

import re
import subprocess
import sys

from stiffgen.emit import fields
from support.project import ROOT

README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_python_examples(robot_folder, tmp_path):
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    code, expected = "\n".join(blocks("python")), blocks("text")[0]
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == expected


def test_c_example(robot_folder, tmp_path):
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    (code,), expected = blocks("c"), blocks("text")[1]
    (tmp_path / "example.c").write_text(code)
    command = re.search(r"`(cc -std=c99 .*?)`", README)[1].split()
    subprocess.run(command, cwd=tmp_path, check=True)
    assert subprocess.run(["./a.out"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout == expected


def test_links_and_targets_exist():
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / link).exists(), link
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"(?:`|^    )make ([a-z-]+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_every_test_that_the_design_names_exists():
    design = (ROOT / "docs" / "design.md").read_text()
    file = ""
    for named_file, test in re.findall(r"`(test_\w+\.py)?(?:::(test_\w+))?`", design):
        file = named_file or file
        if file:
            [found] = (ROOT / "tests").rglob(file)
            source = found.read_text()
            assert not test or f"def {test}(" in source, (file, test)


def test_every_message_of_the_troubleshooting_page_is_one_of_ours():
    """Quoted texts are in the sources, and quoted names are those of the controller's table."""
    page = (ROOT / "docs" / "troubleshooting.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| ")]
    quoted = [text for row in rows for text in re.findall(r"`([^`]+)`", row)]
    files = [
        file
        for folder in ("codegen/stiffgen", "examples/fri_client")
        for file in (ROOT / folder).rglob("*")
        if file.is_file()
    ]
    sources = "".join(file.read_text() for file in files if file.suffix in (".py", ".j2", ".c", ".cpp", ".h"))
    sources = re.sub(r'"\s*\n\s*f?"', "", sources)  # literals over several lines
    names = {name.upper() for name, *_ in (*fields.REASONS, *fields.STATUS)}
    assert len(quoted) > 20
    for text in quoted:
        if text.isupper():
            assert text in names, text
        else:
            assert text in sources, text
