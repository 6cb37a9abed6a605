# SPDX-License-Identifier: MIT
"""The command ``calibrate``: bias and payload of a force-torque sensor from a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from stiffgen.cli.console import table, tables
from stiffgen.core.errors import OutputError, RecordingError, terminal_text
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.robot.chain import Sensor
from stiffgen.lab.calibrate.calibration import Calibration, read_calibration, sensor_functions, tip_functions
from stiffgen.lab.calibrate.check import Source, WeightCheck, check_weight, check_wrenches
from stiffgen.lab.calibrate.estimate import Estimate, estimate, further_poses
from stiffgen.lab.calibrate.picture import residual_picture
from stiffgen.lab.calibrate.poses import StandingPoses, read_rows, standing

_TIP = "tip:"
"""Beginning of ``--reading`` for wrenches at the tip, base axes, that another program computed."""
_AXES = ("Fx [N]", "Fy [N]", "Fz [N]", "Mx [N m]", "My [N m]", "Mz [N m]")
_PAYLOAD = ("mass [kg]", "m cx [kg m]", "m cy [kg m]", "m cz [kg m]")


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    command.add_argument("log", type=Path, metavar="LOG", help="recording of joint positions and the sensor's readings")
    command.add_argument("--robot", type=Path, metavar="DIR", required=True, help="robot's folder, with a sensor")
    command.add_argument(
        "--output",
        type=Path,
        metavar="FILE",
        action="append",
        default=[],
        help="file with the calibration (default: calibration.json); FILE.svg: draw the residuals; repeatable",
    )
    command.add_argument(
        "--q", metavar="PREFIX|A,B,...", help="joint positions: prefix of their columns, or names with commas"
    )
    command.add_argument(
        "--reading",
        metavar="PREFIX|FX,...",
        help="readings: prefix of their columns, or six names (default: wrench_); tip:PREFIX: tip wrenches to check",
    )
    check = command.add_argument_group("check", "compare with a weight that hangs at the tip; writes nothing")
    check.add_argument(
        "--check",
        type=_weight,
        metavar="KG[,X,Y,Z]",
        help="mass of the weight [kg], and its point in the tip [m] (default: the origin); reads --output",
    )
    command.set_defaults(run=run)


def _weight(text: str) -> tuple[float, ...]:
    """Return the mass of a weight and its point."""
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        numbers = ()
    if len(numbers) not in (1, 4):
        raise argparse.ArgumentTypeError(f"'{text}' is not KG or KG,X,Y,Z")
    return (*numbers, 0.0, 0.0, 0.0)[:4]


def _files(chosen: list[Path]) -> tuple[Path, Path | None]:
    """Return the files of the calibration and of the picture, None without one."""
    pictures = [file for file in chosen if file.suffix == ".svg"]
    others = [file for file in chosen if file.suffix != ".svg"]
    for files in (pictures, others):
        if len(files) > 1:
            raise OutputError(f"--output {files[1]}: {files[0]} has the same content; give one of the two")
    return others[0] if others else Path("calibration.json"), pictures[0] if pictures else None


def run(options: argparse.Namespace) -> int:
    """Calibrate, or check with a weight; return 1 if the check fails."""
    robot = open_robot(options.robot)
    robot.require_doubles("'stiffgen calibrate'")
    file, picture = _files(options.output)
    if options.reading is not None and options.reading.startswith(_TIP):
        return _check_wrenches(robot, options)
    if options.check is not None and robot.chain.sensor is None:
        raise RecordingError(
            f"{robot.folder}: has no force-torque sensor; check the wrenches that the FRI client logged with "
            f"--reading {_TIP}wrench_, or generate the robot with --sensor LINK"
        )
    sensor = sensor_functions(robot)
    poses = standing(*read_rows(options.log, robot.chain.coordinate_names, options.q, options.reading))
    if options.check is not None:
        return _check(robot, sensor, poses, file, options.check)
    assert robot.chain.sensor is not None
    found = estimate(sensor, poses, robot=robot.name, place=robot.chain.sensor.text)
    texts = {file: found.calibration.to_json()}
    if picture is not None:
        texts[picture] = residual_picture(poses, found)
    try:
        for target, text in texts.items():
            target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be written ({error.strerror})") from error
    _print(found.calibration)
    _print_further(robot, sensor, poses, found)
    print(terminal_text(str(file)))
    return 0


def _print(found: Calibration) -> None:
    """Print payload and bias with their intervals, centre of mass, rotation and noise."""
    shown = table("quantity", "value", "+-", right=("value", "+-"))
    names = (*_PAYLOAD, *(f"bias {name}" for name in _AXES))
    values, intervals = (*found.payload, *found.bias), (*found.payload_interval, *found.bias_interval)
    for name, value, interval in zip(names, values, intervals, strict=True):
        shown.add_row(name, f"{value:.4f}", f"{interval:.2g}")
    tables().print(shown)
    if found.payload[0] > found.payload_interval[0]:  # the mass is not 0
        centre = ", ".join(f"{1000 * each:.1f}" for each in found.centre_of_mass)
        print(f"centre of mass: ({centre}) mm from the sensor's origin, in its axes")
    turned, within = (np.degrees(np.linalg.norm(each)) for each in (found.rotation, found.rotation_interval))
    print(f"rotation of the sensor against its frame: {turned:.2f} deg, within {within:.2g} deg")
    noise = ", ".join(f"{each:.2g}" for each in found.noise)
    print(f"residuals of {found.poses} poses: ({noise}) N, N m; intervals hold for all ten numbers at once (95 %)")


def _print_further(robot: GeneratedRobot, sensor: Any, poses: StandingPoses, found: Estimate) -> None:
    """Print poses that would tighten the intervals of the first moment, within the joints' limits."""
    lower, upper = np.array([each.range_within(np.pi) for each in robot.chain.coordinates]).T
    for q, factor in further_poses(sensor, poses, found, lower, upper):
        posture = ", ".join(f"{each:.2f}" for each in q)
        print(f"one more pose at q = ({posture}) would narrow the widest interval of the first moment to {factor:.0%}")


def _check(robot: GeneratedRobot, sensor: Any, poses: StandingPoses, file: Path, weight: tuple[float, ...]) -> int:
    """Check a sensor and its calibration in ``file`` with a weight: mass [kg] and its point in the tip [m]."""
    calibration = read_calibration(file)
    mounted = robot.chain.sensor
    assert mounted is not None  # its functions exist
    if calibration.sensor != mounted.text:
        raise RecordingError(
            f"{file}: is the calibration of another sensor ({calibration.sensor}); the robot has {mounted.text}"
        )
    pose = tip_functions(robot).forward_kinematics
    mass, *point = weight
    return _print_findings(check_weight(sensor, pose, poses, calibration, mass, point, mounted.option.gravity))


def _check_wrenches(robot: GeneratedRobot, options: argparse.Namespace) -> int:
    """Check wrenches that another program computed, as the FRI client logs them; no calibration is read."""
    if options.check is None or options.output:
        raise RecordingError(f"--reading {_TIP}...: goes with --check, without --output: wrenches need no calibration")
    pose, mounted = tip_functions(robot).forward_kinematics, robot.chain.sensor
    poses = standing(
        *read_rows(options.log, robot.chain.coordinate_names, options.q, options.reading.removeprefix(_TIP))
    )
    gravity = mounted.option.gravity if mounted else Sensor.gravity
    mass, *point = options.check
    source: Source = "either" if mounted else "external torque"
    return _print_findings(check_wrenches(pose, poses, mass, point, gravity, source=source))


def _print_findings(found: WeightCheck) -> int:
    """Print the findings of a check; return the exit status."""
    print("\n".join(found.findings()))
    print("passed" if found.passed else "FAILED")
    return 0 if found.passed else 1
