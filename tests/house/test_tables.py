# SPDX-License-Identifier: MIT
"""Tables that a campaign writes are what it makes of the CSV file beside the page."""

from __future__ import annotations

import csv

import pytest

from campaigns import compare, robots_table
from support.project import ROOT

DOCS = ROOT / "docs"


def below(page: str, mark: str) -> str:
    return (DOCS / page).read_text().partition(mark)[2]


def test_comparison_with_laws_in_use() -> None:
    text = (DOCS / "compare.csv").read_text()
    assert below("results.md", compare.MARK).strip() == compare.table(text)
    measured: dict[str, dict[str, list[float]]] = {}
    for row in csv.DictReader(text.splitlines()):
        measured.setdefault(row["arm"], {})[row["situation"]] = [float(row[law]) for law in compare.LAWS]
    assert compare.csv_text(measured) == text


def test_robots() -> None:
    pytest.importorskip("xacro")
    records = list(csv.DictReader((DOCS / "robots.csv").read_text().splitlines()))
    assert below("robots.md", robots_table.MARK).strip() == robots_table.table(records).strip()
