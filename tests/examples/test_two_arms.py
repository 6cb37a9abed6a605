# SPDX-License-Identifier: MIT
"""Two arms hold a box: the program's session, and what docs/whole_body.md says of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stiffgen
from examples import two_arms
from support.pictures import difference
from support.project import ROOT


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "away", "turned"),
    [
        ("iiwa14", 10, 3),
        pytest.param("panda", 20, 3, marks=pytest.mark.wide),
        pytest.param("ur5", 25, 5, marks=pytest.mark.wide),
    ],
)
def test_the_box_is_held(name: str, away: float, turned: float, two_arms_folder: Path, tmp_path: Path) -> None:
    """Lift, turn and push the box; the usual law does work round a closed lap, the spring between the hands none."""
    arm = two_arms.ARMS[name]
    if arm is two_arms.IIWA:
        module, file = stiffgen.open_robot(two_arms_folder / "two_arms").module, two_arms_folder / "two_arms.urdf"
    else:
        module, file = two_arms.generated(tmp_path, arm)
    session, work = two_arms.run(module, file, arm), two_arms.work_of_lap(module, arm)
    assert session.faults == 0
    held = (session.time > 0.9) & (session.time < two_arms.PUSHED[0])  # [s] after the squeeze has grown
    assert (np.abs(session.internal[held] / two_arms.SQUEEZE - 1) <= 0.15).mean() > 0.97
    assert (session.contacts[held] == 2).mean() > 0.99
    assert 1e3 * session.error[-1, 0] < away and np.degrees(session.error[-1, 1]) < turned
    assert abs(work[0]) > 0.1 and abs(work[1]) < 1e-9  # [J] of the usual law; of the spring
    if arm is two_arms.IIWA:
        assert difference(two_arms.figure(session), (ROOT / "docs" / "two_arms.svg").read_text(), 20.0) == ""


def test_the_squeeze_is_along_the_axis_between_the_hands() -> None:
    left, right = two_arms.grasps()
    away = right[:3, 3] - left[:3, 3]
    np.testing.assert_allclose(left[:3, 2], away / np.linalg.norm(away), atol=1e-12)
    np.testing.assert_allclose(right[:3, 2], -left[:3, 2], atol=1e-12)
