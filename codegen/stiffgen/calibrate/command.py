# SPDX-License-Identifier: MIT
"""The command ``calibrate``: bias and payload of a force-torque sensor from a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.calibrate.calibration import Calibration, read_calibration, sensor_functions
from stiffgen.calibrate.check import check_weight
from stiffgen.calibrate.estimate import Estimate, estimate, further_poses
from stiffgen.calibrate.picture import residual_picture
from stiffgen.calibrate.poses import StandingPoses, read_rows, standing
from stiffgen.cli.console import table, tables
from stiffgen.errors import OutputError, RecordingError, terminal_text
from stiffgen.opened import GeneratedRobot, open_robot

_AXES = ("Fx [N]", "Fy [N]", "Fz [N]", "Mx [N m]", "My [N m]", "Mz [N m]")
_PAYLOAD = ("mass [kg]", "m cx [kg m]", "m cy [kg m]", "m cz [kg m]")


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    command.add_argument("log", type=Path, metavar="LOG", help="recording of joint positions and the sensor's readings")
    command.add_argument("--robot", type=Path, metavar="DIR", required=True, help="robot's folder, with a sensor")
    command.add_argument(
        "--output", type=Path, metavar="FILE", default=Path("calibration.json"),
        help="file with the calibration (default: calibration.json)",
    )  # fmt: skip
    command.add_argument("--q", metavar="PREFIX", help="prefix of the columns with joint positions")
    command.add_argument(
        "--reading", metavar="PREFIX", help="prefix of the columns with the readings (default: wrench_)"
    )
    command.add_argument("--picture", type=Path, metavar="FILE.svg", help="draw the residuals of the poses")
    check = command.add_argument_group("check", "compare with a weight that hangs at the tip; writes nothing")
    check.add_argument("--check", type=float, metavar="KG", help="mass of the weight [kg]; reads --output")
    check.add_argument(
        "--at", type=float, nargs=3, metavar=("X", "Y", "Z"), default=(0.0, 0.0, 0.0),
        help="point of the weight in the tip [m] (default: its origin)",
    )  # fmt: skip
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Calibrate, or check with a weight; return 1 if the check fails."""
    robot = open_robot(options.robot)
    robot.require_doubles("'stiffgen calibrate'")
    sensor = sensor_functions(robot)
    poses = standing(*read_rows(options.log, robot.chain, q_prefix=options.q, wrench_prefix=options.reading))
    if options.check is not None:
        return _check(robot, sensor, poses, options)
    assert robot.chain.sensor is not None
    found = estimate(sensor, poses, robot=robot.name, place=robot.chain.sensor.text)
    texts = {options.output: found.calibration.to_json()}
    if options.picture is not None:
        texts[options.picture] = residual_picture(poses, found)
    try:
        for file, text in texts.items():
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be written ({error.strerror})") from error
    _print(found.calibration)
    _print_further(robot, sensor, poses, found)
    print(terminal_text(str(options.output)))
    return 0


def _print(found: Calibration) -> None:
    shown = table("quantity", "value", "+-", right=("value", "+-"))
    names = (*_PAYLOAD, *(f"bias {name}" for name in _AXES))
    values, intervals = (*found.payload, *found.bias), (*found.payload_interval, *found.bias_interval)
    for name, value, interval in zip(names, values, intervals, strict=True):
        shown.add_row(name, f"{value:.4f}", f"{interval:.2g}")
    tables().print(shown)
    if found.payload[0] > found.payload_interval[0]:
        centre = ", ".join(f"{1000 * each:.1f}" for each in found.centre_of_mass)
        print(f"centre of mass: ({centre}) mm from the sensor's origin, in its axes")
    turned, within = (np.degrees(np.linalg.norm(each)) for each in (found.rotation, found.rotation_interval))
    print(f"rotation of the sensor against its frame: {turned:.2f} deg, within {within:.2g} deg")
    noise = ", ".join(f"{each:.2g}" for each in found.noise)
    print(f"residuals of {found.poses} poses: ({noise}) N, N m; intervals hold for all ten numbers at once (95 %)")


def _print_further(robot: GeneratedRobot, sensor: Any, poses: StandingPoses, found: Estimate) -> None:
    lower, upper = (np.array([getattr(c, side) for c in robot.chain.coordinates]) for side in ("lower", "upper"))
    for q, factor in further_poses(sensor, poses, found, lower, upper):
        posture = ", ".join(f"{each:.2f}" for each in q)
        print(f"one more pose at q = ({posture}) would narrow the widest interval of the first moment to {factor:.0%}")


def _check(robot: GeneratedRobot, sensor: Any, poses: StandingPoses, options: argparse.Namespace) -> int:
    calibration = read_calibration(options.output)
    mounted = robot.chain.sensor
    assert mounted is not None
    if calibration.sensor != mounted.text:
        raise RecordingError(
            f"{options.output}: is the calibration of another sensor ({calibration.sensor}); the robot has "
            f"{mounted.text}"
        )
    tip = robot.chain.tips[mounted.tip].name
    pose = (getattr(robot.module, tip) if tip else robot.module).forward_kinematics
    found = check_weight(sensor, pose, poses, calibration, options.check, options.at, mounted.option.gravity)
    print("\n".join(found.findings()))
    print("passed" if found.passed else "FAILED")
    return 0 if found.passed else 1
