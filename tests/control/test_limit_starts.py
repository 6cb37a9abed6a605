# SPDX-License-Identifier: MIT
"""Starts at the joint limits: the limit avoidance is as stiff as torque rate and sample time let it be, no stiffer."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from support.plant.loop import Q0, Loop, N

SHARE, MOTOR = 0.25, 0.1
"""Share of the effort limits and motor inertia of the FRI client's defaults."""
SIDES = [(joint, side) for joint in range(N) for side in (1, -1)]
PAIRS = [pair for pair in itertools.combinations(SIDES, 2) if pair[0][0] != pair[1][0]]


def start(loop: Loop, joints: Any, inside: float, sample_time: float, rise: float, delay: int) -> Any:
    """Start with some joints at their limits and stay there for a second."""
    q, effort = Q0.copy(), SHARE * loop.effort
    for joint, side in joints:
        q[joint] = (loop.upper if side > 0 else loop.lower)[joint] - side * inside
    limits = {"effort_limit": effort, "torque_rate_limit": effort / rise}
    config = loop.config(sample_time=sample_time, delay_samples=delay, motor_inertia=MOTOR, ramp_time=0.05,
                         tip_velocity_limit=(2.0, 6.0), **limits)  # fmt: skip
    episode = loop.episode(q=q, motor=MOTOR, sample_time=sample_time, delay=delay, differences=1,
                           effort=effort, rate=effort / rise, substeps=max(1, round(sample_time / 1e-3)))  # fmt: skip
    return loop.run(round(1.0 / sample_time), loop.segments({"wanted": q, "joint": 10.0}), episode, config)


def slow(*values: float) -> Any:
    return pytest.param(*values, marks=pytest.mark.slow)


def wide(*values: float) -> Any:
    return pytest.param(*values, marks=pytest.mark.wide)


@pytest.mark.slow
@pytest.mark.parametrize("inside", [1e-3, -1e-3, pytest.param(0.01, marks=pytest.mark.wide)])
@pytest.mark.parametrize(
    ("sample_time", "rise", "delay"),
    [slow(1e-3, 0.25, 0), wide(2e-3, 0.25, 0), (5e-3, 0.25, 0), wide(5e-3, 0.1, 2), wide(1e-2, 0.25, 0),
     slow(1e-2, 2.0, 1)],
)  # fmt: skip
def test_start_at_the_limits(loop: Loop, sample_time: float, rise: float, delay: int, inside: float) -> None:
    """No joint leaves its range, is too fast, or still moves at the end, at any limit and, 1e-3 away, any two.

    rise: time from zero to the effort limit. Before: up to 26 of 42 single starts, from 5 ms on by A6 alone.
    """
    for joints in [*[(side,) for side in SIDES], *(PAIRS if abs(inside) == 1e-3 else [])]:
        summary = start(loop, joints, inside, sample_time, rise, delay)
        assert summary.faults == 0, (joints, summary.reason)
        assert summary.final_speed < 0.05, joints
