# SPDX-License-Identifier: MIT
"""Short runs of the adversaries in tests/campaigns: settle.py and energy.py."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from campaigns import energy, patterns, schedules, settle
from support.plant.loop import Q0, Loop
from support.project import ROOT, Once


@pytest.mark.parametrize("part", [slice(0, 3), pytest.param(slice(3, 15), marks=pytest.mark.wide)], ids=str)
def test_random_situations_settle(loop: Loop, part: slice) -> None:
    """Fifteen of the situations of settle.py."""
    random = np.random.default_rng(11)
    cases = [settle.situation(random, loop.lower, loop.upper) for _ in range(15)][part]
    found = list(settle.outcomes(loop, cases))
    broken = {k: settle.failures(c, o) for k, (c, o) in enumerate(zip(cases, found, strict=True))}
    assert not {k: words for k, words in broken.items() if words}
    assert sum(outcome.static is not None for outcome in found) > len(cases) / 3


@pytest.mark.parametrize(("seed", "index"), [(1, 377), (3, 109)])
def test_situations_that_failed(loop: Loop, seed: int, index: int) -> None:
    """Situation 377: elbow almost straight, before joints were braked 1.42 times the governor's limit. 109: a load that
    takes up an engagement's 20 J on its way is not stranded; the arm rests where statics says."""
    random = np.random.default_rng(seed)
    case = [settle.situation(random, loop.lower, loop.upper) for _ in range(index + 1)][-1]
    (outcome,) = settle.outcomes(loop, [case])
    assert not settle.failures(case, outcome)
    assert outcome.held == (index == 109)
    assert outcome.static is not None


@pytest.mark.parametrize("pattern", [*patterns.PATTERNS, schedules.schedule], ids=lambda pattern: pattern.__name__)
def test_energy_of_schedules(loop: Loop, pattern: object) -> None:
    """Each pattern of the schedules, and random ones; the fault cycle is `laps` (before: 50 J a lap)."""
    for seed in range(25):
        chosen = pattern(np.random.default_rng(seed), loop)  # type: ignore[operator]
        got = energy.measure(loop, chosen)
        assert got.excess <= energy.TOLERANCE, seed
        assert got.summary.finite
        assert got.summary.effort <= 1
        assert got.summary.torque_step <= 1 + 1e-9


@pytest.fixture(scope="module")
def turning(once: Once) -> Loop:
    """Return the controller in the loop with an arm whose first and last joint turn without limits."""
    folder = once("turning", lambda folder: energy.generate_arm("turning", folder, build=False))
    robot, home = energy.generate_arm("turning", folder)
    return Loop(folder, robot, home=home)


@pytest.mark.parametrize("pattern", [patterns.turns, patterns.gaps, patterns.carried, schedules.schedule],
                         ids=lambda pattern: pattern.__name__)  # fmt: skip
def test_energy_of_joints_without_limits(turning: Loop, pattern: Any) -> None:
    """Encoders wrap. Where the shorter way is booked, ``turns`` puts out up to 2.4 J too much (Kinova)."""
    for seed in range(25):
        got = energy.measure(turning, pattern(np.random.default_rng(seed), turning))
        assert got.excess <= energy.TOLERANCE, seed
        assert got.summary.finite


@pytest.mark.slow
@pytest.mark.parametrize("moving", [pytest.param(False, marks=pytest.mark.slow), True])
def test_energy_hill_climbed(loop: Loop, moving: bool) -> None:
    for seed in range(5):
        got = energy.climb(np.random.default_rng(seed), loop, 60, moving)[1]
        assert got.excess <= energy.TOLERANCE, seed


BREAKS = json.loads((ROOT / "tests" / "data" / "energy_breaks.json").read_text())
"""Schedules that broke the bound while the controller was made, by 1e-3 to 68 J: climbs 811 (two of three calls left
out for long), 844, 919, 958, 20013 (calls left out, delay 2; 2.2 J), 20052 (1.4 J) and 300028 (what the posture of a
command by pose released did not pay for the equilibrium, but filled the tank; 0.3 J)."""


@pytest.mark.parametrize("name", BREAKS)
def test_energy_of_old_breaks(loop: Loop, name: str) -> None:
    def arrays(given: dict[str, Any]) -> dict[str, Any]:
        return {key: np.array(value) if isinstance(value, list) else value for key, value in given.items()}

    given = BREAKS[name]
    parts = [arrays(part) for part in given["parts"]]
    got = energy.measure(loop, schedules.Schedule(arrays(given["config"]), arrays(given["episode"]), parts))
    assert got.excess <= energy.TOLERANCE


def test_energy_held_where_the_first_sample_is_missing(loop: Loop) -> None:
    """The limit avoidance holds 30 J at the start; before, climb 1010371 forgot them."""
    zone = {"limit_zone": 1.8, "limit_stiffness": 1.7 * loop.effort}
    config = {"tank_initial": 0.3, "engagement_limit": 3.7, "damping_ratio": 0.1, **zone}
    along = np.array([0.06, -0.12, -0.06, 0.1, -0.3, 0.38, 0.21])
    carried = {"driven": 2, "driven_to": Q0 + along, "driven_at": 0.9 * loop.velocity, "driven_by": 11.0}
    parts = [{"wanted": Q0, "missed": 1}, {"start": 1, "missed": 0, **carried}]
    got = energy.measure(loop, schedules.Schedule(config, {"q": Q0}, parts))
    assert got.summary.first_energy > 20
    assert got.summary.port_most > 0.4
    assert got.excess <= energy.TOLERANCE


STIFF = {"translation": np.diag([3000.0, 3000, 3000]), "rotation": np.diag([200.0, 200, 200])}
HELD: dict[str, Any] = {
    "driven": 2,
    "driven_to": Q0 + np.array([0.2, -0.2, 0.1, 0.3, 0.2, -0.2, 0.2]),
    "driven_at": 0.5,
    "driven_by": 20.0,
}
"""The arm held away from where it is wanted, on stiff springs."""
CARRIED = 1500
"""[samples] from when on it is carried along."""


def lost(
    loop: Loop, delay: int, tank: float, change: dict[str, Any] | None = None, speed: float = 0.9999, **loss: int
) -> float:
    """How far the work passes energy_supplied [J]: the arm is held away from where it is wanted, and then carried along
    the springs' pull at its velocity limit while samples or calls are missing, or with a changed configuration."""
    config = {"tank_initial": tank, "engagement_limit": 1.0, "delay_samples": delay, "motor_inertia": 0.1}
    settings = [loop.config(**config), loop.config(**config, **(change or {}))]
    parts: list[dict[str, Any]] = [{"wanted": Q0, **STIFF}, {"start": 5, **HELD}]
    episode = loop.episode(q=Q0, delay=delay, engagement=1.0, fastest=max(speed, 1.0))
    summary = loop.run(CARRIED, loop.segments(*parts), episode, settings)
    assert summary.faults == 0
    assert np.abs(np.array(summary.acted)).max() > 5
    along = np.sign(np.array(summary.acted)) * loop.velocity * speed
    carried = {"start": CARRIED, "driven": 1, "driven_to": along, "driven_by": 1e7, "config": 1, **loss}
    return float(loop.run(2000, loop.segments(*parts, carried), episode, settings).excess_supplied)


@pytest.mark.parametrize("delay", [0, 1, 2, 5])
def test_carried_along_while_samples_or_calls_are_lost(loop: Loop, delay: int) -> None:
    """At the boundary of what the theorem assumes of calls (b); beyond it the bound does not hold."""
    for tank in (0.02, 0.3):
        for loss in ({"missed": 1}, {"skip": 2}, {"missed": 1, "skip": 2}, {}):
            assert lost(loop, delay, tank, **loss) <= energy.TOLERANCE, (tank, loss)
    assert lost(loop, delay, 0.02, skip=300) > 0.05


def test_carried_along_faster_than_assumed(loop: Loop) -> None:
    """(c): an environment that carries the arm at ten times its velocity limit, unseen, takes 3 J too many."""
    assert lost(loop, 0, 0.02, missed=1) <= energy.TOLERANCE
    assert lost(loop, 0, 0.02, speed=10.0, missed=1) > 1


def test_limits_that_change_while_the_torque_acts(loop: Loop) -> None:
    """(d): a torque rate limit that is lowered while a torque acts lets it fall more slowly than was covered; what is
    lowered beforehand is covered."""
    lower = {"torque_rate_limit": 0.02 * np.array(loop.config().torque_rate_limit)}
    assert lost(loop, 0, 0.02, {"torque_rate_limit": 1e6}, missed=1) <= energy.TOLERANCE
    assert lost(loop, 0, 0.02, {"effort_limit": 5.0}, missed=1) <= energy.TOLERANCE
    assert lost(loop, 0, 0.02, lower, missed=1) > 0.1
    tank = 0.5
    config = {"tank_initial": tank, "engagement_limit": 1.0, "motor_inertia": 0.1, **lower}
    parts = [{"wanted": Q0, **STIFF}, {"start": 5, **HELD}]
    held = loop.run(CARRIED, loop.segments(*parts), configs=loop.config(**config))
    along = np.sign(np.array(held.acted)) * loop.velocity * 0.9999
    parts.append({"start": CARRIED, "driven": 1, "driven_to": along, "driven_by": 1e7, "missed": 1})
    assert np.abs(np.array(held.acted)).max() > 1
    episode = loop.episode(engagement=1.0, fastest=1.0)
    assert loop.run(2000, loop.segments(*parts), episode, loop.config(**config)).excess_supplied <= energy.TOLERANCE


@pytest.mark.parametrize("quantum", [0.0, 1e-4, 1e-3])
def test_positions_of_an_encoder(loop: Loop, quantum: float) -> None:
    """(a): the account sees positions, so a quantum costs at most half of it at each change of the held torque."""
    off = 0.0
    for seed in range(6):
        chosen = patterns.pumping(np.random.default_rng(seed), loop)
        chosen.episode |= {"quantum": quantum, "differences": 1}
        chosen.config |= {"position_quantum": quantum, "actuation": 1}
        episode = loop.episode(**chosen.episode, fastest=1.0)
        settings = loop.config(**chosen.config)
        summary, rows, outputs = loop.run(
            schedules.SAMPLES, loop.segments(*chosen.parts), episode, settings, rows=True, outputs=True
        )
        done = np.array(rows["port"][: summary.finished - 1])
        booked = np.array(outputs["port_total"][1 : summary.finished])
        acted = np.array(rows["acted"][: summary.finished - 1])
        changes = np.abs(np.diff(acted, axis=0, prepend=0.0)).sum(axis=1)
        most = quantum / 2 * (np.cumsum(changes) + np.abs(acted).sum(axis=1))
        assert np.all(np.abs(done - booked) <= most + energy.TOLERANCE)
        off = max(off, np.abs(done - booked).max())
    assert off > 1e-2 * quantum if quantum else off < energy.TOLERANCE


def test_an_undeclared_delay_is_not_accounted_for(loop: Loop) -> None:
    """Declared, two samples of delay keep the bound in the fastest shaking; what is not declared cannot be known."""
    worst = {0: -np.inf, 2: -np.inf}
    for declared in worst:
        for seed in range(12):
            chosen = patterns.shaking(np.random.default_rng(seed), loop)
            chosen.episode["delay"] = 2
            chosen.config |= {"delay_samples": declared, "actuation": 1}
            worst[declared] = max(worst[declared], energy.measure(loop, chosen).excess)
    assert worst[2] <= energy.TOLERANCE
    assert worst[0] > worst[2]
