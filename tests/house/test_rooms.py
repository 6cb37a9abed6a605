# SPDX-License-Identifier: MIT
"""Rooms and families are deleted in copies: what is left generates the same functions, verifies, passes its tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.rooms import ALL_FAMILIES, OF_THE_CORE, ROOMS, House, functions_of
from support.project import ROOT


@pytest.mark.slow
@pytest.mark.parametrize(
    "room", [pytest.param(room, marks=() if room in ("control", "files") else pytest.mark.wide) for room in ROOMS]
)
def test_the_others_go_on_without_a_room(room: str, tmp_path: Path) -> None:
    House((room,), tmp_path).generate_and_verify()


@pytest.mark.slow
def test_the_core_stands_alone(tmp_path: Path) -> None:
    """All rooms and families are gone at once; tests of the core pass."""
    house = House(("families", "files", "control", "cli", "lab", "fri", "ros2"), tmp_path)
    house.generate_and_verify_alone()
    assert house.functions().items() <= functions_of(ROOT / "generated" / "iiwa14").items()
    house.test_kernels(OF_THE_CORE)


@pytest.mark.wide(instead="test_the_core_stands_alone")
def test_the_kernels_need_no_room(tmp_path: Path) -> None:
    """``make campaign NAME=rooms`` runs the kernels' tests without each room alone."""
    house = House(ROOMS, tmp_path)
    house.generate_and_verify()
    house.test_kernels()


@pytest.mark.parametrize(
    "family", [pytest.param(name, marks=() if name == "sensor" else pytest.mark.slow) for name in ALL_FAMILIES]
)
def test_functions_are_the_same_without_a_family(family: str, tmp_path: Path) -> None:
    """Every function that is left has the text of the whole house's; the controller goes where its functions go."""
    whole, left = functions_of(ROOT / "generated" / "iiwa14"), House((f"families.{family}",), tmp_path).functions()
    assert left.items() <= whole.items() and len(left) >= 30
