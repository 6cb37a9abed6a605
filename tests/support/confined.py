# SPDX-License-Identifier: MIT
"""Run the command line under limits, in copies of one process that has loaded stiffgen: saves a second per run."""

from __future__ import annotations

import multiprocessing
import os
import resource
import subprocess
import sys
from pathlib import Path

LOADED = multiprocessing.get_context("forkserver")
"""Context that forks a server with stiffgen loaded; a Python process has one such server."""
LOADED.set_forkserver_preload(["stiffgen.cli", "support.loaded"])


def run_forked(arguments: list[str], folder: Path, megabytes: int, seconds: int) -> subprocess.CompletedProcess[str]:
    """Run the command line in ``folder``; kill it beyond its processor time [s] or four times its memory.

    The last line of standard error states its peak memory [MB]: PEAK and a number.
    """
    process = LOADED.Process(target=_confined, args=(arguments, folder, megabytes, seconds))
    process.start()
    process.join(60 * seconds)
    assert process.exitcode is not None, "still running"
    out, err = (Path(f"{folder}.{name}").read_text(errors="replace") for name in ("out", "err"))
    return subprocess.CompletedProcess(arguments, process.exitcode, out, err)


def _confined(arguments: list[str], folder: Path, megabytes: int, seconds: int) -> None:
    """Run the command in this process with bounded memory and time, and print its peak [MB] at the end."""
    from stiffgen.cli import main

    limit = 4 * megabytes * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    os.chdir(folder)
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(f"{folder}.{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", errors="backslashreplace") for number in (1, 2))
    code = main(arguments)
    print("PEAK", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    sys.exit(code)
