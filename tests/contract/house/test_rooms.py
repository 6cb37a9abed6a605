# SPDX-License-Identifier: MIT
"""Each room that can be taken out is deleted in a copy: the rest generates, loads, verifies and passes its tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.rooms import ROOMS, House


@pytest.mark.slow
@pytest.mark.parametrize(
    "room", [pytest.param(room, marks=() if room == "controller" else pytest.mark.wide) for room in ROOMS]
)
def test_the_others_go_on_without_a_room(room: str, tmp_path: Path) -> None:
    House((room,), tmp_path).generate_and_verify()


@pytest.mark.slow
def test_the_kernels_need_no_room(tmp_path: Path) -> None:
    """All are gone at once. ``make campaign NAME=rooms`` runs the kernels' tests without each room alone."""
    house = House(ROOMS, tmp_path)
    house.generate_and_verify()
    house.test_kernels()
