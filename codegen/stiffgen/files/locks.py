# SPDX-License-Identifier: MIT
"""Locks with a name, in the user's cache; the system releases them when their process ends."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def exclusive(lock: Path, wait: Callable[[], None]) -> Iterator[None]:
    """Hold the lock of a file while the block runs; call ``wait`` first if another process holds it.

    The system releases the lock when the process ends. The file stays, because removing it would let two processes
    hold a lock of the same name.

    Raises:
        OSError: the file cannot be made.

    """
    held = FileLock(lock)
    try:
        held.acquire(blocking=False)
    except Timeout:
        wait()
        held.acquire()
    try:
        yield
    finally:
        held.release()


def remove_unlocked(lock: Path, folder: Path) -> bool:
    """Remove a folder unless a process holds its lock; return whether it was there and is gone.

    Raises:
        OSError: the folder cannot be removed.

    """
    try:
        with FileLock(lock, blocking=False):
            if not folder.exists():
                return False
            shutil.rmtree(folder)
            return True
    except Timeout:
        return False
