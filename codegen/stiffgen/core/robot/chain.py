# SPDX-License-Identifier: MIT
"""Chain record: the moving joints between a base and its tips, as input of the symbolic modules.

A chain contains the effect of fixed joints, mimic relations and masses. Its users need no XML, files or trees of links.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from stiffgen.core.described import option, python_option, with_attributes
from stiffgen.core.errors import OptionError
from stiffgen.core.given import checked_words, plain, plain_record, shown
from stiffgen.core.robot.description import Input, Reading
from stiffgen.core.robot.geometry import Matrix, Vector

MAX_MOVING_JOINTS = 128
BASE_JOINTS = 6
"""Number of joints of a floating base: three slide along the base link's axes, three rotate about them."""


@dataclass(frozen=True)
class RigidBody:
    """Inertia of all links that move rigidly with one joint, in the joint's frame.

    Mass [kg], first moment m*c [kg m], inertia tensor about the frame's origin (ixx, ixy, ixz, iyy, iyz, izz)
    [kg m^2].
    """

    mass: float
    moment: Vector
    tensor: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Joint:
    """Moving joint of a chain.

    The joint's frame has the axes of the URDF's joint frame, but its origin may be another point of the joint's axis.

    Attributes:
        name: name of the joint.
        type: type of the joint in the URDF.
        child: child link.
        rotation: rotation of the joint's frame at zero position, in the parent joint's frame or the base link. Fixed
            joints between the two are included.
        translation: origin of the joint's frame at zero position, in the same frame [m].
        axis: unit axis in the joint's frame.
        body: inertia of all links that move with the joint.
        parent: index of the parent joint (the moving joint before this one), -1 for none.
        coordinate: index among the velocity coordinates: the index in q, plus six on a floating base.
        multiplier: factor of the entry of q in the joint's position; 1 unless the joint mimics.
        offset: constant part of the joint's position [rad or m]; 0 unless the joint mimics.

    """

    name: str
    type: str
    child: str
    rotation: Matrix
    translation: Vector
    axis: Vector
    body: RigidBody
    parent: int
    coordinate: int
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def prismatic(self) -> bool:
        """Whether the joint slides along its axis; otherwise the joint rotates about its axis."""
        return self.type == "prismatic"


@dataclass(frozen=True)
class Coordinate:
    """Entry of q: name, type and limits of a joint (rad or m, rad/s or m/s, N m or N; infinite if unset).

    ``motor_inertia`` is that of all motors that move with it, reflected to it [kg m^2 or kg]; 0 if the file has none.
    ``acceleration``, ``deceleration`` (per s^2) and ``jerk`` (per s^3) are limits of URDF 1.2, infinite without.
    """

    name: str
    type: str
    lower: float
    upper: float
    velocity: float
    effort: float
    motor_inertia: float = 0.0
    acceleration: float = math.inf
    deceleration: float = math.inf
    jerk: float = math.inf

    def range_within(self, reach: float) -> tuple[float, float]:
        """Return the part of the joint's range that lies within ``reach`` of zero [rad or m].

        Of a range that lies beyond the reach, return the part nearest zero, at most ``reach`` long. Both ends are
        within the joint's limits, and the lower one comes first.
        """
        if self.lower > reach:
            return self.lower, min(self.upper, self.lower + reach)
        if self.upper < -reach:
            return max(self.lower, self.upper - reach), self.upper
        return max(self.lower, -reach), min(self.upper, reach)


@dataclass(frozen=True)
class Tip:
    """Frame of a tip link, or of the tool mounted on it, in the frame of joint number ``joint`` [m].

    ``name`` is the prefix of the tip's functions; it is empty for a chain with one tip.
    """

    link: str
    name: str
    joint: int
    rotation: Matrix
    translation: Vector


@dataclass(frozen=True)
class Tool:
    """Tool mounted on the tip link: frame and inertia.

    Args:
        xyz: position of the tool frame in the tip link's frame [m].
        rpy: orientation of the tool frame in the tip link's frame, as in a URDF's ``<origin>`` [rad].
        mass: mass of the tool [kg], 0 for none.
        com: centre of mass in the tip link's frame [m].
        inertia: (ixx, ixy, ixz, iyy, iyz, izz) about the centre of mass in the tip link's axes [kg m^2].

    """

    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    mass: float = 0.0
    com: Vector = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Take numbers of NumPy, and arrays."""
        plain_record(self)


Sign = Literal["environment", "robot"]
"""Body whose wrench on the other one a force-torque sensor reports."""


@dataclass(frozen=True)
class Sensor:
    """Force-torque sensor that moves rigidly with a tip.

    Args:
        link: link that carries the sensor.
        xyz: origin of the sensor's frame in the link's frame [m].
        rpy: orientation of the sensor's frame in the link's frame, as in a URDF's ``<origin>`` [rad].
        sign: "environment" if the sensor reports the wrench that tool and environment apply to the robot, "robot" if
            it reports the opposite wrench.
        gravity: acceleration of free fall in base axes (world axes on a floating base) [m/s^2].

    """

    link: str
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    sign: Sign = "environment"
    gravity: Vector = (0.0, 0.0, -9.81)

    def __post_init__(self) -> None:
        """Take numbers of NumPy, and arrays."""
        plain_record(self)


@dataclass(frozen=True)
class MountedSensor:
    """Sensor of a chain, from the user's ``option``: its pose [m] in the frame of tip number ``tip``."""

    option: Sensor
    tip: int
    rotation: Matrix
    translation: Vector

    @property
    def text(self) -> str:
        """Place, sign and gravity in one line, without spaces after commas."""
        numbers = (*self.translation, *(entry for row in self.rotation for entry in row), *self.option.gravity)
        return f"{self.option.link} {self.option.sign} {','.join(f'{number:g}' for number in numbers)}"


@dataclass(frozen=True)
class AcceptedInertia:
    """Link whose inertia no rigid body has: the ``fault`` in words, and whether the nearest possible tensor is used."""

    link: str
    fault: str
    is_nearest: bool = False


@dataclass(frozen=True)
class UnusedLimits:
    """Coordinate that keeps its own position limits: those of joints that follow it leave no range (``fault``)."""

    joint: str
    fault: str


@dataclass(frozen=True)
class LoopEnd:
    """End of a loop: the joints that move the end relative to the last link that both ends share, and its frame.

    The pose of the first joint is that in the shared link's frame; ``rotation`` and ``translation`` [m] place the end
    in the frame of the last joint (of the shared link without joints).
    """

    joints: tuple[Joint, ...]
    rotation: Matrix
    translation: Vector


@dataclass(frozen=True)
class ClosedLoop:
    """Closed loop: two frames whose origins coincide and, for a weld, whose axes do too.

    ``rows`` are the independent equations: 0..2 are the distances of the origins along x, y, z of the shared link, 3..5
    the rotations between the frames about these axes. All other equations follow from them. ``option`` is the text of
    ``--loop`` that describes the loop, "" for a loop of the file.
    """

    name: str
    first: LoopEnd
    second: LoopEnd
    rows: tuple[int, ...]
    is_weld: bool = False
    option: str = ""


@dataclass(frozen=True, kw_only=True)
class ChainOptions(Reading):
    """Options that select a chain in a robot's file."""

    tip: str | Sequence[str] | None = option(
        "tip link; repeat it for several tips (default: the only leaf)",
        default=None,
        group="frames",
        metavar="LINK",
        action="append",
    )
    base: str | None = option(
        "first link of the chain (default: the root link)", default=None, group="frames", metavar="LINK"
    )
    floating_base: bool = option(
        "free the base: functions take its pose, its twist precedes the joint rates", default=False, group="frames"
    )
    lock: Mapping[str, float] | None = option(
        "hold a joint at a position [rad or m]; repeatable",
        default=None,
        group="robot",
        metavar="JOINT=VALUE",
        action="append",
    )
    close_loops: bool = option(
        "close the loops of an MJCF file: adds functions in motor coordinates", default=False, group="robot"
    )
    loop: Sequence[str] = option(
        "close a loop by LINK:X,Y,Z=LINK:X,Y,Z, two points of two links that coincide [m]; repeatable",
        default=(),
        group="robot",
        metavar="LINK:X,Y,Z=LINK:X,Y,Z",
        action="append",
    )
    actuated: str | Sequence[str] = option(
        "joints of closed loops with a motor, with commas (default: as in MJCF)",
        default=(),
        group="robot",
        metavar="JOINTS",
    )
    masses: bool = option(
        "generate the functions that need masses",
        default=True,
        negative="ignore masses; omit their functions",
        group="robot",
    )
    tool: Tool | None = option(
        "tool on the tip link by its properties, in the link's axes [SI units]; repeatable",
        default=None,
        group="tool",
        record=Tool,
        metavar="NAME=VALUE|runtime",
    )
    runtime_tool: bool = python_option("pass the tool's pose to the functions, as an argument after q", default=False)
    sensor: Sensor | None = option(
        "force-torque sensor: its link, rigidly connected to a tip, and properties in the link's axes [SI units]; "
        "repeatable",
        default=None,
        group="tool",
        record=Sensor,
        metavar="LINK|NAME=VALUE",
    )

    def __post_init__(self) -> None:
        """Take numbers of NumPy, and one word for the only one; refuse values of other types."""
        super().__post_init__()
        object.__setattr__(self, "loop", checked_words(self.loop, "--loop"))
        for name, words in (("tip", self.tip), ("base", self.base), ("actuated", self.actuated)):
            if words is not None:
                checked_words(words, f"--{name}")
        if self.lock is not None:
            is_complete = isinstance(self.lock, Mapping) and all(isinstance(name, str) for name in self.lock)
            if not is_complete:
                raise OptionError(f"--lock: takes a dict of joints and positions [rad or m], not {shown(self.lock)}")
            object.__setattr__(self, "lock", {name: plain(value) for name, value in self.lock.items()})
        records: tuple[tuple[str, Any, Any], ...] = (("tool", self.tool, Tool), ("sensor", self.sensor, Sensor))
        for name, record, kind in records:
            if record is not None and not isinstance(record, kind):
                raise OptionError(f"--{name}: takes a record stiffgen.{kind.__name__}(...), not {shown(record)}")

    @property
    def motors(self) -> tuple[str, ...]:
        """Joints of closed loops that have a motor."""
        return tuple(self.actuated.split(",") if isinstance(self.actuated, str) else self.actuated)


ChainOptions.__doc__ = with_attributes(ChainOptions)


@dataclass(frozen=True)
class Chain:
    """Kinematic chain from link ``base`` to a tip, or tree from ``base`` to several tips.

    A side joint is on no path to a tip but shares a coordinate with a path through ``<mimic>`` (the second finger of a
    gripper), or belongs to a closed loop: it moves masses but no tip.

    A floating base has six joints. Their unit rates form its body twist (linear first, in the base link's axes), their
    positions are always zero, and the last one carries the base link.

    Attributes:
        robot: name of the robot.
        base: base link.
        tips: tips.
        joints: moving joints, each after its parent: joints of a floating base, joints on the paths to the tips, then
            side joints.
        coordinates: entries of q, fewer than joints where joints mimic. The velocity coordinates are six for a floating
            base, then one per entry of q.
        massless: moving links without ``<inertial>``.
        source: name of the robot's file, without folder.
        digest: SHA-256 of the file.
        masses: False if the user excluded masses: then every body is zero, and only loops have side joints.
        runtime_tool: whether the kernels take the tool's pose in the tip's frame as an argument.
        tool: tool option, for the record; the other fields contain its effect.
        locked: locked joints and their positions, for the record; the other fields contain their effect.
        floating: whether the base floats, so that its pose is an argument.
        ignored: unknown elements and attributes that the user excluded from the checks.
        accepted: links on the chain with an impossible inertia that the user accepts.
        unused_limits: coordinates that keep their own position limits against joints that follow them.
        inputs: files that the file includes.
        arguments: values of a xacro template's arguments.
        loops: closed loops.
        actuated: indices of the motors' entries of q, in order; () without loops.
        is_mjcf: whether the file is an MJCF file.
        start: entries of q near a closed configuration, from which Newton's method closes the loops.
        sensor: force-torque sensor.

    """

    # More than twelve fields: all later stages read this record, and the manifest stores it.
    robot: str
    base: str
    tips: tuple[Tip, ...]
    joints: tuple[Joint, ...]
    coordinates: tuple[Coordinate, ...]
    massless: tuple[str, ...]
    source: str
    digest: str
    masses: bool = True
    runtime_tool: bool = False
    tool: Tool | None = None
    locked: tuple[tuple[str, float], ...] = ()
    floating: bool = False
    ignored: tuple[str, ...] = ()
    accepted: tuple[AcceptedInertia, ...] = ()
    unused_limits: tuple[UnusedLimits, ...] = ()
    inputs: tuple[Input, ...] = ()
    arguments: tuple[tuple[str, str], ...] = ()
    loops: tuple[ClosedLoop, ...] = ()
    actuated: tuple[int, ...] = ()
    start: tuple[float, ...] = ()
    is_mjcf: bool = False
    sensor: MountedSensor | None = None

    @property
    def motors(self) -> tuple[int, ...]:
        """Velocity coordinates of the motors: those of a floating base, then the actuated joints."""
        return (*range(self.base_coordinates), *(self.base_coordinates + k for k in self.actuated))

    @property
    def motor_coordinates(self) -> tuple[Coordinate, ...]:
        """Entries of q that a controller commands: the actuated ones, or all without closed loops."""
        return tuple(self.coordinates[k] for k in self.actuated) if self.loops else self.coordinates

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the entries of q, in their order."""
        return tuple(coordinate.name for coordinate in self.coordinates)

    @property
    def base_coordinates(self) -> int:
        """Number of velocity coordinates of a floating base: 6 or 0."""
        return BASE_JOINTS if self.floating else 0

    @property
    def base_joints(self) -> int:
        """Number of joints of a floating base: 6 or 0; 0 in a part of the robot that its base does not move."""
        return BASE_JOINTS if self.floating and self.joints and self.joints[0].coordinate < BASE_JOINTS else 0

    @property
    def dof(self) -> int:
        """Number of velocity coordinates: six for a floating base, plus the entries of q."""
        return self.base_coordinates + len(self.coordinates)

    @property
    def coupled(self) -> bool:
        """Whether joints and entries of q differ (mimic joints, or the branch of a tree)."""
        return len(self.joints) != self.dof or any(
            joint.coordinate != index or joint.multiplier != 1 or joint.offset != 0
            for index, joint in enumerate(self.joints)
        )

    @property
    def tip(self) -> str:
        """Link of the only tip."""
        return self._only_tip.link

    @property
    def tip_rotation(self) -> Matrix:
        """Rotation of the only tip in its joint's frame."""
        return self._only_tip.rotation

    @property
    def tip_translation(self) -> Vector:
        """Origin of the only tip in its joint's frame [m]."""
        return self._only_tip.translation

    @property
    def _only_tip(self) -> Tip:
        (tip,) = self.tips
        return tip

    def branch(self, *tips: Tip) -> Chain:
        """Return the chain of the joints on the paths to some tips, with unchanged coordinates and bodies."""
        on_paths = set(range(self.base_joints))
        for tip in tips:
            index = tip.joint
            while index >= 0:
                on_paths.add(index)
                index = self.joints[index].parent
        renumbered = {old: new for new, old in enumerate(sorted(on_paths))}
        joints = tuple(
            replace(self.joints[old], parent=renumbered.get(self.joints[old].parent, -1)) for old in renumbered
        )
        return replace(self, joints=joints, tips=tuple(replace(tip, joint=renumbered[tip.joint]) for tip in tips))

    def without_side_joints(self) -> Chain:
        """Return the chain of the joints on the paths to the tips."""
        return self.branch(*self.tips)
