"""What the templates of a robot's impedance controller need, from the field table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from stiffgen.emit.fields import (
    CONFIG,
    ERRORS,
    FAULTS,
    INPUT,
    MAX_DOF,
    MODES,
    OUTPUT,
    REASONS,
    STATUS,
    Field,
)
from stiffgen.robot.chain import Chain

RUNTIME = Path(__file__).parent.parent / "runtime"
"""C that every robot's NAME_impedance.c holds, static."""
PARTS = ("matrix.c", "controller.c")
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
_FIRST_FIELD_ERROR = -20


def has_controller(chain: Chain) -> bool:
    """Whether a robot can have the controller: it needs masses, a base that stands, and few enough coordinates."""
    return chain.masses and not chain.floating and chain.dof <= MAX_DOF


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
    prefix = name.upper()
    tips = len(chain.tips)
    sizes = {"n": chain.dof, "tips": tips}
    scopes = [f"{tip.name}_" if tip.name else "" for tip in chain.tips]
    return {
        "runtime": "\n".join((RUNTIME / part).read_text(encoding="utf-8") for part in PARTS),
        "tool": chain.runtime_tool,
        "tips": tips,
        "scopes": scopes,
        "status": STATUS,
        "modes": MODES,
        "faults": FAULTS,
        "reasons": REASONS,
        "reason_classes": [[fault for fault, _ in FAULTS].index(fault) for _, fault, _ in REASONS],
        "errors": _errors(name),
        "rules": [_rule(index, field) for index, field in enumerate(CONFIG)],
        "structs": [
            {
                "name": struct,
                "summary": summary,
                "fields": [
                    _field(field, sizes, prefix) for field in fields if field.when != "tool" or chain.runtime_tool
                ],
            }
            for struct, summary, fields in _STRUCTS
        ],
        "choice_fields": [(f.name, f.choices) for f in (*CONFIG, *INPUT) if f.choices],
        "defaults": [f"config->{f.name} = {_default(f, prefix)};" for f in CONFIG if not f.shape],
        "joint_defaults": [
            f"config->{f.name}[i] = {f.default.format(name=name)};" for f in CONFIG if f.shape == ("n",)
        ],
    }


def _default(field: Field, prefix: str) -> str:
    return f"{prefix}_{field.name.upper()}_{field.default.upper()}" if field.choices else field.default


def _errors(name: str) -> list[tuple[str, int, str]]:
    """(name, code, text) of every error."""
    own = [(error, -1 - k, text.replace("NAME", name)) for k, (error, text) in enumerate(ERRORS)]
    return own + [
        (f"config_{field.name}", _FIRST_FIELD_ERROR - k, f"{field.name}: {field.rule}")
        for k, field in enumerate(CONFIG)
    ]


def _rule(index: int, field: Field) -> dict[str, Any]:
    return {
        "name": field.name,
        "integer": field.type == "int",
        "least": "-INFINITY" if math.isinf(field.least) else repr(float(field.least)),
        "most": "INFINITY" if math.isinf(field.most) else repr(float(field.most)),
        "code": _FIRST_FIELD_ERROR - index,
    }


def _field(field: Field, sizes: dict[str, int], prefix: str) -> dict[str, Any]:
    extents = [sizes[extent] if isinstance(extent, str) else extent for extent in field.shape]
    if field.shape[:1] == ("tips",) and sizes["tips"] == 1:
        extents = extents[1:]
    default = f" Default: {field.default.replace('{name}_', '')}." if field.default else ""
    bound = f" {field.rule[0].upper()}{field.rule[1:]}." if field in CONFIG or field.choices else ""
    shape = f" ({' x '.join(map(str, extents))})" if len(extents) > 1 else ""
    unit = f"[{field.unit}]{shape} " if field.unit else ""
    return {
        "name": field.name,
        "declaration": f"{field.type} {field.name}" + (f"[{math.prod(extents)}]" if extents else ""),
        "comment": _comment(f"{unit}{field.meaning.replace('NAME_', prefix + '_')}.{bound}{default}"),
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
