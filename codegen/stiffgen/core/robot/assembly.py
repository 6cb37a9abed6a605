# SPDX-License-Identifier: MIT
"""Assembly of a :class:`Chain` from a selection: poses of frames, inertias of bodies, records of joints."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

from stiffgen.core.family import needed, part
from stiffgen.core.names import identifier
from stiffgen.core.robot.chain import (
    BASE_JOINTS,
    AcceptedInertia,
    Chain,
    ChainOptions,
    ClosedLoop,
    Coordinate,
    Joint,
    MountedSensor,
    RigidBody,
    Tip,
    Tool,
    UnusedLimits,
)
from stiffgen.core.robot.description import Description, JointElement
from stiffgen.core.robot.geometry import IDENTITY, Inertia, Pose, Real, mpf
from stiffgen.core.robot.impossible import is_usable, nearest_possible
from stiffgen.core.robot.selection import Selection


def assemble(description: Description, options: ChainOptions, selection: Selection, reserved: Container[str]) -> Chain:
    """Return the chain of a selection; tips receive names that are not ``reserved``.

    An accepted inertia that no rigid body has is used as it is where the mass matrix stays positive definite. Else the
    nearest possible tensor takes its place.
    """
    chain = _assembled(description, options, selection, reserved)
    moving = dict.fromkeys(link for links in selection.carried.values() for link, _ in links)
    accepted = {link: fault for link, fault in description.accepted.items() if link in moving}
    if not accepted:
        return chain
    inertials = dict(description.inertials)
    for link in accepted:
        inertial = inertials[link]
        assert inertial is not None  # it was found impossible
        inertials[link] = replace(inertial, tensor=nearest_possible(inertial.tensor))
    nearest = _assembled(replace(description, inertials=inertials), options, selection, reserved)
    as_it_is = is_usable(chain, nearest)
    records = tuple(AcceptedInertia(link, fault, not as_it_is) for link, fault in accepted.items())
    return replace(chain if as_it_is else nearest, accepted=records)


def _assembled(
    description: Description, options: ChainOptions, selection: Selection, reserved: Container[str]
) -> Chain:
    """Return the chain with the inertias as they are in the description.

    On a floating base the base link comes before the moving joints in ``slides`` and ``inertias``.
    """
    tree = _JointTree(description, selection)
    slides = tree.slide_origins()  # moves the tree's poses, so that all below sees the slid frames
    tool = options.tool
    sensor = _sensor(description, options, selection, tree, slides)
    if selection.floating:
        slides = [Pose.identity(), *slides]
    inertias = _inertias(description, selection, slides)
    if tool is not None and options.masses:  # a tool has one tip
        inertias[tree.tip_joints[0] + selection.floating] += _tool_inertia(tool, tree.tip_poses[0])
    joints = [_joint(selection, tree, index, each) for index, each in enumerate(inertias[selection.floating :])]
    if selection.floating:
        joints = [*_base_joints(selection.base, inertias[0]), *map(_on_base, joints)]
    coordinates = tuple(_coordinate(description.joints[name], selection) for name in selection.masters)
    loops, actuated, start = _closed_loops(description, options, selection, coordinates)
    moving_links = [link for links in selection.carried.values() for link, _ in links]
    return Chain(
        robot=description.robot,
        base=selection.base,
        tips=_tips(selection, tree, tool, reserved),
        joints=tuple(joints),
        coordinates=coordinates,
        massless=tuple(link for link in moving_links if description.inertials[link] is None),
        source=description.file,
        digest=description.digest,
        masses=options.masses,
        runtime_tool=options.runtime_tool,
        tool=tool,
        locked=tuple(sorted((options.lock or {}).items())),
        floating=selection.floating,
        ignored=tuple(options.ignore),
        unused_limits=_unused_limits(description, selection),
        inputs=description.inputs,
        arguments=description.arguments,
        loops=loops,
        actuated=actuated,
        start=start,
        is_mjcf=description.is_mjcf,
        sensor=sensor,
    )


def _unused_limits(description: Description, selection: Selection) -> tuple[UnusedLimits, ...]:
    faults = {name: selection.couplings.exclusion(description.joints[name]) for name in selection.masters}
    return tuple(UnusedLimits(name, fault) for name, fault in faults.items() if fault)


def _closed_loops(
    description: Description, options: ChainOptions, selection: Selection, coordinates: tuple[Coordinate, ...]
) -> tuple[tuple[ClosedLoop, ...], tuple[int, ...], tuple[float, ...]]:
    """Return the closed loops with independent equations, the indices of the motors, and a start for closing them.

    The start is rounded: it has the same digits on every machine, and closing it takes one step.
    """
    if not selection.loops:
        return (), (), ()
    reading, linkages = part("loops.reading"), part("loops.linkage")
    base_joints = BASE_JOINTS if selection.floating else 0
    masters = list(selection.masters)
    loops = tuple(reading.build_loop(loop, selection.couplings, masters, base_joints) for loop in selection.loops)
    elements = [description.joints[name] for name in masters]
    motors = reading.wanted_motors(description.file, loops, elements, base_joints, options.motors)
    linkage = linkages.Linkage(description.file, loops, coordinates, base_joints)
    loops, actuated, start = linkage.study([each.reference for each in elements], motors)
    return loops, actuated, tuple(round(float(value), 6) + 0.0 for value in start)


def _tips(selection: Selection, tree: _JointTree, tool: Tool | None, reserved: Container[str]) -> tuple[Tip, ...]:
    """Return the tips with frames in the axes of their joints; the tool is part of the frame."""
    first = BASE_JOINTS if selection.floating else 0
    tool_pose = _tool_pose(tool)
    frames = [(pose @ tool_pose).rounded() for pose in tree.tip_poses]
    names = _tip_names(selection.tips, reserved)
    return tuple(
        Tip(link, name, joint + first, *frame)
        for link, name, joint, frame in zip(selection.tips, names, tree.tip_joints, frames, strict=True)
    )


def _sensor(
    description: Description, options: ChainOptions, selection: Selection, tree: _JointTree, slides: list[Pose]
) -> MountedSensor | None:
    """Return the force-torque sensor in its tip's frame; ``slides`` are those of ``slide_origins``."""
    if options.sensor is None:
        return None
    mounting = needed("sensor.mounting", "--sensor")
    name, pose = mounting.carrier(description, selection, options.sensor)
    carrying = [element.name for element in tree.moving].index(name)
    tool_pose = _tool_pose(options.tool)
    frames = [
        frame @ tool_pose if joint == carrying else None
        for joint, frame in zip(tree.tip_joints, tree.tip_poses, strict=True)
    ]
    pose = slides[carrying].inverse() @ pose
    sensor: MountedSensor = mounting.mounted(description.file, options.sensor, pose, selection.tips, frames)
    return sensor


def _tool_pose(tool: Tool | None) -> Pose:
    return Pose.identity() if tool is None else Pose.from_xyz_rpy(tool.xyz, tool.rpy)


def _tip_names(tips: Sequence[str], reserved: Container[str]) -> list[str]:
    """Return identifiers of the tips, numbered where two are equal or one is reserved; an only tip has none."""
    if len(tips) == 1:
        return [""]
    names: list[str] = []
    for tip in tips:
        name = first = identifier(tip)
        number = 2
        while name in names or name in reserved:
            name, number = f"{first}_{number}", number + 1
        names.append(name)
    return names


def _base_joints(base: str, inertia: Inertia) -> list[Joint]:
    """Return the six joints of a floating base; the last one carries the base link and all links fixed to it."""
    joints = []
    for index in range(BASE_JOINTS):
        x, y, z = (float(k == index % 3) for k in range(3))  # slides along x, y, z, then turns about them
        joints.append(
            Joint(
                name=f"base, {('along', 'about')[index // 3]} {'xyz'[index % 3]}",
                type=("prismatic", "revolute")[index // 3],
                child=base,
                rotation=IDENTITY,
                translation=(0.0, 0.0, 0.0),
                axis=(x, y, z),
                body=_body(inertia if index == BASE_JOINTS - 1 else Inertia.zero()),
                parent=index - 1,
                coordinate=index,
            )
        )
    return joints


def _on_base(joint: Joint) -> Joint:
    """Return a joint with its indices shifted by the six joints of a floating base."""
    return replace(joint, parent=joint.parent + BASE_JOINTS, coordinate=joint.coordinate + BASE_JOINTS)


def _body(inertia: Inertia) -> RigidBody:
    mass, moment, ((xx, xy, xz), (_, yy, yz), (_, _, zz)) = inertia.rounded()
    return RigidBody(mass, moment, (xx, xy, xz, yy, yz, zz))


def _joint(selection: Selection, tree: _JointTree, index: int, inertia: Inertia) -> Joint:
    """Return joint number `index` of the tree, with the inertia of all that moves with it."""
    return selection.couplings.moving_joint(
        tree.moving[index],
        tree.poses[index],
        selection.masters,
        body=_body(inertia),
        parent=tree.parents[index],
    )


def _coordinate(element: JointElement, selection: Selection) -> Coordinate:
    """Return the entry of q that a joint leads, with the limits and reflected rotors of the joints that follow it."""
    couplings = selection.couplings
    rotors = [
        couplings[joint].multiplier ** 2 * joint.motor_inertia
        for joint in (*selection.moving, *selection.side)
        if couplings[joint].joint == element.name
    ]
    limited = couplings.limited(element)
    return Coordinate(
        name=element.name,
        type=element.type,
        lower=limited.lower,
        upper=limited.upper,
        velocity=limited.velocity,
        effort=limited.effort,
        motor_inertia=sum(rotors),
        acceleration=limited.acceleration,
        deceleration=limited.deceleration,
        jerk=limited.jerk,
    )


class _JointTree:
    """Parents and poses of the moving joints, and frames of the tips; the joints on the paths come first."""

    def __init__(self, description: Description, selection: Selection) -> None:
        """Place the joints of all paths, then side joints: parents and poses in the parent's frame."""
        self.moving = moving = (*selection.moving, *selection.side)
        self.on_paths = len(selection.moving)
        self.parents = [-1] * len(moving)
        self.poses = [Pose.identity()] * len(moving)  # in the parent joint's frame
        self.tip_joints: list[int] = []
        self.tip_poses: list[Pose] = []  # in the frame of the tip's joint
        self._index_of = {element.name: index for index, element in enumerate(moving)}
        for path in selection.paths:
            parent, pose = self._follow(selection, path)
            self.tip_joints.append(parent)
            self.tip_poses.append(pose)
        above = description.parent_joint
        for element in selection.side:  # beyond the base, so that the way up ends there
            upwards: list[JointElement] = [element]
            while upwards[-1].parent != selection.base:
                upwards.append(above[upwards[-1].parent])
            self._follow(selection, upwards[::-1])

    def _follow(self, selection: Selection, path: Sequence[JointElement]) -> tuple[int, Pose]:
        """Store parents and poses of a path's joints; return the last moving joint and the pose of the end there."""
        parent, pose = -1, Pose.identity()
        for element in path:
            index = self._index_of.get(element.name)
            if index is None:
                pose = pose @ selection.couplings.pose_at_rest(element)
                continue
            self.parents[index] = parent
            self.poses[index] = pose @ Pose.placed(element.xyz, element.orientation)
            parent, pose = index, Pose.identity()
        return parent, pose

    def slide_origins(self) -> list[Pose]:
        """Slide each joint's origin along its axis, by the component of the next joint's offset along the axis.

        The motion of the links does not change, since a rotation about an axis (or a translation along it) commutes
        with a shift along the axis. Offsets between origins on one axis vanish, as in arms whose shoulder, elbow or
        wrist axes intersect. Where a tree branches, the first branch to a tip decides.

        Returns:
            For each joint, the pose of its new frame in the old frame.

        """
        slides = [Pose.identity()] * len(self.moving)
        for index in reversed(range(len(self.moving))):  # children before their parents, whose offsets they change
            children = [child for child, parent in enumerate(self.parents) if parent == index]
            tips = [tip for tip, joint in enumerate(self.tip_joints) if joint == index]
            following = [self.poses[child] for child in children if child < self.on_paths]
            following += [self.tip_poses[tip] for tip in tips]
            if not following:
                continue  # side joint
            slide = slides[index] = Pose.translated(_slide(self.moving[index], following[0].translation))
            self.poses[index] = self.poses[index] @ slide
            for child in children:
                self.poses[child] = slide.inverse() @ self.poses[child]
            for tip in tips:
                self.tip_poses[tip] = slide.inverse() @ self.tip_poses[tip]
        return slides


def _slide(element: JointElement, offset: Sequence[Real]) -> Sequence[Real]:
    """Return the component of an offset along a joint's axis; for a prismatic joint, the whole offset."""
    if element.type == "prismatic":
        return offset
    axis = tuple(mpf(v) for v in element.axis)
    component = sum(a * o for a, o in zip(axis, offset, strict=True)) / sum(a * a for a in axis)
    return tuple(component * a for a in axis)


def _tool_inertia(tool: Tool, tip_link: Pose) -> Inertia:
    return Inertia.of_body(tool.mass, tool.inertia, tip_link @ Pose.translated(tool.com))


def _inertias(description: Description, selection: Selection, slides: list[Pose]) -> list[Inertia]:
    """Return the inertia of all links that each joint carries, with a floating base first.

    ``slides`` are the poses of the joints' frames in the joint frames of the URDF.
    """
    if not selection.carried:
        return [Inertia.zero() for _ in slides]
    inertias = []
    for links, slide in zip(selection.carried.values(), slides, strict=True):
        total = Inertia.zero()
        frames: dict[str, Pose] = {}
        for link, above in links:
            parent = slide.inverse() if above is None else frames[above.parent]
            frame = frames[link] = parent if above is None else parent @ selection.couplings.pose_at_rest(above)
            inertial = description.inertials[link]
            if inertial is not None:
                at_com = frame @ Pose.placed(inertial.com, inertial.orientation)
                total = total + Inertia.of_body(inertial.mass, inertial.tensor, at_com)
        inertias.append(total)
    return inertias
