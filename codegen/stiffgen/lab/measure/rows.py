# SPDX-License-Identifier: MIT
"""Read the rows of a measurement from a recording: poses, from joint positions or as such, and readings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from stiffgen.core.errors import RecordingError
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.calibrate.calibration import Calibration, read_calibration, tip_functions
from stiffgen.lab.calibrate.poses import has_columns, read_rows
from stiffgen.lab.measure.motion import skew

Rotation = Literal["quaternion", "vector"]
"""Form of a recorded pose's rotation: (x, y, z, w), or a rotation vector [rad]."""
_NAMES: dict[Rotation, tuple[str, ...]] = {
    "quaternion": ("x", "y", "z", "qx", "qy", "qz", "qw"),
    "vector": ("x", "y", "z", "rx", "ry", "rz"),
}
_MOST_ROWS = 1 << 22


@dataclass(frozen=True)
class MeasurementRows:
    """Time (N) [s], poses of the sensor's frame (N, 4, 4) [m], readings (N, 6) [N, N m], and q (n) in the middle."""

    time: FloatArray
    poses: FloatArray
    readings: FloatArray
    q: FloatArray | None = None


@dataclass(frozen=True)
class RowOptions:
    """Columns of a recording, and the rows to use.

    Attributes:
        positions: joint positions, or the pose without a robot: prefix of the columns, or names with commas.
        reading: prefix of the six columns of the readings, or their names with commas.
        window: first and last time [s].

    """

    positions: str | None = None
    reading: str | None = None
    window: tuple[float, float] | None = None


def read_measurement(
    log: Path, options: RowOptions, robot: GeneratedRobot | None, calibration: Calibration | None = None
) -> MeasurementRows:
    """Return the rows of a recording within the window; readings less bias and payload of a calibration.

    Raises:
        RecordingError: the recording cannot be read, has no time, or its poses are none.

    """
    positions = options.positions or ("pose_" if robot is None else None)
    rotation = find_rotation(log, positions, options.reading) if robot is None and positions else "quaternion"
    names = _NAMES[rotation] if robot is None else robot.chain.coordinate_names
    where, readings, time = read_rows(
        log, names, positions, options.reading, most=_MOST_ROWS, positions_flag="--positions"
    )
    if time is None:
        raise RecordingError(f"{log}: has no column time [s]; a motion is judged by its velocity")
    if options.window is not None:
        inside = (time >= options.window[0]) & (time <= options.window[1])
        time, where, readings = time[inside], where[inside], readings[inside]
    if robot is None:
        return MeasurementRows(time, recorded_poses(where, rotation), readings)
    if calibration is not None:
        bias, payload = np.array(calibration.bias), np.array(calibration.payload)
        readings = readings - tip_functions(robot).sensor.reading(where, np.zeros(6), bias, payload)
    return MeasurementRows(time, sensor_poses(robot, where), readings, where.mean(axis=0) if len(where) else None)


def find_rotation(log: Path, positions: str, reading: str | None) -> Rotation:
    """Return the form of a recording's rotations, by the number of names with commas, or by the columns of a prefix."""
    if "," in positions:
        return "vector" if positions.count(",") == len(_NAMES["vector"]) - 1 else "quaternion"
    is_vector = not has_columns(log, _NAMES["quaternion"], positions, reading) and has_columns(
        log, _NAMES["vector"], positions, reading
    )
    return "vector" if is_vector else "quaternion"


def calibration_of(robot: GeneratedRobot | None, file: Path) -> Calibration:
    """Return the calibration of a robot's sensor.

    Raises:
        RecordingError: it is none, or that of another sensor.

    """
    calibration = read_calibration(file)
    sensor = robot.chain.sensor if robot else None
    if sensor is None:
        raise RecordingError(f"{file}: goes with --robot DIR, a folder generated with --sensor LINK")
    if calibration.sensor != sensor.text:
        raise RecordingError(
            f"{file}: is the calibration of another sensor ({calibration.sensor}); the robot has {sensor.text}"
        )
    return calibration


def sensor_poses(robot: GeneratedRobot, q: FloatArray) -> FloatArray:
    """Return the poses (N, 4, 4) of the sensor's frame in base axes; those of the tip for a robot without a sensor."""
    poses = np.asarray(tip_functions(robot).forward_kinematics(q), dtype=float)
    sensor = robot.chain.sensor
    if sensor is None:
        return poses
    mounted = np.eye(4)
    mounted[:3, :3], mounted[:3, 3] = sensor.rotation, sensor.translation
    return np.asarray(poses @ mounted)


def recorded_poses(columns: FloatArray, rotation: Rotation) -> FloatArray:
    """Return poses (N, 4, 4) from a position [m] with a unit quaternion (x, y, z, w) or a rotation vector [rad].

    Rodrigues' formula gives the rotation as c 1 + s [a] + (1 - c) a a^T, with the unit axis a, and c and s of the
    angle. Of a quaternion, whose vector part v has the length sin(angle / 2), it is c 1 + 2 w [v] + 2 v v^T.

    Raises:
        RecordingError: a quaternion is not of unit length within 1 %.

    """
    poses = np.tile(np.eye(4), (len(columns), 1, 1))
    poses[:, :3, 3], turn = columns[:, :3], columns[:, 3:]
    if rotation == "quaternion":
        unit = _unit_quaternions(turn)
        axis, w = unit[:, :3], unit[:, 3]
        sine, cosine = 2 * w, w**2 - (axis**2).sum(axis=1)
        square = 2.0 * np.ones(len(columns))
    else:
        angle = np.linalg.norm(turn, axis=1)
        axis = turn / np.maximum(angle, 1e-300)[:, None]
        sine, cosine = np.sin(angle), np.cos(angle)
        square = 1 - cosine
    for k, each in enumerate(axis):
        poses[k, :3, :3] = cosine[k] * np.eye(3) + sine[k] * skew(each) + square[k] * np.outer(each, each)
    return poses


def _unit_quaternions(turn: FloatArray) -> FloatArray:
    """Return quaternions (N, 4) of the length 1; RecordingError for one that is not of this length within 1 %."""
    length = np.linalg.norm(turn, axis=1)
    if (np.abs(length - 1) > 0.01).any():
        row = int(np.abs(length - 1).argmax())
        raise RecordingError(
            f"row {row}: the quaternion has the length {length[row]:.3g}, not 1; name six columns for a position "
            "and a rotation vector"
        )
    return np.asarray(turn / length[:, None])
