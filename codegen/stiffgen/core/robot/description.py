# SPDX-License-Identifier: MIT
"""Content of a robot's file: links and joints with checked numbers, and all problems of the file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from stiffgen.core.described import option, python_option
from stiffgen.core.given import checked_path, checked_words

LARGEST = 1e12  # bound on lengths, angles, masses and moments of inertia; keeps every sum and product finite
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MOVING_TYPES = ("revolute", "continuous", "prismatic")

ALL_LINKS = "all"

UNSTATED = (0.0, -1.0)
"""What exporters write for a limit of velocity, effort, acceleration or jerk that they do not know."""


def stated(limit: float) -> float:
    """Return the magnitude of a limit, infinite if a file's number is one of ``UNSTATED``; all readers ask this."""
    return math.inf if limit in UNSTATED else limit


Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Orientation = Vector | Quaternion
"""Roll, pitch, yaw as in a URDF's ``<origin>`` [rad], or a quaternion (w, x, y, z) of any length."""
Affects = Literal["place", "motion", "bounds", "coupling", "nothing"]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Settings of the reader."""

    arguments: Mapping[str, str] | None = python_option("values of a xacro template's arguments, by name", default=None)
    package_path: Sequence[str | Path] = option(
        "folder of ROS packages that a xacro template includes; repeatable",
        default=(),
        group="robot",
        metavar="DIR",
        action="append",
    )
    ignore: Sequence[str] = option(
        "unknown element or attribute that is no misspelling; repeatable",
        default=(),
        group="robot",
        metavar="ELEMENT",
        action="append",
    )
    accept_inertia: Sequence[str] = option(
        "use an inertia that no rigid body has; repeatable (all: of every link)",
        default=(),
        group="robot",
        metavar="LINK",
        action="append",
    )

    def __post_init__(self) -> None:
        """Take one word for the only value: as a sequence it would be its letters."""
        for name in ("package_path", "ignore", "accept_inertia"):
            value = getattr(self, name)
            words = (value,) if isinstance(value, (str, Path)) else value
            flag = f"--{name.replace('_', '-')}"
            if name == "package_path" and isinstance(words, (list, tuple)):
                object.__setattr__(self, name, tuple(checked_path(each, flag) for each in words))
            else:
                object.__setattr__(self, name, checked_words(words, flag))

    def accepts(self, link: str) -> bool:
        """Return whether the inertia of a link is used although no rigid body has it."""
        return link in self.accept_inertia or ALL_LINKS in self.accept_inertia


@dataclass(frozen=True)
class Input:
    """File that the main file includes: path relative to the main file, or package://NAME/PATH, and SHA-256."""

    file: str
    digest: str


@dataclass(frozen=True)
class Inertial:
    """Element ``<inertial>`` of a link.

    ``com`` is the centre of mass [m] and ``orientation`` that of the inertial frame, both in the link frame.
    ``tensor`` is (ixx, ixy, ixz, iyy, iyz, izz) [kg m^2] about the centre of mass in the inertial frame. ``mass`` is in
    kg.
    """

    mass: float
    com: Vector
    orientation: Orientation
    tensor: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Mimic:
    """Element ``<mimic>``: the position of the joint is ``multiplier * q[joint] + offset``."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class JointElement:
    """Element ``<joint>`` of the file (SI units, radians).

    ``axis`` has unit length, or is zero for a joint that does not move. Missing limits are infinite, as are magnitudes
    that the file does not state (:func:`stated`); if only one position limit is missing, it is 0. ``acceleration``,
    ``deceleration`` and ``jerk`` are limits of URDF 1.2. ``motor_inertia`` is the inertia of the motor's rotor,
    reflected to the joint [kg m^2 or kg]; in a URDF of Drake's elements. ``has_motor``: an actuator of an MJCF file
    acts on the joint; ``reference`` is its position in the file's own configuration, in which the loops of the file are
    closed [rad or m].
    """

    # More than twelve fields: one for each entry of the element.
    name: str
    type: str
    parent: str
    child: str
    xyz: Vector
    orientation: Orientation
    axis: Vector
    lower: float
    upper: float
    velocity: float
    effort: float
    mimic: Mimic | None
    motor_inertia: float = 0.0
    has_motor: bool = False
    reference: float = 0.0
    acceleration: float = math.inf
    deceleration: float = math.inf
    jerk: float = math.inf


@dataclass(frozen=True)
class LoopEndElement:
    """Frame of a link at which a loop closes: position [m] and orientation in the link's frame."""

    link: str
    xyz: Vector
    orientation: Orientation = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LoopElement:
    """Constraint that closes a loop: the origins of two frames coincide and, for a weld, their axes too.

    ``text`` names the constraint and its ends, for messages; ``option`` is the text of ``--loop``, "" for a file's own.
    """

    text: str
    first: LoopEndElement
    second: LoopEndElement
    is_weld: bool = False
    option: str = ""


@dataclass(frozen=True)
class Problem:
    """Fault of a URDF file.

    ``element`` is "file", "joint NAME" or "link NAME". A problem of the file refuses every chain; a problem of a joint
    or link refuses only the chains whose result it can change. ``affects`` says which chains these are:

    - "place": the element lies on the chain or moves with it;
    - "motion" (axis, type): the joint does not stand at zero;
    - "bounds" (position, velocity, effort limit): the joint is a coordinate, or follows one;
    - "coupling" (mimic relation): the joint's mass would count if the joint moved with a coordinate;
    - "nothing": the element is a vendor's own and is ignored.

    ``is_type``: the type of a joint is missing or unknown; the joint's record says "fixed" in its place.
    """

    element: str
    text: str
    affects: Affects = "place"
    is_type: bool = False


@dataclass(frozen=True)
class Description:
    """Checked content of a robot's file.

    ``joints`` is keyed by joint name, ``inertials`` by link name (None for a link without inertia). ``digest`` is the
    SHA-256 of the file, ``inputs`` are the files that it includes, ``arguments`` the values of a template's arguments.
    ``notes`` name ignored elements of vendors; ``remarks`` name what the functions leave out (friction, springs).
    ``parameters`` are the arguments of a template with their defaults, None without one. ``accepted`` says by link why
    no rigid body has its inertia, which the user accepts.
    ``forces_at_rest`` are forces of springs, tendons and gravity compensation by joint, which the functions leave out
    [N m or N]. ``loops`` are the constraints that close loops; without --close-loops the functions leave them out, too.
    """

    # More than twelve fields: what one file says, each part read by another step of the selection.
    file: str
    digest: str
    robot: str
    inertials: dict[str, Inertial | None]
    joints: dict[str, JointElement]
    problems: tuple[Problem, ...]
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    loops: tuple[LoopElement, ...] = ()
    inputs: tuple[Input, ...] = ()
    arguments: tuple[tuple[str, str], ...] = ()
    forces_at_rest: Mapping[str, float] = field(default_factory=dict)
    accepted: Mapping[str, str] = field(default_factory=dict)
    is_mjcf: bool = False
    parameters: tuple[tuple[str, str | None], ...] = ()

    @property
    def links(self) -> tuple[str, ...]:
        """Link names in file order."""
        return tuple(self.inertials)

    @property
    def parent_joint(self) -> dict[str, JointElement]:
        """Joint above each link; the root has none."""
        return {joint.child: joint for joint in self.joints.values()}

    @property
    def root(self) -> str:
        """Link without a parent joint."""
        above = self.parent_joint
        return next(link for link in self.links if link not in above)

    @property
    def leaves(self) -> tuple[str, ...]:
        """Links without a child joint, in file order; tips are usually among them."""
        parents = {joint.parent for joint in self.joints.values()}
        return tuple(link for link in self.links if link not in parents)


@dataclass(frozen=True)
class Expansion:
    """URDF text of a template, the other files that went into it, warnings of xacro, and its arguments."""

    text: bytes
    inputs: tuple[Input, ...] = ()
    warnings: tuple[str, ...] = ()
    parameters: tuple[tuple[str, str | None], ...] = ()
