# SPDX-License-Identifier: MIT
"""Laws of operational space on a ball wrist: limits against a body linearised by SciPy, and both sides of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from examples import wrist
from support.project import ROOT

HOSE, ROD = [case for case in wrist.CASES if case.hose], next(case for case in wrist.CASES if case.rod)
INERTIA = np.diag([0.004, 0.012, 0.014])


def first_of(cases: Sequence[wrist.Case]) -> list[Any]:
    """Return cases as parameters, all but the first of them wide."""
    return [cases[0], *(pytest.param(case, marks=pytest.mark.wide) for case in cases[1:])]


def torque(case: wrist.Case, R: np.ndarray) -> np.ndarray:
    """Return the moment on the hand in base axes, by SciPy: law, and hose of 2 N/m from (0, 0.1, 1) to (0, 0.1, 0)."""
    K, fitting = np.diag(case.gains), R @ [0, 0.1, 0]
    e = -Rotation.from_matrix(R).as_rotvec()
    law = (R @ INERTIA @ R.T if case.weighted else np.eye(3)) @ K @ e
    return law + np.cross(fitting, 2 * (np.array([0, 0.1, 1]) - fitting))


@pytest.mark.slow
@pytest.mark.parametrize("case", first_of(HOSE), ids=lambda case: case.name)
def test_the_limit_is_that_of_the_linearised_body(case: wrist.Case) -> None:
    """Compare the damping limit with eigenvalues at equilibrium: growth at 0.98 of the limit, decay at 1.02."""
    R = np.eye(3)
    for _ in range(6000):
        R = Rotation.from_rotvec(R @ np.linalg.solve(INERTIA, R.T @ torque(case, R)) / 300).as_matrix() @ R
    assert np.linalg.norm(torque(case, R)) < 1e-9
    L, step, gains = R @ INERTIA @ R.T, 1e-6, np.array(case.gains)
    turned = (
        [torque(case, Rotation.from_rotvec(sign * step * axis).as_matrix() @ R) for sign in (1, -1)]
        for axis in np.eye(3)
    )
    K = -np.column_stack([(a - b) / (2 * step) for a, b in turned])
    growth = []
    for share in (0.98, 1.02):
        ratio = share * wrist.limit(case)
        D = 2 * ratio * (L @ np.diag(np.sqrt(gains)) if case.weighted else np.sqrt(INERTIA * np.diag(gains)))
        system = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(L, K), -np.linalg.solve(L, D)]])
        growth.append(np.linalg.eigvals(system).real.max())
    assert growth[0] > 0 > growth[1]


def test_the_limit_with_a_rod_is_that_of_three_matrices() -> None:
    """Compare the limit with the eigenvalues of ddq = M^-1 L (-Kp e - Kd w), M of hand and rod."""
    built = wrist.Wrist(ROD, wrist.LAW, 1.0)
    mujoco.mj_forward(built.model, built.data)
    M = np.zeros((3, 3))
    mujoco.mj_fullM(built.model, built.data, M)
    R = Rotation.from_euler("y", np.pi / 3).as_matrix()
    L, gains, signs = R @ INERTIA @ R.T, np.array(ROD.gains), []
    for share in (0.98, 1.02):
        blocks = [np.diag(gains), np.diag(2 * share * wrist.limit(ROD) * np.sqrt(gains))]
        lower = [-np.linalg.solve(R @ M @ R.T, L @ each) for each in blocks]
        signs.append(np.linalg.eigvals(np.block([[np.zeros((3, 3)), np.eye(3)], lower])).real.max())
    assert signs[0] > 0 > signs[1]


def test_the_antisymmetric_part_is_what_the_page_says() -> None:
    """Go round a small loop about a rest at e: its work is twice the antisymmetric part times the area."""
    K, e, radius, t = np.diag([0.2, 2.0, 1.5]), 0.02, 1e-3, np.linspace(0, 2 * np.pi, 201)
    away, rate = np.stack([0 * t, np.cos(t), np.sin(t)], 1), np.stack([0 * t, -np.sin(t), np.cos(t)], 1)
    R = Rotation.from_rotvec(radius * away) * Rotation.from_rotvec([-e, 0, 0])
    rates = radius * (rate + np.cross(radius * away, rate) / 2)  # to second order of the radius
    power = ((-R.as_rotvec() @ K) * rates).sum(1)
    part = abs(np.trapezoid(power, t)) / (2 * np.pi * radius**2)
    assert part == pytest.approx((2.0 + 1.5 - 2 * 0.2) * e / 4, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("case", first_of(wrist.CASES), ids=lambda case: case.name)
def test_pushes_grow_below_the_limit_and_not_above_it(case: wrist.Case) -> None:
    limit = wrist.limit(case)
    swings = [wrist.watch(case, wrist.LAW, share * limit, seconds=8.0)[1] for share in (0.8, 1.25)]
    assert swings[0] > 1.5 * wrist.PUSH > wrist.PUSH > swings[1]
    assert wrist.watch(case, wrist.LAW, 1.0, seconds=8.0)[1] < 1e-4  # the ratio that these laws have


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, pytest.param(None, marks=pytest.mark.wide)])
def test_the_wrists_table_is_that_of_the_page(count: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 20 %; under the gradient the swing of every row has fallen below a tenth of the push."""
    monkeypatch.setattr(wrist, "CASES", wrist.CASES[:count])
    page = (ROOT / "docs" / "flutter.md").read_text()
    for row in wrist.rows():
        (line,) = (line for line in page.split("\n") if line.startswith(f"| {' | '.join(row[:2])} |"))
        cells = line.strip("| ").split(" | ")
        for ours, theirs in zip(row[2:], cells[2:], strict=True):
            number = ours.split()[0]
            if number == "below":
                assert ours == theirs
            else:
                assert float(number) == pytest.approx(float(theirs.split()[0]), rel=0.2)
        *_, of_law, of_gradient = row  # swings after a push
        assert float(of_law.split()[0]) > 10 * wrist.PUSH
        assert of_gradient.startswith("below") or float(of_gradient.split()[0]) < wrist.PUSH / 10
