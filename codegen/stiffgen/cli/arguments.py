# SPDX-License-Identifier: MIT
"""Parsing of arguments: options that may appear once, and checked values."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stiffgen.errors import StiffgenError
from stiffgen.robot.chain import Tool


class Once(argparse.Action):
    """Store a value, and refuse the option's second appearance, which would silently replace the first."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        """Store the value."""
        seen = namespace.__dict__.setdefault("_seen", set())
        if option is not None and self.dest in seen:
            parser.error(f"{option} is given twice; leave one of them out")
        seen.add(self.dest)
        setattr(namespace, self.dest, values)


class OnceTrue(Once):
    """Store True, and refuse the option's second appearance."""

    value = True

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, nargs=0, default=not self.value, help=help)

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        """Store the value."""
        super().__call__(parser, namespace, self.value, option)


class OnceFalse(OnceTrue):
    """Store False, and refuse the option's second appearance."""

    value = False


class Parser(argparse.ArgumentParser):
    """A parser whose options may appear once, unless they collect values."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("action", None, Once)
        self.register("action", "store_true", OnceTrue)
        self.register("action", "store_false", OnceFalse)

    def _print_message(self, message: str, file: Any = None) -> None:
        if message:  # argparse would hide that it cannot be written
            (file or sys.stderr).write(message)


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
