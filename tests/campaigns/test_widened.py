# SPDX-License-Identifier: MIT
"""Short form of the energy search's further draws (widened.py, python_layer.py)."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from campaigns import energy, patterns, schedules, widened
from campaigns.python_layer import PythonLayer, module_sources
from support.plant.loop import Loop
from support.project import Once


@pytest.fixture(scope="module")
def hands(once: Once) -> Loop:
    """Return a robot with two tips, which takes tools at run time."""
    return energy.loop_of(once, "hands")


@pytest.fixture(scope="module")
def five_bar(once: Once) -> Loop:
    """Return a linkage with two motors."""
    return energy.loop_of(once, "five_bar")


def tip_by_differences(loop: Loop) -> np.ndarray:
    """Return the rows of the first tip's position of the Jacobian, by central differences of its pose."""
    steps = 1e-6 * np.eye(loop.n)
    return np.array([(loop.pose(loop.home + d) - loop.pose(loop.home - d))[:3, 3] / 2e-6 for d in steps]).T


def drawn(loop: Loop, count: int) -> list[tuple[schedules.Schedule, energy.Measured]]:
    """Return widened schedules of all patterns that stay within the bound, with what was measured."""
    found = []
    for seed in range(count):
        random = np.random.default_rng(seed)
        every = (*patterns.PATTERNS, schedules.schedule)
        chosen = widened.widen(random, loop, every[seed % len(every)](random, loop))
        got = energy.attempt(loop, chosen)
        assert got.excess <= energy.TOLERANCE, seed
        assert not got.deficit, seed
        assert got.summary.finite or not got.summary.finished, seed
        found.append((chosen, got))
    return found


def total(found: list[tuple[schedules.Schedule, energy.Measured]], name: str) -> float:
    """Return the sum of a field of the summaries."""
    return float(sum(getattr(got.summary, name) for _, got in found))


def test_a_deficit_counts_for_more_than_any_excess(loop: Loop, robot: ModuleType) -> None:
    """Carry the arm along while calls come ten times too late, against assumption (b): the deficit ranks first."""
    assert energy.TANK_DEFICIT == robot.Status.TANK_DEFICIT
    spoilt = patterns.carried(np.random.default_rng(150), loop)
    assert not energy.measure(loop, spoilt).deficit
    spoilt.episode["early"] = -9.0  # sample times that take ten times as long as declared
    got = energy.measure(loop, spoilt)
    assert got.deficit
    assert got.interest == np.inf


def test_each_draw_reaches_its_situation(loop: Loop) -> None:
    """Restarts, some with another delay; late calls; old samples; counters that wrap; positions in single precision."""
    found = drawn(loop, 66)
    assert total(found, "restarts") > 20
    assert total(found, "lates") > 1000
    assert total(found, "stales") > 100
    inexact = [got.summary for chosen, got in found if chosen.episode.get("single_positions")]
    assert len(inexact) > 10
    assert all(0 < summary.allowance < 2 for summary in inexact if summary.torque > 1)
    delays = [{part["late_torque"] for part in widened.settings(chosen)[0]} for chosen, _ in found]
    assert sum(len(each) > 1 for each in delays) > 5
    wraps = [got.summary.finished > 2**32 - start for chosen, got in found
             if (start := chosen.episode.get("first_counter", 0)) > 0]  # fmt: skip
    assert sum(wraps) > 2


def test_a_delay_changes_only_where_the_controller_restarts(loop: Loop) -> None:
    """Replace a segment by one with the same start: nothing restarts, and the declared delay stays."""
    replaced: list[dict[str, Any]] = [
        {"wanted": loop.home},
        {"start": 5, "restart": 1, "delay": 0},
        {"start": 5, "restart": 0},
    ]
    chosen = schedules.Schedule({"delay_samples": 2}, {"delay": 2}, replaced)
    assert [config["delay_samples"] for config in widened.settings(chosen)[1]] == [2]
    assert energy.measure(loop, chosen).summary.restarts == 0
    del chosen.parts[2]
    assert [config["delay_samples"] for config in widened.settings(chosen)[1]] == [2, 0]
    assert energy.measure(loop, chosen).summary.restarts == 1


@pytest.mark.slow
def test_energy_of_two_tips_with_tools(hands: Loop) -> None:
    """Restart with other tools of two tips: no energy beyond the bound."""
    assert (hands.tips, hands.tools) == (2, True)
    np.testing.assert_allclose(hands.jacobian(hands.home)[:3], tip_by_differences(hands), atol=1e-8)
    found = drawn(hands, 44)
    assert total(found, "restarts") > 10
    assert max(got.summary.port_most for _, got in found) > 0.1


@pytest.mark.slow
def test_energy_of_closed_loops(five_bar: Loop) -> None:
    """Loads act at the tip of a linkage, whose motors are the controller's joints."""
    assert five_bar.motors != list(range(five_bar.n))
    np.testing.assert_allclose(five_bar.jacobian(five_bar.home)[:3], tip_by_differences(five_bar), atol=1e-8)
    found = drawn(five_bar, 22)
    assert max(got.summary.port_most for _, got in found) > 0.1
    assert sum(got.summary.finished == schedules.SAMPLES for _, got in found) > 10


@pytest.fixture(scope="module")
def compiled(robot_folder: Path, once: Once) -> Loop:
    """Return a loop with the code that the Python module runs."""
    sources = module_sources(robot_folder)
    return Loop(once("compiled_loop", lambda folder: Loop(folder, robot_folder, sources=sources)), robot_folder)


@pytest.mark.slow
def test_python_puts_out_and_supplies_the_same(compiled: Loop, robot: ModuleType) -> None:
    """The best schedules of short climbs, which put out work."""
    every = [energy.climb(np.random.default_rng(seed), compiled, 12, seed % 2 == 1)[0] for seed in range(6)]
    assert max(energy.difference(compiled, robot, chosen) for chosen in every) == 0.0
    assert max(energy.measure(compiled, chosen).summary.port_most for chosen in every) > 0.1


def test_a_python_layer_that_counts_calls_is_found(compiled: Loop, robot: ModuleType) -> None:
    """Calls are late, and numbered all the same: 2.7 J more are put out than supplied.

    With less velocity_noise q and dq contradict each other then, and a sensor fault comes first.
    """

    class Forgetful(robot.Impedance):  # type: ignore[misc, name-defined]
        calls = 0

        def step(self, *, time: float, **values: Any) -> Any:
            self.calls += 1
            return super().step(counter=self.calls, **values)

        def missed(self, *, time: float) -> Any:
            self.calls += 1
            return super().missed(counter=self.calls)

    forgetful = ModuleType("forgetful")
    forgetful.Impedance = Forgetful  # type: ignore[attr-defined]
    chosen = patterns.gaps(np.random.default_rng(26), compiled)
    chosen.episode |= {"late": 0.5, "delay": 2}
    chosen.config |= {"delay_samples": 2, "call_gap_limit": 6, "missed_limit": 10, "velocity_noise": 1.0}
    assert energy.difference(compiled, robot, chosen) == 0.0
    assert energy.difference(compiled, forgetful, chosen) > 0.1
    with PythonLayer(compiled, forgetful):
        assert energy.measure(compiled, chosen).excess > 0.1


@pytest.mark.slow
def test_a_raised_velocity_limit_leaves_the_tank_room(five_bar: Loop) -> None:
    """Let springs give way under a raised limit: their energy stays in the account; a full tank lost it before."""
    stiff = np.diag([1000.0, 700.0, 100.0])[None]
    slow = {"call_gap_limit": 11, "velocity_limit": np.full(2, 1.6)}
    small = {"tank_initial": 0.66, "missed_limit": 1, "torque_rate_limit": np.full(2, 147.0)}
    carried = {"driven": 3, "driven_to": np.array([3.9, 3.9]), "driven_by": np.full(2, 1e7)}
    # the schedule as a campaign found it, in samples of 1 ms
    parts: list[dict[str, Any]] = [
        {},
        {"start": 392, "translation": stiff},
        {"start": 408, "driven": 2, "driven_at": np.full(2, 1.76), "driven_by": np.full(2, 39.4)},
        {"start": 1086, "config": 1, "restart": 1},
        {"start": 1306, "driven": 3},
        {"start": 1436, "config": 0, **carried},
    ]
    got = energy.measure(five_bar, schedules.Schedule(small, {}, parts, [slow]))
    assert got.summary.restarts == 1
    assert not got.deficit and got.excess <= energy.TOLERANCE
