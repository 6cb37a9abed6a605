# SPDX-License-Identifier: MIT
"""The command ``measure``: a stiffness from motions about a pose, with the sensor's errors, or the joints' friction."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

from stiffgen.cli.console import Progress, messages
from stiffgen.core.errors import OutputError, RecordingError, terminal_text
from stiffgen.core.folder import write_atomically
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.lab.calibrate.calibration import Calibration, tip_functions
from stiffgen.lab.measure.measurement import Measurement, joint_stiffness_deviation, measure_stiffness
from stiffgen.lab.measure.page import render_page, statements, to_csv
from stiffgen.lab.measure.plan import PERIODS, PlanOptions, plan_excitation, rows_of
from stiffgen.lab.measure.residual import NORMAL
from stiffgen.lab.measure.rows import RowOptions, calibration_of, read_measurement
from stiffgen.lab.measure.slow_motion import friction_of, lines_of, plan_slow_motion, read_slow_motion
from stiffgen.lab.measure.slow_motion import to_csv as to_table

TARED = Path("none")
"""Calibration of readings without a bias."""


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments of stiffgen measure."""
    command.add_argument(
        "log", type=Path, nargs="?", metavar="LOG", help="recording of a motion about a pose, with time"
    )
    command.add_argument(
        "--robot", type=Path, metavar="DIR", help="robot's folder: the recording has joint positions (default: poses)"
    )
    command.add_argument(
        "--positions",
        metavar="PREFIX|A,B,...",
        help="joint positions, or without a robot x, y, z [m] and qx, qy, qz, qw or rx, ry, rz [rad] "
        "(default: q_0 ...; pose_x ...)",
    )
    command.add_argument(
        "--reading",
        metavar="PREFIX|FX,...",
        help="readings: prefix of their columns, or names (default: wrench_; --friction: torque_)",
    )
    command.add_argument(
        "--axes", choices=("sensor", "base"), default="sensor", help="axes of the readings (default: sensor)"
    )
    command.add_argument("--window", nargs=2, type=float, metavar=("FROM", "TO"), help="part of the recording [s]")
    command.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE|none",
        help="file of 'stiffgen calibrate': bias and payload are taken off; none: no bias (default: an unknown bias)",
    )
    command.add_argument(
        "--correct", type=Path, metavar="FILE", help="write the calibration with the rotation found by this measurement"
    )
    command.add_argument(
        "--friction",
        action="store_true",
        help="friction of each joint from torques along a slow motion there and back; needs --robot",
    )
    plan = command.add_argument_group("plan", "write a motion to run, in place of a recording; needs --robot")
    plan.add_argument("--plan", type=Path, metavar="FILE.csv", help="trajectory to write: the FRI client's format")
    plan.add_argument("--posture", type=numbers, metavar="Q,Q,...", help="joint positions in the middle [rad or m]")
    plan.add_argument(
        "--stiffness", type=numbers, metavar="K,K,K,K,K,K", help="expected at the sensor: diagonal [N/m, N m/rad]"
    )
    plan.add_argument(
        "--deviation", type=numbers, default=(0.1,), metavar="DEG[,N,NM]",
        help="wanted of the turn [deg]; largest change of force and moment (0.1,10,1)",
    )  # fmt: skip
    command.set_defaults(run=run)


def numbers(text: str) -> tuple[float, ...]:
    """Return numbers with commas."""
    try:
        return tuple(map(float, text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number, or numbers with commas") from None


def run(options: argparse.Namespace) -> int:
    """Write a plan, or page and table of a recording; return 1 if the sensor does not agree with the pose."""
    if (options.plan is None) == (options.log is None):
        raise RecordingError("give a recording LOG, or --plan FILE.csv for the motion to record")
    if options.friction:
        return _friction(options)
    return _measure(options) if options.plan is None else _plan(options)


def _friction(options: argparse.Namespace) -> int:
    """Write the table of a recording's friction, or the motion to record."""
    if options.robot is None or (options.plan is not None and options.posture is None):
        raise RecordingError("--friction: needs --robot DIR, and with --plan FILE.csv --posture Q,Q,...")
    robot = open_robot(options.robot)
    robot.require_doubles("'stiffgen measure'")
    if options.plan is not None:
        write_atomically(options.plan, rows_of(plan_slow_motion(robot, options.posture)))
        print(f"0.25 rad or m to each side of the posture at 0.1 per s, twice there and back; 200 Hz\n{options.plan}")
        return 0
    window = options.window and tuple(options.window)
    motion = read_slow_motion(options.log, robot, options.positions, options.reading, window)
    found = friction_of(options.log, motion)
    joints, table = robot.chain.coordinate_names, Path(f"{options.log.stem}_friction.csv")
    write_atomically(table, to_table(found, joints))
    print(terminal_text("\n".join([*lines_of(found, motion, joints), str(table)])))
    return 0


def _plan(options: argparse.Namespace) -> int:
    """Write the trajectory; print the amplitudes and what they leave."""
    if options.robot is None or options.posture is None or options.stiffness is None:
        raise RecordingError("--plan: needs --robot DIR, --posture Q,Q,... and --stiffness K,K,K,K,K,K")
    if len(options.stiffness) != 6:
        raise RecordingError(f"--stiffness: has {len(options.stiffness)} numbers, not six")
    if len(options.deviation) not in (1, 3):
        raise RecordingError(f"--deviation: has {len(options.deviation)} numbers, not one or three")
    robot = open_robot(options.robot)
    robot.require_doubles("'stiffgen measure'")
    chosen = PlanOptions(options.stiffness, math.radians(options.deviation[0]), has_bias=options.calibration != TARED)
    if options.deviation[1:]:
        chosen = replace(chosen, most_wrench=options.deviation[1:])
    made = plan_excitation(robot, options.posture, chosen)
    write_atomically(options.plan, made.to_csv())
    amplitude = 1000 * made.amplitude
    print(
        f"{amplitude[0]:.3g} mm and {amplitude[3]:.3g} mrad at {len(PERIODS)} frequencies, {made.time[-1]:.0f} s at "
        f"{chosen.rate:g} Hz: the sensor's turn will be known within {math.degrees(made.deviation):.2g} deg (one "
        "standard deviation)"
    )
    if made.limit:
        print(f"the limit of {made.limit} keeps the motion smaller than {options.deviation[0]:g} deg asks for")
    print(terminal_text(str(options.plan)))
    return 0


def _measure(options: argparse.Namespace) -> int:
    """Fit the stiffness to a recording, write page and table, and return 1 if the residual is an alarm."""
    robot, calibration = _opened(options)
    columns = RowOptions(options.positions, options.reading, options.window and tuple(options.window))
    with Progress(messages()).shown() as progress:
        progress(f"reading {options.log}")
        rows = read_measurement(options.log, columns, robot, calibration)
        progress(f"fitting the stiffness to {len(rows.time)} rows")
        try:
            found = measure_stiffness(
                rows.time, rows.poses, rows.readings, in_base_axes=options.axes == "base",
                has_bias=options.calibration is None,
            )  # fmt: skip
        except RecordingError as error:
            raise RecordingError(f"{options.log}: {error}") from error
        joints = None
        if robot is not None and rows.q is not None:
            joints = joint_stiffness_deviation(found, tip_functions(robot), rows.q, robot.chain.sensor)
    page = Path(f"{options.log.stem}_measured.html")
    table = page.with_suffix(".csv")
    texts = {page: render_page(options.log.name, found, joints, table.name), table: to_csv(found, joints)}
    if options.correct is not None:
        assert calibration is not None
        texts[options.correct] = corrected(calibration, found).to_json()
    for file, text in texts.items():
        write_atomically(file, text)
    print(terminal_text("\n".join([*statements(found, joints), *map(str, texts)])))
    return 1 if found.residual.is_alarm else 0


def _opened(options: argparse.Namespace) -> tuple[GeneratedRobot | None, Calibration | None]:
    """Return robot and calibration of a measurement; refuse options that cannot hold together."""
    robot = open_robot(options.robot) if options.robot else None
    if robot is not None:
        robot.require_doubles("'stiffgen measure'")
    if options.calibration in (None, TARED):
        if options.correct is not None:
            raise OutputError("--correct: needs the file to correct; give --calibration FILE, too")
        return robot, None
    if options.axes == "base":
        raise RecordingError("--calibration: holds for readings in sensor axes; leave out --axes base")
    return robot, calibration_of(robot, options.calibration)


def corrected(calibration: Calibration, found: Measurement) -> Calibration:
    """Return a calibration with the turn of a measurement as its rotation.

    Raises:
        RecordingError: no turn was found.

    """
    (turn,) = (each for each in found.residual.errors if each.name == "turn")
    if turn.verdict != "found":
        raise RecordingError("--correct: no turn of the sensor was found; the calibration stays as it is")
    return replace(
        calibration,
        rotation=tuple(float(each) for each in turn.value),
        rotation_interval=tuple(float(NORMAL * each) for each in turn.deviation),
    )
