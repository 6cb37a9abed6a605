# SPDX-License-Identifier: MIT
"""Poses at a SCARA's limits: the equilibrium stops where it is told to, and a pose frees what a pose has stuck."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stiffgen import generate, open_robot
from support.controller_inputs import Arm
from support.project import ROOT, Once

ROTORS = np.array([0.1, 0.1, 2.0, 0.01])
HIGH, LOW = np.array([0.3, -0.7, 0.1, 1.0]), np.array([0.3, -0.7, 0.01, 1.0])
FOLD = np.array([0.181, -0.207, 0.08, 1.174]), np.array([-2.07, -0.874, 0.14, 0.993]), np.array([0.3, -1.2, 0.1, 1.0])
"""A start, and poses on whose straight ways the elbow comes to its limit."""
MOST = 1e-3
"""Error of the tip at rest [m]."""


@pytest.fixture(scope="module")
def scara(once: Once) -> ModuleType:
    made = once("scara", lambda output: generate(ROOT / "tests" / "data" / "scara.urdf", output=output, batches=False))
    return open_robot(made / "scara").module


class Session:
    """A controller with an arm, which starts at rest."""

    def __init__(self, robot: ModuleType, q: np.ndarray, rotors: Any, stiffness: tuple[float, float], **fields: Any):
        self.robot, self.arm = robot, Arm(robot, q, rotors)
        self.controller = robot.Impedance(motor_inertia=rotors, stiffness_cap="accept", **fields)
        names = ("translation_stiffness", "rotation_stiffness")
        self.springs = {name: k * np.eye(3) for name, k in zip(names, stiffness, strict=True)}
        self.beyond = -np.inf

    def go(self, posture: np.ndarray, seconds: float) -> float:
        """Command a posture's pose; return the distance that the tip is away from it then [m]."""
        pose = self.robot.forward_kinematics(posture)
        for _ in range(round(1e3 * seconds)):
            state = {"q": self.arm.q, "dq": self.arm.dq}
            out = self.controller.step(**state, equilibrium=pose, posture=posture, **self.springs)
            assert not out.fault, out.text
            self.arm.step(out.torque)
            self.beyond = max(self.beyond, float(np.max(np.abs(self.arm.q - self.middle) - self.half)))
        return float(np.linalg.norm(self.robot.forward_kinematics(self.arm.q)[:3, 3] - pose[:3, 3]))

    @property
    def middle(self) -> np.ndarray:
        return np.asarray(self.robot.LOWER + self.robot.UPPER) / 2

    @property
    def half(self) -> np.ndarray:
        return np.asarray(self.robot.UPPER - self.robot.LOWER) / 2


@pytest.mark.parametrize("stiffness", [(1500.0, 20.0), (3000.0, 20.0), (400.0, 5.0)])
def test_a_quill_stays_above_its_stop(scara: ModuleType, stiffness: tuple[float, float]) -> None:
    """Before: 11 mm beyond its stop, and a pose back moved nothing: 103 mm off. Slow in the zone, the equilibrium
    could stop at a tenth of its ramp only, and overshot by 19 mm."""
    session = Session(scara, HIGH, ROTORS, stiffness, limit_zone=0.02)
    session.go(LOW, 4.0)
    assert session.beyond < 0.0
    assert session.go(HIGH, 4.0) < MOST


def test_poses_beyond_a_fold_are_reached(scara: ModuleType) -> None:
    """Before: the elbow stopped 0.042 rad beyond its limit, 650, 535 and 371 mm away from the three poses."""
    start, away, other = FOLD
    session = Session(scara, start, 0.1, (700.0, 30.0))
    for posture in (away, start, other):
        assert session.go(posture, 7.0) < MOST
    assert session.beyond < 0.035
