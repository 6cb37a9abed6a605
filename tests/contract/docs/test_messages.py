# SPDX-License-Identifier: MIT
"""docs/messages.md has every message of the sources, docs/troubleshooting.md none but those."""

from __future__ import annotations

import re

from stiffgen.emit import fields
from support.messages import messages
from support.project import ROOT

ROWS = re.findall(r"^\| (`.*?) \| ", (ROOT / "docs" / "messages.md").read_text(), re.MULTILINE)
QUOTED = [text for row in ROWS for text in re.findall(r"`([^`]+)`", row)]


def quoted_in(message: str) -> list[str]:
    """The texts of the page, ``...`` for anything, that a message has."""
    return [text for text in QUOTED if re.search(".*?".join(map(re.escape, text.split("..."))), message)]


def test_every_message_has_its_row() -> None:
    found = messages()
    assert len(found) > 200
    assert [f"{file}: {text}" for text, file in found.items() if not quoted_in(text)] == []


def test_every_row_is_about_a_message() -> None:
    assert len(QUOTED) == len(set(QUOTED))
    matched = [text for message in messages() for text in quoted_in(message)]
    assert [text for text in QUOTED if not 1 <= matched.count(text) <= 5] == []  # more than five: says nothing


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
