"""Compile a robot's folder with CMake and Ninja (from the Python registry) and the system's C compiler."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import cmake
import ninja

from stiffgen.errors import BuildError

_LAST_LINES = 20


def build_module(folder: Path, name: str) -> None:
    """Compile the NumPy module of a generated folder into that folder.

    Args:
        folder: the robot's folder.
        name: the robot's identifier.

    Raises:
        BuildError: no compiler, no Python headers, or the compiler failed; with its last lines.

    """
    compiler = _compiler()
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.exists():
        raise BuildError(
            "Python's C headers are missing; install them (Debian: apt-get install python3-dev) or use --no-build"
        )
    macro = name.upper()
    with tempfile.TemporaryDirectory(prefix="stiffgen-build-") as build:
        configure = [
            str(Path(cmake.CMAKE_BIN_DIR) / "cmake"),
            *("-S", str(folder.resolve()), "-B", build, "-G", "Ninja", "-Wno-dev"),
            f"-DCMAKE_MAKE_PROGRAM={Path(ninja.BIN_DIR) / 'ninja'}",
            f"-DCMAKE_C_COMPILER={compiler[0]}",
            f"-DCMAKE_C_FLAGS={shlex.join(compiler[1:])}",
            "-DCMAKE_BUILD_TYPE=Release",
            f"-DPython_EXECUTABLE={sys.executable}",
            f"-D{macro}_PYTHON=ON",
            f"-D{macro}_NATIVE=ON",
            f"-D{macro}_PYTHON_DIR={folder.resolve()}",
        ]
        _run(configure, compiler[0])
        _run([str(Path(cmake.CMAKE_BIN_DIR) / "cmake"), "--build", build], compiler[0])


def _compiler() -> list[str]:
    """The C compiler and its leading arguments: CC if set, else the first of cc, gcc, clang on the PATH."""
    chosen = shlex.split(os.environ.get("CC", ""))
    for candidate in [chosen] if chosen else [["cc"], ["gcc"], ["clang"]]:
        found = shutil.which(candidate[0])
        if found:
            return [found, *candidate[1:]]
    what = (
        f"the C compiler '{chosen[0]}' named by CC was not found" if chosen else "no C compiler (cc, gcc, clang) found"
    )
    raise BuildError(f"{what}; install one (Debian: apt-get install gcc), set CC, or use --no-build")


def _run(command: list[str], compiler: str) -> None:
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
        )
    except OSError as error:
        raise BuildError(
            f"{command[0]} cannot be run ({error.strerror}); reinstall the Python package 'cmake'"
        ) from error
    if done.returncode != 0:
        lines = done.stdout.rstrip().splitlines()[-_LAST_LINES:]
        raise BuildError(
            f"compiling with {compiler} failed (exit code {done.returncode}); repair the compiler, choose another one "
            "with CC, or use --no-build. Its last lines:\n  " + "\n  ".join(lines)
        )
