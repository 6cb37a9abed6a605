# SPDX-License-Identifier: MIT
"""Rooms and families are deleted in copies: what is left generates the same functions, verifies, passes its tests."""

from __future__ import annotations

from pathlib import Path

import pytest

import stiffgen
from campaigns.rooms import ALL_FAMILIES, OF_THE_CORE, ROOMS, SMALL, House, functions_of, functions_of_each
from stiffgen.core.family import FAMILIES
from support.project import ROOT, Once

NEEDED = {name for others in FAMILIES.values() for name in others}
"""Families without which another one adds nothing."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "room", [pytest.param(room, marks=() if room in ("control", "files") else pytest.mark.wide) for room in ROOMS]
)
def test_the_others_go_on_without_a_room(room: str, tmp_path: Path) -> None:
    House((room,), tmp_path).generate_and_verify()


@pytest.mark.slow
def test_the_core_stands_alone(tmp_path: Path) -> None:
    """All rooms and families are gone at once; tests of the core pass.

    Its C has the text of the whole house's, which other tests compile in programs.
    """
    house = House(("families", "files", "control", "cli", "lab", "fri", "ros2"), tmp_path)
    house.generate_and_verify_alone()
    arm = house.generated("urdf/iiwa14", build=True)
    assert functions_of(arm).items() <= functions_of(ROOT / "generated" / "iiwa14").items()
    house.test_kernels(OF_THE_CORE, "-k", "not c_program", STIFFGEN_ROBOT_FOLDER=str(arm))


@pytest.mark.wide(instead="test_the_core_stands_alone")
def test_the_kernels_need_no_room(tmp_path: Path) -> None:
    """``make campaign NAME=rooms`` runs the kernels' tests without each room alone."""
    house = House(ROOMS, tmp_path)
    house.generate_and_verify()
    house.test_kernels()


@pytest.fixture(scope="module")
def whole(once: Once) -> dict[str, str]:
    """Return the C functions of the small robot, as printed by the whole house."""

    def make(folder: Path) -> None:
        (folder / "small.urdf").write_text(SMALL)
        stiffgen.generate(folder / "small.urdf", output=folder, build=False)

    return functions_of(once("small robot of the whole house", make) / "chain")


REST = "those that none needs"


@pytest.mark.slow
@pytest.mark.parametrize(
    "families",
    [
        pytest.param((*sorted(NEEDED), REST), id="needed, rest"),
        pytest.param(tuple(sorted({*ALL_FAMILIES} - NEEDED)), marks=pytest.mark.wide, id="each of the rest"),
    ],
)
def test_functions_are_the_same_without_a_family(
    families: tuple[str, ...], whole: dict[str, str], tmp_path: Path
) -> None:
    """Every function that is left has the text of the whole house's; the controller goes where its functions go.

    Of the rest all go at once: that none of them imports another one is tests/house/test_walls.py's.
    """
    houses = {}
    for family in families:
        absent = {*ALL_FAMILIES} - NEEDED if family == REST else {family}
        houses[family] = House([f"families.{each}" for each in absent], tmp_path / family, within="codegen/")
    for family, left in functions_of_each(houses).items():
        assert left.items() <= whole.items() and len(left) >= 30, family
