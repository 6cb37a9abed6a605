# SPDX-License-Identifier: MIT
"""Compile a driver beside the kernels of a folder, in C or C++."""

from __future__ import annotations

import os
import shlex
import sysconfig
from collections.abc import Sequence
from pathlib import Path

from stiffgen.core.emit import build
from stiffgen.core.errors import NoCompilerError


def build_beside(
    libraries: Sequence[Path],
    sources: Sequence[Path],
    stem: Path,
    headers: Path,
    compiler: Sequence[str] = (),
    flags: Sequence[str] = ("-std=gnu99",),
) -> Path:
    """Compile sources into a shared library that calls functions of other shared libraries; without optimisation.

    Args:
        libraries: shared libraries with the called functions.
        sources: C files, or those of ``compiler``'s language.
        stem: the new library without its suffix.
        headers: a folder of headers.
        compiler: command (default: the C compiler).
        flags: the language's flags.

    Raises:
        BuildError: no compiler, or it failed; with its last lines.

    """
    command = [*(compiler or build.compiler_command()), *flags, *build.FORWARDS, "-fPIC", "-shared"]
    library = stem.with_name(stem.name + (sysconfig.get_config_var("SHLIB_SUFFIX") or ".so"))
    linked = [
        f"-I{headers.resolve()}",
        *map(str, (*sources, *libraries)),
        "-o",
        str(library),
        *(["-lm"] if os.name != "nt" else []),
    ]
    build.run_all([[*command, *linked, *(["-lm"] if os.name != "nt" else [])]], command[0], stem.parent)
    return library


def cpp_command() -> list[str]:
    """Return the C++ compiler and its leading arguments: CXX if set, else the first of c++, g++, clang++ on the PATH.

    Raises:
        NoCompilerError: there is none.

    """
    found = build.find_compiler("CXX", "c++", "g++", "clang++")
    if found:
        return found
    chosen = shlex.split(os.environ.get("CXX", ""))
    what = f"the C++ compiler '{chosen[0]}' named by CXX was not found" if chosen else "no C++ compiler found"
    raise NoCompilerError(f"{what}; install one (Debian: apt-get install g++), or set CXX")
