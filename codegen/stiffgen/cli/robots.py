# SPDX-License-Identifier: MIT
"""Lists of ``inspect --list``: names of robots that commands take, and the robots in the user's cache."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape

from stiffgen.cli.arguments import needed
from stiffgen.cli.console import table, tables
from stiffgen.core.errors import StiffgenError, printable, terminal_text

LISTS = ("known", "cached", "clear")
"""Robots that can be named, those that ``stiffgen.load()`` has generated, and their removal."""


def list_robots(chosen: str, word: str) -> int:
    """Print the robots of one of LISTS whose name (or maker) contains a word, or clear the cache; return 0."""
    cache, names = needed("files.cache", "--list"), needed("files.names", "--list")
    if chosen == "clear":
        removed = cache.clear([word] if word else [])
        print(f"{removed} robots removed from {terminal_text(str(cache.cache_folder()))}")
        return 0
    if chosen == "cached":
        return _print_cached(cache.entries(), word, cache.cache_folder())
    robots = names.known_robots(word)
    if not robots:
        raise StiffgenError(f"no robot's name or maker contains '{printable(word)}'; leave the word out")
    shown = table("name", "format", "maker", "licence", "package")
    for each in robots:
        cells = (each.name.removesuffix("_description"), each.formats, each.maker, each.licence, each.package)
        shown.add_row(*map(escape, cells))
    tables().print(shown)
    return 0


def _print_cached(entries: Sequence[Any], word: str, place: Path) -> int:
    """Print the robots in the cache whose folder's name contains a word."""
    found = [each for each in entries if word in each.folder.name]
    if found:
        shown = table("robot", "file", "size [MB]", "folder", right=("size [MB]",))
        for each in found:
            texts = (each.folder.name, each.file, f"{each.size / 1e6:.1f}", str(each.folder))
            shown.add_row(*(escape(terminal_text(text)) for text in texts))
        tables().print(shown)
    print(f"{len(found)} robots in {terminal_text(str(place))}")
    return 0
