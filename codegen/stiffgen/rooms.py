# SPDX-License-Identifier: MIT
"""Rooms of the package that can be taken out: each is deleted as a folder, and the others go on without it."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

OPTIONAL = ("controller", "analyze", "calibrate", "new", "passport", "play", "prove")
"""Rooms that no module of another room imports by name."""


def is_there(module: str) -> bool:
    """Return whether a module of the package is there; its room may have been taken out."""
    room = find_spec(f"stiffgen.{module.partition('.')[0]}")
    return room is not None and room.origin is not None


def optional(module: str) -> ModuleType | None:
    """Return a module of the package, imported, or None where its room has been taken out."""
    return import_module(f"stiffgen.{module}") if is_there(module) else None
