# SPDX-License-Identifier: MIT
"""The command ``play``: a robot's playground in the browser."""

from __future__ import annotations

import argparse
import os
import sys
import webbrowser
from pathlib import Path

from stiffgen.cli.arguments import add_folder
from stiffgen.cli.console import Progress, messages
from stiffgen.play.page import write_page


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder(command)
    command.add_argument("--output", type=Path, metavar="FILE.html", help="file to write (default: NAME.html)")
    command.add_argument("--no-open", action="store_true", help="write the page, do not open it")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the page, open it and print its path."""
    with Progress(messages()).shown() as progress:
        page = write_page(options.folder, options.output, progress)
    print(page)
    if not options.no_open and _has_screen() and not webbrowser.open(page.resolve().as_uri()):
        print("stiffgen: warning: no browser found; open the file in one", file=sys.stderr)
    return 0


def _has_screen() -> bool:
    """Whether a browser has a screen; elsewhere a text browser would occupy the terminal."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
