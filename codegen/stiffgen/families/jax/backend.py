# SPDX-License-Identifier: MIT
"""Describe NAME_jax.c and jax.py."""

from __future__ import annotations

from pathlib import Path

from stiffgen.core.emit.backend import Backend, Request
from stiffgen.core.emit.casadi.backend import called_functions

_FOLDER = Path(__file__).parent


def _files(request: Request) -> dict[str, str | Path]:
    if not request.has_wrappers:
        return {}
    return {f"python/{request.name}_jax.c": "jax.c.j2", "python/jax.py": _FOLDER / "wrappers" / "jax.py"}


BACKEND = Backend(_FOLDER, _files, called_functions)
