# SPDX-License-Identifier: MIT
"""Results that appear whole or not at all, and temporary folders that do not outlive their process for long.

A process holds a lock on each folder or file that it makes. The system releases the lock when the process ends, also
by kill -9; the next run removes what carries the name of such a folder and no lock. These locks are on the folders
themselves (fcntl): a lock file, as of filelock, would stay in the user's output folder.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from stiffgen.core.errors import OutputError, printable
from stiffgen.core.signals import signals_deferred

try:
    import fcntl
except ImportError:  # Windows: folders are not locked there, and those of dead processes stay
    fcntl = None  # type: ignore[assignment]

_ATTEMPTS = 100
"""Attempts to swap or remove a folder in which other processes work at the same time."""
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of Linux's renameat2


@contextmanager
def swapped_in(target: Path) -> Iterator[Path]:
    """Make a new folder beside ``target``, which takes the place of ``target`` when the block ends without an error.

    After an error, ``target`` is unchanged and nothing is left beside it. ``target`` exists at every moment of the
    exchange where the system can exchange two folders (Linux).

    Raises:
        OutputError: the folder cannot be made, or not put in its place.

    """
    output = target.parent
    with signals_deferred() as deliver:
        try:
            created = _missing_parents(output)
            output.mkdir(parents=True, exist_ok=True)
            staging, lock = _locked(output, f".{target.name[:40]}.stiffgen-", tempfile.mkdtemp)
        except OSError as error:
            raise unwritable(output, error) from error
        try:
            deliver()  # a signal that came meanwhile raises here, where the folder is removed
            yield staging
            _swap(staging, target)
        except BaseException as error:
            _remove(staging)
            for folder in created:
                with suppress(OSError):  # not empty: another process has put something there
                    folder.rmdir()
            if isinstance(error, OSError):  # a full disk
                is_inside = error.filename is None or str(staging) in str(error.filename)  # the user knows the target
                raise unwritable(target if is_inside else Path(str(error.filename)), error) from error
            raise
        finally:
            _release(lock)


@contextmanager
def temporary_folder(purpose: str) -> Iterator[Path]:
    """Make a folder for temporary files, and remove it when the block ends.

    Raises:
        OutputError: there is no place for it.

    """
    with signals_deferred() as deliver:
        try:
            folder, lock = _locked(Path(tempfile.gettempdir()), f"stiffgen-{purpose}.", tempfile.mkdtemp)
        except OSError as error:
            parent = os.environ.get("TMPDIR", "/tmp")
            raise OutputError(
                f"{printable(parent, 200)}: has no room for temporary files ({error.strerror or error}); "
                "set TMPDIR to a folder that can be written"
            ) from error
        try:
            deliver()
            yield folder
        finally:
            _remove(folder)
            _release(lock)


def flush(folder: Path) -> None:
    """Have the system write a folder and all in it to the disk, so that a power cut leaves no file cut short."""
    for path in (*folder.rglob("*"), folder):
        with suppress(OSError):  # Windows flushes no folders
            descriptor = os.open(path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def write_atomically(target: Path, text: str) -> None:
    """Write a file beside its place and move it there; a symbolic link in its place is replaced, never followed.

    Raises:
        OSError: the file cannot be written.

    """

    def make(prefix: str, dir: Path) -> str:
        descriptor, name = tempfile.mkstemp(prefix=prefix, dir=dir)
        os.close(descriptor)
        return name

    with signals_deferred() as deliver:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial, lock = _locked(target.parent, f".{target.name[:40]}.stiffgen-", make)
        try:
            deliver()
            with partial.open("w", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
            partial.chmod(0o666 & ~_umask())
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)
            _release(lock)


_REMEDIES = {
    errno.EACCES: "ask for permission to write there, or choose another --output",
    errno.EPERM: "ask for permission to write there, or choose another --output",
    errno.EROFS: "choose another --output",
    errno.ENAMETOOLONG: "choose a shorter --output or --name",
    errno.ENOSPC: "make room, or choose another --output",
    errno.EDQUOT: "make room, or choose another --output",
}


def unwritable(path: Path, error: OSError) -> OutputError:
    """Return the refusal of a folder that the system does not let us write, with a remedy for this error."""
    remedy = _REMEDIES.get(error.errno or 0, "choose another --output")
    return OutputError(f"{printable(str(path), 200)}: cannot be written ({error.strerror or error}); {remedy}")


def _missing_parents(folder: Path) -> list[Path]:
    """Return the folders that do not exist yet, the innermost first."""
    return [each for each in (folder, *folder.parents) if not each.exists()]


def _locked(parent: Path, prefix: str, make: Callable[..., str]) -> tuple[Path, int | None]:
    """Remove stale files and folders with this prefix, then make and lock a new one."""
    _remove_stale(parent, prefix)
    while True:
        made = Path(make(prefix=prefix, dir=parent))
        lock = _lock(made, wait=True)
        # Another process may have removed it as a stale one before it was locked.
        if made.exists():
            return made, lock
        _release(lock)


def _lock(path: Path, *, wait: bool = False) -> int | None:
    """Lock a file or folder of this user; return a descriptor that holds the lock, or None if that cannot be."""
    if fcntl is None:
        return None
    descriptor = None
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        if os.fstat(descriptor).st_uid == os.getuid():
            fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
    _release(descriptor)
    return None


def _release(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


def _remove_stale(parent: Path, prefix: str) -> None:
    """Remove files and folders of processes that ended without removing them."""
    with suppress(OSError):
        for entry in os.scandir(parent):
            if entry.name.startswith(prefix):
                lock = _lock(Path(entry.path))
                if lock is not None:
                    _remove(Path(entry.path))
                    _release(lock)


def _remove(path: Path) -> None:
    """Remove a file or folder, also while another process still writes into it."""
    for _ in range(_ATTEMPTS):
        try:
            is_folder = stat.S_ISDIR(path.lstat().st_mode)
        except OSError:
            return
        if is_folder:
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()


def _umask() -> int:
    """Return the process' umask, which can be read only by setting it."""
    umask = os.umask(0)
    os.umask(umask)
    return umask


def _swap(staging: Path, target: Path) -> None:
    """Put a folder in the place of another; other processes may do the same at the same time."""
    try:
        staging.chmod(0o777 & ~_umask())  # mkdtemp makes private folders
        for _ in range(_ATTEMPTS):
            if not target.exists():
                with _tolerate(errno.ENOTEMPTY, errno.EEXIST):  # made by another process just now
                    staging.rename(target)
                    return
            elif _exchange(staging, target) or _replace(staging, target):
                _remove(staging)
                return
        raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
    except OSError as error:
        raise OutputError(
            f"{target}: cannot be replaced ({error.strerror}); close what uses it and try again"
        ) from error


@contextmanager
def _tolerate(*numbers: int) -> Iterator[None]:
    """Suppress OSErrors with these numbers."""
    try:
        yield
    except OSError as error:
        if error.errno not in numbers:
            raise


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; return False if the system or the file system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):  # not Linux, or an old C library
        return False
    return bool(rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0)


def _replace(staging: Path, target: Path) -> bool:
    """Replace a folder by two renames; return False if another process came between them."""
    old = Path(tempfile.mkdtemp(prefix=f".{target.name[:40]}.stiffgen-", dir=target.parent))
    lock = _lock(old)
    try:
        with _tolerate(errno.ENOENT):
            target.rename(old / "old")
        try:
            staging.rename(target)
        except OSError as error:
            if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
                return False
            with suppress(OSError):
                (old / "old").rename(target)
            raise
        return True
    finally:
        _remove(old)
        _release(lock)
