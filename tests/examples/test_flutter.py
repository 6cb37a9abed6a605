# SPDX-License-Identifier: MIT
"""A ball joint on three position drives: the limit against eigenvalues, and angles that others measured."""

from __future__ import annotations

import numpy as np
import pytest

from examples import film, flutter
from support.pictures import difference
from support.project import ROOT

MEASURED = (1.15, 0.0017, 1.23, 3.14, 2.74)
"""Angles [rad] of flutter.CASES after 6 s, measured before this example in MuJoCo 4.0.0 by another program."""


def drive_stiffness(target: float) -> np.ndarray:
    """Differentiate the torque of three drives at a target about z, by rotations about the body's axes: (3, 3)."""
    import pinocchio

    aim, step = np.array([0.0, 0.0, target]), 1e-6
    turned = (
        [pinocchio.log3(pinocchio.exp3(aim) @ pinocchio.exp3(sign * step * axis)) for sign in (1, -1)]
        for axis in np.eye(3)
    )
    return np.column_stack([flutter.STIFFNESS * (a - b) / (2 * step) for a, b in turned])


@pytest.mark.parametrize("target", flutter.TARGETS)
def test_the_limit_is_where_an_eigenvalue_crosses_the_axis(target: float) -> None:
    """Compare the damping limit with eigenvalues: growth at 0.99 of the limit, decay at 1.01."""
    K = drive_stiffness(target)
    assert np.abs(K - K.T).max() == pytest.approx(flutter.STIFFNESS * target, rel=1e-6)
    growth = []
    for share in (0.99, 1.01):
        damping = 2 * share * flutter.limit(target) * np.sqrt(flutter.STIFFNESS * flutter.INERTIA)
        system = np.block(
            [[np.zeros((3, 3)), np.eye(3)], [-K / flutter.INERTIA, -damping / flutter.INERTIA * np.eye(3)]]
        )
        growth.append(np.linalg.eigvals(system).real.max())
    assert growth[0] > 1e-3 > -1e-3 > growth[1]


def page_rows() -> list[list[str]]:
    """Return the table of the results page, which test_results.py simulates anew."""
    page = (ROOT / "docs" / "results.md").read_text()
    table = page.split("<!-- flutter -->\n")[1].split("<!-- end of flutter -->")[0]
    return [[word.strip() for word in row.split("|")[1:-1]] for row in table.splitlines()[2:]]


def test_angles_are_those_that_were_measured_elsewhere() -> None:
    """Within 20 %: the direction of the push was not said. The gradient comes to rest."""
    rows = page_rows()
    assert [float(row[3].split()[0]) for row in rows] == pytest.approx(MEASURED, rel=0.2)
    assert {row[4] for row in rows} == {"below 1e-4 rad"}


@pytest.mark.slow
def test_three_drives_flutter_as_the_page_says_and_the_gradient_rests() -> None:
    """Simulate all cases of the drives, and 2 s of the gradient where the damping ratio is 0.2."""
    for (target, ratio), row in zip(flutter.CASES, page_rows(), strict=True):
        assert row[:2] == [f"{target:g} rad", f"{ratio:g}"]
        assert row[3] == f"{flutter.simulate(target, ratio, flutter.DRIVES)[-1]:.2g} rad"
    assert flutter.simulate(1.8, 0.2, flutter.GRADIENT, seconds=2.0)[-1] < 1e-4


@pytest.mark.wide(instead="test_three_drives_flutter_as_the_page_says_and_the_gradient_rests")
def test_the_picture_is_todays() -> None:
    """It raises where the drives do not flutter below the limit and rest above it."""
    assert difference(flutter.figure(), (ROOT / "docs" / "flutter.svg").read_text(), 1.0) == ""


@pytest.mark.wide(instead="test_three_drives_flutter_as_the_page_says_and_the_gradient_rests")
def test_shoulder_and_hip_flutter_as_the_page_says() -> None:
    """Recompute the table of docs/flutter.md: the page has the same numbers."""
    page = (ROOT / "docs" / "flutter.md").read_text()
    rows = flutter.limb_rows()
    assert [row[5] for row in rows] == ["below 1e-3 rad"] * 2
    assert min(float(row[4].split()[0]) for row in rows) > 1
    for row in rows:
        assert f"| {' | '.join(row)} |" in page


@pytest.mark.wide(instead="test_three_drives_flutter_as_the_page_says_and_the_gradient_rests")
def test_the_film_is_the_motion() -> None:
    assert difference(film.film(), (ROOT / "docs" / "flutter_film.svg").read_text(), 1.0) == ""
