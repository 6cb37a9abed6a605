# SPDX-License-Identifier: MIT
"""Robots whose references once took the rounding of their constants for a motion; the campaign found them."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns.false_alarms import alarms, random_chain


@pytest.mark.parametrize(
    ("robot", "count", "seed"),
    [
        (1140, 20, 0),  # a derivative of 1e-8, and rotations that are orthonormal up to 4e-16
        (1164, 20, 0),  # no bias force at all, and an axis whose length is 1 up to rounding
        (79, 200, 2),  # two forms of a stiffness whose contributions cancel
    ],
)
def test_right_functions_pass(robot: int, count: int, seed: int, tmp_path: Path) -> None:
    """Verify correct functions of chains that once raised a false alarm."""
    found = alarms(random_chain(tmp_path, robot), count, seed)
    assert [f"{each.kernel}, {each.oracle}: {each.error:.2e}" for each in found] == []
