# SPDX-License-Identifier: MIT
"""Controllers are copied and pickled with their state; a copy is independent of the controller that it was made of."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest


@pytest.mark.parametrize("made", [copy.copy, copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_a_copy_steps_as_the_controller_does(made: Callable[[Any], Any], robot: Any) -> None:
    """Step a copy five times: the bits of the original's; a restart of the copy leaves the original alone."""
    stated = {"sample_time": 1e-3, "delay_samples": 0, "motor_inertia": 0.1, "heaviest_wrench": (50.0, 10.0)}
    controller = robot.Impedance(**stated, ramp_time=0.3, coriolis="on", record=3)
    q = 0.5 * (robot.LOWER + robot.UPPER) + 0.1
    sample = {"q": q, "dq": 0 * q, "translation_stiffness": 300 * np.eye(3), "rotation_stiffness": 20 * np.eye(3)}
    for k in range(5):  # towards a q0 that is 0.05 rad away
        controller.step(q0=q + 0.05, counter=k, **sample)
    other = made(controller)
    assert other.config.ramp_time == 0.3 and other.config.coriolis == "on"
    for k in range(5, 10):
        expected = controller.step(q0=q + 0.05, counter=k, **sample)
    for k in range(5, 10):
        out = other.step(q0=q + 0.05, counter=k, **sample)
    assert out.torque.any() and np.array_equal(out.torque, expected.torque) and out.tank == expected.tank
    other.restart(out.torque, ramp_time=0.2)
    assert controller.config.ramp_time == 0.3 and other.config.ramp_time == 0.2
