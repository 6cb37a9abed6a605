"""Short runs of the adversaries in tests/long: settle.py, energy.py, hostile.py."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from long import energy, hostile, settle
from support.plant.loop import Q0, Loop
from support.project import ROOT


def test_random_situations_settle(loop: Loop) -> None:
    """Thirty of the situations of settle.py."""
    random = np.random.default_rng(11)
    cases = [settle.situation(random, loop.lower, loop.upper) for _ in range(30)]
    found = list(settle.outcomes(loop, cases))
    broken = {k: settle.failures(c, o) for k, (c, o) in enumerate(zip(cases, found, strict=True))}
    assert not {k: words for k, words in broken.items() if words}
    assert sum(outcome.static is not None for outcome in found) > 10


@pytest.mark.parametrize("pattern", [*energy.PATTERNS, energy.schedule], ids=lambda pattern: pattern.__name__)
def test_energy_of_schedules(loop: Loop, pattern: object) -> None:
    """Each pattern of the schedules, and random ones; the fault cycle is `laps` (before: 50 J a lap)."""
    for seed in range(25):
        chosen = pattern(np.random.default_rng(seed), loop)  # type: ignore[operator]
        got = energy.measure(loop, chosen)
        assert got.excess <= energy.TOLERANCE, seed
        assert got.summary.finite
        assert got.summary.effort <= 1
        assert got.summary.torque_step <= 1 + 1e-9


@pytest.mark.parametrize("moving", [False, True])
def test_energy_hill_climbed(loop: Loop, moving: bool) -> None:
    for seed in range(5):
        got = energy.climb(np.random.default_rng(seed), loop, 60, moving)[1]
        assert got.excess <= energy.TOLERANCE, seed


BREAKS = json.loads((ROOT / "tests" / "data" / "energy_breaks.json").read_text())
"""Schedules that broke the bound while the controller was made, by 1e-3 to 68 J: climbs 811 (two of three calls left
out for long), 844, 919, 958, 20013 (calls left out, delay 2; 2.2 J) and 20052 (1.4 J)."""


@pytest.mark.parametrize("name", BREAKS)
def test_energy_of_old_breaks(loop: Loop, name: str) -> None:
    def arrays(given: dict[str, Any]) -> dict[str, Any]:
        return {key: np.array(value) if isinstance(value, list) else value for key, value in given.items()}

    given = BREAKS[name]
    parts = [arrays(part) for part in given["parts"]]
    got = energy.measure(loop, energy.Schedule(arrays(given["config"]), arrays(given["episode"]), parts))
    assert got.excess <= energy.TOLERANCE


def lost(loop: Loop, delay: int, tank: float, **loss: int) -> float:
    """How far the output passes the bound [J]: the arm is held away from where it is wanted, and then carried along the
    springs' pull at its velocity limit while samples or calls are missing."""
    away = Q0 + np.array([0.2, -0.2, 0.1, 0.3, 0.2, -0.2, 0.2])
    held = {"driven": 2, "driven_to": away, "driven_at": 0.5, "driven_by": 20.0}
    stiff = {"translation": np.diag([3000.0, 3000, 3000]), "rotation": np.diag([200.0, 200, 200])}
    config = {"tank_initial": tank, "engagement_limit": 1.0, "delay_samples": delay, "motor_inertia": 0.1}
    first: dict[str, Any] = {"wanted": Q0, **stiff}
    held_only = energy.Schedule(config, {"delay": delay, "q": Q0}, [first, {"start": 5, **held}])
    episode = loop.episode(delay=delay, engagement=1.0, fastest=1.0)
    summary = loop.run(1500, loop.segments(*held_only.parts), episode, loop.config(**config))
    assert summary.faults == 0
    assert np.abs(np.array(summary.acted)).max() > 5
    along = np.sign(np.array(summary.acted)) * loop.velocity * 0.9999
    carried = {"start": 1500, "driven": 1, "driven_to": along, "driven_by": 1e7, **loss}
    return energy.measure(loop, energy.Schedule(config, held_only.episode, [*held_only.parts, carried])).excess


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_carried_along_while_samples_or_calls_are_lost(loop: Loop, delay: int) -> None:
    """At the boundary of what the theorem assumes of calls and velocities; beyond it the bound does not hold."""
    for tank in (0.02, 0.3):
        for loss in ({"missed": 1}, {"skip": 2}, {}):
            assert lost(loop, delay, tank, **loss) <= energy.TOLERANCE, (tank, loss)
    assert lost(loop, delay, 0.02, skip=300) > 0.05


def test_an_undeclared_delay_is_not_accounted_for(loop: Loop) -> None:
    """Declared, two samples of delay keep the bound in the fastest shaking; what is not declared cannot be known."""
    worst = {0: -np.inf, 2: -np.inf}
    for declared in worst:
        for seed in range(12):
            chosen = energy.shaking(np.random.default_rng(seed), loop)
            chosen.episode["delay"], chosen.config["delay_samples"] = 2, declared
            worst[declared] = max(worst[declared], energy.measure(loop, chosen).excess)
    assert worst[2] <= energy.TOLERANCE
    assert worst[0] > worst[2]


@pytest.mark.parametrize(
    ("compiler", "flips"),
    [
        ("clang", 20000.0),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("clang", 0.0), ("gcc", 0.0), ("gcc", 20000.0))),
    ],
)
def test_hostile_steps(robot_folder: Path, tmp_path: Path, compiler: str, flips: float) -> None:
    """Bad samples, calls and configurations, and bit flips of the state, under the sanitizers."""
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    done = hostile.run(hostile.build(tmp_path, robot_folder, compiler), 60000, 3, flips)
    assert done.returncode == 0, done.stderr
    active = int(done.stdout.split(", ")[1].split()[0])
    assert active > 5000, "it hardly ever was under control"
