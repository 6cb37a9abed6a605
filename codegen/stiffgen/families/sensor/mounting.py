# SPDX-License-Identifier: MIT
"""Place a force-torque sensor on a chain: a frame that moves rigidly with a tip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

from stiffgen.core.errors import ChainError, listed, printable
from stiffgen.core.given import are_numbers
from stiffgen.core.robot.chain import MountedSensor, Sensor, Sign
from stiffgen.core.robot.description import LARGEST, Description
from stiffgen.core.robot.geometry import Pose
from stiffgen.core.robot.selection import Selection


def carrier(description: Description, selection: Selection, sensor: Sensor) -> tuple[str, Pose]:
    """Return the moving joint that carries a sensor, and the sensor's pose in the child link of this joint.

    Raises:
        ChainError: the link does not exist, lies on no moving joint of the chain, or an option is impossible.

    """
    file, link = description.file, sensor.link
    _check(file, sensor)
    if link not in description.inertials:
        raise ChainError(
            f"{file}: --sensor link '{printable(link)}' does not exist; valid names: {listed(description.links)}"
        )
    of_chain = {element.name for element in (*selection.moving, *selection.side)}
    pose = Pose.from_xyz_rpy(sensor.xyz, sensor.rpy)
    while link in description.parent_joint and link != selection.base:
        element = description.parent_joint[link]
        if element.name in of_chain:
            return element.name, pose
        if selection.couplings.moves(element):
            raise ChainError(
                f"{file}: joint '{printable(element.name)}' moves the --sensor link '{printable(sensor.link)}' and is "
                "no joint of the chain; choose a link that is rigidly connected to the tip, or lock the joint"
            )
        pose = selection.couplings.pose_at_rest(element) @ pose
        link = element.parent
    raise ChainError(
        f"{file}: --sensor link '{printable(sensor.link)}' is moved by no joint of the chain; choose a link that is "
        "rigidly connected to the tip"
    )


def mounted(file: str, sensor: Sensor, pose: Pose, tips: Sequence[str], frames: Sequence[Pose | None]) -> MountedSensor:
    """Return the sensor in the frame of the first tip that moves rigidly with it.

    Args:
        file: name of the robot's file.
        sensor: the user's option.
        pose: pose of the sensor in the frame of the joint that carries the sensor.
        tips: links of the tips.
        frames: poses of the tips in the same frame; None for a tip that another joint carries.

    Raises:
        ChainError: no tip moves rigidly with the sensor.

    """
    for index, frame in enumerate(frames):
        if frame is not None:
            rotation, translation = (frame.inverse() @ pose).rounded()
            xyz, rpy, gravity = map(_vector, (sensor.xyz, sensor.rpy, sensor.gravity))
            option = replace(sensor, xyz=xyz, rpy=rpy, gravity=gravity)
            return MountedSensor(option, index, rotation, translation)
    raise ChainError(
        f"{file}: a joint lies between the --sensor link '{printable(sensor.link)}' and "
        f"{'tip' if len(tips) == 1 else 'each of the tips'} {listed(tips)}; choose a link that is rigidly connected to "
        "a tip"
    )


def _vector(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _check(file: str, sensor: Sensor) -> None:
    """Raise ChainError if a number or the sign of the option is impossible."""
    for name, values in (("xyz", sensor.xyz), ("rpy", sensor.rpy), ("gravity", sensor.gravity)):
        if not are_numbers(values, 3) or not all(abs(value) <= LARGEST for value in values):
            raise ChainError(f"{file}: --sensor {name} must be three finite numbers up to {LARGEST:g}")
    if sensor.sign not in get_args(Sign):
        raise ChainError(
            f"{file}: --sensor sign={printable(str(sensor.sign))} is not one of {listed(list(get_args(Sign)))}"
        )
