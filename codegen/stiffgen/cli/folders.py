# SPDX-License-Identifier: MIT
"""Commands that read a robot's folder take the robot's file or name, too: it is generated into the cache."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from stiffgen.cli.arguments import needed
from stiffgen.cli.console import Progress, messages
from stiffgen.core.robot.files import is_folder


def add_folder_or_robot(command: Any, *, is_optional: bool = False) -> None:
    """Add the folder, or the robot's file or name with the arguments of a template."""
    command.takes_arguments = True
    meaning = "folder that 'stiffgen generate' wrote, or a robot's URDF, MJCF, xacro template or name (no options)"
    command.add_argument("source", nargs="?" if is_optional else None, metavar="ROBOT", help=meaning)


def chosen_folder(options: argparse.Namespace) -> Path:
    """Return the folder; that of a file or name is generated first if the cache does not hold it."""
    with Progress(messages(wide=False)).shown() as progress:
        return folder_of(options.source, options.arguments, progress)


def folder_of(source: str | Path, arguments: Mapping[str, str] | None, progress: Callable[[str], None]) -> Path:
    """Return a robot's folder: the source itself, or that of the cache for a robot's file or name."""
    if is_folder(source):  # without the readers and printers that the cache imports
        return Path(source)
    return Path(needed("files.cache", "a robot's file in place of a folder").folder_of(source, arguments, progress))
