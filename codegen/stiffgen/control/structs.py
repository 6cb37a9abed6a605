# SPDX-License-Identifier: MIT
"""Structs of the controller and its companions as the templates print them, made from tables of fields."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from stiffgen.control.core.field import Field
from stiffgen.core.robot.chain import Chain

_FORMATS = {"double": "f8", "int": "i4", "int32_t": "i4", "uint32_t": "u4"}

_OF_ONE_TIP = {
    "tips": "",
    "springs": "; in the order tips, pairs (axes of A), absolute springs of the pairs",
    "twists": "; in the order tips, pairs (of B against A, axes of A, moment about the origin of B)",
}
"""Extents that are left out where they are 1, and the order of the entries in robots with pairs."""


@dataclass(frozen=True)
class Member:
    """Member of a C struct: declaration, comment, NumPy format, shape, whether unbounded, and a section's heading."""

    name: str
    declaration: str
    comment: list[str]
    format: str
    extents: list[int]
    unbounded: bool
    unit: str
    heading: str = ""


@dataclass(frozen=True)
class Struct:
    """C struct NAME_impedance_<name>, or NAME_<name> of a companion."""

    name: str
    summary: str
    fields: list[Member]


def present(fields: Sequence[Field], chain: Chain, *, bounded: bool = False) -> tuple[Field, ...]:
    """Return the fields that a robot has, by their conditions; ``bounded`` tells whether its springs are bounded."""
    several = len(chain.tips) > 1
    holds = {"": True, "tool": chain.runtime_tool, "loops": bool(chain.loops), "several": several, "bounded": bounded}
    return tuple(field for field in fields if holds[field.when])


def struct_of(
    chain: Chain,
    prefix: str,
    name: str,
    summary: str,
    fields: Sequence[Field],
    headings: Mapping[str, str] | None = None,
    *,
    pairs: int = 0,
) -> Struct:
    """Return the C struct of a chain with some fields; ``headings`` stand above fields, by name."""
    sizes = sizes_of(chain, pairs)
    members = [
        replace(_member(field, sizes, prefix, name), heading=(headings or {}).get(field.name, ""))
        for field in present(fields, chain, bounded=True)  # of a configuration the caller left out the others
    ]
    return Struct(name, summary, members)


def sizes_of(chain: Chain, pairs: int) -> dict[str, int]:
    """Return the extents with a name of a chain with some pairs of tips."""
    n, tips = len(chain.motor_coordinates), len(chain.tips)
    both = {"springs": tips + 2 * pairs, "twists": tips + pairs}
    return {"n": n, "tips": tips, "joints": chain.dof, "short": min(n, 6 * tips), **both}


def _extents(field: Field, sizes: dict[str, int]) -> tuple[list[int], str]:
    """Return the extents of a member, and the order of its first axis in words where there are pairs.

    An axis over tips, springs or twists is left out where it has one entry.
    """
    extents = [sizes[extent] if isinstance(extent, str) else extent for extent in field.shape]
    axis = str(field.shape[0]) if field.shape else ""
    if axis not in _OF_ONE_TIP:
        return extents, ""
    has_pairs = extents[0] > sizes["tips"]
    order = _OF_ONE_TIP[axis] if has_pairs else ""
    return (extents[1:] if extents[0] == 1 else extents), order


def _member(field: Field, sizes: dict[str, int], prefix: str, struct: str) -> Member:
    """Return the member of a C struct; ``sizes`` are the extents with a name, and one tip has no extent.

    The comment has unit, shape, meaning, the rule of a setting or choice, and the default.
    """
    extents, order = _extents(field, sizes)
    default = field.default.replace("{name}_", "").replace("{i}", "i").replace("HUGE_VAL", "infinity")
    stated = field.choices or struct.endswith("config")
    bound = f" {field.rule[0].upper()}{field.rule[1:]}." if stated else ""
    if struct == "config":
        bound += f" Default: {default}; {field.reason}." if default else f" MUST BE STATED: {field.reason}."
    elif default:
        bound += f" Default: {default}."
    shape = f" ({' x '.join(map(str, extents))})" if len(extents) > 1 else ""
    unit = f"[{field.unit}]{shape} " if field.unit else ""
    return Member(
        name=field.name,
        declaration=f"{field.type} {field.name}" + (f"[{math.prod(extents)}]" if extents else ""),
        comment=_comment(f"{unit}{field.meaning.replace('NAME_', prefix + '_')}{order}.{bound}"),
        format=_FORMATS[field.type],
        extents=extents,
        unbounded=math.isinf(field.most),
        unit=field.unit,
    )


def _comment(text: str, width: int = 108) -> list[str]:
    """Return a C comment in lines of at most ``width`` characters."""
    lines = ["/*"]
    for word in text.split():
        if len(lines[-1]) + 1 + len(word) > width:
            lines.append(" *")
        lines[-1] += f" {word}"
    lines[-1] += " */"
    return lines


def defaults(field: Field, prefix: str) -> list[str]:
    """Return the C statements that set a number or a short array; nothing for an array over joints or of poses.

    A field without a default has a value that its check refuses.
    """
    if field.shape == ("n",):  # joint_defaults() sets these
        return []
    if not field.default:
        unstated = "(double)NAN" if field.type == "double" else "-1"
        places = [f"[{k}]" for k in range(int(field.shape[0]))] if field.shape else [""]
        return [f"config->{field.name}{place} = {unstated};" for place in places]
    if field.choices:
        return [f"config->{field.name} = {prefix}_{field.name.upper()}_{field.default.upper()};"]
    if not field.shape:
        return [f"config->{field.name} = {field.default};"]
    entries = field.default.split(", ") if len(field.shape) == 1 else []  # the template sets poses
    return [f"config->{field.name}[{k}] = {entry};" for k, entry in enumerate(entries)]


def joint_defaults(fields: Sequence[Field], name: str, index: str = "i") -> list[str]:
    """Return the statements that set defaults of joint ``index``."""
    each = (f for f in fields if f.shape == ("n",))
    return [f"config->{f.name}[i] = {f.default.format(name=name, i=index) or '(double)NAN'};" for f in each]


def check_of(field: Field) -> str:
    """Return the C condition on a field of the configuration c."""
    if field.type == "int":
        bounds, kind = f"{field.least:.0f}, {field.most:.0f}", "integers"
    else:
        least, most = (bound_text(bound) for bound in (field.least, field.most))
        bounds, kind = f"{least}, {most}", "doubles"
    each = f"c->{field.name}" if field.shape else f"&c->{field.name}"
    count = f"sizeof c->{field.name} / sizeof c->{field.name}[0]" if field.shape else "1"
    return f"{kind}_within({each}, {count}, {bounds})"


def bound_text(bound: float) -> str:
    """Return a bound as a C expression."""
    if math.isinf(bound):
        return "HUGE_VAL" if bound > 0 else "-HUGE_VAL"
    return repr(float(bound))
