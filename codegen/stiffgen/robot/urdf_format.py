# SPDX-License-Identifier: MIT
"""Which elements and attributes a URDF has, and which name was meant by one that it has not.

Readers of URDF ignore what they do not know, so that a misspelt ``<orgin>`` leaves a joint at its parent, without a
word. Here the elements that stiffgen reads, and what stands directly in a joint or link, are held to the format. What
simulators and tools have added to it, found in the robots of docs/robots.md and beyond, passes, and so does everything
with a prefix (``drake:acceleration``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher

from lxml import etree

from stiffgen.errors import printable


@dataclass(frozen=True)
class ElementFormat:
    """Names that an element may hold: those of the format, and those that others have added."""

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


@dataclass(frozen=True)
class Fault:
    """``text`` is a sentence without a full stop; ``repeated`` names what stands twice, if it is that."""

    text: str
    repeated: str = ""


def faults(element: etree._Element) -> Iterator[Fault]:
    """What is misspelt in an element of ``FORMAT``, or stands twice in it though one alone is read."""
    tag = str(element.tag)
    known = FORMAT[tag]
    seen: dict[str, etree._Element] = {}
    for child in element:
        name = str(child.tag)
        if _prefixed(name) or name in known.added_elements:
            continue
        if name not in known.elements:
            meant = _meant(name, [f"<{each}>" for each in known.elements])
            yield Fault(f"<{printable(name)}> is no element of <{tag}>; {meant}")
        elif name in FORMAT and _says(child) != _says(seen.setdefault(name, child)):
            yield Fault(f"<{name}> stands twice in it, and not the same; keep the one that is meant", name)
    for name in map(str, element.attrib):
        if not _prefixed(name) and name not in known.attributes + known.added_attributes:
            meant = _meant(name, [f"'{each}'" for each in known.attributes])
            yield Fault(f"<{tag}> has no attribute '{printable(name)}'; {meant}")


def misspelt_in_robot(robot: etree._Element) -> Iterator[str]:
    """Elements of the robot itself that look like a link or joint and are none."""
    for name in dict.fromkeys(str(child.tag) for child in robot):
        nearest = max(_IN_A_ROBOT, key=lambda known: _likeness(name, known))
        if name not in _IN_A_ROBOT and not _prefixed(name) and _likeness(name, nearest) > 0.7:
            yield f"<{printable(name)}> is no element of <robot>; did you mean <{nearest}>?"


def _prefixed(name: str) -> bool:
    return ":" in name or "{" in name


def _meant(name: str, valid: list[str]) -> str:
    if not valid:
        return "remove it"
    nearest = max(valid, key=lambda known: _likeness(name, known.strip("<>'")))
    if _likeness(name, nearest.strip("<>'")) > 0.5:
        return f"did you mean {nearest}?"
    return f"correct or remove it; valid: {', '.join(valid)}"


def _likeness(name: str, known: str) -> float:
    """1 for the same letters, 0 for none in common; letters that have changed places count as half."""
    if len(name) > 2 * len(known):
        return 0.0
    lower = name.lower()
    shared = 2 * sum(min(lower.count(c), known.count(c)) for c in set(known)) / (len(lower) + len(known))
    return (shared + SequenceMatcher(None, lower, known).ratio()) / 2 if shared > 0.5 else shared / 2


def _says(element: etree._Element) -> list[tuple[str, dict[str, str]]]:
    return [
        (str(each.tag), {str(k): " ".join(str(v).split()) for k, v in each.attrib.items()}) for each in element.iter()
    ]
