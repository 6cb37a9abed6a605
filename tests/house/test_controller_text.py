# SPDX-License-Identifier: MIT
"""Text of the controller for whoever reviews it: whole names, named constants, comments on the memory."""

from __future__ import annotations

import re

import pytest

from stiffgen.control.memory_fields import MEMORY
from stiffgen.control.status_words import REASONS, STATUS
from support.project import ROOT

LIBRARY = sorted((ROOT / "codegen" / "stiffgen" / "control" / "library").glob("*.c"))
GOLDEN = ROOT / "generated" / "iiwa14"


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def test_names_are_printed_whole() -> None:
    """A search for IIWA14_STATUS_ finds every status bit, and so for reasons. Before: ID(STATUS_...) and no other."""
    text = without_comments((GOLDEN / "iiwa14_impedance.c").read_text())
    assert "##" not in text
    assert not re.search(r"\bID\(", text)
    for name, _ in STATUS:
        assert re.search(rf"\bIIWA14_STATUS_{name.upper()}\b", text), name
    for name, _, _ in REASONS:
        assert re.search(rf"\bIIWA14_REASON_{name.upper()}\b", text), name


def test_every_field_of_the_memory_has_a_comment() -> None:
    """Before: none of 110 had one."""
    text = (GOLDEN / "iiwa14_impedance.h").read_text()
    memory = text[text.index("/* Memory between steps") : text.index("} iiwa14_impedance_memory;")]
    declared = re.findall(r"(\*/)?\n    (?:double|u?int32_t) (\w+)", memory)
    assert [name for _, name in declared] == [field.name for field in MEMORY if field.when != "loops"]
    assert [name for comment, name in declared if not comment] == []


@pytest.mark.parametrize("number", ["1e-9", "1e-12", "1e6", "1000000", "1e3", "1000"])
def test_small_and_large_numbers_have_a_name(number: str) -> None:
    """Each stands in one definition, with its reason. Before: 1e-9 in 22 places, 1000000 in 8."""
    bare = rf"(?<![\w.]){re.escape(number)}(?![\w.])"
    for file in LIBRARY:
        for line in without_comments(file.read_text()).splitlines():
            defined = line.startswith(("static const double", "enum {"))
            written = file.name == "text.c"  # digits of a number that is written out
            assert defined or written or not re.search(bare, line), f"{file.name}: {line}"


def test_no_fault_is_put_back_and_no_mode_assigned_twice() -> None:
    text = without_comments("".join(file.read_text() for file in LIBRARY))
    assert len(re.findall(r"out->mode = ", text)) == 1
    assert not re.search(r"m->fault = fault;", text)
