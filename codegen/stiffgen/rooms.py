# SPDX-License-Identifier: MIT
"""Rooms of the package: core < families < files < control < cli < lab, each importing itself and those before it.

All but the core can be taken out: a room or one of its folders is deleted, and what does not import it goes on.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

OPTIONAL = (
    "files",
    "control",
    "cli",
    "lab",
    "lab.analyze",
    "lab.calibrate",
    "lab.measure",
    "lab.new",
    "lab.passport",
    "lab.play",
    "lab.prove",
)
"""Rooms, and folders of rooms, without which the core generates and verifies; families: ``core.family``."""


def is_there(module: str) -> bool:
    """Return whether a module of the package is there; a folder on the way to it may have been taken out."""
    spec = None
    parts = module.split(".")
    for depth in range(1, len(parts) + 1):  # find_spec raises where a parent is missing
        spec = find_spec(".".join(("stiffgen", *parts[:depth])))
        if spec is None:
            return False
    return spec is not None and spec.origin is not None  # what is left of a folder that was deleted has no origin


def optional(module: str) -> ModuleType | None:
    """Return a module of the package, imported, or None where its room has been taken out."""
    return import_module(f"stiffgen.{module}") if is_there(module) else None
