# SPDX-License-Identifier: MIT
"""The command ``robots``: names of robots that ``generate --robot`` takes, and the robots in the user's cache."""

from __future__ import annotations

import argparse

from rich.markup import escape

from stiffgen.cache import cache_folder, clear, entries
from stiffgen.cli.console import table, tables
from stiffgen.errors import StiffgenError, printable, terminal_text
from stiffgen.robot.names import known_robots


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    command.add_argument("word", nargs="?", default="", metavar="WORD", help="part of a name or maker (default: all)")
    command.add_argument(
        "--cache",
        choices=["list", "clear"],
        help="list or remove the robots that stiffgen.load() has generated",
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the robots that can be named, or list or clear the cache."""
    if options.cache == "clear":
        removed = clear([options.word] if options.word else [])
        print(f"{removed} robots removed from {terminal_text(str(cache_folder()))}")
        return 0
    if options.cache == "list":
        return _print_cached(options.word)
    robots = known_robots(options.word)
    if not robots:
        raise StiffgenError(f"no robot's name or maker contains '{printable(options.word)}'; leave the word out")
    shown = table("name", "format", "maker", "licence", "package")
    for each in robots:
        cells = (each.name.removesuffix("_description"), each.formats, each.maker, each.licence, each.package)
        shown.add_row(*map(escape, cells))
    tables().print(shown)
    return 0


def _print_cached(word: str) -> int:
    """Print the robots in the cache whose folder's name contains a word."""
    found = [each for each in entries() if word in each.folder.name]
    if found:
        shown = table("robot", "file", "size [MB]", "folder", right=("size [MB]",))
        for each in found:
            texts = (each.folder.name, each.file, f"{each.size / 1e6:.1f}", str(each.folder))
            shown.add_row(*(escape(terminal_text(text)) for text in texts))
        tables().print(shown)
    print(f"{len(found)} robots in {terminal_text(str(cache_folder()))}")
    return 0
