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
            if reason := _reason_above(each):
                return reason
        return _reason_within(folder)
    except (OSError, RuntimeError) as error:  # no permission to look
        return f"{printable(str(folder), 200)} cannot be examined ({getattr(error, 'strerror', None) or error})"


def make_private(folder: Path) -> None:
    """Make a folder and those that are missing above it, which only this user enters.

    Raises:
        OSError: one of them cannot be made.

    """
    for each in reversed([one for one in (folder, *folder.parents) if not one.exists()]):
        each.mkdir(mode=0o700, exist_ok=True)


def _reason_above(path: Path) -> str:
    """Return why a folder or link on the way to a folder may be another user's."""
    status = path.lstat()
    if reason := _foreign_owner(path, status):
        return reason
    keeps_files_apart = status.st_mode & stat.S_ISVTX  # /tmp: each user removes only their own files
    if stat.S_ISLNK(status.st_mode) or keeps_files_apart:
        return ""
    return _writable(path, status)


def _reason_within(folder: Path) -> str:
    """Return why a folder, or a file below it, may be another user's.

    Files below a folder that others cannot enter may allow writing by their modes: nobody reaches them.
    """
    if not folder.exists():
        return ""
    root = folder.resolve()
    is_private = not folder.stat().st_mode & _ENTER_BY_OTHERS
    for each in (root, *sorted(root.rglob("*"))):
        status = each.lstat()
        if reason := _foreign_owner(each, status):
            return reason
        if stat.S_ISLNK(status.st_mode):
            return f"{_shown(each)} is a link"
        is_hidden = is_private and each != root
        if not is_hidden and (reason := _writable(each, status)):
            return reason
    return ""


def _shown(path: Path) -> str:
    return printable(str(path), 200)


def _foreign_owner(path: Path, status: os.stat_result) -> str:
    """Return a sentence if a file, folder or link belongs neither to this user nor to root; else ''."""
    if status.st_uid in (os.getuid(), 0):
        return ""
    return f"{_shown(path)} belongs to another user ({status.st_uid})"


def _writable(path: Path, status: os.stat_result) -> str:
    """Return a sentence if other users can write a file or folder; else ''."""
    if not status.st_mode & _WRITE_BY_OTHERS:
        return ""
    return f"{_shown(path)} can be written by other users (mode {stat.S_IMODE(status.st_mode):o})"


def _passed(path: Path) -> Iterator[Path]:
    """Yield the folders and links that the system passes on the way to a path, as far as they exist.

    The last folder of the path is not among them. A link's target takes its place among the names that are ahead.
    """
    anchor, *ahead = path.absolute().parts
    reached, links = Path(anchor), 0
    yield reached
    while ahead:
        name, *ahead = ahead
        if name == "..":
            reached = reached.parent
            continue
        place = reached / name
        if not os.path.lexists(place):
            return
        if not place.is_symlink():
            reached = place
            if ahead:
                yield reached
            continue
        links += 1
        if links > _MOST_LINKS:
            return
        yield place
        target = place.readlink()
        if target.is_absolute():
            reached = Path(target.anchor)
            ahead = [*target.parts[1:], *ahead]
        else:
            ahead = [*target.parts, *ahead]
