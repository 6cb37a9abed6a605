"""What the templates of a robot's impedance controller need, from the field table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stiffgen.emit.fields import CONFIG, INPUT, MAX_DOF, MODES, OUTPUT, STATUS, Field
from stiffgen.robot.chain import Chain

RUNTIME = Path(__file__).parent.parent / "runtime"
"""C of the controller that is the same for every robot but for the prefix of its names."""
PUBLIC_PARTS = ("stiffgen_error.h", "stiffgen_impedance.h")
"""Files of it that become part of NAME_impedance.h."""
PRIVATE_PARTS = ("stiffgen_damping.h", "stiffgen_error.c", "stiffgen_damping.c", "stiffgen_impedance_step.h")
"""Files of it that become part of NAME_impedance.c; static but for the text of an error."""
_FORMATS = {"double": "f8", "int": "i4", "uint32_t": "u4"}
_STRUCTS = (
    (
        "config",
        "How the controller behaves; start from the defaults. Fields without a choice's name are numbers.",
        CONFIG,
    ),
    ("input", "One sample. A struct of zeros is a missed sample.", INPUT),
    ("output", "What a step did, complete enough to draw a log from it.", OUTPUT),
)


def spliced(text: str, name: str) -> str:
    """C of the runtime as it stands in a robot's files: ``stiffgen_`` and ``STIFFGEN_`` become the robot's prefix."""
    return re.sub(r"\bSTIFFGEN_", f"{name.upper()}_", re.sub(r"\bstiffgen_", f"{name}_", text))


def runtime_source(parts: Sequence[str], name: str) -> str:
    """Files of the runtime, one after the other, with a robot's prefix."""
    texts = ((RUNTIME / part).read_text(encoding="utf-8") for part in parts)
    return spliced("\n".join(texts), name).rstrip("\n")


def has_controller(chain: Chain) -> bool:
    """Whether the controller can be made for a robot: one wrench at one tip, masses, and few enough coordinates."""
    return len(chain.tips) == 1 and not chain.runtime_tool and chain.masses and chain.dof <= MAX_DOF


def controller_files(name: str, chain: Chain) -> dict[str, str]:
    """Template by file name; empty without a controller."""
    if not has_controller(chain):
        return {}
    return {
        f"{name}_impedance.h": "impedance.h.j2",
        f"{name}_impedance.c": "impedance.c.j2",
        "impedance.py": "impedance.py.j2",
        "impedance.pyi": "impedance.pyi.j2",
    }


def controller_context(name: str, chain: Chain) -> dict[str, Any] | None:
    """The variable ``controller`` of the templates; None without a controller."""
    if not has_controller(chain):
        return None
    sizes = {"n": chain.dof}
    return {
        "public": runtime_source(PUBLIC_PARTS, name),
        "private": runtime_source(PRIVATE_PARTS, name),
        "status": STATUS,
        "modes": MODES,
        "structs": [
            {"name": struct, "summary": summary, "fields": [_field(field, sizes, name) for field in fields]}
            for struct, summary, fields in _STRUCTS
        ],
        "choices": [(f.name, choice, spliced(f.constant(choice), name)) for f in CONFIG for choice in f.choices],
        "defaults": [spliced(f"config->{f.name} = {f.default};", name) for f in CONFIG if not f.shape],
        "joint_defaults": [
            f"config->{f.name}[i] = {f.default.format(name=name)};" for f in CONFIG if f.shape == ("n",)
        ],
    }


def _field(field: Field, sizes: dict[str, int], name: str) -> dict[str, Any]:
    extents = [sizes[extent] if isinstance(extent, str) else extent for extent in field.shape]
    size = 1
    for extent in extents:
        size *= extent
    default = f" Default: {field.default.replace('{name}_', '')}." if field.default else ""
    shape = f" ({' x '.join(map(str, extents))})" if len(extents) > 1 else ""
    unit = f"[{field.unit}]{shape} " if field.unit else ""
    return {
        "name": field.name,
        "declaration": f"{field.type} {field.name}" + (f"[{size}]" if extents else ""),
        "comment": _comment(spliced(f"{unit}{field.meaning}.{default}", name)),
        "format": _FORMATS[field.type],
        "extents": extents,
    }


def _comment(text: str, width: int = 108) -> list[str]:
    lines = ["/*"]
    for word in text.split():
        if len(lines[-1]) + 1 + len(word) > width:
            lines.append(" *")
        lines[-1] += f" {word}"
    lines[-1] += " */"
    return lines
