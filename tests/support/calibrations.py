# SPDX-License-Identifier: MIT
"""Write a sensor's calibration for C and C++ programs without estimating it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

import stiffgen
from stiffgen.lab.calibrate.calibration import Calibration


def calibration_text(robot: Path, bias: ArrayLike = (0.0,) * 6, payload: ArrayLike = (0.0,) * 4) -> str:
    """Return the text of a calibration file for the sensor of a robot's folder."""
    sensor = stiffgen.open_robot(robot).chain.sensor
    assert sensor is not None
    known, held = (tuple(map(float, np.asarray(each))) for each in (bias, payload))
    three, six = (0.0,) * 3, (0.0,) * 6
    return Calibration(robot.name, sensor.text, known, held, six, six[:4], six, six, three, three, 6).to_json()
