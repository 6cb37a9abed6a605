# SPDX-License-Identifier: MIT
"""Names of the URDF format, and the search for misspelt names.

Other readers of URDF ignore unknown names: a misspelt ``<orgin>`` leaves a joint at its parent without a message. This
module compares the names in joints, links and all elements that stiffgen reads with the format:

* Names of simulators and tools, and names with a prefix (``drake:acceleration``), are accepted.
* An unknown element of a joint or link that resembles no known name belongs to a vendor: accepted, with a note.
* All other unknown names are faults, unless the user ignores them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from lxml import etree

from stiffgen.errors import printable


@dataclass(frozen=True)
class ElementFormat:
    """Names within an element: names of the format, and names that simulators and tools have added."""

    elements: tuple[str, ...] = ()
    attributes: tuple[str, ...] = ()
    added_elements: tuple[str, ...] = ()
    added_attributes: tuple[str, ...] = ()


_POSE = ElementFormat(attributes=("xyz", "rpy"))
FORMAT = {
    "joint": ElementFormat(
        ("origin", "parent", "child", "axis", "calibration", "dynamics", "limit", "mimic", "safety_controller"),
        ("name", "type"),
        ("gazebo", "hardwareInterface", "joint_properties", "material", "sensor", "transmission"),
        ("dont_collapse",),
    ),
    "link": ElementFormat(
        ("inertial", "visual", "collision"),
        ("name", "type"),
        (
            *("audio_source", "collision_checking", "contact", "dynamics", "gazebo", "gravity", "kinematic"),
            *("material", "origin", "self_collision_checking", "self_filter", "sensor", "surface"),
        ),
        ("concave",),
    ),
    "inertial": ElementFormat(("origin", "mass", "inertia")),
    "origin": _POSE,
    "axis": ElementFormat(attributes=("xyz",), added_attributes=("rpy",)),
    "parent": ElementFormat(attributes=("link",)),
    "child": ElementFormat(attributes=("link",)),
    "limit": ElementFormat(
        attributes=("lower", "upper", "effort", "velocity"),
        added_attributes=(
            "acceleration",
            "command_effort",
            "current",
            "deceleration",
            "gear_velocity",
            "jerk",
            "twist",
        ),
    ),
    "mimic": ElementFormat(attributes=("joint", "multiplier", "offset")),
    "mass": ElementFormat(attributes=("value",)),
    "inertia": ElementFormat(
        attributes=("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), added_attributes=("iyx", "izx", "izy")
    ),
}

_IN_A_ROBOT = ("link", "joint")
_WITH_VENDOR_ELEMENTS = ("joint", "link")
_MAX_EDITS = 3


@dataclass(frozen=True)
class ElementFault:
    """Fault of an element's content; ``text`` is a sentence without a full stop.

    ``concerns`` is the element of the format that is misspelt or, with ``repeats``, occurs twice; it may be empty. A
    ``note`` reports an element of a vendor, which has no effect.
    """

    text: str
    concerns: str = ""
    repeats: bool = False
    note: bool = False


def faults(element: etree._Element, ignored: Collection[str] = ()) -> Iterator[ElementFault]:
    """Yield misspelt names in an element of ``FORMAT``, and children that occur twice with different content."""
    tag = str(element.tag)
    known = FORMAT[tag]
    siblings: dict[str, etree._Element] = {}
    for child in element:
        name = str(child.tag)
        if _prefixed(name) or name in known.added_elements or name in ignored:
            continue
        if name not in known.elements:
            yield _unknown(tag, name, known.elements)
        elif name in FORMAT and _content(child) != _content(siblings.setdefault(name, child)):
            yield ElementFault(
                f"<{name}> occurs twice in it, with different content; remove the wrong one", name, repeats=True
            )
    for name in map(str, element.attrib):
        if not _prefixed(name) and name not in known.attributes + known.added_attributes:
            meant = _meant(name, known.attributes)
            remedy = f"did you mean '{meant}'?" if meant else _remedy([f"'{each}'" for each in known.attributes])
            yield ElementFault(f"<{tag}> has no attribute '{printable(name)}'; {remedy}")


def _unknown(tag: str, name: str, elements: Sequence[str]) -> ElementFault:
    """Return the fault, or the note, of an unknown element."""
    meant = _meant(name, elements)
    says = f"<{printable(name)}> is no element of <{tag}>"
    if meant:
        return ElementFault(f"{says}; did you mean <{meant}>? (if not: --ignore {printable(name)})", meant)
    if tag in _WITH_VENDOR_ELEMENTS:
        return ElementFault(f"{says} that stiffgen knows; it is ignored", note=True)
    return ElementFault(f"{says}; {_remedy([f'<{each}>' for each in elements])}, or --ignore {printable(name)}")


def misspelt_in_robot(robot: etree._Element, ignored: Collection[str] = ()) -> Iterator[str]:
    """Yield faults for unknown elements of <robot> whose names resemble link or joint."""
    for name in dict.fromkeys(str(child.tag) for child in robot):
        meant = "" if name in _IN_A_ROBOT or _prefixed(name) or name in ignored else _meant(name, _IN_A_ROBOT)
        if meant:
            shown = printable(name)
            yield f"<{shown}> is no element of <robot>; did you mean <{meant}>? (if not: --ignore {shown})"


def _prefixed(name: str) -> bool:
    return ":" in name or "{" in name


def _remedy(valid: Sequence[str]) -> str:
    return f"correct or remove it; valid: {', '.join(valid)}" if valid else "remove it"


def _meant(name: str, valid: Sequence[str]) -> str:
    """Return the valid name that is most similar to a name, or "" if none is similar."""
    distances = {known: _distance(name.lower(), known.lower()) for known in valid if abs(len(name) - len(known)) <= 3}
    nearest = min(distances, key=lambda known: distances[known], default="")
    return nearest if nearest and distances[nearest] <= min(_MAX_EDITS, (len(nearest) + 1) // 2) else ""


def _distance(a: str, b: str) -> int:
    """Return the number of insertions, deletions, replacements and swaps of neighbours that turn a into b."""
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, letter in enumerate(a, start=1):
        before, last, row = row, before, [i]
        for j, other in enumerate(b, start=1):
            best = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == b[j - 2] and a[i - 2] == other:
                best = min(best, last[j - 2] + 1)
            row.append(best)
    return row[-1]


def _content(element: etree._Element) -> list[tuple[str, dict[str, str]]]:
    return [
        (str(each.tag), {str(k): " ".join(str(v).split()) for k, v in each.attrib.items()}) for each in element.iter()
    ]
