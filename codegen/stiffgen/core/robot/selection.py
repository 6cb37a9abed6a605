# SPDX-License-Identifier: MIT
"""Selection of a chain in a description: base, tips, the joints between them, and reasons to reject the chain."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from stiffgen.core import given
from stiffgen.core.errors import ChainError, DescriptionError, listed, printable, shell_word
from stiffgen.core.family import needed, part
from stiffgen.core.given import are_numbers, is_number
from stiffgen.core.robot.chain import MAX_MOVING_JOINTS, ChainOptions, Tool
from stiffgen.core.robot.couplings import Couplings
from stiffgen.core.robot.description import LARGEST, MOVING_TYPES, Description, JointElement, LoopElement
from stiffgen.core.robot.geometry import physical_inertia

Carried = dict[str, list[tuple[str, JointElement | None]]]
"""Links that move rigidly with each moving joint, by joint name: parents first, each with its parent joint.

The parent joint is None for the child link of the moving joint itself. A floating base comes first, with an empty name.
"""

_DEFAULTS = ChainOptions()


@dataclass(frozen=True)
class SelectedLoop:
    """Constraint of a chain, with the joints from the last link that both ends share to each end."""

    element: LoopElement
    first: tuple[JointElement, ...]
    second: tuple[JointElement, ...]

    @property
    def joints(self) -> tuple[JointElement, ...]:
        """All joints of the loop."""
        return *self.first, *self.second


@dataclass(frozen=True)
class Selection:
    """Elements of a description that form a chain.

    Attributes:
        base: base link.
        tips: tip links.
        couplings: mimic relations and locks.
        paths: joints from the base to each tip.
        moving: moving joints on the paths.
        side: moving joints on no path that belong to a closed loop or, with masses, share a coordinate with a path
            through ``<mimic>``.
        masters: joints that are coordinates.
        carried: links that move rigidly with each moving joint; empty without masses.
        beside: problems of the file that cannot change this chain (all other problems reject it).
        floating: whether the base floats.
        loops: closed loops.

    """

    base: str
    tips: tuple[str, ...]
    couplings: Couplings
    paths: tuple[tuple[JointElement, ...], ...]
    moving: tuple[JointElement, ...]
    side: tuple[JointElement, ...]
    masters: tuple[str, ...]
    carried: Carried
    beside: tuple[str, ...]
    floating: bool = False
    loops: tuple[SelectedLoop, ...] = ()


def _loops(
    description: Description, options: ChainOptions, couplings: Couplings, base: str, moving: Sequence[JointElement]
) -> tuple[SelectedLoop, ...]:
    """Return the closed loops that are wanted; the family of loops notes those of the file that stay open."""
    asked_for = options.close_loops or options.loop or options.actuated
    reading = needed("loops.reading", "--loop") if asked_for else part("loops.reading")
    loops = reading.select_loops(description, options, couplings, base, moving) if reading else ()
    return tuple(loops)


def select(description: Description, options: ChainOptions = _DEFAULTS) -> Selection:
    """Find the joints of a chain.

    Raises:
        DescriptionError, ChainError: as :func:`stiffgen.load_chain`.

    """
    file = description.file
    tips = _tips(description, options)
    if options.tool is not None:
        _check_tool(file, options.tool, tips)
    base, floating = _free_base(description, _known_base(description, options.base), tips[0], options)
    couplings = Couplings(description, _checked_locks(description, options.lock or {}))
    paths = [_path(description, base, link) for link in tips]
    elements = list({element.name: element for path in paths for element in path}.values())  # on any path, each once
    moving = list(filter(couplings.moves, elements))
    loops = _loops(description, options, couplings, base, moving)
    of_loops = {element.name: element for loop in loops for element in loop.joints}
    moving_all = [*moving, *filter(couplings.moves, of_loops.values())]
    masters = dict.fromkeys(couplings[element].joint for element in moving_all)  # the coordinates, in order
    beyond = _joints_beyond(description, base)
    wanted = _followers(description, couplings, masters) - {element.name for element in moving}
    side = _side_joints(description, couplings, base, beyond, wanted if options.masses else wanted & of_loops.keys())
    _check_count(file, base, tips, [*moving, *side])
    carried = carried_links(description, [*moving, *side], base if floating else None) if options.masses else {}
    used = [*elements, *of_loops.values(), *side]
    beside = _beside(description, couplings, used, moving_all, carried, beyond if options.masses else [])
    _check_tips_move(description, couplings, base, tips, paths)
    return Selection(
        base=base,
        tips=tuple(tips),
        couplings=couplings,
        paths=tuple(map(tuple, paths)),
        moving=tuple(moving),
        side=tuple(side),
        masters=tuple(masters),
        carried=carried,
        beside=beside,
        floating=floating,
        loops=loops,
    )


def _known_base(description: Description, base: str | None) -> str:
    """Return the base link, by default the root."""
    if base is None:
        return description.root
    if base not in description.inertials:
        raise ChainError(
            f"{description.file}: base link '{printable(base)}' does not exist; valid names: "
            f"{listed(description.links)}"
        )
    return base


def _followers(description: Description, couplings: Couplings, masters: Iterable[str]) -> set[str]:
    """Return the names of the joints that are coordinates and of all that follow them, of those that move."""
    leaders = [description.joints[name] for name in masters]
    led = [each.name for leader in leaders for each in couplings.followers(leader)]
    return {*led, *(leader.name for leader in leaders if couplings.moves(leader))}


def carried_links(
    description: Description, moving: Sequence[JointElement], floating_base: str | None = None
) -> Carried:
    """Return the links that move rigidly with each moving joint, and with a floating base (under the name "").

    Each link comes with the joint above it, the first link with None. All other joints are at zero or locked, so that
    their links move with the joint before them.
    """
    children = _children(description)
    names = {element.name for element in moving}
    carried: Carried = {}
    starts = {"": floating_base} if floating_base is not None else {}
    for name, start in (starts | {element.name: element.child for element in moving}).items():
        links = carried[name] = []
        stack: list[tuple[str, JointElement | None]] = [(start, None)]
        while stack:
            link, above = stack.pop()
            links.append((link, above))
            stack.extend((below.child, below) for below in reversed(children.get(link, [])) if below.name not in names)
    return carried


def _children(description: Description) -> dict[str, list[JointElement]]:
    children: dict[str, list[JointElement]] = {}
    for element in description.joints.values():
        children.setdefault(element.parent, []).append(element)
    return children


def _joints_beyond(description: Description, base: str) -> list[JointElement]:
    """Return all joints beyond the base link, parents first."""
    children = _children(description)
    beyond: list[JointElement] = []
    stack = [base]
    while stack:
        below = children.get(stack.pop(), [])
        beyond += below
        stack += [element.child for element in below]
    return beyond


def _side_joints(
    description: Description, couplings: Couplings, base: str, beyond: list[JointElement], wanted: set[str]
) -> list[JointElement]:
    """Return the wanted joints in the order of the tree; their masses count although no tip moves with them.

    Raises:
        ChainError: one of them is not beyond the base.

    """
    astray = wanted - {element.name for element in beyond}
    for element in description.joints.values():
        if element.name in astray:
            raise ChainError(
                f"{description.file}: joint '{printable(element.name)}' moves with "
                f"'{printable(couplings[element].joint)}' through <mimic> but is not beyond base "
                f"'{printable(base)}', so that its mass cannot be counted; choose a base nearer the root, or leave "
                "all masses out (--no-masses)"
            )
    return [element for element in beyond if element.name in wanted]


def _check_count(file: str, base: str, tips: list[str], moving: list[JointElement]) -> None:
    if len(moving) > MAX_MOVING_JOINTS:
        raise ChainError(
            f"{file}: {len(moving)} moving joints between '{printable(base)}' and '{printable(tips[0])}', more than "
            f"{MAX_MOVING_JOINTS}; choose a nearer base"
        )


def _check_tips_move(
    description: Description, couplings: Couplings, base: str, tips: list[str], paths: list[list[JointElement]]
) -> None:
    """Refuse a tip that no joint moves."""
    for tip, path in zip(tips, paths, strict=True):
        if not any(couplings.moves(element) for element in path):
            raise ChainError(
                f"{description.file}: no moving joint between base '{printable(base)}' and tip '{printable(tip)}'; "
                f"choose another tip, leaf links: {listed(description.leaves)}"
            )


def _beside(
    description: Description,
    couplings: Couplings,
    elements: list[JointElement],
    moving: list[JointElement],
    carried: Carried,
    beyond: list[JointElement],
) -> tuple[str, ...]:
    """Return the texts of the problems that cannot change the chain.

    Args:
        description: the file's content.
        couplings: mimic relations and locks.
        elements: joints on the paths, and side joints.
        moving: moving joints on the paths and in closed loops.
        carried: links that move with moving joints; empty without masses.
        beyond: joints that might be side joints if a faulty mimic relation were corrected.

    Raises:
        DescriptionError: the file has problems that can change the chain.

    """
    affected = _affected(description, couplings, elements, moving, carried, beyond)
    reasons = [problem.text for problem in description.problems if problem.element in affected[problem.affects]]
    if reasons:
        raise DescriptionError(description.file, reasons)
    texts = [p.text for p in description.problems if carried or not p.element.startswith("link ")]
    return *texts, *description.notes


def _affected(
    description: Description,
    couplings: Couplings,
    elements: list[JointElement],
    moving: list[JointElement],
    carried: Carried,
    beyond: list[JointElement],
) -> dict[str, set[str]]:
    """Return the elements that a chain depends on, as in :class:`Problem`, by what a problem of them affects."""
    at_rest = [above for links in carried.values() for _, above in links if above is not None]
    coordinates = couplings.followed(moving)
    displaced = {f"joint {element.name}" for element in at_rest if couplings.position_at_rest(element) != 0}
    masters = [description.joints[couplings[element].joint] for element in moving]
    used = {
        "bounds": coordinates | {f"joint {each.name}" for master in masters for each in couplings.followers(master)},
        "motion": coordinates | {f"joint {element.name}" for element in elements} | displaced,
    }
    # The position of a joint at rest depends on its masters, so that a misspelt <mimic> of these would change it.
    used["place"] = used["motion"] | couplings.followed([*elements, *at_rest])
    used["place"] |= {f"link {link}" for links in carried.values() for link, _ in links}
    used["coupling"] = used["place"] | couplings.followed(beyond)
    return used


def possible_tips(description: Description, base: str | None = None) -> list[str]:
    """Return the leaf links with a moving joint on the way from the base (default: the root).

    A leaf without a moving joint only marks a frame on its parent, such as ``base`` in descriptions of ROS-Industrial.
    """
    return [leaf for leaf in description.leaves if _has_moving(description, leaf, base)]


_FRAMES = ("hand", "tool0", "tcp", "end_effector_link", "end_effector", "ee_link", "ee", "flange", "attachment_site")
"""Last words of links that makers mean as tips, the usual choice first."""


def suggested_tips(description: Description, base: str | None = None) -> list[str]:
    """Return the possible tips, with frames that makers name as such before leaf fingers, cameras and the like."""
    possible = possible_tips(description, base)
    named = []
    for word in _FRAMES:
        pattern = re.compile(rf"(.*[^a-z0-9])?{word}", re.IGNORECASE | re.DOTALL)
        named += [
            link for link in description.links if pattern.fullmatch(link) and _has_moving(description, link, base)
        ]
    return list(dict.fromkeys([*named, *possible]))


def _has_moving(description: Description, link: str, base: str | None) -> bool:
    above, moves = description.parent_joint, False
    while link in above and link != base:
        moves = moves or above[link].type in MOVING_TYPES
        link = above[link].parent
    return moves and base in (None, link)


def _tips(description: Description, options: ChainOptions) -> list[str]:
    """Return the tip links: those that the user names, once each, or the only possible one."""
    tip = options.tip
    if tip is None:
        return [_only_tip(description, options.base)]
    if isinstance(tip, str):
        return [_known_tip(description, tip)]
    if not tip:
        raise ChainError(f"{description.file}: no tip named; leaf links: {listed(description.leaves)}")
    tips = [_known_tip(description, each) for each in tip]
    twice = next((each for each in tips if tips.count(each) > 1), None)
    if twice is not None:
        raise ChainError(f"{description.file}: tip '{printable(twice)}' is named twice; name each tip once")
    return tips


def _only_tip(description: Description, base: str | None) -> str:
    """Return the only leaf with a moving joint above it; name the tips to choose from if there are several."""
    tips = possible_tips(description, base if base in description.inertials else None)
    if len(tips) == 1:
        return tips[0]
    if not tips:
        raise ChainError(
            f"{description.file}: has no moving joint on the way to a leaf link; choose another base or file "
            f"(leaf links: {listed(description.leaves)})"
        )
    names = suggested_tips(description, base if base in description.inertials else None)
    raise ChainError(f"{description.file}: has several leaf links; choose one with --tip: {listed(names)}")


def _known_tip(description: Description, tip: str) -> str:
    if tip not in description.inertials:
        raise ChainError(
            f"{description.file}: tip link '{printable(tip)}' does not exist; leaf links: "
            f"{listed(description.leaves)} ('stiffgen inspect' lists all links)"
        )
    return tip


_WITHOUT_POSITION = {
    "fixed": "is fixed and cannot be locked",
    "floating": "is floating and has no single position to lock; make it fixed",
    "planar": "is planar and has no single position to lock; make it fixed",
    "ball": "is ball and has no single position to lock; replace it by three hinges at one point",
}
"""Faults of joints that cannot be locked, by type."""


def _checked_locks(description: Description, lock: Mapping[str, float]) -> Mapping[str, float]:
    """Return the locks.

    Raises:
        ChainError: a joint does not exist, cannot be locked, or cannot reach the position.
        DescriptionError: the type of a joint is unknown.

    """
    free = Couplings(description, {})
    for name, position in lock.items():
        _check_lock(free, _lockable(description, name), position)
    return lock


def _lockable(description: Description, name: str) -> JointElement:
    """Return the joint of a lock, which must exist, move, and mimic none."""
    element = description.joints.get(name)
    unknown = [each.text for each in description.problems if each.is_type and each.element == f"joint {name}"]
    if unknown:
        raise DescriptionError(description.file, unknown)
    if element is None or element.type not in MOVING_TYPES:
        fault = "does not exist" if element is None else _WITHOUT_POSITION[element.type]
        moving = [joint.name for joint in description.joints.values() if joint.type in MOVING_TYPES and not joint.mimic]
        raise ChainError(f"{description.file}: joint '{printable(name)}' {fault}; joints to lock: {listed(moving)}")
    if element.mimic is not None:
        raise ChainError(
            f"{description.file}: joint '{printable(name)}' mimics '{printable(element.mimic.joint)}'; lock that one"
        )
    return element


def _check_lock(free: Couplings, element: JointElement, position: float) -> None:
    """Refuse a position that is no number, or beyond the limits of the joint and of those that follow it."""
    where = f"{free.description.file}: joint '{printable(element.name)}' cannot be locked at"
    if not is_number(position) or not abs(position) <= LARGEST:
        raise ChainError(f"{where} {given.shown(position)}; give a number")
    limited = free.limited(element)
    if not limited.lower <= position <= limited.upper:
        by_others = "" if limited == element else " (with those of the joints that follow it)"
        raise ChainError(
            f"{where} {position:g}; its limits{by_others} are {limited.lower:g} to "
            f"{limited.upper:g}{_in_degrees(limited, position)}"
        )


def _in_degrees(joint: JointElement, position: float) -> str:
    """Return a question if a position is within the limits of a joint only as degrees."""
    radians = math.radians(position)
    turns = joint.type != "prismatic" and joint.lower <= radians <= joint.upper
    return f"; is it in degrees? {position:g} degrees are {radians:.6g} rad" if turns else ""


_SIZES = {"inertia": 6}


def _check_tool(file: str, tool: Tool, tips: list[str]) -> None:
    """Refuse a tool with several tips, with impossible numbers, or with an inertia but no mass."""
    if len(tips) > 1:
        raise ChainError(
            f"{file}: a tool was given for {len(tips)} tips; add its link to the URDF, or use --tool runtime"
        )
    for name, value in vars(tool).items():
        numbers, count = (value, _SIZES.get(name, 3)) if name != "mass" else ((value,), 1)
        if not are_numbers(numbers, count):
            wanted = "a number" if name == "mass" else f"{count} numbers"
            raise ChainError(f"{file}: --tool {name} takes {wanted}, not {given.shown(value)}")
        if not all(abs(number) <= LARGEST for number in numbers):
            raise ChainError(f"{file}: --tool {name} holds a number that is not finite or beyond {LARGEST:g}")
    if tool.mass < 0:
        raise ChainError(f"{file}: --tool mass={tool.mass:g} is negative [kg]")
    if not physical_inertia(*tool.inertia):
        raise ChainError(
            f"{file}: no rigid body has the inertia of --tool inertia (principal moments must be positive and none "
            "above the sum of the other two)"
        )
    if tool.mass == 0 and any((*tool.com, *tool.inertia)):
        raise ChainError(f"{file}: --tool com or --tool inertia without a mass; add --tool mass=KG")


def _free_base(description: Description, base: str, tip: str, options: ChainOptions) -> tuple[str, bool]:
    """Return the base link and whether it floats, by option or because its parent joint is floating."""
    above = description.parent_joint
    free: JointElement | None = None
    link = tip
    while link != base and link in above:
        element = above[link]
        if element.type == "floating":
            free = element
        elif element.type != "fixed" and free is not None:
            free = None  # a joint before the floating joint moves
        link = element.parent
    if free is not None and link == base:
        return free.child, True
    if not options.floating_base:
        return base, False
    if base in above and above[base].type != "floating":
        raise ChainError(
            f"{description.file}: a floating base must be the root of the robot, but '{printable(base)}' is the child "
            f"of joint '{printable(above[base].name)}'; remove --base, or use --base {shell_word(description.root)}"
        )
    return base, True


def _path(description: Description, base: str, tip: str) -> list[JointElement]:
    """Return the joints from base to tip.

    Raises:
        ChainError: the base is no ancestor of the tip, or a joint between them is floating, planar or a ball joint.

    """
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
        if element.type in ("floating", "planar", "ball"):
            remedy = f"choose a base behind it: --base {shell_word(element.child)}"
            if element.type == "ball":
                hinges = "replace it by three hinges at one point"
                remedy = hinges if element.child == tip else f"{hinges}, or {remedy}"
            raise ChainError(
                f"{description.file}: joint '{printable(element.name)}' between '{printable(base)}' and "
                f"'{printable(tip)}' is {element.type}, which has no single coordinate; "
                f"{remedy}"
            )
    return path[::-1]
