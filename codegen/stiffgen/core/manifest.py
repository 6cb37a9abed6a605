# SPDX-License-Identifier: MIT
"""Reading of manifest.json, the record of a robot's folder: chain, springs, numbers."""

from __future__ import annotations

import json
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from stiffgen.core.errors import printable
from stiffgen.core.family import part
from stiffgen.core.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.core.potentials import potential_of_source, sealed_potential
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.choices import ALL, KINDS, KernelOptions
from stiffgen.core.symbolic.placement import Placement

MANIFEST = "manifest.json"
GENERATOR = "stiffgen"
_MOST_BYTES = 1 << 26
"""Largest manifest that is read [bytes]."""
DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Errors with which a damaged manifest, or one of another version, ends."""


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a generated folder; None without one."""
    file = folder / MANIFEST
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > _MOST_BYTES:  # a device has no end
            return None
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    known = isinstance(content, dict) and content.get("generator") == GENERATOR
    return content if known and isinstance(content.get("files"), dict) else None


def scalar_of_manifest(content: Mapping[str, Any]) -> Scalar:
    """Return the type of a folder's numbers; KeyError for an unknown type."""
    return SCALARS[content.get("scalar", DOUBLE.name)]


def springs_of_manifest(content: dict[str, Any], trust_potentials: bool) -> KernelOptions:
    """Return the springs of a robot's folder; a folder without a record has the default spring.

    The source of potentials is run only if ``trust_potentials`` is True.
    """
    recorded = content.get("springs")
    if recorded is None:
        return KernelOptions()
    family = part("springs.springs")
    names = {family.spring(kind).name: kind for kind in KINDS} if family else {}
    x, y, z = map(float, recorded["centre"])
    return KernelOptions(
        springs=tuple(names[name] for name in recorded["kinds"] if name in names),
        placement=Placement(recorded["translation_axes"], recorded["rotation_axes"], (x, y, z)),
        potentials=tuple(
            potential_of_source(each["source"], each["file"], each["function"])
            if trust_potentials
            else sealed_potential(each)
            for each in recorded["potentials"]
        ),
        pairs=tuple(recorded.get("pairs", ())),
        derivatives=bool(content.get("derivatives", False)),
        kernels=tuple(recorded.get("groups", (ALL,))),
        batches=recorded.get("batches", True),
    )


def chain_from_manifest(content: dict[str, Any]) -> Chain:
    """Return the chain that a folder was generated from; raise one of DAMAGE if the manifest has none."""
    chain = _record(Chain, content["chain"])
    assert isinstance(chain, Chain)
    return chain


def _record(kind: Any, value: Any) -> Any:
    """Turn an entry of the manifest into a value of an annotated type.

    Types are records, ``X | None``, tuples, literals, floats and what JSON has by itself. A bool is no number.

    Raises:
        TypeError: the entry is of another type, or not among the literals; one of DAMAGE for a record of other fields.

    """
    if hasattr(kind, "__dataclass_fields__"):
        kinds = get_type_hints(kind)
        return kind(**{name: _record(kinds[name], entry) for name, entry in value.items()})
    parameters = get_args(kind)
    if type(None) in parameters:
        return None if value is None else _record(parameters[0], value)
    if get_origin(kind) is tuple and isinstance(value, list):
        kinds_of_entries = (parameters[0],) * len(value) if parameters[-1] is Ellipsis else parameters
        return tuple(_record(each, entry) for each, entry in zip(kinds_of_entries, value, strict=True))
    if get_origin(kind) is Literal and value in parameters:
        return value
    if kind is float and (type(value) in (int, float) or value in ("inf", "-inf")):
        return float(value)
    if type(value) is not kind:
        raise TypeError(f"{printable(repr(value))} stands where {kind} is expected")
    return value
