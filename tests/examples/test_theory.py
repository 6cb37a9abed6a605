# SPDX-License-Identifier: MIT
"""The numbers of the theory page: printed by its script, and compared with differentiation of the energies."""

from __future__ import annotations

import re
from types import ModuleType

import numpy as np
import pytest

from examples import theory
from support.project import ROOT

K = np.diag([30.0, 20.0, 10.0])


def trace_energy(R: np.ndarray) -> float:
    return float(np.trace((np.trace(K) / 2 * np.eye(3) - K) @ (np.eye(3) - R)))


def test_page_has_what_the_script_prints(robot: ModuleType) -> None:
    table, sentence = theory.tables(robot).split("\n\n")
    page = (ROOT / "docs" / "theory.md").read_text()
    assert f"```text\n{table}\n```" in page
    least, most = sentence.split("antisymmetric part ")[1].split(",")[0].split(" to ")
    assert f"{least} to {most} N m/rad" in page


def test_gradient_is_the_derivative_of_the_trace_energy() -> None:
    """Compare the moment with central differences (1e-6 rad) of the trace energy, at 50 rotations."""
    random = np.random.default_rng(1)
    for _ in range(50):
        R = theory.turn(random.normal(size=3))
        moment = theory.gradient(R, K)
        for axis, step in zip(moment, 1e-6 * np.eye(3), strict=True):
            difference = (trace_energy(theory.turn(step) @ R) - trace_energy(theory.turn(-step) @ R)) / 2e-6
            assert axis == pytest.approx(-difference, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("law", theory.LAWS)
def test_work_of_small_orbits_falls_with_the_third_power(law: str) -> None:
    """Shrink an orbit tenfold: the work falls by 1000, as the field's curl predicts; a gradient does none."""
    x, y, z = np.eye(3)

    def net(size: float) -> float:
        return float(theory.work(theory.LAWS[law], K, theory.orbit(0.5 * size * x, 0.3 * size, z, y))[-1])

    if law == "gradient of an energy":
        assert abs(net(1.0)) < 1e-10
    else:
        assert net(0.1) > 1e-3  # [J]
        assert net(0.1) / net(0.01) == pytest.approx(1000, rel=0.01)


def test_rotation_vector_and_turn_are_inverse() -> None:
    random = np.random.default_rng(2)
    for length in (0.0, 1e-9, 1e-3, 1.0, 3.1):
        axis = random.normal(size=3)
        w = length * axis / np.linalg.norm(axis)
        np.testing.assert_allclose(theory.rotation_vector(theory.turn(w)), w, atol=1e-13)


def test_tangent_is_the_slope_of_the_torque() -> None:
    angle = np.linspace(0, 2.5, 26)
    slope = (theory.pendulum_spring(angle + 1e-6)["torque"] - theory.pendulum_spring(angle - 1e-6)["torque"]) / 2e-6
    np.testing.assert_allclose(theory.pendulum_spring(angle)["tangent"], -slope, atol=1e-9)


@pytest.mark.slow
def without_hashes(svg: str) -> str:
    """Matplotlib names a clip path by a hash of its box, whose last bit differs between processors."""
    return re.sub(r"\bp[0-9a-f]{10}\b", "clip", svg)


def test_figures_are_those_of_the_page() -> None:
    for name, svg in theory.draw().items():
        page = (ROOT / "docs" / name).read_text()
        assert without_hashes(page) == without_hashes(svg), f"{name}: python -m examples.theory --figures"
