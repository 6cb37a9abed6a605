# SPDX-License-Identifier: MIT
"""Reading of files of somebody else's: regular ones alone, and no more of them than a limit."""

from __future__ import annotations

import os
import stat
from pathlib import Path


class FileError(Exception):
    """A file that is refused; the text is a sentence for the user."""


def read_regular(path: str | Path, most: int) -> bytes:
    """Return the content of a regular file of at most ``most`` bytes.

    A pipe without a writer would block the process, and so would some devices.

    Raises:
        FileError: the file is another kind of file, or larger.
        OSError: the file cannot be read.

    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise FileError(f"'{path}' is not a regular file")
    with os.fdopen(descriptor, "rb") as stream:
        data = stream.read(most + 1)
    if len(data) > most:
        raise FileError(f"'{path}' is larger than {most / 2**20:g} MiB")
    return data


def exists(path: str | Path) -> bool:
    """Return whether a file or folder exists; no name that the system cannot have does."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):  # too long, or a NUL byte
        return False


def is_file(path: str | Path) -> bool:
    """Return whether a path is a regular file, as :func:`exists`."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: str | Path) -> bool:
    """Return whether a path is a folder, as :func:`exists`."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False
