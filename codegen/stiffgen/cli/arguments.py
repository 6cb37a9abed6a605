# SPDX-License-Identifier: MIT
"""Options that several commands share, and checked values."""

from __future__ import annotations

import argparse
from dataclasses import MISSING, Field
from pathlib import Path
from typing import Any, get_args

from stiffgen.errors import StiffgenError, printable
from stiffgen.options import help_of
from stiffgen.robot.chain import Sensor, Sign, Tool
from stiffgen.robot.description import Reading
from stiffgen.robot.names import is_name


def natural(text: str) -> int:
    """Return a number that is not negative."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value


def positive(text: str) -> int:
    """Return a number of at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def add_folder(command: argparse.ArgumentParser) -> None:
    """Add the folder that a command reads."""
    command.add_argument("folder", type=Path, metavar="DIR", help="folder that 'stiffgen generate' wrote")


def add_robot(command: Any, meaning: str = "URDF, MJCF, or a xacro template with NAME:=VALUE behind it") -> None:
    """Add the robot's file or name, and the arguments of a template."""
    command.takes_arguments = True
    command.add_argument(
        "urdf",
        type=Path,
        nargs="?",
        metavar="FILE",
        help=meaning,
    )
    command.add_argument("--robot", metavar="NAME", help="robot by name instead of FILE; 'stiffgen robots' lists them")


def source_of(options: argparse.Namespace) -> Path | str:
    """Return the robot's file, or its name."""
    if options.robot is None:
        return Path(options.urdf)
    if not is_name(options.robot):
        raise StiffgenError(f"--robot {printable(options.robot)}: is no robot's name; give a file without --robot")
    return str(options.robot)


def add_reading(command: argparse.ArgumentParser) -> None:
    """Add the options of the reader, as ``generate`` has them."""
    command.add_argument(
        "--ignore",
        metavar="ELEMENT",
        action="append",
        default=[],
        help="unknown element or attribute that is no misspelling; repeatable",
    )
    command.add_argument(
        "--accept-inertia",
        metavar="LINK",
        action="append",
        default=[],
        help="use an inertia that no rigid body has; repeatable (all: of every link)",
    )
    command.add_argument(
        "--package-path",
        metavar="DIR",
        action="append",
        default=[],
        help="folder of ROS packages that a xacro template includes; repeatable",
    )


def reading_of(options: argparse.Namespace) -> Reading:
    """Return the settings of the reader."""
    return Reading(
        options.arguments,
        tuple(options.package_path or ()),
        tuple(options.ignore or ()),
        tuple(options.accept_inertia or ()),
    )


def add_option(command: argparse._ActionsContainer, option: Field[Any], **more: Any) -> None:
    """Add the option of a field of a record (:func:`stiffgen.options.help_of`); ``more`` goes to argparse."""
    described = help_of(option)
    name = option.name.replace("_", "-")
    if option.default is True:
        command.add_argument(f"--no-{name}", dest=option.name, action="store_false", help=described.negative)
    elif option.default is False:
        command.add_argument(f"--{name}", action="store_true", help=described.meaning)
    else:
        default: dict[str, Any] = {} if option.default is MISSING else {"default": option.default or None}
        keywords = default | dict(described.command or {}) | more
        command.add_argument(described.flag or f"--{name}", dest=option.name, help=described.meaning, **keywords)


def add_tool(command: argparse.ArgumentParser, meaning: str) -> Any:
    """Add the options of a tool; return their group."""
    tool = command.add_argument_group("tool", meaning)
    tool.add_argument("--tool-xyz", type=float, nargs=3, metavar=("X", "Y", "Z"), help="tool frame in the tip [m]")
    tool.add_argument(
        "--tool-rpy", type=float, nargs=3, metavar=("R", "P", "Y"), help="roll, pitch, yaw of the tool frame [rad]"
    )
    tool.add_argument("--tool-mass", type=float, metavar="KG", help="mass of the tool [kg]")
    tool.add_argument("--tool-com", type=float, nargs=3, metavar=("X", "Y", "Z"), help="centre of mass in the tip [m]")
    tool.add_argument(
        "--tool-inertia",
        type=float,
        nargs=6,
        metavar=("IXX", "IXY", "IXZ", "IYY", "IYZ", "IZZ"),
        help="inertia about the centre of mass in the tip's axes [kg m^2]",
    )
    return tool


def tool_of(options: argparse.Namespace) -> Tool | None:
    """Return the tool that the options describe; None without one."""
    chosen: dict[str, Any] = {}
    for field in ("xyz", "rpy", "mass", "com", "inertia"):
        value = getattr(options, f"tool_{field}")
        if value is not None:
            chosen[field] = tuple(value) if isinstance(value, list) else value
    if not chosen:
        return None
    if not options.masses and chosen.keys() - {"xyz", "rpy"}:
        raise StiffgenError(
            "--no-masses ignores all masses; leave out --no-masses, or --tool-mass, --tool-com and --tool-inertia"
        )
    if options.tool == "runtime" and ("xyz" in chosen or "rpy" in chosen):
        raise StiffgenError("--tool runtime takes the tool's pose at run time; leave out --tool-xyz and --tool-rpy")
    return Tool(**chosen)


def add_sensor(command: argparse.ArgumentParser) -> None:
    """Add the options of a force-torque sensor."""
    group = command.add_argument_group("sensor", "force-torque sensor: adds functions from its reading to the tip")
    group.add_argument("--sensor", metavar="LINK", help="link with the sensor, rigidly connected to a tip")
    group.add_argument(
        "--sensor-xyz", type=float, nargs=3, metavar=("X", "Y", "Z"), help="sensor frame in its link [m] (default: 0)"
    )
    group.add_argument(
        "--sensor-rpy", type=float, nargs=3, metavar=("R", "P", "Y"), help="its roll, pitch, yaw [rad] (default: 0)"
    )
    group.add_argument(
        "--sensor-sign", choices=get_args(Sign), help="body whose wrench the sensor reports (default: environment)"
    )


def sensor_of(options: argparse.Namespace) -> Sensor | None:
    """Return the sensor that the options describe; None without one."""
    chosen = {field: getattr(options, f"sensor_{field}") for field in ("xyz", "rpy", "sign")}
    chosen = {name: tuple(value) if isinstance(value, list) else value for name, value in chosen.items() if value}
    if options.sensor is not None:
        return Sensor(options.sensor, **chosen)
    for name in chosen:
        raise StiffgenError(f"--sensor-{name} without a sensor; add --sensor LINK")
    return None
