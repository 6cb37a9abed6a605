# SPDX-License-Identifier: MIT
"""Limits of a process that reads a file of somebody else's."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import Any


def limit_process(seconds: int, gibibytes: int) -> None:
    """Limit this process to some seconds of processor time and some GiB of address space, where the system can."""
    with contextlib.suppress(ImportError, ValueError, OSError):  # not on Windows; a lower limit is in force
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_AS, (gibibytes * 2**30, gibibytes * 2**30))


_HARMFUL = (
    *("subprocess.", "pty.", "socket.", "ctypes.", "shutil.", "tempfile.", "urllib.", "webbrowser.", "mmap."),
    *("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.startfile", "os.kill", "os.chdir"),
    *("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.chmod", "os.chown"),
    *("os.truncate", "os.putenv", "os.unsetenv", "os.utime", "os.setxattr", "signal.", "sys._getframe", "gc."),
)
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
"""Flags of an opened file that may change it."""


def forbid_harm() -> None:
    """Forbid this process to write files, run programs, open connections, and run code that is made at run time.

    A hook of Python's audit events cannot be removed. The modules that the process needs are imported before. This is
    a second wall behind the evaluator of expressions, and no sandbox: .github/SECURITY.md says what it leaves open.
    """

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        writes = event == "open" and _writes(*arguments[1:3])
        # A file's code is that of a module; text that is compiled has a name of the form "<...>".
        is_made = event == "exec" and getattr(arguments[0], "co_filename", "<").startswith("<")
        is_made = is_made and not arguments[0].co_filename.startswith("<frozen ")
        if writes or is_made or event.startswith(_HARMFUL):
            raise PermissionError(f"{event} is not allowed here")

    _forbid_forks()
    sys.addaudithook(hook)
    with contextlib.suppress(ImportError, ValueError, OSError):  # not on Windows
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))


def _writes(mode: Any, flags: Any) -> bool:
    """Return whether a file is opened for writing: by the mode of ``open``, or by the flags of ``os.open``."""
    by_mode = isinstance(mode, str) and bool(set(mode) & set("wax+"))
    return by_mode or (isinstance(flags, int) and bool(flags & _WRITING))


def _forbid_forks() -> None:
    """Replace the function behind ``subprocess``, which forks without an audit event."""

    def refuse(*_: Any) -> Any:
        raise PermissionError("_posixsubprocess.fork_exec is not allowed here")

    with contextlib.suppress(ImportError):  # not on Windows
        import _posixsubprocess
        import subprocess

        _posixsubprocess.fork_exec = refuse
        vars(subprocess)["_fork_exec"] = refuse
