"""Short runs of the adversaries in tests/long: settle.py, energy.py, hostile.py."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from long import energy, hostile, settle
from support.plant.loop import Loop


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


# Schedules that broke the bound while the controller was made: (seed, moving), climbs of 120 or 150 schedules.
@pytest.mark.parametrize(("seed", "steps"), [(106, 120), (301, 120), (503, 120), (608, 150)])
def test_energy_of_old_breaks(loop: Loop, seed: int, steps: int) -> None:
    got = energy.climb(np.random.default_rng(seed), loop, steps, False)[1]
    assert got.excess <= energy.TOLERANCE


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
