# SPDX-License-Identifier: MIT
"""Checks of a URDF file, before the reader makes a description.

Every problem names the element, the fault and the remedy. The reader takes the numbers that pass the checks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import islice

from lxml import etree

from stiffgen.core.errors import counted, listed, printable, shell_word, whole
from stiffgen.core.robot import urdf_format
from stiffgen.core.robot.description import (
    ALL_LINKS,
    JOINT_TYPES,
    LARGEST,
    MOVING_TYPES,
    Affects,
    Problem,
    Reading,
    stated,
)
from stiffgen.core.robot.extras import left_out, rotor_inertias
from stiffgen.core.robot.geometry import physical_inertia
from stiffgen.core.robot.impossible import fault_of
from stiffgen.rooms import optional

MAX_JOINTS = 5_000
_DEFAULTS = Reading()

_MOST_FAULTS = 10  # largest number of reported faults per element
_REPEATED: dict[str, Affects] = {"axis": "motion", "limit": "bounds", "mimic": "coupling"}
_TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NEWER_LIMITS = ("acceleration", "deceleration", "jerk")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?\Z")
_DECIMAL_COMMA = re.compile(r"([-+]?[0-9]+),([0-9]+(?:[eE][-+]?[0-9]+)?)")
_THOUSANDS = re.compile(r"[-+]?[1-9][0-9]{0,2},[0-9]{3}")
_WORD = re.compile(r"[^ \t\r\n]+")


_BALLS = ("spherical", "ball")


class Checker:
    """Checks of one file; yields the problems and stores elements and numbers for the reader."""

    def __init__(self, robot: etree._Element, reading: Reading = _DEFAULTS) -> None:
        self.robot = robot
        self.reading = reading
        self.ignored: Collection[str] = reading.ignore
        self.version, self._version_fault = urdf_format.version_of(robot)
        self._has_accelerations = self.version >= urdf_format.WITH_ACCELERATIONS
        self.links: dict[str, etree._Element] = {}
        self.joints: dict[str, etree._Element] = {}
        self.parents: dict[str, str] = {}  # child link -> joint
        self.numbers: dict[tuple[etree._Element, str], tuple[float, ...]] = {}
        self.broken_mimics: set[str] = set()
        self.sound_mimics: set[str] = set()
        self.remarks: list[str] = []
        self.accepted: dict[str, str] = {}
        self.rotors: dict[str, float] = {}
        self.unstated: dict[str, list[str]] = {}  # joints whose <limit> has such an attribute

    def run(self) -> Iterator[Problem]:
        """Yield every problem of the file."""
        counts = {tag: len(self.robot.findall(tag)) for tag in ("joint", "link")}
        too_many = [f"{count} {tag}s" for tag, count in counts.items() if count > MAX_JOINTS + (tag == "link")]
        if too_many:
            yield Problem(
                "file",
                f"has {' and '.join(too_many)}, more than the {MAX_JOINTS} joints that stiffgen reads; "
                "cut the description down to one robot",
            )
            return
        if not self.robot.get("name", "").strip():
            yield Problem("file", '<robot> has no name; add name="..."')
        if self._version_fault:
            is_newer = self.version > urdf_format.NEWEST
            yield Problem("file" if is_newer else "robot", self._version_fault, "place" if is_newer else "nothing")
        for fault in islice(urdf_format.misspelt_in_robot(self.robot, self.ignored), _MOST_FAULTS):
            yield Problem("file", fault)
        yield from self._named("link", self.links)
        yield from self._named("joint", self.joints)
        if not self.links:
            yield Problem(
                "file",
                "has no <link>; a robot needs at least two links and a joint between them (an SRDF or a macro "
                "file has none: give the URDF)",
            )
        for name, element in self.joints.items():
            yield from self._joint(name, element)
        for name, element in self.links.items():
            yield from self._link(name, element)
        self._note_remarks()
        for name in self.reading.accept_inertia:
            if name not in (*self.links, ALL_LINKS):
                yield Problem("file", f"--accept-inertia {shell_word(name)}: is no link; {_among(self.links)}")
        yield from self._tree()

    def _note_remarks(self) -> None:
        """Note what the functions leave out, limits that state none, and rotors; store the rotors' inertias."""
        self.remarks += left_out(self.joints, () if self._has_accelerations else _NEWER_LIMITS)
        self.remarks += [
            f"{counted(len(names), 'joint has', 'joints have')} {text} in <limit>, read as no limit: "
            f"{listed(names, 8)}; write the limit of a joint that has one"
            for text, names in self.unstated.items()
        ]
        self.rotors, remarks = rotor_inertias(self.robot, self.joints)
        self.remarks += remarks

    def _named(self, tag: str, into: dict[str, etree._Element]) -> Iterator[Problem]:
        """Collect the elements of a tag by name; yield a problem for each without name, or with one twice."""
        for position, element in enumerate(self.robot.findall(tag), start=1):
            name = element.get("name", "")
            if not name.strip():
                yield Problem("file", f'<{tag}> number {position} has no name; add name="..."')
            elif name in into:
                yield Problem(
                    "file", f"{tag} '{printable(name)}' occurs twice; rename one of the two, or remove a copy"
                )
            else:
                into[name] = element

    def _joint(self, name: str, element: etree._Element) -> Iterator[Problem]:
        """Yield the problems of a joint, and store its child's parent; ``this`` names the element in a Problem."""
        this, title = f"joint {name}", f"joint '{printable(name)}'"
        kind = element.get("type")
        if kind not in JOINT_TYPES:
            fault = "has no type" if kind is None else f"has the unknown type '{printable(kind)}'"
            remedy = "; replace it by three revolute joints at one point" if kind in _BALLS else ""
            types = f"valid types: {', '.join(JOINT_TYPES)}{remedy}"
            yield Problem(this, f"{title} {fault}; {types}", self._of_type(name), is_type=True)
        yield from self._spelling(this, element)
        yield from self._ends(this, title, name, element)
        yield from self._origin(this, element)
        # Joints that do not move have zero axes and empty limits in real files; these elements are not read.
        if kind in MOVING_TYPES:
            for problem in self._axis(this, element):
                yield problem if problem.affects == "nothing" else replace(problem, affects="motion")
            for problem in self._limit(this, element, bounded=kind != "continuous"):
                yield problem if problem.affects == "nothing" else replace(problem, affects="bounds")
            yield from self._mimic(this, name, element)

    def _ends(self, this: str, title: str, name: str, element: etree._Element) -> Iterator[Problem]:
        """Yield the problems of <parent> and <child>, and store the child's parent joint."""
        ends = {}
        for tag in ("parent", "child"):
            end = element.find(tag)
            if len({each.get("link") for each in element.findall(tag)}) > 1:
                yield Problem("file", f"{title} has several <{tag}>; a URDF is a tree: keep one")
            if end is not None:
                yield from self._spelling(this, end)
            link = None if end is None else end.get("link")
            if not link:
                yield Problem("file", f'{title} has no <{tag} link="..."/>; add it')
            elif link not in self.links:
                fault = f"its {tag} link '{printable(link)}' does not exist; {_among(self.links)}"
                yield Problem("file", f"{title}: {fault}")
            else:
                ends[tag] = link
        other = self.parents.setdefault(ends["child"], name) if "child" in ends else name
        if other != name:
            yield Problem(
                "file",
                f"link '{printable(ends['child'])}' is the child of joint '{printable(other)}' and of {title}; "
                "a URDF is a tree: give each link one parent joint",
            )

    def _spelling(self, this: str, element: etree._Element) -> Iterator[Problem]:
        """Yield faults and notes for the names in an element; other methods check the names in its children."""
        is_fixed = element.tag == "joint" and element.get("type") not in MOVING_TYPES
        remaining = {True: _MOST_FAULTS, False: _MOST_FAULTS}  # notes, faults
        for fault in urdf_format.faults(element, self.ignored, self.version):
            if fault.repeats and (
                fault.concerns in ("parent", "child") or (is_fixed and fault.concerns in ("axis", "limit", "mimic"))
            ):
                continue  # reported by the check of the tree, or not read
            remaining[fault.note] -= 1
            if remaining[fault.note] >= 0:
                yield Problem(this, f"{_title(this)}: {fault.text}", _affects(fault))
            elif not fault.note:
                return

    def _limit(self, this: str, element: etree._Element, *, bounded: bool) -> Iterator[Problem]:
        """Yield the problems of a joint's <limit>; position limits count for ``bounded`` joints alone."""
        limit = element.find("limit")
        if limit is None:
            return
        yield from self._spelling(this, limit)
        magnitudes = ("velocity", "effort", *(_NEWER_LIMITS if self._has_accelerations else ()))
        for key in (*(("lower", "upper") if bounded else ()), *magnitudes):
            yield from self._number(this, limit, key, 1, limit=True)
        if bounded:
            yield from self._bounds(this, limit)
        for key in magnitudes:
            yield from self._magnitude(this, limit, key)

    def _magnitude(self, this: str, limit: etree._Element, key: str) -> Iterator[Problem]:
        """Replace a magnitude that states no limit by infinity; yield the fault of a negative one.

        Since URDF 1.2 a joint without a limit has no attribute, so that 0 and -1 are faults there.
        """
        value = self.numbers.get((limit, key), (math.inf,))[0]
        is_unstated = stated(value) != value
        if is_unstated and not self._has_accelerations:
            self.numbers[limit, key] = (stated(value),)
            self.unstated.setdefault(f'{key}="{value:g}"', []).append(this.split(" ", 1)[1])
        elif is_unstated:
            fault = f'<limit {key}="{value:g}"> is no limit in URDF 1.2'
            yield Problem(this, f"{_title(this)}: {fault}; write the joint's limit, or remove {key} if it has none")
        elif value < 0:
            none = f"remove {key}" if self._has_accelerations else "write 0"
            fault = f'<limit {key}="{value:g}"> is negative'
            yield Problem(this, f"{_title(this)}: {fault}; write the joint's limit, or {none} if it has none")

    def _bounds(self, this: str, limit: etree._Element) -> Iterator[Problem]:
        """Yield the faults of a range, and remark what is odd; before URDF 1.2 a missing bound beside another is 0."""
        missing = [key for key in ("lower", "upper") if limit.get(key) is None]
        none = " and ".join(missing)
        if missing and self._has_accelerations:
            yield Problem(this, f"{_title(this)}: its <limit> has no {none}, which URDF 1.2 requires; add {none}")
            return
        if any(limit.get(key) is not None and (limit, key) not in self.numbers for key in ("lower", "upper")):
            return  # already reported
        lower, upper = (self.numbers.get((limit, key), (0.0,))[0] for key in ("lower", "upper"))
        if lower > upper and missing:
            fault = f"has no {none}, and without one its range is {lower:g} to {upper:g}; add {none}"
            yield Problem(this, f"{_title(this)}: its <limit> {fault}")
        elif lower > upper:
            fault = f"lower limit {lower:g} is above upper limit {upper:g}"
            yield Problem(this, f"{_title(this)}: {fault}; swap them, or correct the wrong one")
        elif len(missing) == 1:
            self.remarks.append(f"{_title(this)}: its <limit> has no {none}, which is taken as 0; add it")
        elif lower == upper and not missing:
            point = f"its position limits are one point, {lower:g}"
            self.remarks.append(f"{_title(this)}: {point}; correct them if it moves")

    def _axis(self, this: str, element: etree._Element) -> Iterator[Problem]:
        """Yield the problems of a joint's <axis>; without one the axis is x."""
        axis = element.find("axis")
        if axis is None:
            return
        yield from self._spelling(this, axis)
        if axis.get("xyz") is None:
            yield Problem(this, f"{_title(this)}: its <axis> has no xyz; add the direction in which it turns or slides")
        yield from self._number(this, axis, "xyz", 3)
        xyz = self.numbers.get((axis, "xyz"), (1.0, 0.0, 0.0))
        if not math.hypot(*xyz) > 1e-6:
            fault = f"its axis {_show(xyz)} has no direction"
            remedy = 'give the one in which it turns or slides (if it does not move: type="fixed")'
            yield Problem(this, f"{_title(this)}: {fault}; {remedy}")

    def _mimic(self, this: str, name: str, element: etree._Element) -> Iterator[Problem]:
        """Follow the mimics from a joint to its master, the master's master and so on, to the first fault.

        All joints of a followed chain are remembered, so that each fault is reported once.
        """
        mimic = element.find("mimic")
        if mimic is None:
            return
        yield from self._spelling(this, mimic)
        yield from self._number(this, mimic, "offset", 1)
        for problem in self._number(this, mimic, "multiplier", 1):
            yield replace(problem, affects="motion")
        followers = [name]
        while mimic is not None:
            master = mimic.get("joint", "")
            fault = self._fault_of_mimic(master, followers)
            if fault:
                self.broken_mimics.update(followers)
                yield Problem(this, f"joint '{printable(followers[-1])}' {fault}", affects="coupling")
                return
            if master in self.sound_mimics:
                break
            followers.append(master)  # without a fault it exists, and is not yet a follower: the loop ends
            # A fixed joint does not move, even if a converter left a <mimic> in it.
            moves = self.joints[master].get("type") in MOVING_TYPES
            mimic = self.joints[master].find("mimic") if moves else None
        self.sound_mimics.update(followers)

    def _fault_of_mimic(self, master: str, followers: Sequence[str]) -> str:
        """Return what is wrong with a <mimic> that names the master, "" for nothing; ``followers`` lead to it."""
        if not master:
            return 'has a <mimic> without a joint; add joint="..."'
        if master not in self.joints:
            return f"mimics the unknown joint '{printable(master)}'; {_among(self.joints)}"
        if master in followers:
            return f"mimics in a circle ({listed([*followers, master])}); break it"
        if master in self.broken_mimics:
            return f"mimics '{printable(master)}', whose <mimic> is faulty; correct that <mimic> first"
        if self.joints[master].get("type") not in (*MOVING_TYPES, "fixed"):  # a fixed one is at rest: a constant
            return f"mimics '{printable(master)}', which has no coordinate; name a {', '.join(MOVING_TYPES)} joint"
        return ""

    def _of_type(self, joint: str) -> Affects:
        """Return which chains a wrong type affects: it depends on whether the joint could move or have an offset."""
        if self.joints[joint].find("mimic") is not None:
            return "coupling"
        return "motion" if _at_zero(self.joints, joint) else "place"

    def _link(self, name: str, element: etree._Element) -> Iterator[Problem]:
        """Yield the problems of a link's <inertial>: missing parts, numbers, and a mass or tensor that no body has."""
        this, title = f"link {name}", f"link '{printable(name)}'"
        yield from self._spelling(this, element)
        inertial = element.find("inertial")
        if inertial is None:
            return
        yield from self._spelling(this, inertial)
        yield from self._origin(this, inertial)
        for tag, keys in (("mass", ("value",)), ("inertia", _TENSOR)):
            child = inertial.find(tag)
            if child is None:
                yield Problem(
                    this, f"{title}: <inertial> has no <{tag}>; add it, or leave all masses out (--no-masses)"
                )
                continue
            yield from self._spelling(this, child)
            for key in keys:
                if child.get(key) is None:
                    yield Problem(this, f"{title}: <{tag}> has no '{key}'; add it")
                yield from self._number(this, child, key, 1)
            values = [self.numbers.get((child, key), (math.nan,))[0] for key in keys]
            if any(math.isnan(value) for value in values):
                continue  # already reported
            if tag == "mass" and values[0] < 0:
                yield Problem(this, f"{title}: mass {values[0]:g} kg is negative; correct <mass>")
            if tag == "inertia" and not physical_inertia(*values):
                mass = inertial.find("mass")
                kilograms = 0.0 if mass is None else self.numbers.get((mass, "value"), (0.0,))[0]
                yield from self._impossible(name, values, _doubt(kilograms, tuple(values)))

    def _impossible(self, name: str, tensor: list[float], doubt: str) -> Iterator[Problem]:
        """Record an impossible tensor (xx, xy, xz, yy, yz, zz) that the user accepts, or yield it as a problem.

        ``doubt`` is a question about its unit, or "".
        """
        fault = fault_of(tensor)
        if self.reading.accepts(name):
            self.accepted[name] = fault
            return
        yield Problem(
            f"link {name}",
            f"link '{whole(name)}': no rigid body has this inertia tensor ({fault}; principal moments must be positive "
            f"and none above the sum of the other two){doubt}; correct <inertia>, accept it "
            f"(--accept-inertia {shell_word(name)}), or leave all masses out (--no-masses)",
        )

    def _origin(self, this: str, element: etree._Element) -> Iterator[Problem]:
        """Yield the problems of an element's <origin>."""
        origin = element.find("origin")
        if origin is not None:
            yield from self._spelling(this, origin)
            for key in ("xyz", "rpy"):
                yield from self._number(this, origin, key, 3)
            if self.version >= urdf_format.WITH_QUATERNIONS and origin.get("quat_xyzw") is not None:
                yield from self._quaternion(this, origin)

    def _quaternion(self, this: str, origin: etree._Element) -> Iterator[Problem]:
        """Yield the problems of a quaternion, which URDF 1.1 has in place of rpy."""
        yield from self._number(this, origin, "quat_xyzw", 4)
        if origin.get("rpy") is not None:
            yield Problem(this, f"{_title(this)}: its <origin> has rpy and quat_xyzw; remove one of the two")
        values = self.numbers.get((origin, "quat_xyzw"), (1.0,))
        if not math.hypot(*values) > 1e-6:
            fault = f"its quaternion {_show(values)} has no direction"
            yield Problem(this, f"{_title(this)}: {fault}; correct it, or remove it if nothing is turned")

    def _number(
        self, this: str, element: etree._Element, key: str, count: int, *, limit: bool = False
    ) -> Iterator[Problem]:
        """Store the ``count`` numbers of an attribute, or yield the first problem; a ``limit`` may be infinite."""
        text = element.get(key)
        if text is None:
            return
        words = _WORD.findall(text)
        place = f'{_title(this)}: <{element.tag} {key}="{printable(text)}">'
        if "${" in text or "$(" in text:
            yield Problem(
                this,
                f"{place} holds an expression of xacro; give the template (NAME.urdf.xacro), which stiffgen expands",
            )
            return
        if len(words) != count:
            expected = "a number" if count == 1 else f"{count} numbers"
            remedy = "; separate numbers by spaces, without commas" if "," in text else ""
            yield Problem(this, f"{place} holds {len(words)} words, expected {expected}{remedy}")
            return
        values = [_value(word, limit=limit) for word in words]
        fault = next((f"'{printable(each[0])}' {each[1]}" for each in values if isinstance(each, tuple)), "")
        if fault:
            yield Problem(this, f"{place}: {fault}")
            return
        self.numbers[element, key] = tuple(each for each in values if isinstance(each, float))

    def _tree(self) -> Iterator[Problem]:
        """Yield a problem for several roots, and one for each circle of links.

        From every link the parents are followed until a root or a link of an earlier path: each link is visited once.
        """
        roots = [link for link in self.links if link not in self.parents]
        if len(roots) > 1:
            yield Problem("file", f"has {len(roots)} root links ({listed(roots)}); connect them by joints to one tree")
        parent_of = {}
        for child, joint in self.parents.items():
            end = self.joints[joint].find("parent")
            parent_of[child] = None if end is None else end.get("link")
        visited: set[str] = set()
        for start in self.links:
            path: list[str] = []
            on_path: set[str] = set()
            link: str | None = start
            while link is not None and link not in visited:
                if link in on_path:
                    circle = path[path.index(link) :]
                    yield Problem("file", f"links form a circle ({listed(circle)}); a URDF is a tree: cut one joint")
                    break
                path.append(link)
                on_path.add(link)
                link = parent_of.get(link)
            visited.update(path)


def _at_zero(joints: dict[str, etree._Element], joint: str) -> bool:
    """Return whether a joint is at zero if its coordinate is: no <mimic> on its chain of masters has an offset."""
    names: set[str] = set()
    while joint in joints and joint not in names and joints[joint].get("type") != "fixed":
        mimic = joints[joint].find("mimic")
        offset = "0" if mimic is None else mimic.get("offset", "0").strip()
        if not _NUMBER.match(offset) or float(offset) != 0:
            return False
        names.add(joint)
        joint = "" if mimic is None else mimic.get("joint", "")
    return True


def _affects(fault: urdf_format.ElementFault) -> Affects:
    """Return which chains a fault of spelling affects; a note affects none."""
    if fault.note:
        return "nothing"
    if fault.repeats:
        return _REPEATED.get(fault.concerns, "place")
    return "coupling" if fault.concerns == "mimic" else "place"


def _title(this: str) -> str:
    kind, name = this.split(" ", 1)
    return f"{kind} '{printable(name)}'"


def _show(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _value(word: str, *, limit: bool) -> float | tuple[str, str]:
    """Return a number, which may be infinite for a ``limit``; or the word with its fault and the remedy."""
    if limit and word.lower().lstrip("+-") in ("inf", "infinity"):
        return -math.inf if word.startswith("-") else math.inf
    value = float(word) if _NUMBER.match(word) else math.nan
    if math.isnan(value) or (math.isinf(value) and limit):
        fault = "not a finite decimal number" if math.isnan(value) else "beyond double precision"
        return word, f"is {fault}; write {printable(_remedy_of(word))}"
    if abs(value) > LARGEST and not limit:
        return word, f"is beyond {LARGEST:g}; give metres, radians and kilograms"
    return value


def _remedy_of(word: str) -> str:
    """Return what to write in place of a word that is no number."""
    plain = word.rstrip(",;")
    if _NUMBER.match(plain):
        too_large = "-inf for no limit" if word.startswith("-") else "inf for no limit"
        return plain if math.isfinite(float(plain)) else too_large
    comma = _DECIMAL_COMMA.fullmatch(word)
    if comma is None:
        return "a number like 0.25, without a unit"
    decimal = f"{comma[1]}.{comma[2]}"
    return f"{decimal}, or {comma[1]}{comma[2]} for thousands" if _THOUSANDS.fullmatch(word) else decimal


def _among(names: dict[str, etree._Element]) -> str:
    return f"valid names: {listed(list(names))}" if names else "there is none"


def _doubt(mass: float, tensor: tuple[float, ...]) -> str:
    """Return the sentence of a doubt about an inertia, where the lint is there."""
    lint = optional("files.plausibility")
    return str(lint.doubt_about_inertia(mass, tensor)) if lint else ""
