"""Tests and messages that pages name are there."""

from __future__ import annotations

import re

from stiffgen.emit import fields
from support.project import ROOT


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
