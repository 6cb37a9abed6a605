# SPDX-License-Identifier: MIT
"""Torque that acts later than declared, on joints that are elastic: the arm shakes, and gets no torque."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.arms.arms import Arm
from support.project import Once

STEP = 0.15 * np.array([1.0, -0.6, 0, 1, 0, 0, 0])
BEGIN = 300


@pytest.fixture(scope="module")
def arm(once: Once) -> Arm:
    folder = once("arms-iiwa14", lambda folder: Arm("iiwa14", folder))
    return Arm("iiwa14", folder)


def run(arm: Arm, delay: int, declared: int, flexible: bool = True, noise: float = 0.0, **inputs: Any) -> Any:
    """Return the rows for a step of q0 at BEGIN, at the page's gains."""
    goal = arm.posture + (np.arange(2000) >= BEGIN)[:, None] * STEP
    random = np.random.default_rng(1)
    told = {"goal": goal, "translation": 400.0, "rotation": 20.0, "noise": noise * random.normal(size=(2000, 7))}
    plant = arm.plant(flexible=flexible, delay=delay)
    return arm.run(plant, 2000, arm.config(delay_samples=declared), **(told | inputs))


@pytest.mark.parametrize(("delay", "declared"), [(3, 0), (3, 1), (4, 1)])
def test_an_undeclared_delay_is_seen(arm: Arm, delay: int, declared: int) -> None:
    """Within 0.3 s of the step, with less than 3 J put out; all torque then goes to 0, damping too.

    Before, delay 3 at 0 declared put out 95 J, of which energy_supplied was 26 J.
    """
    rows = run(arm, delay, declared)
    first = int(np.flatnonzero(rows["faulted"])[0])
    assert rows["reason"][first] == arm.module.Reason.SHAKING
    assert BEGIN < first < BEGIN + 300
    assert rows["work"].max() < 3.0
    assert not rows["torque"][first + 250 :].any()


@pytest.mark.parametrize(
    ("delay", "flexible", "noise"), [(0, False, 0.0), (2, False, 0.0), (1, True, 0.0), (1, True, 0.02)]
)
def test_an_arm_that_does_not_shake_has_no_fault(arm: Arm, delay: int, flexible: bool, noise: float) -> None:
    """Delays as declared, elastic joints, and noise of 0.02 rad/s that is not declared."""
    assert not run(arm, delay, delay, flexible, noise)["faulted"].any()


def test_a_hand_that_shakes_the_tip_slowly_has_no_fault(arm: Arm) -> None:
    """5 Hz, 40 N: a half takes 0.1 s."""
    load = np.zeros((2000, 6))
    load[:, 1] = 40 * np.sin(2 * np.pi * 5e-3 * np.arange(2000))
    assert not run(arm, 1, 1, goal=arm.posture, load=load)["faulted"].any()
