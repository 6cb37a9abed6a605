# SPDX-License-Identifier: MIT
"""Describe the controller's files: the C library with the robot's kernels in it, and the Python class around it."""

from __future__ import annotations

from pathlib import Path

from stiffgen.control.page import has_follow, has_paper_law
from stiffgen.core.emit.backend import Backend, Request

_PYTHON = Path(__file__).parent / "python"
"""Python modules that are the same for every robot: the tables of the compiled module say what differs."""


def _files(request: Request) -> dict[str, str | Path]:
    if not request.controller:
        return {}
    name = request.name
    files: dict[str, str | Path] = {f"{name}_impedance.h": "impedance.h.j2", f"{name}_impedance.c": "impedance.c.j2"}
    if request.options.python:
        files |= {f"python/{file}": _PYTHON / file for file in ("_structs.py", "impedance.py")}
        files["python/impedance.pyi"] = "impedance.pyi.j2"
    if has_follow(request.chain):
        files |= {f"{name}_follow.h": "follow.h.j2", f"{name}_follow.c": "follow.c.j2"}
        if request.options.python:
            files |= {"python/follow.py": _PYTHON / "follow.py", "python/follow.pyi": "follow.pyi.j2"}
    if has_paper_law(request.chain):
        files |= {f"{name}_paper.h": "paper.h.j2", f"{name}_paper.c": "paper.c.j2"}
        if request.options.python:
            files |= {"python/paper.py": _PYTHON / "paper.py", "python/paper.pyi": "paper.pyi.j2"}
    return files


BACKEND = Backend(Path(__file__).parent, _files)
