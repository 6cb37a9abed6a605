# SPDX-License-Identifier: MIT
"""The manifest of a robot's folder, manifest.json: what it was generated from and by what. Written and read here."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from stiffgen._version import __version__
from stiffgen.lower.graph import Operations
from stiffgen.lower.rounding import Ranges, Stated
from stiffgen.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.robot.chain import Body, Chain, Coordinate, Joint, Tip, Tool
from stiffgen.symbolic.potentials import SpringOptions

MANIFEST = "manifest.json"
_GENERATOR = "stiffgen"


def manifest_text(
    chain: Chain,
    name: str,
    scalar: Scalar,
    kernels: Mapping[str, tuple[str, Operations]],
    texts: Mapping[str, str],
    options: SpringOptions,
    bounds: Mapping[str, Sequence[Stated]],
    ranges: Ranges,
) -> str:
    """The manifest of a robot's folder.

    Args:
        chain: the robot.
        name: its identifier.
        scalar: type of its numbers; the manifest names it where it is not double.
        kernels: signature and operation count of every function, by qualified name.
        texts: the other files by name; the manifest has their SHA-256.
        options: what was asked of springs.
        bounds: of the functions' rounding errors, by qualified name.
        ranges: what the functions' arguments are at most for these.

    """
    content = {
        "generator": _GENERATOR,
        "versions": {"stiffgen": __version__, "casadi": version("casadi"), "sympy": version("sympy")},
        "name": name,
        "urdf": {"file": chain.source, "sha256": chain.digest},
        "kernels": {
            kernel: {"signature": signature, "operations": asdict(operations) | {"total": operations.total}}
            for kernel, (signature, operations) in kernels.items()
        },
        "rounding": {
            "ranges": asdict(ranges),
            "bounds": {kernel: [asdict(each) for each in stated] for kernel, stated in bounds.items() if stated},
        },
        "files": {file: hashlib.sha256(text.encode()).hexdigest() for file, text in texts.items()},
        "springs": options.to_manifest(),
        **({"scalar": scalar.name} if scalar != DOUBLE else {}),
        **({"derivatives": True} if options.derivatives else {}),
        "chain": _finite({k: v for k, v in asdict(chain).items() if k != "ignored" or v}),
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """The manifest of a generated folder, or None if it has none."""
    try:
        content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    known = isinstance(content, dict) and content.get("generator") == _GENERATOR
    return content if known and isinstance(content.get("files"), dict) else None


def scalar_of_manifest(content: Mapping[str, Any]) -> Scalar:
    """The type of a folder's numbers; KeyError if there is none like it."""
    return SCALARS[content.get("scalar", DOUBLE.name)]


def _finite(value: Any) -> Any:
    """Infinite limits as "inf" and "-inf", which JSON has no numbers for."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return str(value) if isinstance(value, float) and math.isinf(value) else value


def chain_from_manifest(content: dict[str, Any]) -> Chain:
    """The chain that a folder was generated from."""
    data = content["chain"]

    def nested(value: Any) -> Any:
        return tuple(nested(entry) for entry in value) if isinstance(value, list) else value

    def joint(entry: dict[str, Any]) -> Joint:
        return Joint(**fields(entry) | {"body": Body(**fields(entry["body"]))})

    def coordinate(entry: dict[str, Any]) -> Coordinate:
        limits = {key: float(entry[key]) for key in ("lower", "upper", "velocity", "effort")}
        return Coordinate(name=entry["name"], type=entry["type"], **limits)

    def fields(entry: dict[str, Any]) -> dict[str, Any]:
        return {key: nested(value) for key, value in entry.items()}

    structured = ("joints", "coordinates", "tips", "tool")
    rest = fields({key: value for key, value in data.items() if key not in structured})
    return Chain(
        tips=tuple(Tip(**fields(entry)) for entry in data["tips"]),
        tool=None if data["tool"] is None else Tool(**fields(data["tool"])),
        joints=tuple(joint(entry) for entry in data["joints"]),
        coordinates=tuple(coordinate(entry) for entry in data["coordinates"]),
        **rest,
    )
