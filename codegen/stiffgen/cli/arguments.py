# SPDX-License-Identifier: MIT
"""Options that several commands share, and checked values."""

from __future__ import annotations

import argparse
from pathlib import Path
from types import ModuleType
from typing import Any

from stiffgen.core.errors import StiffgenError, printable
from stiffgen.rooms import optional


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


def add_robot(
    command: Any, meaning: str = "URDF, MJCF, xacro template with NAME:=VALUE behind it, or a robot's name", **more: Any
) -> None:
    """Add the robot's file or name, and the arguments of a template; ``more`` goes to argparse."""
    command.takes_arguments = True
    command.add_argument("urdf", metavar="FILE", help=meaning, **more)


def needed(module: str, option: str) -> ModuleType:
    """Return a module of the room ``files``, which an option needs; refuse the option where the room is gone."""
    found = optional(module)
    if found is None:
        raise StiffgenError(
            f"{option} needs the room 'files', which has been taken out of this stiffgen; give a URDF or a robot's "
            "folder, or install stiffgen whole"
        )
    return found


def source_of(options: argparse.Namespace) -> Path | str:
    """Return the robot's file, or its name."""
    name = getattr(options, "robot", None)
    if name is not None and not needed("files.names", "--robot").is_name(name):
        raise StiffgenError(f"--robot {printable(name)}: is no robot's name; give a file without --robot")
    source, names = str(name or options.urdf), optional("files.names")
    return source if names and names.is_name(source) else Path(source)
