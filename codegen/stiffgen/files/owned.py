# SPDX-License-Identifier: MIT
"""Folders from which code is run: nobody but this user and root may have written there, nor in a folder above."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from stiffgen.core.errors import printable

_MOST_LINKS = 40
"""Symbolic links on a path that are followed, as Linux does."""
_WRITE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ENTER_BY_OTHERS = stat.S_IXGRP | stat.S_IXOTH


def distrust(folder: Path) -> str:
    """Return why another user can have written files of a folder; '' if none can, or where the system has no owners.

    Every folder and link on the path, and every file below the folder, belongs to this user or root. Others may write
    in none of them, except in a folder above that lets each user remove only their own files (/tmp). The folder, and
    the last folders of its path, need not exist.
    """
    if os.name == "nt":
        return ""
    try:
        for each in _passed(folder):
            if reason := _reason(each, is_above=True):
                return reason
        if not folder.exists():
            return ""
        is_private = not folder.stat().st_mode & _ENTER_BY_OTHERS
        for each in (folder.resolve(), *sorted(folder.resolve().rglob("*"))):
            if reason := _reason(each, is_above=False, is_hidden=is_private and each != folder.resolve()):
                return reason
    except (OSError, RuntimeError) as error:  # no permission to look
        return f"{printable(str(folder), 200)} cannot be examined ({getattr(error, 'strerror', None) or error})"
    return ""


def make_private(folder: Path) -> None:
    """Make a folder and those that are missing above it, which only this user enters.

    Raises:
        OSError: one of them cannot be made.

    """
    for each in reversed([one for one in (folder, *folder.parents) if not one.exists()]):
        each.mkdir(mode=0o700, exist_ok=True)


def _reason(path: Path, *, is_above: bool, is_hidden: bool = False) -> str:
    """Return why a file or folder may be another user's; ``is_hidden``: others cannot reach what its mode allows."""
    status = path.lstat()
    shown = printable(str(path), 200)
    if status.st_uid not in (os.getuid(), 0):
        return f"{shown} belongs to another user ({status.st_uid})"
    if stat.S_ISLNK(status.st_mode):
        return "" if is_above else f"{shown} is a link"
    if is_above and status.st_mode & stat.S_ISVTX:
        return ""
    if status.st_mode & _WRITE_BY_OTHERS and not is_hidden:
        return f"{shown} can be written by other users (mode {stat.S_IMODE(status.st_mode):o})"
    return ""


def _passed(path: Path) -> Iterator[Path]:
    """Yield the folders and links that the system passes on the way to a path, as far as they exist."""
    anchor, *names = path.absolute().parts
    reached, links = Path(anchor), 0
    yield reached
    while names:
        name = names.pop(0)
        if name == "..":
            reached = reached.parent
            continue
        if not os.path.lexists(reached / name):
            return
        if (reached / name).is_symlink():
            links += 1
            if links > _MOST_LINKS:
                return
            yield reached / name
            target = (reached / name).readlink()
            reached = Path(target.anchor) if target.is_absolute() else reached
            names = [*target.parts[1 if target.is_absolute() else 0 :], *names]
            continue
        reached = reached / name
        if names:
            yield reached
