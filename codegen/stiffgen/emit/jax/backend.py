# SPDX-License-Identifier: MIT
"""Describe NAME_jax.c and jax.py."""

from __future__ import annotations

from pathlib import Path

from stiffgen.emit.backend import Backend, Request
from stiffgen.emit.casadi.backend import called_functions


def _files(request: Request) -> dict[str, str]:
    if not request.has_wrappers:
        return {}
    return {f"python/{request.name}_jax.c": "jax.c.j2", "python/jax.py": "jax.py.j2"}


JAX = Backend(Path(__file__).parent, _files, called_functions)
