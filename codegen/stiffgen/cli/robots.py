# SPDX-License-Identifier: MIT
"""The command ``robots``: names of robots that ``generate --robot`` takes."""

from __future__ import annotations

import argparse

from rich.markup import escape

from stiffgen.cli.console import table, tables
from stiffgen.errors import StiffgenError, printable
from stiffgen.robot.names import known_robots


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    command.add_argument("word", nargs="?", default="", metavar="WORD", help="part of a name or maker (default: all)")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the robots."""
    robots = known_robots(options.word)
    if not robots:
        raise StiffgenError(f"no robot's name or maker contains '{printable(options.word)}'; leave the word out")
    shown = table("name", "format", "maker", "licence", "package")
    for each in robots:
        cells = (each.name.removesuffix("_description"), each.formats, each.maker, each.licence, each.package)
        shown.add_row(*map(escape, cells))
    tables().print(shown)
    return 0
