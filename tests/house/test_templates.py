# SPDX-License-Identifier: MIT
"""A long template is made of what differs between robots; a program that is the same for all is a source."""

from __future__ import annotations

import re
from pathlib import Path

import stiffgen

PACKAGE = Path(stiffgen.__file__).parent
MARKER = re.compile(r"\{\{|\{%|\{#")
LONG, LEAST = 150, 0.25


def share(text: str) -> float:
    """Return the share of lines with a marker of Jinja."""
    lines = text.splitlines()
    return sum(MARKER.search(line) is not None for line in lines) / len(lines)


def test_long_templates_are_no_programs() -> None:
    """Count the template lines of long templates: few, as programs belong into sources."""
    files = [file for folder in PACKAGE.rglob("templates") for file in folder.rglob("*") if file.is_file()]
    texts = {file.relative_to(PACKAGE).as_posix(): file.read_text(encoding="utf-8") for file in files}
    long = {name: text for name, text in texts.items() if text.count("\n") > LONG}
    assert len(texts) > 50
    assert len(long) > 5
    found = {name: f"{share(text):.0%}" for name, text in long.items() if share(text) < LEAST}
    assert found == {}
