# SPDX-License-Identifier: MIT
"""Find the Pythons of this machine, and run programs without what leads to this working tree."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

VERSIONS = ("3.11", "3.12", "3.13", "3.14")
"""Versions of Python that are supported, where one is installed."""
IN_A_CHILD = """import os, sys, traceback
import casadi, numpy, yourdfpy

def in_a_child(work, *arguments):
    child = os.fork()
    if child == 0:
        try:
            work(*arguments)
        except BaseException:
            print(*arguments, file=sys.stderr)
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    if os.waitpid(child, 0)[1] != 0:
        sys.exit(1)
"""
"""Beginning of a program that runs copies of the package, each in a child: other packages are imported once for all."""


def interpreter(version: str) -> str | None:
    """Return a Python of a version that can make virtual environments, of pyenv or on the path; None without one."""
    kept = Path("~/.pyenv/versions").expanduser().glob(f"{version}.*/bin/python3")
    own = [sys.executable] if version == "{}.{}".format(*sys.version_info) else []
    code = "import ensurepip, sys; print('{}.{}'.format(*sys.version_info))"
    for candidate in (*own, *sorted(map(str, kept), reverse=True), shutil.which(f"python{version}")):
        if candidate:  # one on the path may be pyenv's word that it is another's
            done = subprocess.run([candidate, "-c", code], capture_output=True, text=True, check=False)
            if done.stdout.strip() == version:
                return candidate
    return None


def clean_environment() -> dict[str, str]:
    """Return the environment without what leads to this working tree, and without the flags of its tests."""
    return {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV", "CFLAGS")}
