# SPDX-License-Identifier: MIT
"""Names of the URDF format, and the search for misspelt names.

Other readers of URDF ignore unknown names: a misspelt ``<orgin>`` leaves a joint at its parent without a message. This
module compares the names in joints, links and all elements that stiffgen reads with the format of the file's version
(``<robot version="1.1">``; without it 1.0):

* Names of simulators and tools, and names with a prefix (``drake:acceleration``), are accepted.
* An unknown attribute that resembles no known name, and any unknown element of a joint or link that does not, belongs
  to a vendor: accepted, with a note. Unknown numbers that may be a pose, an axis, the relation of a mimic joint or a
  missing bound are no vendor's: the robot would be another one without them.
* All other unknown names are faults, unless the user ignores them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from lxml import etree

from stiffgen.core.errors import printable, shell_word

Version = tuple[int, int]
OLDEST: Version = (1, 0)
WITH_QUATERNIONS: Version = (1, 1)
WITH_ACCELERATIONS: Version = (1, 2)
"""Version with limits of acceleration, deceleration and jerk; its position limits have no default."""
NEWEST = WITH_ACCELERATIONS


def version_of(robot: etree._Element) -> tuple[Version, str]:
    """Return the version of a file, and a note or a fault of its text ("" if there is none).

    A text that is not of the form "1.1" is read as 1.0, as writers before version 1.1 meant it.
    """
    text = robot.get("version", "").strip()
    match = re.fullmatch(r"([0-9]{1,3})\.([0-9]{1,3})", text)
    if match is None:
        note = f'<robot version="{printable(text)}"> is no version of the format, like 1.0; read as 1.0' if text else ""
        return OLDEST, note
    version = int(match[1]), int(match[2])
    if version < OLDEST:
        return OLDEST, f'<robot version="{text}"> is older than the format; read as 1.0'
    newest = ".".join(map(str, NEWEST))
    return (
        version,
        f'<robot version="{text}"> is newer than {newest}, which stiffgen reads; save it as URDF {newest}'
        if version > NEWEST
        else "",
    )


@dataclass(frozen=True)
class ElementFormat:
    """Names within an element: names of the format, and names that simulators and tools have added.

    ``newer`` has the attributes of later versions, each with the first version that has it.
    """

    elements: tuple[str, ...] = ()
    attributes: tuple[str, ...] = ()
    added_elements: tuple[str, ...] = ()
    added_attributes: tuple[str, ...] = ()
    newer: Mapping[str, Version] = field(default_factory=dict)

    def has_attribute(self, name: str, version: Version) -> bool:
        """Return whether a version of the format, or a tool, knows an attribute."""
        known = name in self.attributes or name in self.added_attributes
        return known or (name in self.newer and version >= self.newer[name])


_POSE = ElementFormat(attributes=("xyz", "rpy"), newer={"quat_xyzw": WITH_QUATERNIONS})
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
_PLACES = ("origin", "axis")
_BOUNDED = ("revolute", "prismatic")
_NUMBERS = re.compile(r"[-+.,;eE0-9\s]*[0-9][-+.,;eE0-9\s]*")
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


def faults(element: etree._Element, ignored: Collection[str] = (), version: Version = OLDEST) -> Iterator[ElementFault]:
    """Yield misspelt names in an element of ``FORMAT``, and children that occur twice with different content."""
    tag = str(element.tag)
    known = FORMAT[tag]
    siblings: dict[str, etree._Element] = {}
    for child in element:
        name = str(child.tag)
        if _prefixed(name) or name in known.added_elements or name in ignored:
            continue
        if name not in known.elements:
            yield _unknown(element, child, known.elements)
        elif name in FORMAT and _content(child) != _content(siblings.setdefault(name, child)):
            yield ElementFault(
                f"<{name}> occurs twice in it, with different content; remove the wrong one", name, repeats=True
            )
    for name in map(str, element.attrib):
        if not _prefixed(name) and name not in ignored and not known.has_attribute(name, version):
            yield _unknown_attribute(element, name, known)


def _unknown_attribute(element: etree._Element, name: str, known: ElementFormat) -> ElementFault:
    """Return the fault of an attribute that is misspelt or of a later version, or the note of a vendor's own."""
    tag, shown = str(element.tag), printable(name)
    says = f"<{tag}> has no attribute '{shown}'"
    valid = ", ".join(f"'{each}'" for each in known.attributes)
    if name in known.newer:
        needed = ".".join(map(str, known.newer[name]))
        return ElementFault(
            f'{says} before URDF {needed}; state <robot version="{needed}">, or correct it (valid: {valid})'
        )
    meant = _meant(name, (*known.attributes, *known.newer))
    if meant:
        order = ", with its numbers in this order" if tag in _PLACES and sorted(meant) == sorted(name) else ""
        return ElementFault(f"{says}; did you mean '{meant}'{order}? (if not: --ignore {shell_word(name)})")
    if _decides_the_robot(element) and _NUMBERS.fullmatch(element.get(name, "")):
        return ElementFault(f"{says}; correct it (valid: {valid}), or --ignore {shell_word(name)}")
    return ElementFault(f"{says} that stiffgen knows; it is ignored", note=True)


def _decides_the_robot(element: etree._Element) -> bool:
    """Return whether unknown numbers of an element may be those that place or bound a joint."""
    tag, joint = str(element.tag), element.getparent()
    if tag == "limit" and joint is not None and joint.get("type") in _BOUNDED:
        return element.get("lower") is None or element.get("upper") is None
    return tag in (*_PLACES, "mimic")


def _unknown(element: etree._Element, child: etree._Element, elements: Sequence[str]) -> ElementFault:
    """Return the fault, or the note, of an unknown element."""
    tag, name = str(element.tag), str(child.tag)
    meant = _meant(name, elements)
    says = f"<{printable(name)}> is no element of <{tag}>"
    if meant:
        return ElementFault(f"{says}; did you mean <{meant}>? (if not: --ignore {shell_word(name)})", meant)
    if tag in _WITH_VENDOR_ELEMENTS and not _may_be_the_origin(element, child):
        return ElementFault(f"{says} that stiffgen knows; it is ignored", note=True)
    return ElementFault(f"{says}; {_remedy([f'<{each}>' for each in elements])}, or --ignore {shell_word(name)}")


def _may_be_the_origin(element: etree._Element, child: etree._Element) -> bool:
    """Return whether an unknown element of a joint without origin has numbers of a pose, such as <pose> of SDF."""
    text = child.text or ""
    numbers = text.split() if _NUMBERS.fullmatch(text) else []
    has_pose = len(numbers) in (3, 6, 7) or any(each in child.attrib for each in _POSE.attributes)
    return element.tag == "joint" and element.find("origin") is None and has_pose


def misspelt_in_robot(robot: etree._Element, ignored: Collection[str] = ()) -> Iterator[str]:
    """Yield faults for unknown elements of <robot> whose names resemble link or joint."""
    for name in dict.fromkeys(str(child.tag) for child in robot):
        meant = "" if name in _IN_A_ROBOT or _prefixed(name) or name in ignored else _meant(name, _IN_A_ROBOT)
        if meant:
            says = f"<{printable(name)}> is no element of <robot>"
            yield f"{says}; did you mean <{meant}>? (if not: --ignore {shell_word(name)})"


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
    above: list[int] = []
    row = list(range(len(b) + 1))  # row i of the table, entry j: the distance of the first i letters of a and j of b
    for i, letter in enumerate(a, start=1):
        above, two_above, row = row, above, [i]
        for j, other in enumerate(b, start=1):
            best = min(above[j] + 1, row[j - 1] + 1, above[j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == b[j - 2] and a[i - 2] == other:  # swapped
                best = min(best, two_above[j - 2] + 1)
            row.append(best)
    return row[-1]


def _content(element: etree._Element) -> list[tuple[str, dict[str, str]]]:
    """Return tags and attributes of an element and all below it, without superfluous blanks."""
    return [
        (str(each.tag), {str(k): " ".join(str(v).split()) for k, v in each.attrib.items()}) for each in element.iter()
    ]
