# SPDX-License-Identifier: MIT
"""Closed loops of a chain: read from the file or from ``--loop``, and expressed in the joints that move their ends."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stiffgen.core.errors import ChainError, listed, printable, shell_word
from stiffgen.core.robot.chain import ChainOptions, ClosedLoop, Joint, LoopEnd, RigidBody
from stiffgen.core.robot.couplings import Couplings
from stiffgen.core.robot.description import MOVING_TYPES, Description, JointElement, LoopElement, LoopEndElement
from stiffgen.core.robot.geometry import Pose
from stiffgen.core.robot.selection import SelectedLoop

_NUMBERS = ",".join(3 * ("([^,:=]+)",))
_LOOP = re.compile(f"(.+):{_NUMBERS}=(.+):{_NUMBERS}")
_NO_BODY = RigidBody(0.0, (0.0, 0.0, 0.0), (0.0,) * 6)


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
    return LoopElement(f"loop {text}", *ends, option=text)


def _refuse_nothing_to_close(file: str, options: ChainOptions) -> None:
    """Refuse options of closed loops where neither the file nor the user has any."""
    if options.close_loops:
        raise ChainError(f"{file}: has no constraints that close loops; describe them by --loop LINK:X,Y,Z=LINK:X,Y,Z")
    if options.actuated:
        raise ChainError(
            f"{file}: --actuated names the motors of closed loops, and none is closed; add --close-loops (loops of an "
            "MJCF file) or --loop LINK:X,Y,Z=LINK:X,Y,Z"
        )


def select_loops(
    description: Description, options: ChainOptions, couplings: Couplings, base: str, on_paths: Sequence[JointElement]
) -> tuple[SelectedLoop, ...]:
    """Return the loops of ``--loop``, and with ``--close-loops`` those of the file that share a joint with the chain.

    Raises:
        ChainError: an end is no link, a loop is not beyond the base, a joint of a loop has no single coordinate, or
            there is nothing to close.

    """
    of_file = description.loops if options.close_loops else ()
    if not (options.loop or of_file):
        _refuse_nothing_to_close(description.file, options)

    def coordinates(elements: Sequence[JointElement]) -> set[str]:
        return {couplings[each].joint for each in elements if couplings.moves(each)}

    candidates = [_candidate(description, element) for element in (*map(read_loop, options.loop), *of_file)]
    found = [loop for loop in candidates if loop.element.option]
    # A loop of the file belongs to the chain if it shares a coordinate with it, or with a loop that does.
    while True:
        reached = coordinates([*on_paths, *(joint for loop in found for joint in loop.joints)])
        near = [loop for loop in candidates if loop not in found and coordinates(loop.joints) & reached]
        if not near:
            break
        found += near
    for loop in found:
        _check(description, loop, base)
    return tuple(filter(found.__contains__, candidates))


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


def _candidate(description: Description, element: LoopElement) -> SelectedLoop:
    """Return a loop without the joints from the root that both ends share."""
    first, second = (_above(description, end.link) for end in (element.first, element.second))
    while first and second and first[0] is second[0]:
        first, second = first[1:], second[1:]
    return SelectedLoop(element, tuple(first), tuple(second))


def _check(description: Description, loop: SelectedLoop, base: str) -> None:
    """Refuse a loop that moves nothing, has joints not beyond the base, or joints with none or several coordinates."""
    title = f"{description.file}: {printable(loop.element.text)}"
    moving = [joint for joint in loop.joints if joint.type != "fixed"]
    if not moving:
        raise ChainError(f"{title} has no moving joint; choose other links, or leave the loop out")
    start = loop.joints[0].parent
    to_start, to_base = ([link, *(each.parent for each in _above(description, link)[::-1])] for link in (start, base))
    if base not in to_start:
        where = "before" if start in to_base else "which is not beyond"
        common = next(link for link in to_base if link in to_start)
        raise ChainError(
            f"{title} starts at '{printable(start)}', {where} base '{printable(base)}'; "
            f"use --base {shell_word(common)}, or leave the loop out"
        )
    other = next((joint for joint in moving if joint.type not in MOVING_TYPES), None)
    if other is not None:
        raise ChainError(
            f"{title}: joint '{printable(other.name)}' is {other.type}, which has no single coordinate; "
            "replace it by hinges with one coordinate each (links without mass between them), or leave the loop open"
        )


def build_loop(loop: SelectedLoop, couplings: Couplings, masters: Sequence[str], base_joints: int) -> ClosedLoop:
    """Return the record of a loop, with all its equations as rows."""
    element = loop.element
    ends = [
        _end(path, end, couplings, masters, base_joints)
        for path, end in ((loop.first, element.first), (loop.second, element.second))
    ]
    rows = tuple(range(6 if element.is_weld else 3))
    return ClosedLoop(element.text, ends[0], ends[1], rows, element.is_weld, element.option)


def _end(
    path: Sequence[JointElement], end: LoopEndElement, couplings: Couplings, masters: Sequence[str], base_joints: int
) -> LoopEnd:
    """Return an end with the moving joints of its path; joints at rest are part of the poses after them."""
    pose, joints = Pose.identity(), list[Joint]()  # pose: since the last moving joint
    for element in path:
        if not couplings.moves(element):
            pose = pose @ couplings.pose_at_rest(element)
            continue
        joint_pose = pose @ Pose.placed(element.xyz, element.orientation)
        joints.append(
            couplings.moving_joint(
                element, joint_pose, masters, body=_NO_BODY, parent=len(joints) - 1, first=base_joints
            )
        )
        pose = Pose.identity()
    return LoopEnd(tuple(joints), *(pose @ Pose.placed(end.xyz, end.orientation)).rounded())


def wanted_motors(
    file: str, loops: Sequence[ClosedLoop], elements: Sequence[JointElement], base_joints: int, actuated: Sequence[str]
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
