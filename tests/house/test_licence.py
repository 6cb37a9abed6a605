# SPDX-License-Identifier: MIT
"""Every source begins with its licence, but what becomes part of generated code, which belongs to its user."""

from __future__ import annotations

import difflib
import importlib.metadata
import re
import subprocess
import sys
from pathlib import PurePath

import pytest

from stiffgen.core.emit.backend import OF_ITS_USER
from support.project import ROOT

COMMENTS = {
    "#": (".py",), "//": (".js", ".cpp", ".hpp", ".cu"), "/*": (".c", ".h", ".css"), "<!--": (".html",),
}  # fmt: skip
BEGIN = {suffix: comment for comment, suffixes in COMMENTS.items() for suffix in suffixes}
OF_THE_USER = re.compile(
    r"generated/|codegen/stiffgen/(control/(core/library|loops|paper|python)|core/emit/\w+/library"
    r"|(\w+/)*(templates|wrappers))/"
    r"|codegen/stiffgen/control/(carry|follow|policy|gains|posture|settle|press|shared)/\w+\.[ch]$"
)


def sources() -> list[str]:
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"]
    files = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\n")
    return [file for file in files if PurePath(file).suffix in BEGIN and (ROOT / file).exists()]


def test_every_source_begins_with_its_licence() -> None:
    """Read the first lines of our sources: each states its licence."""
    ours = [file for file in sources() if not OF_THE_USER.match(file)]
    assert len(ours) > 250
    for file in ours:
        first = [
            line for line in (ROOT / file).read_text().splitlines()[:2] if not line.startswith(("#!", "<!doctype"))
        ]
        assert re.match(r"(#|//|/\*|<!--) SPDX-License-Identifier[:] MIT\b", first[0]), file


def test_what_belongs_to_its_user_does_not() -> None:
    """REUSE.toml says it for these; the generator's output must not carry the generator's licence."""
    theirs = [file for file in sources() if OF_THE_USER.match(file)]
    assert len(theirs) > 10
    assert [file for file in theirs if "SPDX-License-Identifier" in (ROOT / file).read_text()] == []


def words(text: str) -> list[str]:
    """Return the words of a licence from its first condition, without the lines of title and copyright."""
    return re.findall(r"[a-z]+", text[text.index("Permission is hereby") :].lower())


def test_the_licence_is_mit_alone() -> None:
    """Hosts recognise a licence from 98 % of its words on: as a set, and here in their order, too."""
    ours = words((ROOT / "LICENSE").read_text())
    (file,) = (file for file in importlib.metadata.files("pytest") or () if file.name == "LICENSE")
    mit = words(file.read_text())
    assert len(mit) > 150
    assert difflib.SequenceMatcher(None, ours, mit).ratio() > 0.98
    assert 2 * len(set(ours) & set(mit)) / (len(set(ours)) + len(set(mit))) > 0.98
    assert (ROOT / "LICENSE").read_text().startswith("MIT License\n\nCopyright (c) ")


def test_generated_code_says_whose_it_is() -> None:
    """Read the first line of each generated text: it states whose the code is."""
    folder = ROOT / "generated" / "iiwa14"
    files = [file for file in sources() if file.startswith("generated/iiwa14/")] + [
        f"generated/iiwa14/{name}" for name in ("README.md", "CMakeLists.txt", "pyproject.toml")
    ]
    assert len(files) > 20 and folder.exists()
    assert [file for file in files if OF_ITS_USER not in (ROOT / file).read_text().partition("\n")[0]] == []
    page = (ROOT / "GENERATED_CODE.md").read_text()
    assert all(word in page for word in ("used, changed and licensed in any way", "belongs to the user", "warranty"))


@pytest.mark.wide(instead="test_ci_runs_the_reuse_tool")
def test_reuse_passes() -> None:
    """Run the REUSE tool: each file has a licence."""
    done = subprocess.run(
        [sys.executable, "-m", "reuse", "--root", str(ROOT), "lint", "--lines"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr


def test_ci_runs_the_reuse_tool() -> None:
    """Look the tool up in ``make lint``, which CI runs beside the tests."""
    (recipe,) = re.findall(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert "$(BIN)/reuse lint --lines\n" in recipe
    assert re.search(r"^make .*\blint\b", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)
