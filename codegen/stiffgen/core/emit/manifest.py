# SPDX-License-Identifier: MIT
"""Text of manifest.json, the record of a robot's folder: robot, options, functions, files."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from stiffgen._version import __version__
from stiffgen.core.emit.backend import Request
from stiffgen.core.lower.scalar import DOUBLE
from stiffgen.core.manifest import GENERATOR

SHAPING = ("casadi", "sympy", "mpmath", "Jinja2")
"""Packages whose versions can change the generated text."""
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
        "generator": GENERATOR,
        "versions": {"stiffgen": __version__, **{package: version(package) for package in SHAPING}},
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


def _finite(value: Any) -> Any:
    """Replace infinite limits, which JSON lacks, by "inf" and "-inf"."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(entry) for entry in value]
    return str(value) if isinstance(value, float) and math.isinf(value) else value
