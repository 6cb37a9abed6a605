# SPDX-License-Identifier: MIT
"""Friction of a robot's joints from a recording of a slow motion there and back, and the motion to record."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stiffgen.core.errors import RecordingError, StiffgenError, listed
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.calibrate.calibration import tip_functions
from stiffgen.lab.calibrate.poses import read_rows
from stiffgen.lab.measure.friction import JointFriction, estimate_friction

HEAD = ("joint", "friction", "half_width_95", "smallest", "largest", "coulomb_friction")
"""Columns of the table."""
_MOST_ROWS = 1 << 22
_SPAN = 0.05
"""[s] time over which positions are differenced: encoder steps of 1e-4 rad are then 2 % of 0.1 rad/s."""
_GRAVITY = np.array([0.0, 0.0, -9.81])
"""Acceleration of free fall in base axes [m/s^2]: the base stands upright."""
_HALF_WAY, _LEG, _RATE = 0.25, 5.0, 200.0
"""Motion: way to each side of the posture [rad or m], time from end to end [s], samples per second [Hz]."""
_TURN = 0.25
"""[s] time in which a joint turns round."""


@dataclass(frozen=True)
class SlowMotion:
    """Joint positions, velocities and torques (N, n); ``has_gravity``: the recorded torques carried the arm's weight.

    The model's gravity has then been subtracted.
    """

    q: FloatArray
    dq: FloatArray
    torque: FloatArray
    has_gravity: bool


def read_slow_motion(
    log: Path, robot: GeneratedRobot, positions: str | None, reading: str | None, window: tuple[float, float] | None
) -> SlowMotion:
    """Return the rows of a recording within a window [s]: positions by the robot's names, a torque per joint.

    Raises:
        RecordingError: the recording cannot be read, has no rising time, or too few rows.

    """
    names = robot.chain.coordinate_names
    q, torque, time = read_rows(
        log, names, positions, reading or "torque_", most=_MOST_ROWS, readings=len(names), positions_flag="--positions"
    )
    if time is None:
        raise RecordingError(f"{log}: has no column time [s]; friction is told by the direction of the velocity")
    if window is not None:
        inside = (time >= window[0]) & (time <= window[1])
        q, torque, time = q[inside], torque[inside], time[inside]
    if len(time) < 2 or not (np.diff(time) > 0).all():
        raise RecordingError(f"{log}: {len(time)} rows, whose time must rise from row to row; use part with --window")
    half = round(0.5 * _SPAN / float(np.median(np.diff(time)))) or 1  # rows in half of the span of a difference
    if len(time) <= 2 * half:
        raise RecordingError(f"{log}: lasts {time[-1] - time[0]:.2g} s; a slow motion there and back takes seconds")
    # central differences of the positions [rad/s]; rows too near to the ends drop out
    dq = (q[2 * half :] - q[: -2 * half]) / (time[2 * half :] - time[: -2 * half])[:, None]
    q, torque = q[half:-half], torque[half:-half]
    weight = gravity_torque(robot, q)
    has_gravity = _share(torque, weight) > 0.5
    return SlowMotion(q, dq, torque - weight if has_gravity else torque, has_gravity)


def gravity_torque(robot: GeneratedRobot, q: FloatArray) -> FloatArray:
    """Return the torque (N, n) [N m or N] that holds the robot upright; 0 for a folder without masses."""
    functions: Any = tip_functions(robot)
    if "gravity_gradient" not in {kernel.qualified_name for kernel in robot.table}:
        return np.zeros_like(q)
    return np.asarray(functions.gravity.gradient(q, _GRAVITY), dtype=float)


def _share(torque: FloatArray, weight: FloatArray) -> float:
    """Return the share of the model's gravity in the torques, from their changes along the motion."""
    changes, of_weight = torque - torque.mean(axis=0), weight - weight.mean(axis=0)
    size = float((of_weight**2).sum())
    return float((changes * of_weight).sum()) / size if size > 0 else 0.0


def friction_of(log: Path, motion: SlowMotion) -> JointFriction:
    """Return the friction of a recording.

    Raises:
        RecordingError: a joint does not go there and back slowly; the message names the recording.

    """
    try:
        return estimate_friction(motion.q, motion.dq, motion.torque)
    except RecordingError as error:
        raise RecordingError(f"{log}: {error}; 'stiffgen measure --friction --plan' writes a motion") from error


def lines_of(found: JointFriction, motion: SlowMotion, joints: tuple[str, ...]) -> list[str]:
    """Return the findings in sentences."""
    gravity = "contain gravity: the model's is taken off" if motion.has_gravity else "contain no gravity"
    lines = [f"{len(motion.q)} rows; the torques {gravity}. Sliding friction with 95 % intervals [N m or N]:"]
    for name, mean, half in zip(joints, found.mean, found.half_width, strict=True):
        unsure = "" if half < 0.5 * abs(mean) else "  (not certain: record a longer or quieter motion)"
        lines.append(f"  {name}: {mean:.3g} +- {half:.2g}{unsure}")
    return [*lines, found.text]


def to_csv(found: JointFriction, joints: tuple[str, ...]) -> str:
    """Return the table [N m or N], a row per joint."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEAD)
    columns = (found.mean, found.half_width, found.smallest, found.largest, found.fields["coulomb_friction"])
    for name, *values in zip(joints, *columns, strict=True):
        rows.writerow((name, *(f"{value:.6g}" for value in values)))
    return text.getvalue()


def read_friction(file: Path, joints: tuple[str, ...]) -> tuple[float, ...]:
    """Return the friction of each joint [N m or N] from a table of 'stiffgen measure --friction'.

    Raises:
        RecordingError: the file cannot be read, is no such table, or has other joints.

    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            rows = list(csv.DictReader(text))
        found = {row["joint"]: max(float(row["friction"]), 0.0) for row in rows}
    except (OSError, UnicodeDecodeError, csv.Error, KeyError, TypeError, ValueError) as error:
        raise RecordingError(
            f"{file}: is no table of 'stiffgen measure --friction' ({type(error).__name__}: {error})"
        ) from error
    if set(found) != set(joints) or not np.isfinite(list(found.values())).all():
        raise RecordingError(f"{file}: has the joints {listed(sorted(found))}, and the robot {listed(joints)}")
    return tuple(found[name] for name in joints)


def plan_slow_motion(robot: GeneratedRobot, posture: ArrayLike) -> FloatArray:
    """Return joint positions (N, n) at 200 Hz [rad or m]: twice there and back about a posture, 20 s and the turns.

    Every joint moves by 0.25 rad or m to each side at 0.1 per s, neighbours in opposite directions.

    Raises:
        StiffgenError: the posture does not fit, or a joint would leave its range.

    """
    middle = np.asarray(posture, dtype=float)
    coordinates = robot.chain.coordinates
    if middle.shape != (len(coordinates),) or not np.isfinite(middle).all():
        raise StiffgenError(f"--plan: the posture has the shape {middle.shape}, the robot {len(coordinates)} joints")
    for each, value in zip(coordinates, middle, strict=True):
        if value - _HALF_WAY < each.lower or value + _HALF_WAY > each.upper:
            raise StiffgenError(
                f"--plan: joint '{each.name}' would leave its range, {_HALF_WAY:g} to each side; choose another posture"
            )
    sides = np.where(np.arange(len(middle)) % 2, -1.0, 1.0)
    return np.asarray(middle + np.outer(_to_and_fro(), sides))


def _to_and_fro() -> FloatArray:
    """Return the way (N) [rad or m] of a joint from the middle: to one end, three times to the other, and back.

    The speed is constant between the turns; its steps are averaged over the time of a turn, which makes them ramps.
    """
    time = np.arange(round(_RATE * (4 * _LEG + 2 * _TURN)) + 1) / _RATE
    turns = np.array([0.5, 1.5, 2.5, 3.5]) * _LEG + _TURN  # [s] at the ends of the way
    has_turned_back = np.searchsorted(turns, time) % 2
    wanted = 2 * _HALF_WAY / _LEG * np.where(has_turned_back, -1.0, 1.0)
    wanted[(time < _TURN) | (time > time[-1] - _TURN)] = 0.0
    width = round(_RATE * _TURN)
    velocity = np.convolve(np.pad(wanted, (width, width)), np.ones(width) / width, mode="same")[width:-width]
    way = np.concatenate([[0.0], np.cumsum(velocity[1:] + velocity[:-1]) / (2 * _RATE)])  # by the trapezoidal rule
    return np.asarray(way - way[-1] * time / time[-1])  # ends in the middle to the last bit
