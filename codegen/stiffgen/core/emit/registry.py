# SPDX-License-Identifier: MIT
"""Registry of backends: a new one is a folder and a line here."""

from __future__ import annotations

from stiffgen.rooms import optional

_FOLDERS = (
    "core.emit.c",
    "families.cpp",
    "core.emit.python",
    "core.emit.package",
    "families.cuda",
    "core.emit.casadi",
    "families.jax",
    "families.torch",
    "control",
)
"""Folders with a module ``backend``; a family or the controller may have been taken out."""

BACKENDS = tuple(module.BACKEND for folder in _FOLDERS if (module := optional(f"{folder}.backend")))
"""Backends in the order in which their files stand in the manifest."""
