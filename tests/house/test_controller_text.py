# SPDX-License-Identifier: MIT
"""Text of the controller for whoever reviews it: whole names, named constants, comments on the memory."""

from __future__ import annotations

import re

import pytest

from stiffgen.control.core.memory import RECORDS
from stiffgen.control.core.words import REASONS, STATUS
from support.project import ROOT

LIBRARY = sorted((ROOT / "codegen" / "stiffgen" / "control" / "core" / "library").glob("*.c"))
GOLDEN = ROOT / "generated" / "iiwa14"


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def test_names_are_printed_whole() -> None:
    """Search the C for IIWA14_STATUS_: each status bit is found, and each reason."""
    text = without_comments((GOLDEN / "iiwa14_impedance.c").read_text())
    assert "##" not in text
    assert not re.search(r"\bID\(", text)
    for name, _ in STATUS:
        assert re.search(rf"\bIIWA14_STATUS_{name.upper()}\b", text), name
    for name, _, _ in REASONS:
        assert re.search(rf"\bIIWA14_REASON_{name.upper()}\b", text), name


def test_every_field_of_the_memory_has_a_comment() -> None:
    """Look for a comment at each field of the memory. Before: none of 110."""
    text = (GOLDEN / "iiwa14_impedance.h").read_text()
    for name, _, fields in RECORDS:
        (body,) = re.findall(rf"typedef struct {{([^}}]*)}} iiwa14_impedance_{name};", text)
        declared = re.findall(r"    \w+ (\w+)(?:\[\d+\])?;( /\* .)?", body)
        names = [field.name for field in fields if field.when != "loops"]
        assert [each for each, _ in declared if each != "padding"] == names
        assert all(comment for _, comment in declared)


@pytest.mark.parametrize("number", ["1e-9", "1e-12", "1e6", "1000000", "1e3", "1000"])
def test_small_and_large_numbers_have_a_name(number: str) -> None:
    """Look for bare numbers: each has one definition with its reason. Before: 1e-9 in 22 places."""
    bare = rf"(?<![\w.]){re.escape(number)}(?![\w.])"
    for file in LIBRARY:
        for line in without_comments(file.read_text()).splitlines():
            defined = line.strip().startswith(("static const double", "enum {"))
            written = file.name == "text.c"  # digits of a number that is written out
            assert defined or written or not re.search(bare, line), f"{file.name}: {line}"
