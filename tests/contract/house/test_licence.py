# SPDX-License-Identifier: MIT
"""Every source begins with its licence, but what becomes part of generated code, which belongs to its user."""

from __future__ import annotations

import re
import subprocess
from pathlib import PurePath

from support.project import ROOT

COMMENTS = {
    "#": (".py",), "//": (".js", ".cpp", ".hpp", ".cu"), "/*": (".c", ".h", ".css"), "<!--": (".html",),
}  # fmt: skip
BEGIN = {suffix: comment for comment, suffixes in COMMENTS.items() for suffix in suffixes}
OF_THE_USER = re.compile(
    r"generated/|codegen/stiffgen/(control/(library|loops|paper|python)|core/emit/(\w+/library|python/wrappers)|(\w+/)*templates)/"
)


def sources() -> list[str]:
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"]
    files = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\n")
    return [file for file in files if PurePath(file).suffix in BEGIN and (ROOT / file).exists()]


def test_every_source_begins_with_its_licence() -> None:
    ours = [file for file in sources() if not OF_THE_USER.match(file)]
    assert len(ours) > 250
    for file in ours:
        first = [
            line for line in (ROOT / file).read_text().splitlines()[:2] if not line.startswith(("#!", "<!doctype"))
        ]
        assert re.match(r"(#|//|/\*|<!--) SPDX-License-Identifier: MIT\b", first[0]), file


def test_what_belongs_to_its_user_does_not() -> None:
    """REUSE.toml says it for these; the generator's output must not carry the generator's licence."""
    theirs = [file for file in sources() if OF_THE_USER.match(file)]
    assert len(theirs) > 10
    assert [file for file in theirs if "SPDX-License-Identifier" in (ROOT / file).read_text()] == []
