# SPDX-License-Identifier: MIT
"""Commands by pose leave the self-motion alone: beside a textbook law with a projected posture, on the same plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.compare import Bench
from support.arms.arms import Arm
from support.plant.loop import KERNELS, Q0, TEXTBOOK, Loop
from support.project import Once

SPRINGS = {"translation": np.diag([700.0] * 3), "rotation": np.diag([30.0] * 3)}


@pytest.fixture(scope="module")
def textbook(robot_folder: Path, once: Once) -> Loop:
    flags = ("-O2", "-march=native")
    arguments = (robot_folder, TEXTBOOK, KERNELS, flags)
    return Loop(once("textbook", lambda folder: Loop(folder, *arguments)), *arguments)


def self_motion(loop: Loop, q: np.ndarray, v: np.ndarray) -> float:
    """Return the largest velocity of the self-motion n [rad/s], J n = 0: v = n a + M^-1 J^T b; |a| is returned.

    The second part is the tip's own motion in its clamp, which has a part along n, too.
    """
    most = 0.0
    for at, rate in zip(q[::5], v[::5], strict=True):
        n, M = np.linalg.svd(loop.jacobian(at))[2][-1], loop.mass_matrix(at) + 0.1 * np.eye(7)
        most = max(most, abs(float(n @ M @ rate / (n @ M @ n))))
    return most


def run(loop: Loop, parts: list[dict[str, Any]], samples: int) -> float:
    segments = loop.segments({**SPRINGS, "wanted": Q0, "posture": Q0, "pose": 1}, *parts)
    rows = loop.run(samples, segments, loop.episode(substeps=4), loop.config(), rows=True)[1]
    return self_motion(loop, rows["q"], rows["v"])


def oscillation(loop: Loop, speed: float, half: int, halves: int) -> list[dict[str, Any]]:
    """Return segments in which the equilibrium swings about Q0, joints moving so that the tip goes along a line."""
    parts, wanted = [], Q0.copy()
    rate = np.linalg.pinv(loop.jacobian(Q0)) @ np.array([0.0, speed, 0.6 * speed, 0.0, 0.0, 2.0 * speed])
    for k in range(halves):
        now = rate * (1 if k % 2 == 0 else -1)
        parts.append({"start": 500 + half * k, "wanted": wanted, "wanted_rate": now})
        wanted = wanted + now * half * 1e-3
    return parts


@pytest.mark.parametrize("speed", [0.05, 0.1, 0.3])
def test_the_tip_is_clamped_and_the_equilibrium_swings(loop: Loop, textbook: Loop, speed: float) -> None:
    """At most twice the textbook's self-motion. Before: 0.044, 0.050 and 0.155 against 0.002, 0.004 and 0.012 rad/s."""
    parts = [{"start": 1, "clamp": 1}, *oscillation(loop, speed, 250, 10)]
    ours, theirs = (run(each, parts, 3000) for each in (loop, textbook))
    assert ours <= 2 * theirs
    assert theirs > 0.001


@pytest.mark.parametrize("force", [20.0, 50.0, 80.0])
def test_a_loaded_tip_is_moved(loop: Loop, textbook: Loop, force: float) -> None:
    """By 15 cm in 0.6 s under a load: at most twice the textbook's self-motion."""
    rate = np.linalg.pinv(loop.jacobian(Q0)) @ np.array([0.0, 0.25, 0.0, 0.0, 0.0, 0.0])
    parts = [
        {"start": 1, "load": np.array([0.0, 0.0, -force, 0.0, 0.0, 0.0])},
        {"start": 1500, "wanted": Q0, "wanted_rate": rate},
        {"start": 2100, "wanted": Q0 + 0.6 * rate, "wanted_rate": np.zeros(7)},
    ]
    ours, theirs = (run(each, parts, 3500) for each in (loop, textbook))
    assert ours <= 2 * theirs
    assert theirs > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", ["iiwa14", pytest.param("panda", marks=pytest.mark.wide)])
def test_a_swing_that_begins_at_once(name: str, tmp_path: Path) -> None:
    """Flexible joints, friction, delay: at most twice the rotation vector's law. Before: 2.05 and 2.49 times."""
    arm = Arm(name, tmp_path)
    ours, theirs = (bench.self_motion(bench.clamped(1e-3)[:1500]) for bench in (Bench(arm, 0), Bench(arm, 1)))
    assert ours <= 2 * theirs
    assert theirs > 0.01
