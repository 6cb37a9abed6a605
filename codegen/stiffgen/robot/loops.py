# SPDX-License-Identifier: MIT
"""Closed loops of a chain: read from the file or from ``--loop``, and expressed in the joints that move their ends."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from stiffgen.errors import ChainError, listed, printable
from stiffgen.robot.chain import Body, ChainOptions, Joint, Loop, LoopEnd
from stiffgen.robot.couplings import Couplings
from stiffgen.robot.description import MOVING_TYPES, Description, JointElement, LoopElement, LoopEndElement
from stiffgen.robot.geometry import Pose

_NUMBERS = ",".join(3 * ("([^,:=]+)",))
_LOOP = re.compile(f"(.+):{_NUMBERS}=(.+):{_NUMBERS}")
OWN_LOOP = "loop "
"""Beginning of the names of loops that ``--loop`` describes; the option's text follows."""
_NO_BODY = Body(0.0, (0.0, 0.0, 0.0), (0.0,) * 6)


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


def read_loop(text: str) -> LoopElement:
    """Return the loop of the option ``--loop LINK:X,Y,Z=LINK:X,Y,Z``.

    Raises:
        ChainError: the text has another form.

    """
    match = _LOOP.fullmatch(text)
    try:
        first, *xyz, second, u, v, w = match.groups() if match else ()
        x, y, z = map(float, xyz)
        ends = LoopEndElement(first, (x, y, z)), LoopEndElement(second, (float(u), float(v), float(w)))
    except ValueError:
        raise ChainError(f"--loop {printable(text)}: is not LINK:X,Y,Z=LINK:X,Y,Z (numbers in metres)") from None
    return LoopElement(OWN_LOOP + text, *ends)


def select_loops(
    description: Description, options: ChainOptions, couplings: Couplings, base: str, on_paths: Sequence[JointElement]
) -> tuple[SelectedLoop, ...]:
    """Return the loops to close: those of ``--loop``, and those of the file that share a joint with the chain.

    Raises:
        ChainError: an end is no link or not beyond the base, a joint of a loop has no single coordinate, or there is
            nothing to close.

    """
    own = [read_loop(text) for text in options.loop]
    if (options.close_loops or options.actuated) and not (own or description.loops):
        raise ChainError(
            f"{description.file}: has no constraints that close loops; describe them by --loop LINK:X,Y,Z=LINK:X,Y,Z"
        )
    if not (own or options.close_loops or options.actuated):
        return ()
    wanted = {couplings[element].master.name for element in on_paths if couplings.moves(element)}
    pending = [(element, element in own) for element in (*own, *description.loops)]
    found: list[SelectedLoop] = []
    while True:
        rest = []
        for element, is_own in pending:
            joints = [_above(description, end.link) for end in (element.first, element.second)]
            names = {couplings[each].master.name for path in joints for each in path if couplings.moves(each)}
            if is_own or names & wanted:
                loop = _selected(description, element, base)
                moving = {couplings[each].master.name for each in loop.joints if couplings.moves(each)}
                if is_own or moving & wanted:
                    found.append(loop)
                    wanted |= moving
                    continue
            rest.append((element, False))
        if len(rest) == len(pending):
            return tuple(found)
        pending = rest


def _above(description: Description, link: str) -> list[JointElement]:
    """Return the joints from the root to a link."""
    if link not in description.inertials:
        raise ChainError(
            f"{description.file}: --loop names link '{printable(link)}', which does not exist ('stiffgen inspect' "
            "lists all links)"
        )
    above, path = description.parent_joint, []
    while link in above:
        path.append(above[link])
        link = above[link].parent
    return path[::-1]


def _selected(description: Description, element: LoopElement, base: str) -> SelectedLoop:
    first, second = (_above(description, end.link) for end in (element.first, element.second))
    while first and second and first[0] is second[0]:
        first, second = first[1:], second[1:]
    shared = first[0].parent if first else second[0].parent if second else element.first.link
    beyond = base in (shared, *(joint.parent for joint in _above(description, shared)))
    name, moving = printable(element.text), [joint for joint in (*first, *second) if joint.type != "fixed"]
    if not moving or (not beyond and any(base == joint.child for joint in (*first, *second))):
        fault = f"starts at '{printable(shared)}', before base '{printable(base)}'" if moving else "has no moving joint"
        raise ChainError(
            f"{description.file}: {printable(element.text)} {fault}; choose a base nearer the root, or leave it out"
        )
    without = [joint for joint in moving if joint.type not in MOVING_TYPES]
    if without:
        raise ChainError(
            f"{description.file}: {name}: joint '{printable(without[0].name)}' is {without[0].type}, which has no "
            "single coordinate; replace it by hinges with one coordinate each (links without mass between them), "
            "or leave the loop open (without --close-loops)"
        )
    return SelectedLoop(element, tuple(first), tuple(second))


def build_loop(loop: SelectedLoop, couplings: Couplings, masters: Sequence[str], base_joints: int) -> Loop:
    """Return the record of a loop, with all its equations as rows."""
    element = loop.element
    ends = [
        _end(path, end, couplings, masters, base_joints)
        for path, end in ((loop.first, element.first), (loop.second, element.second))
    ]
    return Loop(element.text, ends[0], ends[1], tuple(range(6 if element.is_weld else 3)), element.is_weld)


def _end(
    path: Sequence[JointElement], end: LoopEndElement, couplings: Couplings, masters: Sequence[str], base_joints: int
) -> LoopEnd:
    pose, joints = Pose.identity(), list[Joint]()
    for element in path:
        if not couplings.moves(element):
            pose = pose @ couplings.pose_at_rest(element)
            continue
        coupling = couplings[element]
        rotation, translation = (pose @ Pose.placed(element.xyz, element.orientation)).rounded()
        joints.append(
            Joint(
                name=element.name,
                type=element.type,
                child=element.child,
                rotation=rotation,
                translation=translation,
                axis=element.axis,
                body=_NO_BODY,
                parent=len(joints) - 1,
                coordinate=masters.index(coupling.master.name) + base_joints,
                multiplier=coupling.multiplier,
                offset=coupling.offset,
            )
        )
        pose = Pose.identity()
    return LoopEnd(tuple(joints), *(pose @ Pose.placed(end.xyz, end.orientation)).rounded())


def wanted_motors(
    file: str, loops: Sequence[Loop], elements: Sequence[JointElement], base_joints: int, actuated: Sequence[str]
) -> set[str]:
    """Return the names of the actuated joints of the loops: as chosen, or those with a motor in the file.

    Raises:
        ChainError: a chosen joint is in no loop, or none is chosen and none has a motor.

    """
    ends = [end for loop in loops for end in (loop.first, loop.second)]
    in_loops = {joint.coordinate - base_joints for end in ends for joint in end.joints}
    names = [elements[k].name for k in sorted(in_loops)]
    unknown = [name for name in actuated if name not in names]
    if unknown:
        raise ChainError(
            f"{file}: --actuated {printable(unknown[0])}: is no joint of a closed loop; these are: {listed(names)} "
            "(all other joints of q are independent anyway)"
        )
    chosen = set(actuated) or {elements[k].name for k in in_loops if elements[k].has_motor}
    if not chosen:
        raise ChainError(f"{file}: no joint of the closed loops has a motor; choose with --actuated: {listed(names)}")
    return chosen
