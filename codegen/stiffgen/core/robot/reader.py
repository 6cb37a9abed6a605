# SPDX-License-Identifier: MIT
"""Reader of a robot's file: makes a :class:`Description` from a URDF, a xacro template of one, or an MJCF file.

The file is untrusted input. lxml parses it once, without entities, DTDs or network access. The links, inertials and
joints are checked (:mod:`stiffgen.core.robot.checker`) and passed to yourdfpy, which reads the elements. Origins are an
exception: yourdfpy converts roll-pitch-yaw to a float matrix whose last digit depends on the machine's libm. The reader
therefore stores the angles, and :mod:`stiffgen.core.robot.geometry` computes the matrices.

The reader ignores meshes, materials, transmissions and gazebo elements.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
import select
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, BinaryIO

from lxml import etree

from stiffgen.core.errors import DescriptionError, listed, printable
from stiffgen.core.robot.checker import Checker
from stiffgen.core.robot.description import (
    JOINT_TYPES,
    MOVING_TYPES,
    Description,
    Expansion,
    Inertial,
    JointElement,
    Mimic,
    Orientation,
    Reading,
    Vector,
)
from stiffgen.core.robot.geometry import unit
from stiffgen.rooms import optional

if TYPE_CHECKING:
    import yourdfpy

_PIPE_TIMEOUT = 2  # time until the first data of a pipe [s]
# The largest description in docs/robots.md has 0.2 MB. One byte of XML can take 50 bytes of memory after parsing.
MAX_BYTES = 4 * 2**20

_XACRO = re.compile(rb"<xacro:[a-zA-Z]")
# Faults of the XML that other readers of URDF accept and that change no element: prefixes without a namespace
# (<drake:...>), "--" in a comment, an unknown version number, a blank line before the XML declaration.
_HARMLESS = {"NS_ERR_UNDEFINED_NAMESPACE", "ERR_HYPHEN_IN_COMMENT", "ERR_UNKNOWN_VERSION", "ERR_RESERVED_XML_NAME"}
# A root element <mujoco> behind comments; the comments' pattern takes time that grows with the file alone.
_MJCF = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:<\?xml[^>]{0,200}>\s*)?(?:<!--(?:[^-]|-(?!->))*-->\s*)*<mujoco[\s/>]")
_MAX_LOGGED = 100  # size of lxml's log of errors; further errors are lost
_OTHER_FORMATS = {"sdf": "SDF", "COLLADA": "COLLADA", "openrave": "OpenRAVE"}


def read_description(path: str | Path, reading: Reading | None = None) -> Description:
    """Read a robot's file: a URDF, a xacro template, which is expanded first, or an MJCF file.

    ``problems`` of the result holds the problems of single joints and links; :func:`stiffgen.load_chain` documents
    which of them reject a chain.

    Raises:
        DescriptionError: the file cannot be read, has another format, or its links do not form a tree. The error
            holds all problems of the file.
        MissingExtraError: the package that reads this format is not installed.

    """
    path, reading = Path(path), reading or Reading()
    data = _read_bytes(path)
    templates = optional("files.templates")
    if templates:
        templates.check_package_path(path, reading)
    if _is_mjcf(data) and not reading.arguments:
        described: Description = _format(path, "files.mjcf", "MJCF").read_mjcf(path, data)
        return described
    is_template = _is_template(path.name, data)
    expansion = _expand(path, reading, data) if is_template else Expansion(data)
    if reading.arguments and not is_template:
        given = listed([f"{name}:={value}" for name, value in reading.arguments.items()])
        raise DescriptionError(path.name, [f"takes no arguments ({given}): it is no xacro template; leave them out"])
    robot = _parse_xml(path.name, expansion.text)
    if is_template and robot.find("link") is None:
        raise DescriptionError(
            path.name,
            ["expands to a robot without links; if it only defines macros, give the file that calls them"],
        )
    return _checked(path.name, data, reading, expansion, Checker(robot, reading))


def _checked(file: str, data: bytes, reading: Reading, expansion: Expansion, checker: Checker) -> Description:
    """Return the content of a URDF that passes the checks of the file as a whole."""
    problems = tuple(checker.run())
    if any(p.element == "file" for p in problems):
        # Problems of the whole file come first, because the message shows only some of them.
        raise DescriptionError(file, [p.text for p in sorted(problems, key=lambda p: p.element != "file")])
    model = _read_with_yourdfpy(checker)
    return Description(
        file=file,
        digest=hashlib.sha256(data).hexdigest(),
        robot=model.name,
        inertials={link.name: _inertial(link, checker) for link in model.links},
        joints={joint.name: _joint(joint, checker) for joint in model.joints},
        problems=tuple(problem for problem in problems if problem.affects != "nothing"),
        notes=(*expansion.warnings, *(problem.text for problem in problems if problem.affects == "nothing")),
        remarks=tuple(checker.remarks),
        accepted=checker.accepted,
        parameters=expansion.parameters,
        inputs=expansion.inputs,
        arguments=tuple(sorted((reading.arguments or {}).items())),
    )


def _expand(path: Path, reading: Reading, data: bytes) -> Expansion:
    """Expand a template; refuse a file with elements of xacro that is not given as one."""
    if not path.name.endswith(".xacro") and not reading.arguments:
        _parse_xml(path.name, data)  # a file that is not well-formed has no elements
        raise DescriptionError(
            path.name,
            ["has elements of xacro; only a template is expanded: name it FILE.xacro, or give one of its arguments"],
        )
    expansion: Expansion = _format(path, "files.templates", "xacro").expand(path, reading)
    return expansion


def _format(path: Path, module: str, name: str) -> ModuleType:
    """Return the module that reads a format besides URDF; refuse the file where the room ``files`` is gone."""
    found = optional(module)
    if found is None:
        problem = (
            f"is {name}, which the room 'files' reads, and that has been taken out of this stiffgen; convert the file "
            "to a URDF, or install stiffgen whole"
        )
        raise DescriptionError(path.name, [problem])
    return found


def _read_bytes(path: Path) -> bytes:
    """Return the content of a file; a :class:`DescriptionError` says why it has none, or too much."""
    try:
        if path.is_dir():
            raise DescriptionError(str(path), ["is a folder; name the URDF file in it"])
        with _open(path) as stream:
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


def _open(path: Path) -> BinaryIO:
    """Open a file; reject a named pipe without a writer, since reading it would never return."""
    if not path.is_fifo():
        return path.open("rb")
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    if not poll.poll(1000 * _PIPE_TIMEOUT):
        os.close(descriptor)
        raise DescriptionError(str(path), ["is a pipe to which nothing writes; name a file, or start the writer first"])
    os.set_blocking(descriptor, True)
    return os.fdopen(descriptor, "rb")


def _is_mjcf(data: bytes) -> bool:
    """Return whether the root element of a file is ``<mujoco>``."""
    return _MJCF.match(data) is not None


def _is_template(file: str, data: bytes) -> bool:
    """Return whether a file is a xacro template: by its name, or by elements of xacro outside comments."""
    if file.endswith(".xacro") or not _XACRO.search(data):
        return file.endswith(".xacro")
    try:
        elements = _well_formed(data).iter()
    except (etree.XMLSyntaxError, ValueError):
        return True
    tags = (str(element.tag) for element in elements)
    return any("xacro" in tag and tag.startswith(("{", "xacro:")) for tag in tags)


def _parse_xml(file: str, data: bytes) -> etree._Element:
    """Return the element <robot> of a URDF, without a default namespace; refuse all other files by what they are."""
    try:
        root = _well_formed(data)
    except (etree.XMLSyntaxError, ValueError) as error:
        if encoding := _encoding_fault(data):
            raise DescriptionError(file, [encoding]) from error
        reason = printable(getattr(error, "msg", None) or str(error) or "empty file", 200).rstrip(".")
        raise DescriptionError(file, [f"is not well-formed XML: {reason}; give a URDF file"]) from error
    tree = root.getroottree()
    if tree.docinfo.internalDTD is not None or tree.docinfo.doctype:
        raise DescriptionError(file, ["has a DOCTYPE; a URDF needs none: remove the <!DOCTYPE ...> declaration"])
    _drop_default_namespace(root)
    if root.tag == "mujoco":
        raise DescriptionError(file, ["is an MJCF file that is not UTF-8 text; save it as UTF-8"])
    if root.tag == "mujocoinclude":
        raise DescriptionError(file, ["is part of an MJCF file; give the file that includes it"])
    if root.tag != "robot":
        other = _OTHER_FORMATS.get(str(root.tag))
        fault = f"is an {other} file" if other else f"has the root element <{printable(str(root.tag))}>"
        raise DescriptionError(file, [f"{fault}, expected <robot>; give a URDF file, a xacro template or an MJCF file"])
    return root


def _encoding_fault(data: bytes) -> str:
    """Return the fault of bytes that are not text in their encoding, with the remedy; "" if there is none."""
    if b"\0" in data[:4] and not data.startswith((b"\xff\xfe", b"\xfe\xff", b"\0\0\xfe\xff")):
        return "is not well-formed XML: UTF-16 text without a byte order mark; save it as UTF-8"
    if not data.lstrip().startswith(b"<"):  # no XML of any encoding
        return ""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        return (
            f"is not well-formed XML: no UTF-8 text (byte 0x{data[error.start]:02x} at {error.start}); save it as "
            'UTF-8, or declare its encoding: <?xml version="1.0" encoding="ISO-8859-1"?>'
        )
    return ""


def _well_formed(data: bytes) -> etree._Element:
    """Parse XML; accept faults of the kinds in ``_HARMLESS``."""
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
        # a log that is full may have lost a fault that is not harmless
        if root is None or len(lenient.error_log) >= _MAX_LOGGED or {entry.type_name for entry in log} - _HARMLESS:
            raise
        return root


def _drop_default_namespace(root: etree._Element) -> None:
    """Remove the namespace of ``<robot xmlns="...">`` from all tags; a URDF has none."""
    if root.prefix is None and str(root.tag).startswith("{"):
        namespace = str(root.tag)[: str(root.tag).index("}") + 1]
        for element in root.iter(f"{namespace}*"):
            if element.prefix is None:
                element.tag = str(element.tag)[len(namespace) :]


def _read_with_yourdfpy(checker: Checker) -> yourdfpy.urdf.Robot:
    """Return yourdfpy's robot, from a copy of links and joints without the elements that failed a check."""
    import yourdfpy  # not at the top: with its mesh libraries it takes as long as all other imports together

    copy = etree.Element("robot", {"name": checker.robot.get("name", "")})
    for name, link in checker.links.items():
        target = etree.SubElement(copy, "link", {"name": name})
        inertial = link.find("inertial")
        if inertial is not None and inertial.find("mass") is not None and inertial.find("inertia") is not None:
            _copy(checker, target, inertial, ("mass", "inertia"))
    for name, joint in checker.joints.items():
        target = etree.SubElement(copy, "joint", {"name": name, "type": _type(joint)})
        for tag in ("parent", "child"):
            end = joint.find(tag)
            etree.SubElement(target, tag, {"link": "" if end is None else end.get("link", "")})
        for tag in ("axis", "limit", "mimic"):
            child = joint.find(tag)
            is_faulty = tag == "mimic" and name in checker.broken_mimics
            if child is not None and not is_faulty and joint.get("type") in MOVING_TYPES:
                element = etree.SubElement(target, tag)
                _copy_numbers(checker, element, child)
                if tag == "mimic":
                    element.set("joint", child.get("joint", ""))
    stream = io.BytesIO(etree.tostring(copy, encoding="utf-8"))
    return yourdfpy.URDF.load(stream, build_scene_graph=False, load_meshes=False).robot


def _copy(checker: Checker, into: etree._Element, element: etree._Element, tags: tuple[str, ...]) -> None:
    target = etree.SubElement(into, str(element.tag))
    for tag in tags:
        child = element.find(tag)
        if child is not None:
            _copy_numbers(checker, etree.SubElement(target, tag), child)


def _copy_numbers(checker: Checker, into: etree._Element, element: etree._Element) -> None:
    for key in map(str, element.attrib):
        values = checker.numbers.get((element, key))
        if values is not None:
            into.set(key, " ".join(map(repr, values)))


def _origin(element: etree._Element | None, checker: Checker) -> tuple[Vector, Orientation]:
    """Return position [m] and orientation of an <origin>: roll, pitch, yaw [rad], or a quaternion (w, x, y, z)."""
    origin = None if element is None else element.find("origin")
    zero = (0.0, 0.0, 0.0)
    if origin is None:
        return zero, zero
    xyz, rpy = (checker.numbers.get((origin, key), zero) for key in ("xyz", "rpy"))
    quaternion = checker.numbers.get((origin, "quat_xyzw"))
    place = (xyz[0], xyz[1], xyz[2])
    if quaternion is not None:
        x, y, z, w = quaternion
        return place, (w, x, y, z)
    return place, (rpy[0], rpy[1], rpy[2])


def _inertial(link: yourdfpy.urdf.Link, checker: Checker) -> Inertial | None:
    if link.inertial is None:
        return None
    com, rpy = _origin(checker.links[link.name].find("inertial"), checker)
    i = link.inertial.inertia.tolist()
    return Inertial(float(link.inertial.mass), com, rpy, (i[0][0], i[0][1], i[0][2], i[1][1], i[1][2], i[2][2]))


def _joint(joint: yourdfpy.urdf.Joint, checker: Checker) -> JointElement:
    """Return the record of a joint; axis, limits and mimic of a joint that does not move are not read.

    yourdfpy does not read acceleration, deceleration and jerk of URDF 1.2, which come from the checker.
    """
    xyz, rpy = _origin(checker.joints[joint.name], checker)
    axis = (0.0, 0.0, 0.0)
    if joint.type in MOVING_TYPES and any(joint.axis):
        axis = unit(joint.axis.tolist())
    lower, upper = _bounds(joint)
    limit, mimic = joint.limit, joint.mimic if joint.type in MOVING_TYPES else None
    element = checker.joints[joint.name].find("limit")
    acceleration, deceleration, jerk = (
        checker.numbers.get((element, key), (math.inf,))[0] if element is not None else math.inf
        for key in ("acceleration", "deceleration", "jerk")
    )
    return JointElement(
        name=joint.name,
        type=joint.type,
        parent=joint.parent,
        child=joint.child,
        xyz=xyz,
        orientation=rpy,
        axis=axis,
        lower=lower,
        upper=upper,
        velocity=limit.velocity if limit and limit.velocity is not None else math.inf,
        effort=limit.effort if limit and limit.effort is not None else math.inf,
        mimic=None if mimic is None else Mimic(mimic.joint, float(mimic.multiplier), float(mimic.offset)),
        acceleration=acceleration,
        deceleration=deceleration,
        jerk=jerk,
        motor_inertia=checker.rotors.get(joint.name, 0.0),
    )


def _bounds(joint: yourdfpy.urdf.Joint) -> tuple[float, float]:
    """Return the position limits of a joint: 0 for a missing one, as in the format; unlimited if both are missing."""
    bounds = (joint.limit.lower, joint.limit.upper) if joint.limit else (None, None)
    if joint.type not in ("revolute", "prismatic") or bounds == (None, None):
        return -math.inf, math.inf
    return bounds[0] or 0.0, bounds[1] or 0.0


def _type(joint: etree._Element) -> str:
    """Return the type of a joint; an unknown type, which the checker reports, becomes fixed."""
    kind = str(joint.get("type"))
    return kind if kind in JOINT_TYPES else "fixed"
