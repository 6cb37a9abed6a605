# SPDX-License-Identifier: MIT
"""What an analysis computes at each row: robot's tip, task stiffness, and what the recorded wrenches are."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.connection import Representation
from stiffgen.lab.arms.loads import stiffness_deviation, tip_covariance


@dataclass(frozen=True)
class SensorTask:
    """Sensor whose readings were recorded: bias (6), payload (4) and standard deviations of a reading (6)."""

    bias: FloatArray
    payload: FloatArray
    deviation: FloatArray


@dataclass(frozen=True)
class Task:
    """Computation to do at each row.

    Attributes:
        representation: representation of the wrenches and of the task stiffness.
        task_stiffness: (6, 6) symmetric [N/m, N, N m/rad].
        negate: true if the recorded wrench is the one that the robot applies to the environment.
        lower, upper: (n,) limits of q [rad or m], infinite where there is none.
        tip: name of the tip in the robot's module, "" for the only one.
        sensor: the sensor whose readings were recorded in place of wrenches.

    """

    representation: Representation
    task_stiffness: FloatArray
    negate: bool
    lower: FloatArray
    upper: FloatArray
    tip: str = ""
    sensor: SensorTask | None = None

    def wrench_of(self, robot: ModuleType, q: FloatArray, recorded: FloatArray) -> FloatArray:
        """Return the wrenches of the environment on the robot from the recorded ones, or from a sensor's readings."""
        if self.sensor is None:
            return -recorded if self.negate else recorded
        with np.errstate(invalid="ignore"):  # rows with missing numbers are not used
            bias, payload = self.sensor.bias, self.sensor.payload
            return np.asarray(self.of_tip(robot).sensor.tip_wrench(q, recorded, bias, payload))

    def of_tip(self, robot: ModuleType) -> Any:
        """Return the functions of the tip in a generated module."""
        return getattr(robot, self.tip) if self.tip else robot

    def functions_of(self, robot: ModuleType) -> Any:
        """Return the functions of the tip and the representation in a generated module."""
        return getattr(self.of_tip(robot), self.representation)

    def deviations(self, robot: ModuleType, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """Return the standard deviations (N, 2) of the antisymmetric part and of the smallest eigenvalue."""
        if self.sensor is None:
            return np.full((len(q), 2), np.nan)
        functions = self.of_tip(robot)
        covariance = tip_covariance(functions, q, np.diag(self.sensor.deviation**2))
        found = stiffness_deviation(functions, q, wrench, self.task_stiffness, covariance)
        return np.stack([found.antisymmetric_deviation, found.smallest_deviation], axis=1)
