# SPDX-License-Identifier: MIT
"""Closed loops as the playground draws them: joints beside the chain, and the points in which the loops are cut."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stiffgen.core.robot.chain import Chain, Joint, LoopEnd, Tip

_PoseMatrix = NDArray[np.float64]


def pose(placed: Joint | LoopEnd | Tip) -> _PoseMatrix:
    """Return the 4 x 4 pose of a joint, a tip or an end of a loop in its parent."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = np.array(placed.rotation), placed.translation
    return result


def drawn_joints(chain: Chain) -> tuple[list[dict[str, Any]], list[list[dict[str, Any]]]]:
    """Return the joints of the chain, then those of its loops, parents first, and the two ends of each loop.

    An end is a joint (-1: the base) and a point in its frame. Joints of loops count from the last link that both ends
    share. The chain slides the origins of its joints along their axes, loops do not; a joint of both is drawn twice.
    """
    records = [_record(chain, joint, joint.parent, pose(joint)) for joint in chain.joints]
    placed: dict[str, tuple[int, int, _PoseMatrix]] = {}  # of loops: number, parent, pose in the parent
    ends = []
    for loop in chain.loops:
        parent, shared = _shared(chain, placed, (loop.first, loop.second))
        pair = []
        for end in (loop.first, loop.second):
            at, before = parent, shared
            for joint in end.joints:
                if joint.name not in placed:
                    placed[joint.name] = len(records), at, before @ pose(joint)
                    records.append(_record(chain, joint, at, before @ pose(joint)))
                at, before = placed[joint.name][0], np.eye(4)
            pair.append({"joint": at, "point": (before @ pose(end))[:3, 3].tolist()})
        ends.append(pair)
    return records, ends


def _shared(
    chain: Chain, placed: dict[str, tuple[int, int, _PoseMatrix]], ends: Sequence[LoopEnd]
) -> tuple[int, _PoseMatrix]:
    """Return the shared link of a loop: a joint before it, and the link's pose in that joint's frame.

    Where only the chain has the first joint of an end, the link is known up to a shift along that joint's axis.
    """
    firsts = [end.joints[0] for end in ends if end.joints]
    for joint in firsts:
        if joint.name in placed:
            _, parent, place = placed[joint.name]
            return parent, place @ np.linalg.inv(pose(joint))
    for joint, other in product(firsts, chain.joints):
        if joint.name == other.name:
            shared = pose(other) @ np.linalg.inv(pose(joint))
            along = np.array(other.rotation) @ other.axis
            away = shared - np.eye(4)
            away[:3, 3] -= along * (along @ away[:3, 3])
            is_base = other.parent < 0 and np.abs(away).max() < 1e-9
            return other.parent, np.eye(4) if is_base else shared
    return -1, np.eye(4)


def _record(chain: Chain, joint: Joint, parent: int, place: _PoseMatrix) -> dict[str, Any]:
    """Return a joint as the page's scripts read it; its place is in the parent joint's frame."""
    return {
        "name": joint.name,
        "prismatic": joint.prismatic,
        "parent": parent,
        "coordinate": joint.coordinate - chain.base_joints,  # negative: a floating base's own
        "multiplier": joint.multiplier,
        "offset": joint.offset,
        "rotation": place[:3, :3].tolist(),
        "translation": place[:3, 3].tolist(),
        "axis": joint.axis,
    }
