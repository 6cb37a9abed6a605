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
    """Five steps of the copy give the bits of the original's; fields that change afterwards are its own."""
    controller = robot.Impedance(energy_limit=3.0, coriolis="on", record=3)
    q = 0.5 * (robot.LOWER + robot.UPPER) + 0.1
    sample = {"q": q, "dq": 0 * q, "translation_stiffness": 300 * np.eye(3), "rotation_stiffness": 20 * np.eye(3)}
    for _ in range(5):
        controller.step(q0=q + 0.05, **sample)
    other = made(controller)
    assert other.config.energy_limit == 3.0 and other.config.coriolis == "on"
    for _ in range(5):
        expected = controller.step(q0=q + 0.05, **sample)
    for _ in range(5):
        out = other.step(q0=q + 0.05, **sample)
    assert out.torque.any() and np.array_equal(out.torque, expected.torque) and out.tank_energy == expected.tank_energy
    other.config.energy_limit = 2.0
    assert controller.config.energy_limit == 3.0
