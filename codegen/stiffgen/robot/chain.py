# SPDX-License-Identifier: MIT
"""Chain record: the moving joints between a base and its tips, ready for the symbolic modules.

Fixed joints, mimic relations and masses are folded in; users of a chain see no XML, no files and no trees of links.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from stiffgen.robot.geometry import Matrix, Vector

MAX_MOVING_JOINTS = 128
BASE_JOINTS = 6
"""Number of joints of a floating base: three slide along the base link's axes, three turn about them."""


@dataclass(frozen=True)
class Body:
    """Inertia of everything that moves rigidly with one joint, in the joint's frame.

    Mass [kg], first moment m*c [kg m], inertia tensor about the frame's origin (ixx, ixy, ixz, iyy, iyz, izz)
    [kg m^2].
    """

    mass: float
    moment: Vector
    tensor: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Joint:
    """Moving joint of a chain.

    ``rotation`` and ``translation`` [m] are the pose of the joint's frame (at zero position) in the frame of the moving
    joint before it, or in the base link; fixed joints between the two are folded in. The frame has the axes of the
    URDF's joint frame, but its origin is slid to another point of the joint's axis. ``axis`` is the unit axis in the
    joint's frame. ``parent`` is the index of the moving joint before it, -1 for none. The joint stands at
    ``multiplier`` times its entry of q, plus ``offset`` (1 and 0 unless it mimics). ``coordinate`` is its index among
    the velocity coordinates: the index in q, plus six on a floating base.
    """

    name: str
    type: str
    child: str
    rotation: Matrix
    translation: Vector
    axis: Vector
    body: Body
    parent: int
    coordinate: int
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def prismatic(self) -> bool:
        """Whether the joint slides along its axis; otherwise it turns about it."""
        return self.type == "prismatic"


@dataclass(frozen=True)
class Coordinate:
    """Entry of q: a joint's name, type and limits (rad or m, rad/s or m/s, N m or N; infinite if unset)."""

    name: str
    type: str
    lower: float
    upper: float
    velocity: float
    effort: float


@dataclass(frozen=True)
class Tip:
    """Frame of a tip link, or of the tool mounted on it, in the frame of joint number ``joint`` [m].

    ``name`` is the identifier of the tip's functions; the only tip of a chain has an empty name.
    """

    link: str
    name: str
    joint: int
    rotation: Matrix
    translation: Vector


@dataclass(frozen=True)
class Tool:
    """Tool mounted on the tip link: its frame and its inertia.

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


@dataclass(frozen=True)
class ChainOptions:
    """Options that select a chain in a description; :func:`stiffgen.load_chain` documents each."""

    tip: str | Sequence[str] | None = None
    base: str | None = None
    masses: bool = True
    tool: Tool | None = None
    runtime_tool: bool = False
    lock: Mapping[str, float] | None = None
    floating_base: bool = False
    ignore: tuple[str, ...] = ()


@dataclass(frozen=True)
class Chain:
    """Kinematic chain from link ``base`` to a tip, or tree from ``base`` to several tips.

    ``joints`` are the moving joints, each after its parent: first those on the paths to the tips, then side joints.
    A side joint is off all paths and shares a coordinate with a path through ``<mimic>`` (the other finger of a
    gripper): it moves masses and no tip. ``coordinates`` are the entries of q (fewer than joints where joints mimic).
    ``massless`` names the links on the moving part that have no ``<inertial>``, ``ignored`` the unknown elements of the
    file that were not to refuse it. If ``masses`` is False, all masses were
    left out on request: every body is zero, and there are no side joints. With ``runtime_tool`` the kernels take the
    tool's pose in the tip's frame as an argument. ``tool`` and ``locked`` (joint name, position) record the options;
    their effect is contained in the other fields. ``source`` is the URDF's file name without its folder, ``digest`` the
    SHA-256 of its bytes.

    If ``floating``, the base is free and its pose an argument. The first six joints are then the base's own: their unit
    rates are its body twist (linear first, in the base link's axes), their positions are always zero, and the last one
    carries the base link. Their velocity coordinates come first, then those of ``coordinates``.
    """

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

    @property
    def base_joints(self) -> int:
        """Number of joints of a floating base: 6 or 0."""
        return BASE_JOINTS if self.floating else 0

    @property
    def dof(self) -> int:
        """Number of velocity coordinates: entries of q, and six of a floating base before them."""
        return self.base_joints + len(self.coordinates)

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
        """Return the chain of the joints on the paths to some tips, with the coordinates and bodies of the whole."""
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
