# SPDX-License-Identifier: MIT
"""A quadruped on contact springs: kernels against MuJoCo, in rest, modes, and forces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import scipy.linalg

from examples.whole_body import identify, trials
from examples.whole_body.__main__ import main
from examples.whole_body.findings import BAR, LEANING, SOFTEST
from examples.whole_body.law import WholeBodyLaw, on_base
from examples.whole_body.stance import FEET, LEG, Springs, Stance, feet, level, standing
from stiffgen.core.errors import StiffgenError
from support.pictures import difference
from support.project import ROOT


@pytest.fixture(scope="session")
def stance(solo: ModuleType) -> Stance:
    return standing(solo, LEANING)


def rings(stance: Stance) -> list[identify.Found]:
    return trials.identified(stance, 1.6)


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_rest_is_the_simulations_too(stance: Stance) -> None:
    acceleration = trials.simulated(stance).acceleration(trials.legs_law(stance))
    assert np.abs(acceleration).max() < 1e-8
    elsewhere = stance.moved(np.full(18, 1e-3))
    assert np.abs(trials.simulated(elsewhere).acceleration(trials.legs_law(stance))).max() > 1e-2


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_stiffness_is_the_slope_of_the_gradient_where_it_is_zero(stance: Stance) -> None:
    """Compare the stiffness (18 x 18) with differences of the gradient (step 1e-5); it is symmetric to the bit."""
    K, step = stance.stiffness(), 1e-5
    columns = [
        (stance.moved(step * x).gradient() - stance.moved(-step * x).gradient()) / (2 * step) for x in np.eye(18)
    ]
    np.testing.assert_allclose(np.transpose(columns), K, atol=1e-6 * np.abs(K).max())
    assert np.array_equal(K, K.T)


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_the_softest_modes_are_those_of_the_simulation(stance: Stance) -> None:
    """Compare the softest modes with those identified from a simulation, and show that the base term matters."""
    found, M = rings(stance), stance.mass_matrix()
    for mode, own in zip(stance.modes()[:SOFTEST], found, strict=False):
        assert own.frequency == pytest.approx(mode.frequency, rel=1e-3)  # the bar is 2 %
        assert identify.agreement(M, mode.direction, own.shape) > 0.9999
    without = stance.modes(stance.stiffness_without_base_term())[0].frequency
    assert abs(without / found[0].frequency - 1) > 50 * BAR


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_a_load_too_heavy_lets_it_fall_as_predicted(solo: ModuleType) -> None:
    """Load the base with 60 N: one mode grows, at the predicted rate, which the stiffness without base term misses."""
    heavy = standing(solo, np.array([0.0, 0.0, -60.0]))
    falling, M = heavy.modes()[0], heavy.mass_matrix()
    # The square of a growing motion grows as well, twice as fast: the mode is known by its direction.
    found = max(trials.identified(heavy, 0.8), key=lambda each: identify.agreement(M, falling.direction, each.shape))
    assert identify.agreement(M, falling.direction, found.shape) > 0.9999
    assert found.exponent.real > 0 and found.frequency < 0
    assert found.frequency == pytest.approx(falling.frequency, rel=1e-3)
    assert heavy.modes(heavy.stiffness_without_base_term())[0].frequency > 0  # missed


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_base_term_left_out_of_everything_cancels_at_rest_without_a_load(solo: ModuleType, stance: Stance) -> None:
    """Leave the base term out: it cancels at rest, while contacts alone are asymmetric by the weight."""
    at_rest = standing(solo)
    np.testing.assert_allclose(at_rest.stiffness_without_base_term(), at_rest.stiffness(), atol=1e-9)
    asymmetry = at_rest.contacts_without_base_term()
    assert np.abs(asymmetry - asymmetry.T).max() == pytest.approx(2.50000279 * 9.81, rel=1e-9)  # the weight
    loaded = stance.stiffness_without_base_term()
    assert np.abs(loaded - loaded.T).max() > 10


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_modes_of_a_matrix_that_is_not_symmetric(stance: Stance) -> None:
    """Compare the modes of an asymmetric stiffness with SciPy's eigenvalues of M^-1 K."""
    K, M = stance.contacts_without_base_term(), stance.mass_matrix()
    modes = stance.modes(K)
    expected = np.sort_complex(scipy.linalg.eigvals(np.linalg.solve(M, K)))
    np.testing.assert_allclose([mode.eigenvalue for mode in modes], expected, rtol=1e-8)
    for mode in stance.modes():
        np.testing.assert_allclose(
            stance.stiffness() @ mode.direction, mode.eigenvalue.real * M @ mode.direction, atol=1e-6
        )


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_no_rest_is_refused(stance: Stance) -> None:
    with pytest.raises(StiffgenError, match="no rest near its posture"):
        replace(stance, load=np.array([0.0, 0.0, 1e5])).at_rest()


def test_identification_finds_modes_that_are_known() -> None:
    """Identify three known modes: two swing, one of them damped, and one grows."""
    time = 0.004 * np.arange(400)
    shapes = np.array([[1.0, 2, -1], [0.5, -1, 0.2], [1, 1, 1]])
    # a swing, a damped swing, a growth: 20 rad/s, 31 rad/s at 1/s, 2/s
    parts = np.array([np.cos(20 * time + 0.3), np.exp(-time) * np.cos(31 * time), 0.1 * np.exp(2 * time)])
    responses = np.stack([(shapes.T * w) @ parts for w in ([1.0, 2, 1], [2, -1, 1], [1, 1, -3])]).transpose(2, 1, 0)
    found = identify.modes(responses, 0.004, 5)
    exponents = [2, 20j, -1 + 31j]  # [1/s] by decreasing growth
    for mode, exponent, shape in zip(found[:1] + found[1:], exponents, shapes[[2, 0, 1]], strict=True):
        assert mode.exponent == pytest.approx(exponent, abs=1e-6)
        assert identify.agreement(np.eye(3), mode.shape, shape) > 1 - 1e-8


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_the_law_is_the_gradient_and_contacts_supply_the_bases_part(solo: ModuleType, stance: Stance) -> None:
    """Add torques and contact forces: together they are -dU/dq + gravity's gradient, in all 18 entries."""
    random = np.random.default_rng(1)
    where = stance.base_pose, stance.q
    zero, one = np.zeros((4, 3, 3)), np.array([1.0, 0, 0, 0])[:, None, None]
    in_base, in_world = (level(feet(solo, pose, stance.q)) for pose in (np.eye(4), stance.base_pose))
    of_base = Springs(in_base + 0, LEG * (1 - one), zero)
    of_ground = Springs(in_world, 100 * np.eye(3) * one, zero)
    of_base.equilibria[:, :3, 3] += random.normal(size=(4, 3)) * 0.01
    of_ground.equilibria[:, :3, 3] += random.normal(size=(4, 3)) * 0.05
    law = WholeBodyLaw(solo, of_base, of_ground, FEET[1:], damping=0.0)
    command = law.command(*where, np.zeros(12))
    J = np.vstack([getattr(solo, foot).hybrid.jacobian(*where)[:3] for foot in FEET])
    acting = np.concatenate([np.zeros(6), command.torque]) + J.T @ command.contact_forces.ravel()

    def energy(x: np.ndarray) -> float:
        moved = stance.moved(x)
        there = moved.base_pose, moved.q
        legs = solo.spring.energy_total(np.eye(4), moved.q, *of_base.parameters)
        gravity = solo.gravity.energy(*there, np.array([0, 0, -9.81]))
        return float(legs + solo.spring.energy_total(*there, *of_ground.parameters) - gravity)

    step = 1e-5
    slope = [(energy(step * x) - energy(-step * x)) / (2 * step) for x in np.eye(18)]
    np.testing.assert_allclose(acting, -np.array(slope), atol=1e-6)
    np.testing.assert_allclose(on_base(solo, *where, command.contact_forces), command.on_base, atol=1e-12)
    assert not command.contact_forces[0].any() and np.abs(command.on_base).max() > 10


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_at_rest_the_ground_gives_what_the_law_asks(solo: ModuleType) -> None:
    trace = trials.at_wall(solo, supplies=True)
    rest = np.searchsorted(trace.time, trials.PUSHED[0]) - 1
    np.testing.assert_allclose(trace.supplied[rest], trace.asked[rest], atol=0.01)
    assert trace.wall[rest, 0] < -4 and np.all(trace.ground[rest, 1:, 2] > 0)


@pytest.mark.wide(instead="test_identification_finds_modes_that_are_known")
def test_the_whole_report(solo: ModuleType, tmp_path: Path) -> None:
    """Run the report: all bars hold, and the page's pictures are those drawn now."""
    folder = str(Path(str(solo.__file__)).parent)
    assert main(["--robot", folder, "--output", str(tmp_path)]) == 0
    assert (tmp_path / "tables.txt").is_file()
    found = {
        name: difference((tmp_path / f"{name}.svg").read_text(),
                         (ROOT / "docs" / "figures" / f"stance_{name}.svg").read_text(), within=1.0)
        for name in ("modes", "load", "wall")
    }  # fmt: skip
    assert found == dict.fromkeys(found, "")


def test_no_robot_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["--robot", str(tmp_path)]) == 2
    assert "make build/robots/solo12" in capsys.readouterr().err


@pytest.mark.slow  # the arm is compiled
def test_another_robot_is_refused(capsys: pytest.CaptureFixture[str], plate_folder: Path) -> None:
    assert main(["--robot", str(plate_folder)]) == 2
    assert "not Solo 12" in capsys.readouterr().err
