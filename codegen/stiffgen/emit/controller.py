# SPDX-License-Identifier: MIT
"""What the templates of a robot's impedance controller need, from the field table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

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
from stiffgen.lower.scalar import DOUBLE, Scalar
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


def has_controller(chain: Chain, scalar: Scalar = DOUBLE) -> bool:
    """Whether a robot can have the controller: masses, a base that stands, few enough coordinates, and doubles."""
    return scalar == DOUBLE and chain.masses and not chain.floating and chain.dof <= MAX_DOF


def controller_files(name: str, chain: Chain, scalar: Scalar) -> dict[str, str]:
    """Template by file name; empty without a controller."""
    if not has_controller(chain, scalar):
        return {}
    return {
        f"{name}_impedance.h": "impedance.h.j2",
        f"{name}_impedance.c": "impedance.c.j2",
        "impedance.py": "impedance.py.j2",
        "impedance.pyi": "impedance.pyi.j2",
    }


@dataclass(frozen=True)
class Rule:
    """The check of a configuration field: C bounds, whether it is an int, and the error's code."""

    name: str
    integer: bool
    least: str
    most: str
    code: int


@dataclass(frozen=True)
class Member:
    """A field in its C struct: declaration, comment in lines, NumPy's format of an entry, and the shape."""

    name: str
    declaration: str
    comment: list[str]
    format: str
    extents: list[int]


@dataclass(frozen=True)
class Struct:
    """A C struct, NAME_impedance_<name>."""

    name: str
    summary: str
    fields: list[Member]


@dataclass(frozen=True)
class ControllerPage:
    """The variable ``controller`` of the templates.

    Attributes:
        runtime: the C of all controllers.
        tool: whether the tool's pose is given at run time.
        tips: number of tips.
        scopes: prefix of the kernels' names, tip by tip.
        status, modes, faults: name and meaning.
        reasons: name, fault and meaning.
        reason_classes: the number of each reason's fault.
        errors: name, code and text.
        rules: of the configuration's fields.
        structs: config, input and output.
        remembered: of the output, what is a member of the state's memory: name, that member's, whether it is an array.
        choice_fields: name and words of the fields that are choices.
        defaults, joint_defaults: C statements that set the configuration's fields, and entry i of those over joints.

    """

    runtime: str
    tool: bool
    tips: int
    scopes: list[str]
    status: tuple[tuple[str, str], ...]
    modes: tuple[tuple[str, str], ...]
    faults: tuple[tuple[str, str], ...]
    reasons: tuple[tuple[str, str, str], ...]
    reason_classes: list[int]
    errors: list[tuple[str, int, str]]
    rules: list[Rule]
    structs: list[Struct]
    remembered: list[tuple[str, str, bool]]
    choice_fields: list[tuple[str, tuple[str, ...]]]
    defaults: list[str]
    joint_defaults: list[str]


def controller_page(name: str, chain: Chain, scalar: Scalar) -> ControllerPage | None:
    """What the templates are to know of a robot's controller; None without one."""
    if not has_controller(chain, scalar):
        return None
    prefix = name.upper()
    return ControllerPage(
        runtime="\n".join((RUNTIME / part).read_text(encoding="utf-8") for part in PARTS),
        tool=chain.runtime_tool,
        tips=len(chain.tips),
        scopes=[f"{tip.name}_" if tip.name else "" for tip in chain.tips],
        status=STATUS,
        modes=MODES,
        faults=FAULTS,
        reasons=REASONS,
        reason_classes=[[fault for fault, _ in FAULTS].index(fault) for _, fault, _ in REASONS],
        errors=_errors(name),
        rules=[_rule(index, field) for index, field in enumerate(CONFIG)],
        structs=[_struct(chain, prefix, *each) for each in _STRUCTS],
        remembered=[(f.name, f.name if f.memory == "=" else f.memory, bool(f.shape)) for f in OUTPUT if f.memory],
        choice_fields=[(f.name, f.choices) for f in (*CONFIG, *INPUT) if f.choices],
        defaults=[f"config->{f.name} = {_default(f, prefix)};" for f in CONFIG if not f.shape],
        joint_defaults=[f"config->{f.name}[i] = {f.default.format(name=name)};" for f in CONFIG if f.shape == ("n",)],
    )


def _struct(chain: Chain, prefix: str, name: str, summary: str, fields: tuple[Field, ...]) -> Struct:
    sizes = {"n": chain.dof, "tips": len(chain.tips)}
    members = [_member(field, sizes, prefix) for field in fields if field.when != "tool" or chain.runtime_tool]
    return Struct(name, summary, members)


def _default(field: Field, prefix: str) -> str:
    return f"{prefix}_{field.name.upper()}_{field.default.upper()}" if field.choices else field.default


def _errors(name: str) -> list[tuple[str, int, str]]:
    """(name, code, text) of every error."""
    own = [(error, -1 - k, text.replace("NAME", name)) for k, (error, text) in enumerate(ERRORS)]
    return own + [
        (f"config_{field.name}", _FIRST_FIELD_ERROR - k, f"{field.name}: {field.rule}")
        for k, field in enumerate(CONFIG)
    ]


def _rule(index: int, field: Field) -> Rule:
    return Rule(
        name=field.name,
        integer=field.type == "int",
        least="-INFINITY" if math.isinf(field.least) else repr(float(field.least)),
        most="INFINITY" if math.isinf(field.most) else repr(float(field.most)),
        code=_FIRST_FIELD_ERROR - index,
    )


def _member(field: Field, sizes: dict[str, int], prefix: str) -> Member:
    extents = [sizes[extent] if isinstance(extent, str) else extent for extent in field.shape]
    if field.shape[:1] == ("tips",) and sizes["tips"] == 1:
        extents = extents[1:]
    default = f" Default: {field.default.replace('{name}_', '')}." if field.default else ""
    bound = f" {field.rule[0].upper()}{field.rule[1:]}." if field in CONFIG or field.choices else ""
    shape = f" ({' x '.join(map(str, extents))})" if len(extents) > 1 else ""
    unit = f"[{field.unit}]{shape} " if field.unit else ""
    return Member(
        name=field.name,
        declaration=f"{field.type} {field.name}" + (f"[{math.prod(extents)}]" if extents else ""),
        comment=_comment(f"{unit}{field.meaning.replace('NAME_', prefix + '_')}.{bound}{default}"),
        format=_FORMATS[field.type],
        extents=extents,
    )


def _comment(text: str, width: int = 108) -> list[str]:
    lines = ["/*"]
    for word in text.split():
        if len(lines[-1]) + 1 + len(word) > width:
            lines.append(" *")
        lines[-1] += f" {word}"
    lines[-1] += " */"
    return lines
