# SPDX-License-Identifier: MIT
"""Mimic relations and locks: the coordinate that moves each joint, and the poses of joints at rest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from stiffgen.core.errors import DescriptionError, printable
from stiffgen.core.robot.chain import Joint, RigidBody
from stiffgen.core.robot.description import LARGEST, MOVING_TYPES, Description, JointElement, Mimic
from stiffgen.core.robot.geometry import Pose, exact

_MOST_NAMED = 4
"""Largest number of joints that the sentence about a coordinate names."""


def _is_empty(limited: JointElement, master: JointElement) -> bool:
    """Return whether the limits of a coordinate contain no range, or one point where its own have a range."""
    return limited.lower > limited.upper or (limited.lower == limited.upper and master.lower < master.upper)


class Couplings:
    """Couplings of all joints of a description: chains of ``<mimic>`` relations, resolved to the joint that leads."""

    def __init__(self, description: Description, locks: Mapping[str, float]) -> None:
        self.description = description
        self.locks = locks
        self._known: dict[str, Mimic] = {}

    def __getitem__(self, element: JointElement) -> Mimic:
        """Return the joint that leads an element, with multiplier and offset; a joint that mimics none leads itself.

        The chain of masters is followed to the first known one, and composed back from there.
        """
        followers: list[JointElement] = []
        while element.name not in self._known and element.mimic is not None:
            followers.append(element)
            element = self.description.joints[element.mimic.joint]
        coupling = self._known.setdefault(element.name, Mimic(element.name, 1.0, 0.0))
        for follower in reversed(followers):  # q = m (m' q' + o') + o
            assert follower.mimic is not None
            coupling = Mimic(
                coupling.joint,
                follower.mimic.multiplier * coupling.multiplier,
                follower.mimic.multiplier * coupling.offset + follower.mimic.offset,
            )
            if not max(abs(coupling.multiplier), abs(coupling.offset)) <= LARGEST:
                raise DescriptionError(
                    self.description.file,
                    [
                        f"joint '{printable(follower.name)}': the multiplier or offset of its chain of <mimic> "
                        f"elements is beyond {LARGEST:g}; correct them"
                    ],
                )
            self._known[follower.name] = coupling
        return coupling

    def moves(self, element: JointElement) -> bool:
        """Return whether a coordinate moves a joint; a joint that mimics a fixed or locked joint does not move."""
        if element.type not in MOVING_TYPES:
            return False
        coupling = self[element]
        master = self.description.joints[coupling.joint]
        return master.type in MOVING_TYPES and coupling.multiplier != 0 and master.name not in self.locks

    def limited(self, master: JointElement) -> JointElement:
        """Return the joint of a coordinate, its limits narrowed by those of each joint that follows it.

        A follower at the position m q + o bounds q, by its velocity limit v the rate of q to v / |m|, and by its effort
        limit e the force on q to |m| e: then no joint exceeds its limit, whichever of them carries the load. A range of
        one point is what exporters write for no limit.

        Position limits that exclude each other leave no range; then the coordinate keeps its own (:meth:`exclusion`).
        """
        limited = master
        for follower in self.followers(master):
            limited = self._narrowed(limited, follower)
        if _is_empty(limited, master):
            return replace(limited, lower=master.lower, upper=master.upper)
        return limited

    def exclusion(self, master: JointElement) -> str:
        """Return which joints leave a coordinate no range within their position limits; "" if there is a range.

        Named are the joints that exclude the coordinate's own range, or else all that narrow it.
        """
        limited, narrowing, excluding = master, list[str](), list[str]()
        for follower in self.followers(master):
            limited = self._narrowed(limited, follower)
            alone = self._narrowed(master, follower)  # by this follower only
            if (alone.lower, alone.upper) == (master.lower, master.upper):
                continue
            lower, upper = self._range(follower)
            own_range = f"'{printable(follower.name)}' with {follower.lower:g} to {follower.upper:g}"
            narrowing.append(f"{own_range}, which needs {lower:g} to {upper:g}")
            if _is_empty(alone, master):
                excluding.append(narrowing[-1])
        if not _is_empty(limited, master):
            return ""
        named = excluding or narrowing
        more = f" and {len(named) - _MOST_NAMED} more" if len(named) > _MOST_NAMED else ""
        return "; ".join(named[:_MOST_NAMED]) + more

    def _range(self, follower: JointElement) -> tuple[float, float]:
        """Return the positions of the coordinate at the position limits of a joint that follows it."""
        coupling = self[follower]
        rate, offset = exact(coupling.multiplier), exact(coupling.offset)
        lower, upper = sorted(
            float((exact(end) - offset) / rate) if math.isfinite(end) else math.copysign(end, end * rate)
            for end in (follower.lower, follower.upper)
        )
        return lower, upper

    def _narrowed(self, limited: JointElement, follower: JointElement) -> JointElement:
        """Return the joint of a coordinate, its limits narrowed by those of one follower (:meth:`limited`)."""
        coupling = self[follower]
        lower, upper = limited.lower, limited.upper
        if follower.lower < follower.upper:
            ends = self._range(follower)
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
        effort = min(limited.effort, follower.effort * abs(coupling.multiplier))
        rates = {
            name: min(getattr(limited, name), getattr(follower, name) / abs(coupling.multiplier))
            for name in ("velocity", "acceleration", "deceleration", "jerk")
        }
        return replace(limited, lower=lower, upper=upper, effort=effort, **rates)

    def followers(self, master: JointElement) -> Iterator[JointElement]:
        """Yield the joints of the file, on the chain or not, that move when a coordinate moves."""
        for name in self._followers.get(master.name, ()):
            element = self.description.joints[name]
            if self.moves(element):
                yield element

    @cached_property
    def _followers(self) -> dict[str, list[str]]:
        """Joints that mimic, by the joint that leads them."""
        joints = self.description.joints
        leaders: dict[str, str] = {}
        found: dict[str, list[str]] = {}
        for name, element in joints.items():
            path = [name]  # to the leader, or to a joint whose leader is known
            while element.mimic is not None and path[-1] not in leaders:
                element = joints[element.mimic.joint]
                path.append(element.name)
            leader = leaders.get(path[-1], path[-1])
            leaders |= dict.fromkeys(path, leader)
            if name != leader:
                found.setdefault(leader, []).append(name)
        return found

    def position_at_rest(self, element: JointElement) -> float:
        """Return the position of a joint at rest: as locked, or with its coordinate at zero [rad or m]."""
        coupling = self[element]
        return coupling.multiplier * self.locks.get(coupling.joint, 0.0) + coupling.offset

    def pose_at_rest(self, element: JointElement) -> Pose:
        """Return the pose of a joint's child link in its parent link, for a joint that is fixed, locked or not in q."""
        pose = Pose.placed(element.xyz, element.orientation)
        if element.type not in MOVING_TYPES:
            return pose
        position = self.position_at_rest(element)
        if position == 0:
            return pose
        if element.type == "prismatic":
            return pose @ Pose.translated([exact(position) * exact(v) for v in element.axis])
        return pose @ Pose.rotation_about(element.axis, position)

    def moving_joint(
        self, element: JointElement, pose: Pose, masters: Sequence[str], *, body: RigidBody, parent: int, first: int = 0
    ) -> Joint:
        """Return a joint of a chain whose coordinates are ``masters``.

        Args:
            element: the joint in the file.
            pose: pose of the joint at zero position, in the parent joint's frame.
            masters: names of the joints that are coordinates.
            body: inertia of the links that move with the joint.
            parent: index of the parent joint.
            first: index of the first master's coordinate.

        """
        coupling = self[element]
        rotation, translation = pose.rounded()
        return Joint(
            name=element.name,
            type=element.type,
            child=element.child,
            rotation=rotation,
            translation=translation,
            axis=element.axis,
            body=body,
            parent=parent,
            coordinate=first + masters.index(coupling.joint),
            multiplier=coupling.multiplier,
            offset=coupling.offset,
        )

    def followed(self, elements: Iterable[JointElement]) -> set[str]:
        """Return the names of joints and of all joints that they mimic, directly or not, as in :class:`Problem`."""
        names: set[str] = set()
        for start in elements:
            element: JointElement | None = start
            while element is not None and element.name not in names:
                names.add(element.name)
                element = None if element.mimic is None else self.description.joints[element.mimic.joint]
        return {f"joint {name}" for name in names}
