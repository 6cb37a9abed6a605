# SPDX-License-Identifier: MIT
"""Limits of a process that reads a file of somebody else's."""

from __future__ import annotations

import contextlib


def limit_process(seconds: int, gibibytes: int) -> None:
    """Limit this process to some seconds of processor time and some GiB of address space, where the system can."""
    with contextlib.suppress(ImportError, ValueError, OSError):  # not on Windows; a lower limit is in force
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_AS, (gibibytes * 2**30, gibibytes * 2**30))
