# SPDX-License-Identifier: MIT
"""The software paper: its length, its references, and each of its numbers as a page states it that a command writes."""

from __future__ import annotations

import re

import pytest

from benchmarks import claims
from support.project import ROOT

PAPER = (ROOT / "docs" / "paper" / "paper.md").read_text()
BODY = PAPER.split("---\n", 2)[2]
NUMBERS = {
    "docs/results.md": (
        "8.3 N m/rad",
        "6.7 N m",
        "0.93 to 1.40",
        "47.8%",
        "30 N m/rad",
        "0.002 N m",
        "| constant | 10000 | 0 |",
    ),
    "docs/theory.md": ("| 0.13 | 150 |", "3.9e-13", "| 0.93 |", "100 closed joint-space orbits"),
    "benchmarks/RESULTS.md": tuple(claims.stated((ROOT / "benchmarks" / "RESULTS.md").read_text())),
}
"""Page, and what it says; the paper has the same numbers."""


def test_the_paper_is_short_and_cites_what_it_lists() -> None:
    """Check the paper: 750 to 1750 words, as JOSS asks, each source cited, all sections."""
    words = len(re.findall(r"[\w@'-]+", re.sub(r"^\|[^\n]*$|\$\$.*?\$\$", "", BODY, flags=re.MULTILINE | re.DOTALL)))
    assert 750 <= words <= 1750  # JOSS
    listed = set(re.findall(r"@\w+\{(\w+),", (ROOT / "docs" / "paper" / "paper.bib").read_text()))
    assert set(re.findall(r"@(\w+)", BODY)) == listed
    titles = set(re.findall(r"^# (.+)$", BODY, flags=re.MULTILINE))
    assert titles >= {"Summary", "Statement of need", "State of the field", "Software design"}
    assert titles >= {"Research impact statement", "AI usage disclosure", "References"}
    assert "10.1177/02783649251393332" in (ROOT / "docs" / "paper" / "paper.bib").read_text()


@pytest.mark.parametrize("page", NUMBERS)
def test_every_number_is_that_of_a_page(page: str) -> None:
    text = (ROOT / page).read_text()
    for said in NUMBERS[page]:
        assert said in text, said


def test_no_number_is_unaccounted_for() -> None:
    """Numbers with a decimal point or a unit stand in NUMBERS; names of standards and equations do not count."""
    text = re.sub(r"\[@[^\]]*\]|`[^`]*`|\$\$.*?\$\$|^\|[^\n]*$", "", BODY, flags=re.MULTILINE | re.DOTALL)
    names = r"C99|iiwa 14|1 kHz|60 digits|1 N m |ROS 2|Pinocchio [0-9.]+"
    found = set(re.findall(r"\d+(?:\.\d+)?(?:e-\d+)?%?", re.sub(names, "", text)))
    stated = {
        number for said in NUMBERS.values() for each in said for number in re.findall(r"[\d.]+(?:e-\d+)?%?", each)
    }
    assert found <= stated
