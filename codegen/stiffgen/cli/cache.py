# SPDX-License-Identifier: MIT
"""The command ``cache``: robots that ``stiffgen.load`` has generated."""

from __future__ import annotations

import argparse

from rich.markup import escape

from stiffgen.cache import cache_folder, clear, entries
from stiffgen.cli.console import table, tables
from stiffgen.errors import StiffgenError, terminal_text


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    command.add_argument("robot", nargs="*", help="with --clear: names of the robots to remove [all]")
    command.add_argument("--clear", action="store_true", help="remove robots from the cache")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """List the cache, or clear it."""
    if options.robot and not options.clear:
        raise StiffgenError(f"cache {options.robot[0]}: add --clear to remove this robot")
    if options.clear:
        print(f"{clear(options.robot)} robots removed from {terminal_text(str(cache_folder()))}")
        return 0
    found = entries()
    if found:
        shown = table("robot", "file", "size [MB]", "folder", right=("size [MB]",))
        for each in found:
            texts = (each.folder.name, each.file, f"{each.size / 1e6:.1f}", str(each.folder))
            shown.add_row(*(escape(terminal_text(text)) for text in texts))
        tables().print(shown)
    print(f"{len(found)} robots in {terminal_text(str(cache_folder()))}")
    return 0
