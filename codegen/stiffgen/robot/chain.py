# SPDX-License-Identifier: MIT
"""URDF -> :class:`Chain`: the moving joints between a base and its tip links, ready for the symbolic modules.

:func:`select` finds the joints that are meant and refuses what cannot be; then frames are placed, what rides on each
joint is carried along, and the chain is assembled. Fixed joints, mimic relations and masses are folded in here; what
follows knows nothing of XML, files or trees.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stiffgen.errors import ChainError, DescriptionError, DescriptionWarning, listed, printable
from stiffgen.names import CPP_NAMES, identifier
from stiffgen.robot.description import LARGEST, MOVING_TYPES, Description, JointElement, Problem
from stiffgen.robot.geometry import IDENTITY, Inertia, Matrix, Placement, Real, Vector, exact, mpf, physical_inertia
from stiffgen.robot.reader import read_description

MAX_MOVING_JOINTS = 128
BASE_JOINTS = 6
"""Of a floating base: three that slide along the base link's axes, three that turn about them."""


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
    the unit axis in the joint's frame. ``parent`` is the index of the moving joint before it, -1 for none. The joint
    stands at ``multiplier`` times its entry of q, plus ``offset`` (1 and 0 unless it mimics); ``coordinate`` is its
    place among the velocity coordinates, the place in q but for a floating base's six.
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
class Tip:
    """A tip frame: tip link (or the tool mounted on it), placed in the frame of joint ``joint`` (index; metres).

    ``name`` is empty for the only tip of a chain, else the identifier under which its functions stand.
    """

    link: str
    name: str
    joint: int
    rotation: Matrix
    translation: Vector


@dataclass(frozen=True)
class Tool:
    """A tool mounted on the tip link: its frame, and its inertia.

    Args:
        xyz: position of the tool frame in the tip link's frame [m].
        rpy: its orientation there, as in a URDF's ``<origin>`` [rad].
        mass: [kg], 0 for none.
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
    """What selects a chain in a description, and what is done to it; :func:`load_chain` says what each means."""

    tip: str | Sequence[str] | None = None
    base: str | None = None
    masses: bool = True
    tool: Tool | None = None
    runtime_tool: bool = False
    lock: Mapping[str, float] | None = None
    floating_base: bool = False


@dataclass(frozen=True)
class Chain:
    """A kinematic chain from link ``base`` to a tip, or to several tips (a tree).

    ``joints`` are the moving joints, each after its parent; ``coordinates`` are the entries of q (fewer than joints
    where joints mimic). ``massless`` names the links on the moving part that have no ``<inertial>``. Where
    ``masses`` is False, all masses were left out on request: every body is zero, and a mass matrix would be
    meaningless. With ``runtime_tool`` the kernels take the tool's pose in the tip's frame as an argument. ``tool``
    and ``locked`` (joint name, position) record what was asked for and is contained in the rest. ``source`` is the
    URDF's file name without its folder, ``digest`` the SHA-256 of its bytes.

    Where ``floating``, the base is free and its pose an argument. The first six joints are then the base's own:
    unit rates of them are its body twist (linear first, in the base link's axes), their positions are always zero, and
    the last one carries the base link. The velocity coordinates are theirs, then those of ``coordinates``.
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

    @property
    def base_joints(self) -> int:
        """Number of joints that are the floating base's own: 6 or 0."""
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
        """Rotation of the only tip in the last joint's frame."""
        return self._only_tip.rotation

    @property
    def tip_translation(self) -> Vector:
        """Origin of the only tip in the last joint's frame [m]."""
        return self._only_tip.translation

    @property
    def _only_tip(self) -> Tip:
        (tip,) = self.tips
        return tip

    def branch(self, tip: Tip) -> Chain:
        """The serial chain to one tip, with the coordinates of the whole; its bodies are those of the tree."""
        path: list[int] = []
        index = tip.joint
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        joints = tuple(replace(self.joints[old], parent=new - 1) for new, old in enumerate(reversed(path)))
        return replace(self, joints=joints, tips=(replace(tip, joint=len(joints) - 1),))


def load_chain(
    urdf: str | Path,
    *,
    tip: str | Sequence[str] | None = None,
    base: str | None = None,
    masses: bool = True,
    tool: Tool | None = None,
    runtime_tool: bool = False,
    lock: Mapping[str, float] | None = None,
    floating_base: bool = False,
) -> Chain:
    """Read the chain between two links of a URDF file, or the tree between a base and several tips.

    Args:
        urdf: path of the URDF file. Meshes are not needed and not opened.
        tip: link at the end of the chain; its frame is where the wrench acts. May be left out if the robot has
            a single leaf link. Several links: the chains to all of them, with one vector q.
        base: link at the start of the chain, an ancestor of the tip; default: the root link.
        masses: False leaves out all masses, and with them everything that the file says of links and joints
            beside the chain: for files whose inertias are wrong, if no mass matrix is wanted.
        tool: what is mounted on the (only) tip link; the tool's frame then takes the tip's place.
        runtime_tool: the kernels take the tool's pose (4x4, in the tip's frame) as an argument after q.
        lock: joints to hold at a position [rad or m]; they are no coordinates.
        floating_base: the base link is free: its pose is an argument, its body twist comes before the joints' rates. A
            file's own floating joint between base and tips, with nothing that moves before it, has the same effect:
            the link behind it is the base.

    Returns:
        The chain; q holds its moving joints from base to tip, a mimic joint following its master's entry.

    Raises:
        DescriptionError: the file cannot be used (all problems that can change this chain are named).
        ChainError: no such link or joint, no moving joint between base and tip, a joint type that has no
            coordinate, or a tool or lock that cannot be.

    Warns:
        DescriptionWarning: the file has problems beside this chain, which cannot change it.

    """
    options = ChainOptions(tip, base, masses, tool, runtime_tool, lock, floating_base)
    return read_chain(urdf, options)


def read_chain(urdf: str | Path, options: ChainOptions) -> Chain:
    """:func:`load_chain` with its options in one; the warning names the line that called the caller."""
    description = read_description(urdf)
    selection = select(description, options)
    if selection.beside:
        warnings.warn(DescriptionWarning(description.file, selection.beside), stacklevel=3)
    return _assembled(description, options, selection)


_DEFAULTS = ChainOptions()


def chain_between(description: Description, options: ChainOptions = _DEFAULTS) -> Chain:
    """:func:`load_chain` on a description that has been read already; nothing is said of problems beside the chain."""
    return _assembled(description, options, select(description, options))


@dataclass(frozen=True)
class Selection:
    """What the options select: links ``base`` and ``tips``, the joints on the way to each tip, those of them that
    move, the joints that are coordinates, and the links that ride on each moving joint.

    ``beside`` are the problems of the file that cannot change this chain; the others refused it. Those of links are not
    among them where all masses are left out on request.
    """

    base: str
    tips: tuple[str, ...]
    couplings: _Couplings
    paths: tuple[tuple[JointElement, ...], ...]
    moving: tuple[JointElement, ...]
    masters: tuple[str, ...]
    carried: _Carried
    beside: tuple[str, ...]
    floating: bool = False


_Carried = dict[str, list[tuple[str, JointElement | None]]]
"""By moving joint: the links that move rigidly with it, parents first, each with the joint that holds it (None: the
moving joint itself). A floating base stands before the joints, under an empty name."""


def select(description: Description, options: ChainOptions = _DEFAULTS) -> Selection:
    """Find the joints of a chain.

    Raises:
        DescriptionError, ChainError: as :func:`load_chain`.

    """
    file = description.file
    tips = _tips(description, options.tip)
    if options.tool is not None:
        _check_tool(file, options.tool, tips)
    base = description.root if options.base is None else options.base
    if base not in description.inertials:
        raise ChainError(
            f"{file}: base link '{printable(base)}' does not exist; valid names: {listed(description.links)}"
        )
    base, floating = _free_base(description, base, tips[0], options)
    couplings = _Couplings(description, _checked_locks(description, options.lock or {}))
    paths = [_path(description, base, link) for link in tips]
    elements = list({element.name: element for path in paths for element in path}.values())
    moving = [element for element in elements if couplings.moves(element)]
    if len(moving) > MAX_MOVING_JOINTS:
        raise ChainError(
            f"{file}: {len(moving)} moving joints between '{printable(base)}' and '{printable(tips[0])}', more than "
            f"{MAX_MOVING_JOINTS}; choose a nearer base"
        )
    carried = carried_links(description, moving, base if floating else None) if options.masses else {}
    problems = _beside(description, couplings, elements, moving, carried)
    beside = tuple(p.text for p in problems if options.masses or not p.element.startswith("link "))
    for tip, path in zip(tips, paths, strict=True):
        if not any(couplings.moves(element) for element in path):
            raise ChainError(
                f"{file}: no moving joint between base '{printable(base)}' and tip '{printable(tip)}'; "
                f"choose another tip, leaf links: {listed(description.leaves)}"
            )
    masters = dict.fromkeys(couplings[element].master.name for element in moving)
    return Selection(
        base, tuple(tips), couplings, tuple(map(tuple, paths)), tuple(moving), tuple(masters), carried, beside, floating
    )


def _assembled(description: Description, options: ChainOptions, selection: Selection) -> Chain:
    tree = _Tree(selection)
    slides = tree.slide_origins()
    tool = options.tool
    if selection.floating:
        slides = [Placement.identity(), *slides]
    inertias = _inertias(description, selection, slides)
    if tool is not None and options.masses:
        inertias[tree.tip_joints[0] + selection.floating] += _tool_inertia(tool, tree.tip_placements[0])
    joints = [_joint(selection, tree, index, each) for index, each in enumerate(inertias[selection.floating :])]
    if selection.floating:
        joints = [*_base_joints(selection.base, inertias[0]), *map(_on_base, joints)]
    first = BASE_JOINTS if selection.floating else 0
    mounted = Placement.identity() if tool is None else Placement.from_xyz_rpy(tool.xyz, tool.rpy)
    frames = [(placement @ mounted).rounded() for placement in tree.tip_placements]
    on_moving_part = [link for links in selection.carried.values() for link, _ in links]
    return Chain(
        robot=description.robot,
        base=selection.base,
        tips=tuple(
            Tip(link, name, joint + first, *frame)
            for link, name, joint, frame in zip(
                selection.tips, _tip_names(selection.tips), tree.tip_joints, frames, strict=True
            )
        ),
        joints=tuple(joints),
        coordinates=tuple(_coordinate(description.joints[name]) for name in selection.masters),
        massless=tuple(link for link in on_moving_part if description.inertials[link] is None),
        source=description.file,
        digest=description.digest,
        masses=options.masses,
        runtime_tool=options.runtime_tool,
        tool=tool,
        locked=tuple(sorted((options.lock or {}).items())),
        floating=selection.floating,
    )


def _base_joints(base: str, inertia: Inertia) -> list[Joint]:
    """The six joints of a floating base, the last of which carries what rides on the base link."""
    joints = []
    for index in range(BASE_JOINTS):
        x, y, z = (float(k == index % 3) for k in range(3))
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
    """A joint behind those of the base."""
    return replace(joint, parent=joint.parent + BASE_JOINTS, coordinate=joint.coordinate + BASE_JOINTS)


def _body(inertia: Inertia) -> Body:
    mass, moment, ((xx, xy, xz), (_, yy, yz), (_, _, zz)) = inertia.rounded()
    return Body(mass, moment, (xx, xy, xz, yy, yz, zz))


def _joint(selection: Selection, tree: _Tree, index: int, inertia: Inertia) -> Joint:
    element = selection.moving[index]
    coupling = selection.couplings[element]
    rotation, translation = tree.placements[index].rounded()
    return Joint(
        name=element.name,
        type=element.type,
        child=element.child,
        rotation=rotation,
        translation=translation,
        axis=element.axis,
        body=_body(inertia),
        parent=tree.parents[index],
        coordinate=selection.masters.index(coupling.master.name),
        multiplier=coupling.multiplier,
        offset=coupling.offset,
    )


class _Tree:
    """The moving joints of all paths: each one's parent and placement, and where the tips are."""

    def __init__(self, selection: Selection) -> None:
        self.moving = moving = selection.moving
        self.parents = [-1] * len(moving)
        self.placements = [Placement.identity()] * len(moving)  # in the parent joint's frame
        self.tip_joints: list[int] = []
        self.tip_placements: list[Placement] = []  # in the frame of the tip's joint
        index_of = {element.name: index for index, element in enumerate(moving)}
        for path in selection.paths:
            parent, placement = -1, Placement.identity()
            for element in path:
                index = index_of.get(element.name)
                if index is None:
                    placement = placement @ _held(selection.couplings, element)
                    continue
                self.parents[index] = parent
                self.placements[index] = placement @ Placement.from_xyz_rpy(element.xyz, element.rpy)
                parent, placement = index, Placement.identity()
            self.tip_joints.append(parent)
            self.tip_placements.append(placement)

    def slide_origins(self) -> list[Placement]:
        """Move each joint's origin along its axis as far as the next one's offset reaches in that direction.

        Nothing moves physically: a turn about an axis (or a slide along it) commutes with a shift along it. Offsets
        that only place a frame on its axis vanish, as in the arms whose shoulder, elbow and wrist axes meet. Where a
        tree branches, the first branch decides.

        Returns:
            For each joint its new frame in the old one.

        """
        slides = [Placement.identity()] * len(self.moving)
        for index in reversed(range(len(self.moving))):
            children = [child for child, parent in enumerate(self.parents) if parent == index]
            tips = [tip for tip, joint in enumerate(self.tip_joints) if joint == index]
            following = self.placements[children[0]] if children else self.tip_placements[tips[0]]
            slide = slides[index] = Placement.translated(_slide(self.moving[index], following.translation))
            self.placements[index] = self.placements[index] @ slide
            for child in children:
                self.placements[child] = slide.inverse() @ self.placements[child]
            for tip in tips:
                self.tip_placements[tip] = slide.inverse() @ self.tip_placements[tip]
        return slides


def _slide(element: JointElement, offset: Sequence[Real]) -> Sequence[Real]:
    """The part of an offset along a joint's axis; a sliding joint lets all of it pass."""
    if element.type == "prismatic":
        return offset
    axis = tuple(mpf(v) for v in element.axis)
    along = sum(a * o for a, o in zip(axis, offset, strict=True)) / sum(a * a for a in axis)
    return tuple(along * a for a in axis)


def _tips(description: Description, tip: str | Sequence[str] | None) -> list[str]:
    if tip is None or isinstance(tip, str):
        return [_tip(description, tip)]
    if not tip:
        raise ChainError(f"{description.file}: no tip named; leaf links: {listed(description.leaves)}")
    tips = [_tip(description, each) for each in tip]
    twice = next((each for each in tips if tips.count(each) > 1), None)
    if twice is not None:
        raise ChainError(f"{description.file}: tip '{printable(twice)}' is named twice; name each tip once")
    return tips


_GROUPS_AND_KERNELS = (
    "body", "spatial", "hybrid", "spring", "posture", "limits", "gravity", "packed", "mass_matrix", "bias_forces",
    *CPP_NAMES,
)  # fmt: skip
"""What stands beside the tips' names in a module, and in the namespace of NAME.hpp."""


def _tip_names(tips: Sequence[str]) -> list[str]:
    """Identifiers of several tips, told apart by a number where links' names give the same one."""
    if len(tips) == 1:
        return [""]
    names: list[str] = []
    for tip in tips:
        name = first = identifier(tip)
        number = 2
        while name in names or name in _GROUPS_AND_KERNELS:
            name, number = f"{first}_{number}", number + 1
        names.append(name)
    return names


def _checked_locks(description: Description, lock: Mapping[str, float]) -> Mapping[str, float]:
    for name, position in lock.items():
        element = description.joints.get(name)
        moving = [joint.name for joint in description.joints.values() if joint.type in MOVING_TYPES and not joint.mimic]
        shown = printable(name)
        if element is None or element.type not in MOVING_TYPES:
            what = "does not exist" if element is None else f"is {element.type} and cannot be locked"
            raise ChainError(f"{description.file}: joint '{shown}' {what}; joints to lock: {listed(moving)}")
        if element.mimic is not None:
            raise ChainError(
                f"{description.file}: joint '{shown}' mimics '{printable(element.mimic.joint)}'; lock that one"
            )
        if not element.lower <= position <= element.upper:
            raise ChainError(
                f"{description.file}: joint '{shown}' cannot be locked at {position:g}; "
                f"its limits are {element.lower:g} to {element.upper:g}"
            )
        if not abs(position) <= LARGEST:
            raise ChainError(f"{description.file}: joint '{shown}' cannot be locked at {position:g}; give a number")
    return lock


def _check_tool(file: str, tool: Tool, tips: list[str]) -> None:
    if len(tips) > 1:
        raise ChainError(
            f"{file}: a tool was given for {len(tips)} tips; add its link to the URDF, or use --tool runtime"
        )
    for option, values in (
        ("--tool-xyz", tool.xyz),
        ("--tool-rpy", tool.rpy),
        ("--tool-mass", (tool.mass,)),
        ("--tool-com", tool.com),
        ("--tool-inertia", tool.inertia),
    ):
        if not all(abs(value) <= LARGEST for value in values):
            raise ChainError(f"{file}: {option} holds a number that is not finite or beyond {LARGEST:g}")
    if tool.mass < 0:
        raise ChainError(f"{file}: --tool-mass {tool.mass:g} kg is negative")
    if not physical_inertia(*tool.inertia):
        raise ChainError(
            f"{file}: no rigid body has the inertia of --tool-inertia (principal moments must be positive and none "
            "above the sum of the other two)"
        )
    if tool.mass == 0 and any((*tool.com, *tool.inertia)):
        raise ChainError(f"{file}: --tool-com or --tool-inertia without a mass; add --tool-mass")


def _tool_inertia(tool: Tool, tip_link: Placement) -> Inertia:
    return Inertia.of_body(tool.mass, tool.inertia, tip_link @ Placement.translated(tool.com))


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


def _free_base(description: Description, base: str, tip: str, options: ChainOptions) -> tuple[str, bool]:
    """The base link and whether it floats: as asked for, or because a floating joint holds it."""
    above = description.parent_joint
    free: JointElement | None = None
    link = tip
    while link != base and link in above:
        element = above[link]
        if element.type == "floating":
            free = element
        elif element.type != "fixed" and free is not None:
            free = None  # something moves before it
        link = element.parent
    if free is not None and link == base:
        return free.child, True
    if not options.floating_base:
        return base, False
    if base in above and above[base].type != "floating":
        raise ChainError(
            f"{description.file}: a floating base takes all of the robot along, but '{printable(base)}' is held by "
            f"joint '{printable(above[base].name)}'; leave out --base, or take --base {printable(description.root)}"
        )
    return base, True


def _path(description: Description, base: str, tip: str) -> list[JointElement]:
    """The joints from base to tip; one that has no single coordinate is refused."""
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
    for element in reversed(path):
        if element.type in ("floating", "planar"):
            raise ChainError(
                f"{description.file}: joint '{printable(element.name)}' between '{printable(base)}' and "
                f"'{printable(tip)}' is {element.type}, which has no single coordinate; "
                f"choose a base behind it: --base {printable(element.child)}"
            )
    return path[::-1]


@dataclass(frozen=True)
class _Coupling:
    """A joint stands at ``multiplier * q[master] + offset``."""

    master: JointElement
    multiplier: float
    offset: float


class _Couplings:
    """Follows every joint's ``<mimic>`` to the master at the end, each joint once."""

    def __init__(self, description: Description, locks: Mapping[str, float]) -> None:
        self.description = description
        self.locks = locks
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
        """Whether the joint has or follows a coordinate; one that mimics a fixed or locked joint stands still."""
        if element.type not in MOVING_TYPES:
            return False
        coupling = self[element]
        master = coupling.master
        return master.type in MOVING_TYPES and coupling.multiplier != 0 and master.name not in self.locks

    def held_position(self, element: JointElement) -> float:
        """Where a joint stands that does not move: as locked, else at its coordinate's zero."""
        coupling = self[element]
        return coupling.multiplier * self.locks.get(coupling.master.name, 0.0) + coupling.offset


def _held(couplings: _Couplings, element: JointElement) -> Placement:
    """Placement of a child in its parent for a joint that is fixed, locked, or off the chain (held at zero)."""
    placement = Placement.from_xyz_rpy(element.xyz, element.rpy)
    if element.type not in MOVING_TYPES:
        return placement
    position = couplings.held_position(element)
    if position == 0:
        return placement
    if element.type == "prismatic":
        return placement @ Placement.translated([exact(position) * exact(v) for v in element.axis])
    return placement @ Placement.rotation_about(element.axis, position)


def carried_links(
    description: Description, moving: Sequence[JointElement], floating_base: str | None = None
) -> _Carried:
    """The links that ride on each moving joint, and on a base that floats. Joints off the chain are held at zero (or
    where they are locked), so a gripper's fingers count as payload.
    """
    children: dict[str, list[JointElement]] = {}
    for element in description.joints.values():
        children.setdefault(element.parent, []).append(element)
    names = {element.name for element in moving}
    carried: _Carried = {}
    starts = {"": floating_base} if floating_base is not None else {}
    for name, start in (starts | {element.name: element.child for element in moving}).items():
        links = carried.setdefault(name, [])
        stack: list[tuple[str, JointElement | None]] = [(start, None)]
        while stack:
            link, above = stack.pop()
            links.append((link, above))
            stack.extend((below.child, below) for below in reversed(children.get(link, [])) if below.name not in names)
    return carried


def _inertias(description: Description, selection: Selection, slides: list[Placement]) -> list[Inertia]:
    """Everything that each moving joint carries; ``slides`` place its frame in the URDF's joint frame."""
    if not selection.carried:
        return [Inertia.zero() for _ in slides]
    inertias = []
    for links, slide in zip(selection.carried.values(), slides, strict=True):
        total = Inertia.zero()
        frames: dict[str, Placement] = {}
        for link, above in links:
            frame = slide.inverse() if above is None else frames[above.parent] @ _held(selection.couplings, above)
            frames[link] = frame
            inertial = description.inertials[link]
            if inertial is not None:
                at_com = frame @ Placement.from_xyz_rpy(inertial.com, inertial.rpy)
                total = total + Inertia.of_body(inertial.mass, inertial.tensor, at_com)
        inertias.append(total)
    return inertias


def _beside(
    description: Description,
    couplings: _Couplings,
    elements: list[JointElement],
    moving: list[JointElement],
    carried: _Carried,
) -> tuple[Problem, ...]:
    """Refuse the problems that can change the chain; what is left of them stands beside it."""
    held = [above for links in carried.values() for _, above in links if above is not None]
    coordinates = _followed(description, moving)
    displaced = {f"joint {element.name}" for element in held if couplings.held_position(element) != 0}
    used = {
        "bounds": coordinates,
        "motion": coordinates | {f"joint {element.name}" for element in elements} | displaced,
    }
    # A held joint stands where its masters say: a misspelt <mimic> of these would move it.
    used["place"] = used["motion"] | _followed(description, [*elements, *held])
    used["place"] |= {f"link {link}" for links in carried.values() for link, _ in links}
    refusing = [problem.text for problem in description.problems if problem.element in used[problem.affects]]
    if refusing:
        raise DescriptionError(description.file, refusing)
    return description.problems


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
