# SPDX-License-Identifier: MIT
"""Pictures of the pages are those that their programs draw today.

Not here: pictures that the tests of their programs compare (``adaptive.svg``, ``casadi.svg``,
``compliance.svg``, ``flutter.svg``, ``fri_session.svg``, ``bowl_antisymmetric.svg``, ``recordings.svg``,
``iiwa_bowl.png``, ``playground.png`` and those of ``whole_body.md``); and ``wrench.svg``, drawn by hand.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from support.pictures import difference
from support.project import ROOT

WITHIN = 1.0
"""Coordinates may differ by this much of some 500: pictures of noise differ from machine to machine."""


def assert_same(pictures: dict[str, str], within: float = WITHIN) -> None:
    found = {name: difference(svg, (ROOT / "docs" / name).read_text(), within) for name, svg in pictures.items()}
    assert found == dict.fromkeys(pictures, "")


@pytest.mark.slow
def test_theory() -> None:
    from examples import theory

    pictures = theory.draw()
    assert len(pictures) == 4
    assert_same(pictures)


def test_a_change_is_seen() -> None:
    """A word, a place, and an element less."""
    picture = (ROOT / "docs" / "theory_basis.svg").read_text()
    for old, new in (("</text>", "s</text>"), (' d="M ', ' d="M 1'), ("<path ", "<line ")):
        assert old in picture
        assert difference(picture.replace(old, new, 1), picture, WITHIN)


def test_no_legend_shows_a_name_of_matplotlib() -> None:
    """A line without a label has the name _child0."""
    pictures = [*(ROOT / "docs").glob("*.svg"), *(ROOT / "docs" / "figures").glob("*.svg")]
    assert len(pictures) > 20
    assert [picture.name for picture in pictures if ">_child" in picture.read_text()] == []


def test_controller() -> None:
    from examples import controller

    assert_same(controller.draw())


@pytest.mark.wide(instead="test_controller")
def test_analysis(robot_folder: Path) -> None:
    from examples import analyze_recording

    assert_same(analyze_recording.draw(robot_folder))


@pytest.mark.wide(instead="test_theory")
def test_closed_loops() -> None:
    from examples import closed_loops

    assert_same({"figures/loops.svg": closed_loops.figure()})


@pytest.mark.slow
def test_energy_cycle(robot: ModuleType) -> None:
    """Its curves of rounding alone lie within 3 of one another."""
    from examples import energy_cycle

    assert_same({"energy_cycle.svg": energy_cycle.figure(robot, energy_cycle.centre())}, within=3.0)
