# SPDX-License-Identifier: MIT
"""The command ``passport``: what stiffness, force and damping a robot's tip can render, as a page and a table."""

from __future__ import annotations

import argparse
from pathlib import Path

from stiffgen.cli.console import Progress, messages
from stiffgen.cli.folders import add_folder_or_robot, chosen_folder
from stiffgen.control.presets import motor_tables
from stiffgen.core.folder import write_atomically
from stiffgen.core.opened import open_robot
from stiffgen.lab.measure.slow_motion import read_friction
from stiffgen.lab.passport.loop import LoopTiming
from stiffgen.lab.passport.page import render_page, statements, warnings
from stiffgen.lab.passport.passport import PassportOptions, make_passport


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder_or_robot(command)
    command.add_argument(
        "recording",
        nargs="?",
        type=Path,
        metavar="LOG.csv",
        help="recorded postures (columns q_0 ..., or the joints' names) in place of the whole workspace",
    )
    command.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="rate of the loop [Hz] (1000)")
    command.add_argument("--delay", type=int, default=0, metavar="N", help="delay of the torques [samples] (0)")
    command.add_argument(
        "--sensor",
        type=float,
        default=0.0,
        metavar="STEP",
        help="step of the encoders, whose differences are the velocity [rad or m] (default: measured velocity)",
    )
    command.add_argument("--kp", type=_numbers, metavar="K|K,K,...", help="gains of a PD arm, to judge too [N m/rad]")
    command.add_argument("--kc", type=_numbers, metavar="K|K,K,...", help="stiffness of elastic gears [N m/rad]")
    command.add_argument(
        "--friction",
        metavar="C|C,C,...|FILE.csv",
        help="sliding friction of the joints [N m or N], or the table of 'stiffgen measure --friction'",
    )
    command.set_defaults(run=run)


def _numbers(text: str) -> tuple[float, ...]:
    """Return numbers with commas."""
    try:
        return tuple(map(float, text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number, or numbers with commas") from None


def _friction(text: str | None, joints: tuple[str, ...]) -> tuple[float, ...] | None:
    """Return the friction of the joints from numbers with commas, or from a table; None without."""
    if text is None:
        return None
    try:
        return _numbers(text)
    except argparse.ArgumentTypeError:
        return read_friction(Path(text), joints)


def run(options: argparse.Namespace) -> int:
    """Write page and table into the working folder; print the findings and the files."""
    robot = open_robot(chosen_folder(options))
    chosen = PassportOptions(
        LoopTiming(options.rate, options.delay, options.sensor),
        options.kp,
        options.kc,
        options.recording,
        _friction(options.friction, robot.chain.coordinate_names),
    )
    page = Path(f"{robot.name}_passport.html")
    table = page.with_suffix(".csv")
    with Progress(messages(wide=False)).shown() as progress:
        progress(f"computing the passport of {robot.name}")
        passport = make_passport(robot, chosen)
        text = render_page(passport, motor_tables(robot.chain), table.name)
    write_atomically(table, passport.to_csv())
    write_atomically(page, text)
    print("\n".join([*warnings(passport), *statements(passport), str(page), str(table)]))
    return 0
