# SPDX-License-Identifier: MIT
"""Pages claim of runs that CI cannot make what a receipt holds, and name its sources."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from campaigns import receipts
from campaigns.__main__ import CAMPAIGNS
from campaigns.__main__ import main as campaign
from support.project import ROOT

RECEIPTS = receipts.read()
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LINK = re.compile(r"\[receipt\]\((?:docs/)?receipts/([\w-]+)\.json\)\s+of\s+(older\s+)?sources\s+`([0-9a-f]{12})`")
ELSEWHERE = re.compile(r"\bH100\b|in real ros2_control|\bNAME=([a-z-]+)")
"""Runs that CI cannot make: on a GPU, in real ros2_control, campaigns."""
COMPARED = {
    "cuda": "a part of bench-cuda",
    "robots": "tests/campaigns/test_robots_table.py",
    "targets": "tests/campaigns/test_targets.py",
    "compliance": "a method, no result",
}
"""Campaigns whose numbers on pages are compared otherwise."""
NUMBER = re.compile(r"(?<![\w.^-])-?\d+(?: \d{3}\b)*(?:\.\d+)?(?:e[+-]?\d{1,2})?(?![\w^]|\.\d)")
Block = tuple[str, str]
"""A page's name, and a paragraph or an entry of a list with the tables behind it."""


def blocks(text: str) -> list[str]:
    """Return paragraphs and entries of lists, each with the tables behind it, without code and headings."""
    found: list[str] = []
    bare = re.sub(r"^ *```.*?^ *```$|<!--.*?-->", "", text, flags=re.MULTILINE | re.DOTALL)
    for part in map(str.strip, re.split(r"\n\s*\n|\n(?=[*-] )", bare)):
        if part.startswith("|") and found:
            found[-1] += f"\n{part}"
        elif part:
            found.append(part)
    return [each for each in found if not each.startswith("#")]


def numbers(text: str) -> Iterator[tuple[float, float]]:
    """Yield the numbers of a text with half a unit of their last digit, those in code and addresses left out."""
    text = re.sub(r"`[^`]*`|\]\([^)]*\)|\bLBR|\biiwa \d+|\bmed \d+", " ", LINK.sub("", text))
    for found in NUMBER.finditer(text):
        digits, _, exponent = found[0].replace(" ", "").partition("e")
        decimals = len(digits.partition(".")[2])
        yield float(found[0].replace(" ", "")), 0.5 * 10.0 ** (int(exponent or 0) - decimals)


def unsupported(block: str) -> list[float]:
    """Return the numbers of a block that no number of its receipts rounds to."""
    output = [line for name, _, _ in LINK.findall(block) for line in RECEIPTS[name].output]
    held = [value for line in output for value, _ in numbers(line.replace("`", ""))]
    return [value for value, half in numbers(block) if not any(abs(value - each) <= half * (1 + 1e-9) for each in held)]


def claims() -> list[Block]:
    return [(page.name, block) for page in PAGES for block in blocks(page.read_text())]


def test_numbers_of_a_page_are_those_of_its_receipts() -> None:
    """Compare the numbers of the pages with the receipts that they link to."""
    linked = [block for block in claims() if LINK.search(block[1])]
    assert {name for _, block in linked for name, _, _ in LINK.findall(block)} == set(RECEIPTS)
    for page, block in linked:
        for name, older, sources in LINK.findall(block):
            assert sources == RECEIPTS[name].sources, f"{page}: {name}"
            assert bool(older) == (RECEIPTS[name].recorded == receipts.BEFORE), f"{page}: {name}"
        assert not unsupported(block), f"{page}: {block}"


def test_what_ci_cannot_run_has_a_receipt() -> None:
    """Look at blocks that state numbers of runs CI cannot make: each links to a receipt."""
    wrong = []
    for page, block in claims():
        runs = {found[1] or found[0] for found in ELSEWHERE.finditer(block)} - COMPARED.keys()
        runs = {each for each in runs if each in CAMPAIGNS or not re.fullmatch("[a-z-]+", each)}
        if runs and any(numbers(block)) and not LINK.search(block):
            wrong.append(f"{page}: {runs}: {block[:200]}")
    assert not wrong, "\n".join(wrong)


def test_a_changed_number_is_seen() -> None:
    (block,) = (block for page, block in claims() if page == "README.md" and LINK.search(block))
    assert unsupported(block.replace("0.97", "0.98")) == [0.98]
    assert unsupported(block.replace("8.7e9", "8.8e9")) == [8.8e9]
    assert not unsupported(block)


@pytest.mark.parametrize("name", RECEIPTS)
def test_a_receipt_is_complete_and_names_no_machine(name: str) -> None:
    """Check a receipt: all fields, and no path, host or date."""
    receipt = RECEIPTS[name]
    assert receipt.command and receipt.output
    assert receipt.recorded in (receipts.BY_COMMAND, receipts.BEFORE)
    assert re.fullmatch("[0-9a-f]{12}", receipt.sources)
    assert re.fullmatch(r"[0-9a-f]{12}\+?", receipt.commit)
    text = (receipts.FOLDER / f"{name}.json").read_text()
    assert not re.search(r"(?<![\w.])/(home|root|tmp|work|Users)/|\b20\d\d-\d\d-\d\d\b", text)


def test_a_run_writes_its_receipt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a command: output without paths and host, digest of the sources; a failing run writes none."""
    monkeypatch.setenv("RECEIPTS", str(tmp_path))
    lines = f"3.5 of 4 in {ROOT}/build on {platform.node()}"
    assert receipts.run("trial", ["sh", "-c", f"echo '{lines}'"], "make trial") == 0
    (written,) = receipts.read(tmp_path).values()
    assert written.output == ["3.5 of 4 in ./build on HOST"]
    assert (written.command, written.recorded) == ("make trial", receipts.BY_COMMAND)
    assert written.sources == receipts.digest()
    assert receipts.run("failed", ["sh", "-c", "exit 3"]) == 3
    assert set(receipts.read(tmp_path)) == {"trial"}


def test_a_campaign_is_recorded_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[object, ...]] = []
    monkeypatch.setattr(receipts, "run", lambda *given: calls.append(given) or 0)
    assert campaign(["--receipt", "soak", "--steps", "10"]) == 0
    assert calls == [
        ("soak", CAMPAIGNS["soak"].command(["--steps", "10"]), 'make campaign NAME=soak OPTIONS="--steps 10"')
    ]


def test_the_digest_follows_a_source(tmp_path: Path) -> None:
    """Change a source: another digest; a test does not count."""
    file = tmp_path / "codegen" / "stiffgen" / "law.c"
    file.parent.mkdir(parents=True)
    file.write_text("one")
    (before,) = {receipts.digest(tmp_path), receipts.digest(tmp_path)}
    (file.parent / "test_law.py").write_text("a test")
    assert receipts.digest(tmp_path) == before
    file.write_text("two")
    assert receipts.digest(tmp_path) != before
