"""URDF -> :class:`Chain`: the moving joints between a base and a tip link, ready for the symbolic modules.

Fixed joints, mimic relations and the masses that ride on each joint are folded in here; what follows knows
nothing of XML, files or trees.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stiffgen.description import MOVING_TYPES, Description, JointElement, read_description
from stiffgen.errors import ChainError, DescriptionError
from stiffgen.geometry import Inertia, Matrix, Placement, Vector, mpf, rounded

MAX_MOVING_JOINTS = 128


@dataclass(frozen=True)
class Body:
    """Everything that moves rigidly with one joint, in the joint's frame: mass [kg], first moment m*c [kg m],
    inertia tensor about the frame's origin (ixx, ixy, ixz, iyy, iyz, izz) [kg m^2].
    """

    mass: float
    moment: Vector
    tensor: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Joint:
    """A moving joint of the chain.

    ``rotation`` and ``translation`` [m] place the joint's frame (at zero position) in the frame of the moving
    joint before it, or in the base link; fixed joints between are folded in. The frame has the axes of the URDF's
    joint frame, but its origin is slid to another point of the joint's axis (:func:`_slide_origins`). ``axis`` is
    the unit axis in the joint's frame. The joint stands at ``multiplier * q[coordinate] + offset`` (1 and 0 unless
    it mimics).
    """

    name: str
    type: str
    child: str
    rotation: Matrix
    translation: Vector
    axis: Vector
    body: Body
    coordinate: int
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def prismatic(self) -> bool:
        """Whether the joint slides along its axis; else it turns about it."""
        return self.type == "prismatic"


@dataclass(frozen=True)
class Coordinate:
    """One entry of q: a joint's name, type and limits (rad or m, rad/s or m/s, N m or N; infinite if unset)."""

    name: str
    type: str
    lower: float
    upper: float
    velocity: float
    effort: float


@dataclass(frozen=True)
class Chain:
    """A kinematic chain from link ``base`` to link ``tip``.

    ``joints`` are the moving joints in order; ``coordinates`` are the entries of q (fewer than joints where
    joints mimic). ``tip_rotation`` and ``tip_translation`` place the tip link in the last joint's frame.
    ``massless`` names the links on the moving part that have no ``<inertial>``. ``source`` is the URDF's file
    name without its folder, ``digest`` the SHA-256 of its bytes.
    """

    robot: str
    base: str
    tip: str
    joints: tuple[Joint, ...]
    coordinates: tuple[Coordinate, ...]
    tip_rotation: Matrix
    tip_translation: Vector
    massless: tuple[str, ...]
    source: str
    digest: str

    @property
    def dof(self) -> int:
        """Number of entries of q."""
        return len(self.coordinates)

    @property
    def coupled(self) -> bool:
        """Whether joints and entries of q differ (mimic joints)."""
        return any(
            joint.coordinate != index or joint.multiplier != 1 or joint.offset != 0
            for index, joint in enumerate(self.joints)
        )


def load_chain(urdf: str | Path, *, tip: str | None = None, base: str | None = None) -> Chain:
    """Read the chain between two links of a URDF file.

    Args:
        urdf: path of the URDF file. Meshes are not needed and not opened.
        tip: link at the end of the chain; its frame is where the wrench acts. May be left out if the robot has
            a single leaf link.
        base: link at the start of the chain, an ancestor of the tip; default: the root link.

    Returns:
        The chain; q holds its moving joints from base to tip, a mimic joint following its master's entry.

    Raises:
        DescriptionError: the file cannot be used (all problems that concern this chain are named).
        ChainError: no such link, no moving joint between base and tip, or a joint type that has no coordinate.

    """
    return chain_between(read_description(urdf), tip=tip, base=base)


def chain_between(description: Description, *, tip: str | None = None, base: str | None = None) -> Chain:
    """:func:`load_chain` on a description that has been read already."""
    file = description.file
    tip = _tip(description, tip)
    base = description.root if base is None else base
    if base not in description.inertials:
        raise ChainError(f"{file}: base link '{base}' does not exist; valid names: {_listed(description.links)}")
    path = _path(description, base, tip)
    for element in path:
        if element.type in ("floating", "planar"):
            raise ChainError(
                f"{file}: joint '{element.name}' between '{base}' and '{tip}' is {element.type}, which has no single "
                f"coordinate; choose a base behind it: --base {element.child}"
            )
    moving = [element for element in path if element.type in MOVING_TYPES]
    if not moving:
        raise ChainError(
            f"{file}: no moving joint between base '{base}' and tip '{tip}'; "
            f"choose another tip, leaf links: {_listed(description.leaves)}"
        )
    if len(moving) > MAX_MOVING_JOINTS:
        raise ChainError(
            f"{file}: {len(moving)} moving joints between '{base}' and '{tip}', more than {MAX_MOVING_JOINTS}; "
            "choose a nearer base"
        )
    couplings = [_coupling(description, element) for element in moving]
    masters = list(dict.fromkeys(master.name for master, _, _ in couplings))
    carried = _carried(description, path)
    _refuse_problems(description, path, couplings, carried)

    placements = [Placement.identity()]  # of each joint's frame in the one before; the last is the tip's
    for element in path:
        placements[-1] = placements[-1] @ Placement.from_xyz_rpy(element.xyz, element.rpy)
        if element.type in MOVING_TYPES:
            placements.append(Placement.identity())
    placements, slides = _slide_origins(moving, placements)

    joints = []
    for element, placement, slide, coupling in zip(moving, placements, slides, couplings, strict=False):
        rotation, translation = placement.rounded()
        master, multiplier, offset = coupling
        joints.append(
            Joint(
                name=element.name,
                type=element.type,
                child=element.child,
                rotation=rotation,
                translation=translation,
                axis=element.axis,
                body=_body(description, carried[element.name], slide.inverse()),
                coordinate=masters.index(master.name),
                multiplier=multiplier,
                offset=offset,
            )
        )
    tip_rotation, tip_translation = placements[-1].rounded()
    on_moving_part = [link for element in moving for link, _ in carried[element.name]]
    return Chain(
        robot=description.robot,
        base=base,
        tip=tip,
        joints=tuple(joints),
        coordinates=tuple(_coordinate(description.joints[name]) for name in masters),
        tip_rotation=tip_rotation,
        tip_translation=tip_translation,
        massless=tuple(link for link in on_moving_part if description.inertials[link] is None),
        source=file,
        digest=description.digest,
    )


def _slide_origins(moving: list[JointElement], placements: list[Placement]) -> tuple[list[Placement], list[Placement]]:
    """Move each joint's origin along its axis as far as the next one's offset reaches in that direction.

    Nothing moves physically: a turn about an axis (or a slide along it) commutes with a shift along it. Offsets
    that only place a frame on its axis vanish, as in the arms whose shoulder, elbow and wrist axes meet.

    Returns:
        The new placements, and for each joint its new frame in the old one.

    """
    placements = list(placements)
    slides = []
    for index in reversed(range(len(moving))):
        following = placements[index + 1]
        offset = following.translation
        if moving[index].type == "prismatic":
            shift = offset
        else:
            axis = tuple(mpf(v) for v in moving[index].axis)
            along = sum(a * o for a, o in zip(axis, offset, strict=True)) / sum(a * a for a in axis)
            shift = tuple(along * a for a in axis)
        slide = Placement.translated(shift)
        slides.append(slide)
        placements[index] = placements[index] @ slide
        placements[index + 1] = slide.inverse() @ following
    return placements, slides[::-1]


def _tip(description: Description, tip: str | None) -> str:
    leaves = _listed(description.leaves)
    if tip is None:
        if len(description.leaves) != 1:
            raise ChainError(f"{description.file}: has several leaf links; choose one with --tip: {leaves}")
        return description.leaves[0]
    if tip not in description.inertials:
        raise ChainError(
            f"{description.file}: tip link '{tip}' does not exist; leaf links: {leaves} "
            "('stiffgen inspect' lists all links)"
        )
    return tip


def _path(description: Description, base: str, tip: str) -> list[JointElement]:
    above = description.parent_joint
    path: list[JointElement] = []
    link = tip
    while link != base:
        if link not in above:
            ancestors = [element.parent for element in reversed(path)]
            raise ChainError(
                f"{description.file}: base '{base}' is no ancestor of tip '{tip}'; "
                f"possible bases: {_listed(ancestors) or '(none)'}"
            )
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


def _coupling(description: Description, element: JointElement) -> tuple[JointElement, float, float]:
    """Follow mimics to the master: position = multiplier * q[master] + offset."""
    multiplier, offset = 1.0, 0.0
    while element.mimic is not None:
        offset += multiplier * element.mimic.offset
        multiplier *= element.mimic.multiplier
        element = description.joints[element.mimic.joint]
    return element, multiplier, offset


def _carried(description: Description, path: list[JointElement]) -> dict[str, list[tuple[str, Placement]]]:
    """Links that move rigidly with each moving joint of the chain, placed in the joint's frame.

    Joints off the chain are held at zero, so a gripper's fingers count as payload.
    """
    children: dict[str, list[JointElement]] = {}
    for element in description.joints.values():
        children.setdefault(element.parent, []).append(element)
    moving = {element.name for element in path if element.type in MOVING_TYPES}
    carried: dict[str, list[tuple[str, Placement]]] = {}
    for element in path:
        if element.name not in moving:
            continue
        links = carried.setdefault(element.name, [])
        stack = [(element.child, Placement.identity())]
        while stack:
            link, frame = stack.pop()
            links.append((link, frame))
            for below in reversed(children.get(link, [])):
                if below.name not in moving:
                    stack.append((below.child, frame @ _at_zero(description, below)))
    return carried


def _at_zero(description: Description, element: JointElement) -> Placement:
    placement = Placement.from_xyz_rpy(element.xyz, element.rpy)
    if element.mimic is None or element.type not in MOVING_TYPES:
        return placement
    _, _, position = _coupling(description, element)
    if element.type == "prismatic":
        return placement @ Placement.translated([position * v for v in element.axis])
    return placement @ Placement.rotation_about(element.axis, position)


def _body(description: Description, links: list[tuple[str, Placement]], joint_frame: Placement) -> Body:
    """Everything that a joint carries; ``joint_frame`` is the URDF's joint frame in the joint's own."""
    total = Inertia.zero()
    for link, frame in links:
        inertial = description.inertials[link]
        if inertial is not None:
            at_com = joint_frame @ frame @ Placement.from_xyz_rpy(inertial.com, inertial.rpy)
            total = total + Inertia.of_body(inertial.mass, inertial.tensor, at_com)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = total.tensor
    mass, x, y, z, *tensor = (rounded(v) for v in (total.mass, *total.moment, xx, xy, xz, yy, yz, zz))
    return Body(mass, (x, y, z), (tensor[0], tensor[1], tensor[2], tensor[3], tensor[4], tensor[5]))


def _refuse_problems(
    description: Description,
    path: list[JointElement],
    couplings: list[tuple[JointElement, float, float]],
    carried: dict[str, list[tuple[str, Placement]]],
) -> None:
    used = {f"joint {element.name}" for element in path}
    used |= {f"joint {master.name}" for master, _, _ in couplings}
    above = description.parent_joint
    for links in carried.values():
        used |= {f"link {link}" for link, _ in links}
        used |= {f"joint {above[link].name}" for link, _ in links}
    problems = [problem.text for problem in description.problems if problem.element in used]
    if problems:
        raise DescriptionError(description.file, problems)


def _coordinate(element: JointElement) -> Coordinate:
    return Coordinate(
        name=element.name,
        type=element.type,
        lower=element.lower,
        upper=element.upper,
        velocity=element.velocity,
        effort=element.effort,
    )


def _listed(names: tuple[str, ...] | list[str], most: int = 20) -> str:
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
