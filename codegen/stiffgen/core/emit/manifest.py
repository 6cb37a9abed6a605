# SPDX-License-Identifier: MIT
"""Write and read manifest.json, the record of a robot's folder: robot, options, functions, files."""

from __future__ import annotations

import hashlib
import json
import math
import stat
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from stiffgen._version import __version__
from stiffgen.core.emit.backend import Request
from stiffgen.core.errors import printable
from stiffgen.core.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.core.robot.chain import Chain

MANIFEST = "manifest.json"
_GENERATOR = "stiffgen"
_OPTIONAL = (
    "ignored",
    "accepted",
    "unused_limits",
    "inputs",
    "arguments",
    "loops",
    "actuated",
    "start",
    "is_mjcf",
    "sensor",
)
"""Fields of a chain that are written where they are not empty."""
_MOST_BYTES = 1 << 26
"""Largest manifest that is read [bytes]."""
DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Errors with which a damaged manifest, or one of another version, ends."""


def manifest_text(request: Request, texts: Mapping[str, str]) -> str:
    """Return the manifest of a robot's folder.

    Args:
        request: the robot and the user's options.
        texts: the other files by name; the manifest records their SHA-256.

    """
    chain, scalar, springs = request.chain, request.scalar, request.springs
    kernels = {
        kernel.qualified_name: {
            "signature": kernel.signature(chain),
            "operations": asdict(function.operations) | {"total": function.operations.total},
        }
        for kernel, function in request.single.kernels
    }
    content = {
        "generator": _GENERATOR,
        "versions": {"stiffgen": __version__, "casadi": version("casadi"), "sympy": version("sympy")},
        "name": request.name,
        "urdf": {
            "file": chain.source,
            "sha256": chain.digest,
            **({"arguments": dict(chain.arguments)} if chain.arguments else {}),
            **({"inputs": {each.file: each.digest for each in chain.inputs}} if chain.inputs else {}),
        },
        "options": request.options.to_manifest(),
        "kernels": kernels,
        "rounding": {
            "ranges": asdict(request.ranges),
            "bounds": {
                kernel: [asdict(each) for each in stated] for kernel, stated in request.bounds.items() if stated
            },
        },
        "files": {file: hashlib.sha256(text.encode()).hexdigest() for file, text in texts.items()},
        "springs": springs.springs_record(),
        **({"scalar": scalar.name} if scalar != DOUBLE else {}),
        **({"derivatives": True} if springs.derivatives else {}),
        "chain": _finite({k: v for k, v in asdict(chain).items() if k not in _OPTIONAL or v}),
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


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
    known = isinstance(content, dict) and content.get("generator") == _GENERATOR
    return content if known and isinstance(content.get("files"), dict) else None


def scalar_of_manifest(content: Mapping[str, Any]) -> Scalar:
    """Return the type of a folder's numbers; KeyError for an unknown type."""
    return SCALARS[content.get("scalar", DOUBLE.name)]


def _finite(value: Any) -> Any:
    """Replace infinite limits, which JSON lacks, by "inf" and "-inf"."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return str(value) if isinstance(value, float) and math.isinf(value) else value


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
