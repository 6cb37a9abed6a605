# SPDX-License-Identifier: MIT
"""Describe NAME_casadi.c and NAME_calls.c: the functions of the wrappers behind one signature."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.library import Library

CALLS = Library(Path(__file__).parent / "library", "calls.h", ("calls.c",))
"""C of every NAME_calls.c, which computes derivatives from vector-Jacobian products."""


def called_functions(request: Request) -> dict[str, Any]:
    """Return the variable ``called``: the functions of the wrappers and their vector-Jacobian products."""
    return {"called": request.kernels}


def _variables(request: Request) -> dict[str, Any]:
    texts = {"calls_interface": CALLS.interface(request.name), "calls": CALLS.functions(request.name)}
    return texts | called_functions(request)


def _files(request: Request) -> dict[str, str | Path]:
    """Return the files of the CasADi wrapper, where wrappers are asked for."""
    if not request.has_wrappers:
        return {}
    return {
        f"python/{request.name}_calls.h": "calls.h.j2",
        f"python/{request.name}_calls.c": "calls.c.j2",
        f"python/{request.name}_casadi.c": "casadi.c.j2",
        "python/casadi.py": Path(__file__).parent / "wrappers" / "casadi.py",
    }


BACKEND = Backend(Path(__file__).parent, _files, _variables)
