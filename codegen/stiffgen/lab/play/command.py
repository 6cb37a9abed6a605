# SPDX-License-Identifier: MIT
"""The command ``play``: a robot's playground in the browser."""

from __future__ import annotations

import argparse
import os
import sys
import webbrowser
from contextlib import ExitStack
from pathlib import Path

from stiffgen.cli.arguments import add_robot, source_of
from stiffgen.cli.console import Progress, messages
from stiffgen.cli.records import add_options, values_of
from stiffgen.core.folder import temporary_folder
from stiffgen.core.generate import generate_folder
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.lab.play.page import write_page


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_robot(command, "folder that 'stiffgen generate' wrote, or a robot's URDF, MJCF, xacro template or name")
    add_options(command, ChainOptions, "tip")
    command.add_argument(
        "--output", type=Path, metavar="FILE.html", help="file to write, without opening it (default: NAME.html)"
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the page, open it and print its path."""
    source = source_of(options)
    with Progress(messages()).shown() as progress, ExitStack() as open_folders:
        if isinstance(source, str) or not source.is_dir():
            source = _generated(source, open_folders.enter_context(temporary_folder("play")), options, progress)
        page = write_page(source, options.output, progress)
    print(page)
    if options.output is None and _has_screen() and not webbrowser.open(page.resolve().as_uri()):
        print("stiffgen: warning: no browser found; open the file in one", file=sys.stderr)
    return 0


def _generated(source: Path | str, folder: Path, options: argparse.Namespace, progress: Progress) -> Path:
    """Generate the functions of a robot's file, without the controller, and return their folder."""
    chosen = values_of(options, ChainOptions)
    return generate_folder(
        source, GenerationOptions(**chosen, output=folder, controller=False, build=False, progress=progress)
    )


def _has_screen() -> bool:
    """Whether a browser has a screen; elsewhere a text browser would occupy the terminal."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
