"""URDF -> :class:`Chain`: the moving joints between a base and a tip link, ready for the symbolic modules.

Fixed joints, mimic relations and the masses that ride on each joint are folded in here; what follows knows
nothing of XML, files or trees.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stiffgen.description import LARGEST, MOVING_TYPES, Description, JointElement, read_description
from stiffgen.errors import ChainError, DescriptionError, listed, printable
from stiffgen.geometry import Inertia, Matrix, Placement, Vector, exact, mpf, rounded

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
    ``massless`` names the links on the moving part that have no ``<inertial>``. Where ``masses`` is False, all
    masses were left out on request: every body is zero, and a mass matrix would be meaningless. ``source`` is the
    URDF's file name without its folder, ``digest`` the SHA-256 of its bytes.
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
    masses: bool = True

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


def load_chain(urdf: str | Path, *, tip: str | None = None, base: str | None = None, masses: bool = True) -> Chain:
    """Read the chain between two links of a URDF file.

    Args:
        urdf: path of the URDF file. Meshes are not needed and not opened.
        tip: link at the end of the chain; its frame is where the wrench acts. May be left out if the robot has
            a single leaf link.
        base: link at the start of the chain, an ancestor of the tip; default: the root link.
        masses: False leaves out all masses, and with them everything that the file says of links and joints
            beside the chain: for files whose inertias are wrong, if no mass matrix is wanted.

    Returns:
        The chain; q holds its moving joints from base to tip, a mimic joint following its master's entry.

    Raises:
        DescriptionError: the file cannot be used (all problems that concern this chain are named).
        ChainError: no such link, no moving joint between base and tip, or a joint type that has no coordinate.

    """
    return chain_between(read_description(urdf), tip=tip, base=base, masses=masses)


def chain_between(
    description: Description, *, tip: str | None = None, base: str | None = None, masses: bool = True
) -> Chain:
    """:func:`load_chain` on a description that has been read already."""
    file = description.file
    tip = _tip(description, tip)
    base = description.root if base is None else base
    if base not in description.inertials:
        raise ChainError(
            f"{file}: base link '{printable(base)}' does not exist; valid names: {listed(description.links)}"
        )
    path = _path(description, base, tip)
    between = f"between '{printable(base)}' and '{printable(tip)}'"
    for element in path:
        if element.type in ("floating", "planar"):
            raise ChainError(
                f"{file}: joint '{printable(element.name)}' {between} is {element.type}, which has no single "
                f"coordinate; choose a base behind it: --base {printable(element.child)}"
            )
    couplings = _Couplings(description)
    moving = [element for element in path if couplings.moves(element)]
    if not moving:
        raise ChainError(
            f"{file}: no moving joint between base '{printable(base)}' and tip '{printable(tip)}'; "
            f"choose another tip, leaf links: {listed(description.leaves)}"
        )
    if len(moving) > MAX_MOVING_JOINTS:
        raise ChainError(
            f"{file}: {len(moving)} moving joints {between}, more than {MAX_MOVING_JOINTS}; choose a nearer base"
        )
    carried = _carried(description, path, moving) if masses else {}
    _refuse_problems(description, path, moving, carried)

    placements = [Placement.identity()]  # of each joint's frame in the one before; the last is the tip's
    for element in path:
        if couplings.moves(element):
            placements[-1] = placements[-1] @ Placement.from_xyz_rpy(element.xyz, element.rpy)
            placements.append(Placement.identity())
        else:
            placements[-1] = placements[-1] @ _held(couplings, element)
    placements, slides = _slide_origins(moving, placements)
    masters = list(dict.fromkeys(couplings[element].master.name for element in moving))
    bodies = _bodies(description, couplings, carried, slides)

    joints = []
    for element, placement, body in zip(moving, placements, bodies, strict=False):
        rotation, translation = placement.rounded()
        coupling = couplings[element]
        joints.append(
            Joint(
                name=element.name,
                type=element.type,
                child=element.child,
                rotation=rotation,
                translation=translation,
                axis=element.axis,
                body=body,
                coordinate=masters.index(coupling.master.name),
                multiplier=coupling.multiplier,
                offset=coupling.offset,
            )
        )
    tip_rotation, tip_translation = placements[-1].rounded()
    on_moving_part = [link for links in carried.values() for link, _ in links]
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
        masses=masses,
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
    leaves = listed(description.leaves)
    if tip is None:
        if len(description.leaves) != 1:
            raise ChainError(f"{description.file}: has several leaf links; choose one with --tip: {leaves}")
        return description.leaves[0]
    if tip not in description.inertials:
        raise ChainError(
            f"{description.file}: tip link '{printable(tip)}' does not exist; leaf links: {leaves} "
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
                f"{description.file}: base '{printable(base)}' is no ancestor of tip '{printable(tip)}'; "
                f"possible bases: {listed(ancestors) or '(none)'}"
            )
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


@dataclass(frozen=True)
class _Coupling:
    """A joint stands at ``multiplier * q[master] + offset``."""

    master: JointElement
    multiplier: float
    offset: float


class _Couplings:
    """Follows every joint's ``<mimic>`` to the master at the end, each joint once."""

    def __init__(self, description: Description) -> None:
        self.description = description
        self._known: dict[str, _Coupling] = {}

    def __getitem__(self, element: JointElement) -> _Coupling:
        followers: list[JointElement] = []
        while element.name not in self._known and element.mimic is not None:
            followers.append(element)
            element = self.description.joints[element.mimic.joint]
        coupling = self._known.setdefault(element.name, _Coupling(element, 1.0, 0.0))
        for follower in reversed(followers):
            assert follower.mimic is not None
            coupling = _Coupling(
                coupling.master,
                follower.mimic.multiplier * coupling.multiplier,
                follower.mimic.multiplier * coupling.offset + follower.mimic.offset,
            )
            if not max(abs(coupling.multiplier), abs(coupling.offset)) <= LARGEST:
                raise DescriptionError(
                    self.description.file,
                    [
                        f"joint '{printable(follower.name)}': along its chain of <mimic> elements multiplier or offset "
                        f"grow beyond {LARGEST:g}; correct them"
                    ],
                )
            self._known[follower.name] = coupling
        return coupling

    def moves(self, element: JointElement) -> bool:
        """Whether the joint has or follows a coordinate; one that mimics a fixed joint stands still."""
        if element.type not in MOVING_TYPES:
            return False
        coupling = self[element]
        return coupling.master.type in MOVING_TYPES and coupling.multiplier != 0


def _held(couplings: _Couplings, element: JointElement) -> Placement:
    """Placement of a joint's child in its parent while all coordinates off the chain are zero."""
    placement = Placement.from_xyz_rpy(element.xyz, element.rpy)
    if element.type not in MOVING_TYPES:
        return placement
    position = couplings[element].offset
    if position == 0:
        return placement
    if element.type == "prismatic":
        return placement @ Placement.translated([exact(position) * exact(v) for v in element.axis])
    return placement @ Placement.rotation_about(element.axis, position)


def _carried(
    description: Description, path: list[JointElement], moving: list[JointElement]
) -> dict[str, list[tuple[str, JointElement | None]]]:
    """Links that move rigidly with each moving joint of the chain, parents first, each with the joint that holds
    it (None: the moving joint itself).

    Joints off the chain are held at zero, so a gripper's fingers count as payload.
    """
    children: dict[str, list[JointElement]] = {}
    for element in description.joints.values():
        children.setdefault(element.parent, []).append(element)
    names = {element.name for element in moving}
    carried: dict[str, list[tuple[str, JointElement | None]]] = {}
    for element in moving:
        links = carried.setdefault(element.name, [])
        stack: list[tuple[str, JointElement | None]] = [(element.child, None)]
        while stack:
            link, above = stack.pop()
            links.append((link, above))
            stack.extend((below.child, below) for below in reversed(children.get(link, [])) if below.name not in names)
    return carried


def _bodies(
    description: Description,
    couplings: _Couplings,
    carried: dict[str, list[tuple[str, JointElement | None]]],
    slides: list[Placement],
) -> list[Body]:
    """Everything that each moving joint carries; ``slides`` place its frame in the URDF's joint frame."""
    if not carried:
        return [_body(Inertia.zero()) for _ in slides]
    bodies = []
    for links, slide in zip(carried.values(), slides, strict=True):
        total = Inertia.zero()
        frames: dict[str, Placement] = {}
        for link, above in links:
            frame = slide.inverse() if above is None else frames[above.parent] @ _held(couplings, above)
            frames[link] = frame
            inertial = description.inertials[link]
            if inertial is not None:
                at_com = frame @ Placement.from_xyz_rpy(inertial.com, inertial.rpy)
                total = total + Inertia.of_body(inertial.mass, inertial.tensor, at_com)
        bodies.append(_body(total))
    return bodies


def _body(total: Inertia) -> Body:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = total.tensor
    mass, x, y, z, *tensor = (rounded(v) for v in (total.mass, *total.moment, xx, xy, xz, yy, yz, zz))
    return Body(mass, (x, y, z), (tensor[0], tensor[1], tensor[2], tensor[3], tensor[4], tensor[5]))


def _refuse_problems(
    description: Description,
    path: list[JointElement],
    moving: list[JointElement],
    carried: dict[str, list[tuple[str, JointElement | None]]],
) -> None:
    held = [above for links in carried.values() for _, above in links if above is not None]
    on_chain = _followed(description, moving)
    used = _followed(description, [*path, *held]) | {f"link {link}" for links in carried.values() for link, _ in links}
    problems = [
        problem.text
        for problem in description.problems
        if problem.element in used and (not problem.bounds or problem.element in on_chain)
    ]
    if problems:
        raise DescriptionError(description.file, problems)


def _followed(description: Description, elements: list[JointElement]) -> set[str]:
    """The joints and all that they mimic, as :class:`Problem` names them."""
    names: set[str] = set()
    for start in elements:
        element: JointElement | None = start
        while element is not None and element.name not in names:
            names.add(element.name)
            element = None if element.mimic is None else description.joints[element.mimic.joint]
    return {f"joint {name}" for name in names}


def _coordinate(element: JointElement) -> Coordinate:
    return Coordinate(
        name=element.name,
        type=element.type,
        lower=element.lower,
        upper=element.upper,
        velocity=element.velocity,
        effort=element.effort,
    )
