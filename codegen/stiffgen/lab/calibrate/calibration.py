# SPDX-License-Identifier: MIT
"""Record of a sensor's calibration, and its file: JSON with one array per quantity."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import RecordingError, printable
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.files import FileError, read_regular
from stiffgen.core.robot.geometry import FloatArray

GENERATOR = "stiffgen calibrate"
_MOST_BYTES = 1 << 16


@dataclass(frozen=True)
class Calibration:
    """Calibration of a force-torque sensor; all values in sensor axes, about the sensor's origin.

    The true values of bias and payload lie within their intervals, all ten at once, with a probability of 95 %.

    Attributes:
        robot: name of the robot's folder.
        sensor: link, sign and pose of the sensor, as the folder has them.
        bias: reading without payload and contact (6) at the end of the recording [N, N m].
        payload: mass and first moment (4) [kg, kg m].
        bias_interval: half widths of the intervals of ``bias`` (6).
        payload_interval: half widths of the intervals of ``payload`` (4).
        drift: rate of the bias (6) [N/s, N m/s]; zeros where the recording has no time or fewer than eight poses.
        noise: standard deviations of a pose's mean reading from the model (6) [N, N m].
        rotation: rotation of the sensor against the frame at generation (3) [rad], which the forces suggest.
        rotation_interval: half widths of its intervals (3) [rad].
        poses: number of poses.

    """

    robot: str
    sensor: str
    bias: tuple[float, ...]
    payload: tuple[float, ...]
    bias_interval: tuple[float, ...]
    payload_interval: tuple[float, ...]
    drift: tuple[float, ...]
    noise: tuple[float, ...]
    rotation: tuple[float, ...]
    rotation_interval: tuple[float, ...]
    poses: int

    @property
    def centre_of_mass(self) -> tuple[float, ...]:
        """Centre of mass of the payload (3) [m]."""
        mass, *moment = self.payload
        return tuple(each / mass for each in moment)

    def to_json(self) -> str:
        """Return the text of the file: C and C++ find an array behind its name, ROS reads it as YAML."""
        lines = [f'  "generator": {json.dumps(GENERATOR)}']
        lines += [f"  {json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in asdict(self).items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"


_SIZES = {
    "bias": 6, "payload": 4, "bias_interval": 6, "payload_interval": 4, "drift": 6, "noise": 6, "rotation": 3,
    "rotation_interval": 3,
}  # fmt: skip


def read_calibration(file: str | Path) -> Calibration:
    """Return the calibration in a file that ``stiffgen calibrate`` wrote.

    Raises:
        RecordingError: the file cannot be read, or is no calibration.

    """
    try:
        content = json.loads(read_regular(str(file), _MOST_BYTES).decode("utf-8"))
        return _of_content(content)
    except (OSError, FileError) as error:
        raise RecordingError(f"{file}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    except (ValueError, ArithmeticError, TypeError, KeyError, RecursionError) as error:
        raise RecordingError(
            f"{file}: is no calibration by 'stiffgen calibrate' ({type(error).__name__}: {printable(str(error))}); "
            "make it again"
        ) from error


def _of_content(content: Mapping[str, Any]) -> Calibration:
    """Return the calibration in the content of a file; raise ValueError for anything else."""
    if not isinstance(content, dict) or content.get("generator") != GENERATOR:
        raise ValueError("another generator")
    arrays: dict[str, Any] = {name: tuple(map(float, content[name])) for name in _SIZES}
    for name, size in _SIZES.items():
        if len(arrays[name]) != size or not all(map(math.isfinite, arrays[name])):
            raise ValueError(f"{name} must be {size} finite numbers")
    return Calibration(str(content["robot"]), str(content["sensor"]), poses=int(content["poses"]), **arrays)


def sensor_functions(robot: GeneratedRobot) -> Any:
    """Return the group ``sensor`` of a robot's module.

    Raises:
        RecordingError: the robot has no sensor.

    """
    if robot.chain.sensor is None:
        raise RecordingError(f"{robot.folder}: has no force-torque sensor; generate it with --sensor LINK")
    return tip_functions(robot).sensor


def tip_functions(robot: GeneratedRobot) -> Any:
    """Return the functions of the tip with the sensor; without one, of the robot's only tip.

    Raises:
        RecordingError: the functions take a pose that a recording does not have, or the tip is not known.

    """
    sensor = robot.chain.sensor
    if robot.chain.runtime_tool or robot.chain.floating:
        raise RecordingError(
            f"{robot.folder}: its functions take the pose of {'a tool' if robot.chain.runtime_tool else 'the base'}, "
            "which a recording does not have; generate a second folder without it, with another --name"
        )
    if sensor is None and len(robot.chain.tips) > 1:
        raise RecordingError(f"{robot.folder}: has several tips; generate it with --sensor LINK, or with one tip")
    tip = robot.chain.tips[sensor.tip if sensor else 0].name
    return getattr(robot.module, tip) if tip else robot.module


def tare(sensor: Any, q: ArrayLike, reading: ArrayLike, payload: ArrayLike) -> FloatArray:
    """Return the bias (6) that explains readings of a robot at rest without contact.

    Args:
        sensor: functions of the sensor, ``module.sensor``.
        q: joint positions (..., n) [rad or m].
        reading: readings (..., 6) in the same postures; their mean counts.
        payload: mass and first moment (4) of all that hangs behind the sensor.

    """
    none = np.zeros(6)
    expected = sensor.reading(q, none, none, np.asarray(payload, dtype=float))
    return np.asarray((np.asarray(reading, dtype=float) - expected).reshape(-1, 6).mean(axis=0))
