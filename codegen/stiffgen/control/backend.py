# SPDX-License-Identifier: MIT
"""Describe the controller's files: the C library with the robot's kernels in it, and the Python class around it."""

from __future__ import annotations

from pathlib import Path

from stiffgen.control.companions import companions_of
from stiffgen.core.emit.backend import Backend, Request

_PYTHON = Path(__file__).parent / "python"
"""Python modules that are the same for every robot: the tables of the compiled module say what differs."""


def _files(request: Request) -> dict[str, str | Path]:
    """Return the controller's files and those of its companions, with their templates or sources."""
    if not request.controller:
        return {}
    name = request.name
    files: dict[str, str | Path] = {f"{name}_impedance.h": "impedance.h.j2", f"{name}_impedance.c": "impedance.c.j2"}
    if request.options.python:
        files |= {f"python/{file}": _PYTHON / file for file in ("_structs.py", "impedance.py")}
        files["python/impedance.pyi"] = "impedance.pyi.j2"
    for companion in companions_of(request.chain):
        files |= {f"{name}{ending}": template for ending, template in companion.files.items()}
        if request.options.python:
            module = companion.name
            files |= {f"python/{module}.py": _PYTHON / f"{module}.py", f"python/{module}.pyi": f"{module}.pyi.j2"}
    return files


BACKEND = Backend(Path(__file__).parent, _files)
