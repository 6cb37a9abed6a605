# SPDX-License-Identifier: MIT
"""Every number of docs/results.md, computed anew."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from examples import results, stiff_postures
from stiffgen.core.errors import StiffgenError
from support.project import ROOT

PAGE = results.PAGE.read_text()
IN_CONTACT = 0.05
"""Relative tolerance of the experiments: processors round differently, and contact amplifies it."""
NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?"


def shown(section: str) -> str:
    (table,) = re.findall(rf"<!-- {section} -->\n(.*?)<!-- end of {section} -->", PAGE, re.DOTALL)
    return str(table)


@pytest.fixture(scope="module")
def robots(
    plate_folder: Path, ball_folder: Path, bowl_results: Path, parkour_results: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:  # fmt: skip
    """Return a folder like build/robots, with what ``make experiment`` writes beside it."""
    build = tmp_path_factory.mktemp("build")
    (build / "robots").mkdir()
    for each in (plate_folder, ball_folder):
        (build / "robots" / each.name).symlink_to(each)
    (build / "bowl_wiping").symlink_to(bowl_results)
    (build / "parkour").symlink_to(parkour_results)
    return build / "robots"


def test_every_table_has_its_section_and_its_command() -> None:
    others = {"energy", "laws in use", "recordings"}
    assert set(re.findall(r"<!-- (?!end of)(.*?) -->", PAGE)) == {*results.SECTIONS, *others}
    for section in results.SECTIONS:
        assert re.search(rf"examples\.results \"?{section}|make experiment", PAGE.replace("\n", " "))


@pytest.mark.slow
@pytest.mark.parametrize(
    "section",
    [  # a quick relative of the simulation is in test_flutter.py
        pytest.param(each, marks=[pytest.mark.wide] if each == "flutter" else [])
        for each in results.SECTIONS
        if each != "experiments"
    ],
)
def test_numbers(
    section: str, robot: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Recompute a section: the same text, to the digits shown."""
    monkeypatch.setattr(results, "_iiwa", lambda: robot)
    monkeypatch.setattr(stiff_postures, "panda", lambda: request.getfixturevalue("panda"))
    assert results.table(section, tmp_path) == shown(section)


@pytest.mark.slow
def test_without_the_experiments_their_command_is_named(plate_folder: Path, ball_folder: Path, tmp_path: Path) -> None:
    for each in (plate_folder, ball_folder):
        (tmp_path / each.name).symlink_to(each)
    with pytest.raises(StiffgenError, match=r"traces\.npz: does not exist; run 'make experiment'"):
        results.table("experiments", tmp_path)


@pytest.mark.wide(instead="test_numbers")
def test_numbers_in_contact(robots: Path) -> None:
    made, page = results.table("experiments", robots), shown("experiments")
    assert re.sub(NUMBER, "#", made) == re.sub(NUMBER, "#", page)
    for ours, theirs in zip(re.findall(NUMBER, made), re.findall(NUMBER, page), strict=True):
        assert float(ours) == pytest.approx(float(theirs), rel=IN_CONTACT), (ours, theirs)


@pytest.mark.wide(instead="test_numbers")
def test_numbers_of_the_adversary() -> None:
    """Run the page's command: the first columns agree; what a climb finds differs between processors."""
    (options,) = re.findall(r'NAME=energy OPTIONS="(.*?)"', PAGE.replace("\n", " "))
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "campaigns" / "energy.py"), *options.split(), "--workers", "2"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), str(ROOT), *sys.path])},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    rows = [row.split("|")[1:4] for row in done.stdout.splitlines() if re.match(r"\| (constant|moving)", row)]
    page = [row.split("|")[1:4] for row in shown("energy").splitlines()[2:]]
    assert done.returncode == 0, done.stdout + done.stderr
    assert rows == page
