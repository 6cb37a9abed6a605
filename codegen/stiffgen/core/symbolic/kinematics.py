# SPDX-License-Identifier: MIT
"""CasADi expressions of a chain's kinematics: pose, Jacobian columns, and the bracket form of dJ/dq.

The pose recursions name their intermediate results in sections (:class:`Section`), so that a reader can compare the
printed C with a drawing of the robot.

Units: metres, radians. A Jacobian column is the twist (v, w), linear first, at a unit rate of its joint:
body     v = velocity of the tip's origin, w, both in tip axes                  (Pinocchio: LOCAL)
spatial  v = velocity of the point passing the base's origin, w, in base axes   (Pinocchio: WORLD)
hybrid   v = velocity of the tip's origin, w, both in base axes                 (Pinocchio: LOCAL_WORLD_ALIGNED)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import casadi as ca

from stiffgen.core.robot.chain import Chain, Joint
from stiffgen.core.robot.geometry import Matrix, Vector, aligning_rotation
from stiffgen.core.symbolic.connection import Representation

_IDENTITY = ca.SX.eye(3)


class Kind(Enum):
    """Kind of a quantity, for bounds on its magnitude that do not follow from its operations."""

    NUMBER = "nothing is known"
    ROTATION = "entry of a rotation or of a unit vector: at most 1"
    POINT = "coordinate of a point of the chain, or an arm to one: at most the chain's reach"
    ZERO = "zero"
    ONE = "one"


@dataclass
class Section:
    """Titled group of named intermediate matrices of a pose recursion, in order of computation.

    ``kinds`` holds the kinds of those values whose kind is known, under the same names. A ``shared`` section names its
    values only where several formulas use them.
    """

    title: str
    values: dict[str, ca.SX] = field(default_factory=dict)
    kinds: dict[str, Kind] = field(default_factory=dict)
    shared: bool = False


@dataclass(frozen=True)
class Expressions:
    """Result and the sections of its computation; ``kinds`` holds the kinds of its entries, row-major, if known."""

    result: ca.SX
    sections: tuple[Section, ...]
    kinds: tuple[Kind, ...] = ()


FRAME = Kind.ROTATION, Kind.POINT
"""Kinds of a frame's rotation and origin."""

_POSE = (*(3 * (3 * (Kind.ROTATION,) + (Kind.POINT,))), Kind.ZERO, Kind.ZERO, Kind.ZERO, Kind.ONE)
"""Kinds of the entries of a pose."""


def constant(matrix: Matrix | Vector) -> ca.SX:
    """Return a matrix or column of numbers."""
    # Exact zeros become structural zeros, so that their products vanish from the graph.
    return ca.SX(ca.sparsify(ca.DM(matrix)))


def dense(x: ca.SX) -> ca.SX:
    """Return a matrix without structural zeros, itself if it has none: CasADi's densify takes its time for both."""
    return x if x.is_dense() else ca.densify(x)


def cross(a: ca.SX, b: ca.SX) -> ca.SX:
    """Return a x b of two 3-vectors."""
    return ca.cross(dense(a), dense(b))


def bracket(x: ca.SX, y: ca.SX) -> ca.SX:
    """Return the Lie bracket [x, y] of two twists (6) in se(3), linear first."""
    return ca.vertcat(cross(x[3:], y[:3]) + cross(x[:3], y[3:]), cross(x[3:], y[3:]))


def jacobian_column_derivative(
    representation: Representation, column: ca.SX, moving: ca.SX, *, moving_is_outward: bool
) -> ca.SX:
    """Return the derivative of a Jacobian column with respect to the position of another joint, in closed form.

    Args:
        representation: representation of both columns.
        column: column to differentiate.
        moving: column of the joint that moves.
        moving_is_outward: whether the moving joint is farther from the base than the joint of ``column``.

    A joint moves all links beyond it. Relative to the tip (body), only the joints nearer the base move; relative to the
    base (spatial), only the joints nearer the tip move; the hybrid representation combines both (Selig, Geometric
    Fundamentals of Robotics; Bruyninckx and De Schutter 1996).

    """
    if representation == "body":
        return bracket(column, moving) if moving_is_outward else ca.SX.zeros(6)
    if representation == "spatial":
        return ca.SX.zeros(6) if moving_is_outward else bracket(moving, column)
    if moving_is_outward:
        return ca.vertcat(cross(column[3:], moving[:3]), ca.SX.zeros(3))
    return ca.vertcat(cross(moving[3:], column[:3]), cross(moving[3:], column[3:]))


def joint_position(chain: Chain, joint: Joint, q: ca.SX) -> ca.SX:
    """Return the position of a joint [rad or m] at joint positions q; the joints of a floating base are at zero."""
    if joint.coordinate < chain.base_coordinates:
        return ca.SX(0)
    return joint.multiplier * q[joint.coordinate - chain.base_coordinates] + joint.offset


@dataclass(frozen=True)
class _Axis:
    """Joint axis as a coordinate axis of an auxiliary frame, which is the URDF frame unless the axis is oblique."""

    index: int  # 0, 1, 2: x, y, z
    sign: int
    align: Matrix | None  # rotation of the auxiliary frame in the joint's frame, None if they agree

    @staticmethod
    def of(joint: Joint) -> _Axis:
        has_one_entry = sum(map(bool, joint.axis)) == 1  # beside an entry of 1.0 may be a small tilt
        for index in range(3):
            if has_one_entry and joint.axis[index]:
                return _Axis(index, int(joint.axis[index]), None)
        return _Axis(2, 1, aligning_rotation(joint.axis))

    def rotation(self, c: ca.SX, s: ca.SX) -> ca.SX:
        """Return the rotation about the axis by the angle with this cosine and sine."""
        matrix = ca.SX(3, 3)
        i, j, k = self.index, (self.index + 1) % 3, (self.index + 2) % 3
        matrix[i, i] = 1
        matrix[j, j] = matrix[k, k] = c
        matrix[k, j], matrix[j, k] = (s, -s) if self.sign > 0 else (-s, s)
        return matrix


class PoseRecursion:
    """Shared parts of outward and inward pose recursions: sines and cosines of the joint angles, and named frames.

    Each joint has ``positions`` [rad or m], ``axes``, and ``rotations`` about its axis; None for a joint that turns
    nothing.
    """

    def __init__(self, chain: Chain, q: ca.SX) -> None:
        self.chain = chain
        self.positions = [joint_position(chain, joint, q) for joint in chain.joints]
        self.axes = [_Axis.of(joint) for joint in chain.joints]
        self.sections: list[Section] = []
        trig = Section("sine and cosine of each joint angle")
        self.rotations: list[ca.SX | None] = []
        for index, joint in enumerate(chain.joints):
            if joint.prismatic or index < chain.base_joints:  # they turn nothing: a floating base's joints are at zero
                self.rotations.append(None)
                continue
            s, c = ca.sin(self.positions[index]), ca.cos(self.positions[index])
            trig.values[f"s{index}"], trig.values[f"c{index}"] = s, c
            self.rotations.append(self.axes[index].rotation(c, s))
        if trig.values:
            self.sections.append(trig)

    def frame(self, index: int, axes: str, rotation: ca.SX, translation: ca.SX) -> None:
        """Add a section for a joint's frame, with entries R<index>_ij and p<index>_i in base or tip axes."""
        title = f"{frame_title(self.chain, index)}: rotation R{index}, origin p{index}, in {axes} axes"
        values = {f"R{index}_": ca.densify(rotation), f"p{index}_": ca.densify(translation)}
        self.sections.append(Section(title, values, dict(zip(values, FRAME, strict=True))))

    def rotation_in_parent(self, index: int) -> ca.SX:
        """Return the rotation of a joint's auxiliary frame at zero position, in the parent joint's frame."""
        joint, align = self.chain.joints[index], self.axes[index].align
        rotation = constant(joint.rotation)
        return rotation if align is None else rotation @ constant(align)

    def rotation_to_urdf_frame(self, index: int) -> ca.SX:
        """Return the constant rotation from a joint's auxiliary frame to its URDF frame."""
        align = self.axes[index].align
        return _IDENTITY if align is None else constant(align).T

    def axis(self, index: int, rotation: ca.SX) -> ca.SX:
        """Return the axis of a joint from the rotation of its auxiliary frame."""
        return ca.densify(self.axes[index].sign * rotation[:, self.axes[index].index])


Frame = tuple[ca.SX, ca.SX, ca.SX]
"""Frame of a moving joint, in base axes: rotation of its URDF frame (3x3), a point on its axis [m], its axis."""


@dataclass(frozen=True)
class Configuration:
    """Configuration of a tip: q, pose of a floating base, and pose of a tool at run time."""

    q: ca.SX
    base_pose: ca.SX | None = None
    tool_pose: ca.SX | None = None

    @staticmethod
    def of(chain: Chain, arguments: Sequence[ca.SX], *, seen_from_tip: bool = False) -> Configuration:
        """Return the configuration of arguments in the order of ``configuration_arguments``.

        The tool pose may be absent. With ``seen_from_tip``, the base pose is absent.
        """
        values = list(arguments)
        base_pose = values.pop(0) if chain.base_joints and not seen_from_tip else None
        return Configuration(values[0], base_pose, values[1] if len(values) > 1 else None)

    @property
    def base(self) -> tuple[ca.SX, ca.SX]:
        """Rotation and origin of the base link in the frame of reference."""
        if self.base_pose is None:
            return _IDENTITY, ca.SX.zeros(3)
        return self.base_pose[:3, :3], self.base_pose[:3, 3]


def outward_frames(chain: Chain, configuration: Configuration) -> tuple[PoseRecursion, list[Frame]]:
    """Return the recursion and the frames of all moving joints, from the base outwards."""
    r = PoseRecursion(chain, configuration.q)
    base_rotation, base_origin = configuration.base
    frames: list[Frame] = [(base_rotation, base_origin, base_rotation[:, k % 3]) for k in range(chain.base_joints)]
    for index, joint in enumerate(chain.joints[chain.base_joints :], start=chain.base_joints):
        rotation, origin, _ = frames[joint.parent] if joint.parent >= 0 else (base_rotation, base_origin, None)
        origin = origin + rotation @ constant(joint.translation)
        auxiliary = rotation @ r.rotation_in_parent(index)  # at the joint's zero position
        axis = r.axis(index, auxiliary)
        turn = r.rotations[index]
        if turn is None:
            origin = origin + axis * r.positions[index]
        else:
            auxiliary = auxiliary @ turn
        r.frame(index, "base", auxiliary, origin)
        frames.append((auxiliary @ r.rotation_to_urdf_frame(index), origin, axis))
    return r, frames


def _tip_in_joint(chain: Chain, tool_pose: ca.SX | None) -> tuple[ca.SX, ca.SX]:
    """Return rotation and origin of the tip, or of the tool mounted there, in the last joint's frame."""
    rotation, origin = constant(chain.tip_rotation), constant(chain.tip_translation)
    if tool_pose is None:
        return rotation, origin
    return rotation @ tool_pose[:3, :3], origin + rotation @ tool_pose[:3, 3]


def _tip_in_base(chain: Chain, frames: list[Frame], tool_pose: ca.SX | None) -> tuple[ca.SX, ca.SX]:
    """Return rotation and origin of the tip, or of the tool mounted there, in base axes; the last frame carries it."""
    rotation, origin, _ = frames[-1]
    tip_rotation, tip_origin = _tip_in_joint(chain, tool_pose)
    return ca.densify(rotation @ tip_rotation), ca.densify(origin + rotation @ tip_origin)


def frame_title(chain: Chain, index: int) -> str:
    """Return the title of the section of a joint's frame."""
    return f"frame of joint {chain.joints[index].name}"


def spatial_column(joint: Joint, origin: ca.SX, axis: ca.SX) -> ca.SX:
    """Return the twist (6) at the frame's origin, at a unit rate of a joint whose axis passes through ``origin``."""
    if joint.prismatic:
        return ca.vertcat(axis, ca.SX.zeros(3))
    return ca.vertcat(cross(origin, axis), axis)


def forward_kinematics(chain: Chain, *arguments: ca.SX) -> Expressions:
    """Return the pose (4x4, metres) of the tip, or of the tool mounted there, in the base frame."""
    configuration = Configuration.of(chain, arguments)
    r, frames = outward_frames(chain, configuration)
    rotation, tip = _tip_in_base(chain, frames, configuration.tool_pose)
    return Expressions(_pose(rotation, tip), tuple(r.sections), _POSE)


def _pose(rotation: ca.SX, origin: ca.SX) -> ca.SX:
    return ca.densify(ca.vertcat(ca.horzcat(rotation, origin), ca.SX([[0, 0, 0, 1]])))


def joint_jacobian(chain: Chain, *arguments: ca.SX, representation: Representation) -> Expressions:
    """Return the Jacobian (6 x number of joints): one column per moving joint, mimic joints included."""
    if representation == "body":
        return _body_jacobian(chain, Configuration.of(chain, arguments, seen_from_tip=True))
    configuration = Configuration.of(chain, arguments)
    r, frames = outward_frames(chain, configuration)
    _, tip = _tip_in_base(chain, frames, configuration.tool_pose)
    if representation == "hybrid":
        r.sections.append(Section("tip's origin p, in base axes", {"p_": tip}, {"p_": Kind.POINT}))
    return Expressions(_outward_columns(chain, frames, tip, representation), tuple(r.sections), _kinds(chain))


def hybrid_jacobian_and_pose(chain: Chain, *arguments: ca.SX) -> Expressions:
    """Return the tip's hybrid Jacobian (6 x number of joints) and pose (4x4): row-major entries, stacked."""
    configuration = Configuration.of(chain, arguments)
    r, frames = outward_frames(chain, configuration)
    rotation, tip = _tip_in_base(chain, frames, configuration.tool_pose)
    r.sections.append(Section("tip's origin p, in base axes", {"p_": tip}, {"p_": Kind.POINT}))
    columns = _outward_columns(chain, frames, tip, "hybrid")
    result = ca.vertcat(ca.vec(columns.T), ca.vec(_pose(rotation, tip).T))
    return Expressions(result, tuple(r.sections), (*_kinds(chain), *_POSE))


def _kinds(chain: Chain) -> tuple[Kind, ...]:
    """Return the kinds of the entries of Jacobian columns, row-major."""
    linear = [Kind.ROTATION if joint.prismatic else Kind.POINT for joint in chain.joints]
    return (*(3 * linear), *(3 * len(linear) * [Kind.ROTATION]))


def _outward_columns(chain: Chain, frames: list[Frame], tip: ca.SX, representation: Representation) -> ca.SX:
    """Return spatial or hybrid columns (6 x number of joints); ``tip`` is the tip's origin in base axes [m]."""
    columns = []
    for joint, (_, origin, axis) in zip(chain.joints, frames, strict=True):
        if representation == "spatial":
            columns.append(spatial_column(joint, origin, axis))
        elif joint.prismatic:
            columns.append(ca.vertcat(axis, ca.SX.zeros(3)))
        else:
            columns.append(ca.vertcat(cross(axis, tip - origin), axis))
    return ca.densify(ca.horzcat(*columns))


def _body_jacobian(chain: Chain, configuration: Configuration) -> Expressions:
    """Return the body Jacobian, by a recursion from the tip to the base.

    (rotation, origin) is the pose in the tip's frame: first of the last joint's URDF frame, then, joint by joint, of
    the parent's, at last of the base link.
    """
    r = PoseRecursion(chain, configuration.q)
    tip_rotation, tip_origin = _tip_in_joint(chain, configuration.tool_pose)
    rotation = tip_rotation.T
    origin = -(rotation @ tip_origin)
    columns: list[ca.SX] = []  # from the tip to the base
    for index in reversed(range(chain.base_joints, len(chain.joints))):
        joint = chain.joints[index]
        auxiliary = rotation @ r.rotation_to_urdf_frame(index).T
        axis = r.axis(index, auxiliary)
        r.frame(index, "tip", auxiliary, origin)
        columns.append(spatial_column(joint, origin, axis))  # in the tip's frame instead of the base's
        turn = r.rotations[index]
        if turn is None:
            origin = origin - axis * r.positions[index]
        else:
            auxiliary = auxiliary @ turn.T
        rotation = auxiliary @ r.rotation_in_parent(index).T
        origin = origin - rotation @ constant(joint.translation)
    base_joints = chain.joints[: chain.base_joints]
    if base_joints:
        values = {"Rb_": ca.densify(rotation), "pb_": ca.densify(origin)}
        kinds = dict(zip(values, FRAME, strict=True))
        r.sections.append(Section("base link: rotation Rb, origin pb, in tip axes", values, kinds))
    for k, joint in reversed(list(enumerate(base_joints))):
        columns.append(spatial_column(joint, origin, rotation[:, k % 3]))
    return Expressions(ca.densify(ca.horzcat(*reversed(columns))), tuple(r.sections), _kinds(chain))


def in_base_axes(base_pose: ca.SX, vectors: ca.SX) -> ca.SX:
    """Return an acceleration (3), a wrench (6) or one wrench per row (tips, 6) in the axes of a floating base."""
    rows = ca.densify(vectors).T
    turned = base_pose[:3, :3].T @ ca.reshape(rows, 3, rows.numel() // 3)
    return ca.reshape(turned, *rows.shape).T
