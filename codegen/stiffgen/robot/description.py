"""URDF file -> :class:`Description`: links and joints with checked numbers, and every problem of the file.

The file is untrusted input. It is parsed once by lxml without entities, DTDs or network; what a chain needs
(links, inertials, joints) is checked and handed to yourdfpy, which reads the elements. Origins are the one
exception: yourdfpy turns roll-pitch-yaw into a float matrix whose last digit depends on the machine's libm, so
the angles themselves are kept and turned into matrices by :mod:`stiffgen.geometry`.

Meshes, materials, transmissions, gazebo and unknown elements are never looked at.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import yourdfpy
from lxml import etree

from stiffgen.errors import DescriptionError, listed, printable
from stiffgen.robot.geometry import unit

# The largest description in docs/robots.md has 0.2 MB. A parsed byte can cost 50 bytes of memory.
MAX_BYTES = 4 * 2**20
MAX_JOINTS = 5_000
LARGEST = 1e12  # of a length, an angle, a mass or a moment of inertia; keeps every sum and product finite
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MOVING_TYPES = ("revolute", "continuous", "prismatic")

Vector = tuple[float, float, float]

_TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?\Z")
_WORD = re.compile(r"[^ \t\r\n]+")
_XACRO = re.compile(rb"www\.ros\.org/wiki/xacro|wiki\.ros\.org/xacro|<xacro:")
# Faults of the XML that other readers of URDF let pass and that change no element: prefixes without a namespace
# (<drake:...>), "--" in a comment, a strange version number, a blank line before the XML declaration.
_HARMLESS = {"NS_ERR_UNDEFINED_NAMESPACE", "ERR_HYPHEN_IN_COMMENT", "ERR_UNKNOWN_VERSION", "ERR_RESERVED_XML_NAME"}
_LOGGED = 100  # libxml2's errors that lxml keeps; more may hide behind them
_OTHER_FORMATS = {"sdf": "SDF", "mujoco": "MJCF", "mujocoinclude": "MJCF", "COLLADA": "COLLADA", "openrave": "OpenRAVE"}


@dataclass(frozen=True)
class Inertial:
    """``<inertial>`` of a link: mass [kg], centre of mass [m] and orientation [rad] in the link frame, and
    (ixx, ixy, ixz, iyy, iyz, izz) [kg m^2] about the centre of mass in that orientation's axes.
    """

    mass: float
    com: Vector
    rpy: Vector
    tensor: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Mimic:
    """``<mimic>``: this joint stands at ``multiplier * q[joint] + offset``."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class JointElement:
    """A ``<joint>`` as the file has it (SI units, radians). ``axis`` is of unit length, or zero on a joint
    that does not move. Limits that the file leaves out are infinite; of two position limits, one left out is 0.
    """

    name: str
    type: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    lower: float
    upper: float
    velocity: float
    effort: float
    mimic: Mimic | None


@dataclass(frozen=True)
class Problem:
    """Something wrong with the file. ``element`` is "file", "joint NAME" or "link NAME": a problem of the file
    refuses every chain, one of a joint or link only the chains that use it. ``bounds`` marks a wrong position,
    velocity or effort limit, which matters where the joint is a coordinate and nowhere else.
    """

    element: str
    text: str
    bounds: bool = False


@dataclass(frozen=True)
class Description:
    """The checked content of a URDF file. ``joints`` is keyed by joint name, ``inertials`` by link name (None:
    the link has no ``<inertial>``); ``digest`` is the SHA-256 of the file's bytes.
    """

    file: str
    digest: str
    robot: str
    inertials: dict[str, Inertial | None]
    joints: dict[str, JointElement]
    problems: tuple[Problem, ...]

    @property
    def links(self) -> tuple[str, ...]:
        """Link names in file order."""
        return tuple(self.inertials)

    @property
    def parent_joint(self) -> dict[str, JointElement]:
        """The joint above each link; the root has none."""
        return {joint.child: joint for joint in self.joints.values()}

    @property
    def root(self) -> str:
        """The link that is no joint's child."""
        above = self.parent_joint
        return next(link for link in self.links if link not in above)

    @property
    def leaves(self) -> tuple[str, ...]:
        """The links that are no joint's parent, in file order: the usual tips."""
        parents = {joint.parent for joint in self.joints.values()}
        return tuple(link for link in self.links if link not in parents)


def read_description(path: str | Path) -> Description:
    """Read a URDF file.

    Problems of single joints and links are left in ``problems``; see :func:`stiffgen.load_chain` for which of
    them refuse a chain.

    Raises:
        DescriptionError: the file cannot be read, is no URDF, or its tree of links is broken. All problems of
            the file are in the error.

    """
    path = Path(path)
    data = _read_bytes(path)
    robot = _parse_xml(path.name, data)
    checker = _Checker(robot)
    problems = tuple(checker.run())
    if any(p.element == "file" for p in problems):
        # Those of the file first: the message shows a few only.
        raise DescriptionError(path.name, [p.text for p in sorted(problems, key=lambda p: p.element != "file")])
    model = _read_with_yourdfpy(checker)
    return Description(
        file=path.name,
        digest=hashlib.sha256(data).hexdigest(),
        robot=model.name,
        inertials={link.name: _inertial(link, checker) for link in model.links},
        joints={joint.name: _joint(joint, checker) for joint in model.joints},
        problems=problems,
    )


def _read_bytes(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise DescriptionError(str(path), ["is a folder; name the URDF file in it"])
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        reason = error.strerror or str(error)
        raise DescriptionError(str(path), [f"cannot be read ({reason}); check the path"]) from error
    except ValueError as error:  # a NUL byte in the path
        raise DescriptionError(repr(str(path)), [f"is no file name ({error})"]) from error
    if len(data) > MAX_BYTES:
        limit = MAX_BYTES // 2**20
        raise DescriptionError(
            path.name, [f"is larger than {limit} MiB; a robot description holds no meshes: is this the right file?"]
        )
    return data


def _parse_xml(file: str, data: bytes) -> etree._Element:
    xacro = (
        "is a xacro file, a template of a URDF; expand it first: xacro INPUT.xacro > OUTPUT.urdf "
        "(ROS package 'xacro', also on the Python registry), then give OUTPUT.urdf"
    )
    try:
        root = _well_formed(data)
    except (etree.XMLSyntaxError, ValueError) as error:
        if _XACRO.search(data):
            raise DescriptionError(file, [xacro]) from error
        reason = printable(getattr(error, "msg", None) or str(error) or "empty file", 200).rstrip(".")
        raise DescriptionError(file, [f"is not well-formed XML: {reason}; give a URDF file"]) from error
    tree = root.getroottree()
    if tree.docinfo.internalDTD is not None or tree.docinfo.doctype:
        raise DescriptionError(file, ["has a DOCTYPE; a URDF needs none: remove the <!DOCTYPE ...> declaration"])
    _drop_default_namespace(root)
    # xacro itself leaves its namespace declared on the files it has expanded: only its elements count.
    if any(isinstance(e.tag, str) and e.tag.startswith(("{", "xacro:")) and "xacro" in e.tag for e in root.iter()):
        raise DescriptionError(file, [xacro])
    if root.tag != "robot":
        other = _OTHER_FORMATS.get(str(root.tag))
        said = f"is an {other} file" if other else f"has the root element <{printable(str(root.tag))}>"
        raise DescriptionError(file, [f"{said}, expected <robot>; give a URDF file"])
    return root


def _well_formed(data: bytes) -> etree._Element:
    """Parse; faults of the kinds in ``_HARMLESS`` pass."""
    settings = {
        "resolve_entities": False,
        "load_dtd": False,
        "no_network": True,
        "huge_tree": False,
        "remove_comments": True,
        "remove_pis": True,
    }
    try:
        return etree.fromstring(data, etree.XMLParser(**settings))
    except etree.XMLSyntaxError:
        lenient = etree.XMLParser(recover=True, **settings)
        root = etree.fromstring(data, lenient)
        log = lenient.error_log.filter_from_errors()
        if root is None or len(lenient.error_log) >= _LOGGED or {entry.type_name for entry in log} - _HARMLESS:
            raise
        return root


def _drop_default_namespace(root: etree._Element) -> None:
    """<robot xmlns="..."> puts its elements in a namespace; a URDF has none, so the tags are taken without it."""
    if root.prefix is None and str(root.tag).startswith("{"):
        namespace = str(root.tag)[: str(root.tag).index("}") + 1]
        for element in root.iter(f"{namespace}*"):
            if element.prefix is None:
                element.tag = str(element.tag)[len(namespace) :]


class _Checker:
    """Walks the XML once, yields the problems, and keeps what reading needs afterwards."""

    def __init__(self, robot: etree._Element) -> None:
        self.robot = robot
        self.links: dict[str, etree._Element] = {}
        self.joints: dict[str, etree._Element] = {}
        self.parents: dict[str, str] = {}  # child link -> joint
        self.numbers: dict[tuple[etree._Element, str], tuple[float, ...]] = {}
        self.broken_mimics: set[str] = set()
        self.sound_mimics: set[str] = set()

    def run(self) -> Iterator[Problem]:
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
        yield from self._tree()

    def _named(self, tag: str, into: dict[str, etree._Element]) -> Iterator[Problem]:
        for position, element in enumerate(self.robot.findall(tag), start=1):
            name = element.get("name", "")
            if not name.strip():
                yield Problem("file", f'<{tag}> number {position} has no name; add name="..."')
            elif name in into:
                yield Problem("file", f"{tag} '{printable(name)}' stands twice; rename one of the two")
            else:
                into[name] = element

    def _joint(self, name: str, element: etree._Element) -> Iterator[Problem]:
        this, title = f"joint {name}", f"joint '{printable(name)}'"
        kind = element.get("type")
        if kind not in JOINT_TYPES:
            said = "has no type" if kind is None else f"has the unknown type '{printable(kind)}'"
            yield Problem("file", f"{title} {said}; valid types: {', '.join(JOINT_TYPES)}")
        ends = {}
        for tag in ("parent", "child"):
            end = element.find(tag)
            link = None if end is None else end.get("link")
            if not link:
                yield Problem("file", f'{title} has no <{tag} link="..."/>; add it')
            elif link not in self.links:
                yield Problem(
                    "file", f"{title}: its {tag} link '{printable(link)}' does not exist; {self._known_links}"
                )
            else:
                ends[tag] = link
        if "child" in ends:
            other = self.parents.setdefault(ends["child"], name)
            if other != name:
                yield Problem(
                    "file",
                    f"link '{printable(ends['child'])}' is the child of joint '{printable(other)}' and of {title}; "
                    "a URDF is a tree: give each link one parent joint",
                )
        yield from self._origin(this, element)
        # Real files have zero axes and empty limits on joints that do not move; nobody reads them.
        if kind in MOVING_TYPES:
            yield from self._axis(this, element)
            for problem in self._limit(this, element, bounded=kind != "continuous"):
                yield replace(problem, bounds=True)
            yield from self._mimic(this, name, element)

    def _limit(self, this: str, element: etree._Element, *, bounded: bool) -> Iterator[Problem]:
        limit = element.find("limit")
        if limit is None:
            return
        for key in ("lower", "upper", "velocity", "effort"):
            if bounded or key in ("velocity", "effort"):
                yield from self._number(this, limit, key, 1, limit=True)
        lower, upper = (self.numbers.get((limit, key), (0.0,))[0] for key in ("lower", "upper"))
        if lower > upper:
            yield Problem(this, f"{_title(this)}: lower limit {lower:g} is above upper limit {upper:g}; swap them")
        for key in ("velocity", "effort"):
            if self.numbers.get((limit, key), (0.0,))[0] < 0:
                yield Problem(this, f"{_title(this)}: <limit {key}> is negative; give its magnitude")

    def _axis(self, this: str, element: etree._Element) -> Iterator[Problem]:
        axis = element.find("axis")
        if axis is None:
            return
        if axis.get("xyz") is None:
            yield Problem(this, f'{_title(this)}: its <axis> has no xyz; add xyz="0 0 1" or the like')
        yield from self._number(this, axis, "xyz", 3)
        xyz = self.numbers.get((axis, "xyz"), (1.0, 0.0, 0.0))
        if not math.hypot(*xyz) > 1e-6:
            yield Problem(
                this, f'{_title(this)}: its axis {_show(xyz)} has no direction; give a vector like xyz="0 0 1"'
            )

    def _mimic(self, this: str, name: str, element: etree._Element) -> Iterator[Problem]:
        mimic = element.find("mimic")
        if mimic is None:
            return
        for key in ("multiplier", "offset"):
            yield from self._number(this, mimic, key, 1)
        followed = dict.fromkeys([name])
        while mimic is not None:
            last, master = next(reversed(followed)), mimic.get("joint", "")
            wrong = None
            if not master:
                wrong = 'has a <mimic> without a joint; add joint="..."'
            elif master not in self.joints:
                wrong = f"mimics the unknown joint '{printable(master)}'; {self._known_joints}"
            elif master in followed:
                wrong = f"mimics in a circle ({listed([*followed, master])}); break it"
            elif master in self.broken_mimics:
                wrong = f"mimics '{printable(master)}', whose own <mimic> is broken; correct that one"
            elif self.joints[master].get("type") not in (*MOVING_TYPES, "fixed"):
                wrong = f"mimics '{printable(master)}', which has no coordinate; name a {', '.join(MOVING_TYPES)} joint"
            if wrong:
                self.broken_mimics.update(followed)
                yield Problem(this, f"joint '{printable(last)}' {wrong}")
                return
            if master in self.sound_mimics:
                break
            followed[master] = None
            # A fixed joint stands at zero, whatever <mimic> a converter has left in it.
            moves = self.joints[master].get("type") in MOVING_TYPES
            mimic = self.joints[master].find("mimic") if moves else None
        self.sound_mimics.update(followed)

    def _link(self, name: str, element: etree._Element) -> Iterator[Problem]:
        this, title = f"link {name}", f"link '{printable(name)}'"
        inertial = element.find("inertial")
        if inertial is None:
            return
        yield from self._origin(this, inertial)
        for tag, keys in (("mass", ("value",)), ("inertia", _TENSOR)):
            child = inertial.find(tag)
            if child is None:
                yield Problem(this, f"{title}: <inertial> has no <{tag}>; add it or remove <inertial>")
                continue
            for key in keys:
                if child.get(key) is None:
                    yield Problem(this, f"{title}: <{tag}> has no '{key}'; add it")
                yield from self._number(this, child, key, 1)
            values = [self.numbers.get((child, key), (math.nan,))[0] for key in keys]
            if any(math.isnan(value) for value in values):
                continue  # said already
            if tag == "mass" and values[0] < 0:
                yield Problem(this, f"{title}: mass {values[0]:g} kg is negative; correct <mass>")
            if tag == "inertia" and not physical_inertia(*values):
                yield Problem(
                    this,
                    f"{title}: no rigid body has this inertia tensor (principal moments must be positive and "
                    "none above the sum of the other two); correct <inertia>, or leave all masses out (--no-masses)",
                )

    @cached_property
    def _known_links(self) -> str:
        return _among(self.links)

    @cached_property
    def _known_joints(self) -> str:
        return _among(self.joints)

    def _origin(self, this: str, element: etree._Element) -> Iterator[Problem]:
        origin = element.find("origin")
        if origin is not None:
            for key in ("xyz", "rpy"):
                yield from self._number(this, origin, key, 3)

    def _number(
        self, this: str, element: etree._Element, key: str, count: int, *, limit: bool = False
    ) -> Iterator[Problem]:
        text = element.get(key)
        if text is None:
            return
        words = _WORD.findall(text)
        where = f'{_title(this)}: <{element.tag} {key}="{printable(text)}">'
        if "${" in text or "$(" in text:
            yield Problem(
                this, f"{where} holds an expression of xacro; expand the file first: xacro IN.xacro > OUT.urdf"
            )
            return
        if len(words) != count:
            many = "a number" if count == 1 else f"{count} numbers"
            yield Problem(this, f"{where} holds {len(words)} words, expected {many}")
            return
        values = []
        for word in words:
            if limit and word.lower().lstrip("+-") in ("inf", "infinity"):
                values.append(-math.inf if word.startswith("-") else math.inf)
                continue
            value = float(word) if _NUMBER.match(word) else math.nan
            if not math.isfinite(value):
                yield Problem(this, f"{where}: '{printable(word)}' is not a finite decimal number; write one like 0.25")
                return
            if abs(value) > LARGEST and not limit:
                yield Problem(
                    this, f"{where}: '{printable(word)}' is beyond {LARGEST:g}; give metres, radians and kilograms"
                )
                return
            values.append(value)
        self.numbers[element, key] = tuple(values)

    def _tree(self) -> Iterator[Problem]:
        roots = [link for link in self.links if link not in self.parents]
        if len(roots) > 1:
            yield Problem("file", f"has {len(roots)} root links ({listed(roots)}); connect them by joints to one tree")
        parent_of = {}
        for child, joint in self.parents.items():
            end = self.joints[joint].find("parent")
            parent_of[child] = None if end is None else end.get("link")
        done: set[str] = set()
        for start in self.links:
            path: list[str] = []
            on_path: set[str] = set()
            link: str | None = start
            while link is not None and link not in done:
                if link in on_path:
                    circle = path[path.index(link) :]
                    yield Problem("file", f"links form a circle ({listed(circle)}); a URDF is a tree: cut one joint")
                    break
                path.append(link)
                on_path.add(link)
                link = parent_of.get(link)
            done.update(path)


def physical_inertia(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> bool:
    """Whether a rigid body can have this inertia tensor about its centre of mass (1 % slack: exports are rounded)."""
    # Principal moments of a symmetric 3x3 matrix in closed form.
    largest = max(map(abs, (xx, xy, xz, yy, yz, zz)))
    if largest == 0:
        return True
    xx, xy, xz, yy, yz, zz = (value / largest for value in (xx, xy, xz, yy, yz, zz))
    mean = (xx + yy + zz) / 3
    spread = math.sqrt(((xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2 * (xy**2 + xz**2 + yz**2)) / 6)
    if spread == 0:
        return mean >= 0
    a, b, c = ((value - mean) / spread for value in (xx, yy, zz))
    d, e, f = xy / spread, xz / spread, yz / spread
    half_det = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    angle = math.acos(min(1.0, max(-1.0, half_det))) / 3
    high = mean + 2 * spread * math.cos(angle)
    low = mean + 2 * spread * math.cos(angle + 2 * math.pi / 3)
    middle = 3 * mean - high - low
    return low >= -0.01 * abs(high) and high <= 1.01 * (low + middle)


def _read_with_yourdfpy(checker: _Checker) -> yourdfpy.urdf.Robot:
    """Hand yourdfpy the links and joints alone, without what failed the checks of single elements."""
    copy = etree.Element("robot", {"name": checker.robot.get("name", "")})
    for name, link in checker.links.items():
        kept = etree.SubElement(copy, "link", {"name": name})
        inertial = link.find("inertial")
        if inertial is not None and inertial.find("mass") is not None and inertial.find("inertia") is not None:
            _copy(checker, kept, inertial, ("mass", "inertia"))
    for name, joint in checker.joints.items():
        kept = etree.SubElement(copy, "joint", {"name": name, "type": joint.get("type", "")})
        for tag in ("parent", "child"):
            end = joint.find(tag)
            etree.SubElement(kept, tag, {"link": "" if end is None else end.get("link", "")})
        for tag in ("axis", "limit", "mimic"):
            child = joint.find(tag)
            skipped = tag == "mimic" and name in checker.broken_mimics
            if child is not None and not skipped and joint.get("type") in MOVING_TYPES:
                made = etree.SubElement(kept, tag)
                _copy_numbers(checker, made, child)
                if tag == "mimic":
                    made.set("joint", child.get("joint", ""))
    stream = io.BytesIO(etree.tostring(copy, encoding="utf-8"))
    return yourdfpy.URDF.load(stream, build_scene_graph=False, load_meshes=False).robot


def _copy(checker: _Checker, into: etree._Element, element: etree._Element, tags: tuple[str, ...]) -> None:
    made = etree.SubElement(into, str(element.tag))
    for tag in tags:
        child = element.find(tag)
        if child is not None:
            _copy_numbers(checker, etree.SubElement(made, tag), child)


def _copy_numbers(checker: _Checker, into: etree._Element, element: etree._Element) -> None:
    for key in map(str, element.attrib):
        values = checker.numbers.get((element, key))
        if values is not None:
            into.set(key, " ".join(map(repr, values)))


def _placement(element: etree._Element | None, checker: _Checker) -> tuple[Vector, Vector]:
    origin = None if element is None else element.find("origin")
    zero = (0.0, 0.0, 0.0)
    if origin is None:
        return zero, zero
    xyz, rpy = (checker.numbers.get((origin, key), zero) for key in ("xyz", "rpy"))
    return (xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2])


def _inertial(link: yourdfpy.urdf.Link, checker: _Checker) -> Inertial | None:
    if link.inertial is None:
        return None
    com, rpy = _placement(checker.links[link.name].find("inertial"), checker)
    i = link.inertial.inertia.tolist()
    return Inertial(float(link.inertial.mass), com, rpy, (i[0][0], i[0][1], i[0][2], i[1][1], i[1][2], i[2][2]))


def _joint(joint: yourdfpy.urdf.Joint, checker: _Checker) -> JointElement:
    xyz, rpy = _placement(checker.joints[joint.name], checker)
    axis = (0.0, 0.0, 0.0)
    if joint.type in MOVING_TYPES and any(joint.axis):
        axis = unit(joint.axis.tolist())
    limit = joint.limit or yourdfpy.urdf.Limit()
    bounds = (limit.lower, limit.upper)
    bounded = joint.type in ("revolute", "prismatic") and bounds != (None, None)
    # The format's default of a left-out bound is 0; but where both are left out, a joint that moves is meant.
    lower, upper = (bound or 0.0 for bound in bounds) if bounded else (-math.inf, math.inf)
    mimic = joint.mimic if joint.type in MOVING_TYPES else None
    return JointElement(
        name=joint.name,
        type=joint.type,
        parent=joint.parent,
        child=joint.child,
        xyz=xyz,
        rpy=rpy,
        axis=axis,
        lower=lower,
        upper=upper,
        velocity=math.inf if limit.velocity is None else limit.velocity,
        effort=math.inf if limit.effort is None else limit.effort,
        mimic=None if mimic is None else Mimic(mimic.joint, float(mimic.multiplier), float(mimic.offset)),
    )


def _title(this: str) -> str:
    kind, name = this.split(" ", 1)
    return f"{kind} '{printable(name)}'"


def _show(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _among(names: dict[str, etree._Element]) -> str:
    return f"valid names: {listed(list(names))}" if names else "there is none"
