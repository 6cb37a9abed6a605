# SPDX-License-Identifier: MIT
"""Mimic relations and locks: the coordinate that moves each joint, and the poses of joints at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stiffgen.errors import DescriptionError, printable
from stiffgen.robot.chain import Joint, RigidBody
from stiffgen.robot.description import LARGEST, MOVING_TYPES, Description, JointElement, Mimic
from stiffgen.robot.geometry import Pose, exact


class Couplings:
    """Couplings of all joints of a description: chains of ``<mimic>`` relations, resolved to the joint that leads."""

    def __init__(self, description: Description, locks: Mapping[str, float]) -> None:
        self.description = description
        self.locks = locks
        self._known: dict[str, Mimic] = {}

    def __getitem__(self, element: JointElement) -> Mimic:
        followers: list[JointElement] = []
        while element.name not in self._known and element.mimic is not None:
            followers.append(element)
            element = self.description.joints[element.mimic.joint]
        coupling = self._known.setdefault(element.name, Mimic(element.name, 1.0, 0.0))
        for follower in reversed(followers):
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

    def followed(self, elements: list[JointElement]) -> set[str]:
        """Return the names of joints and of all joints that they mimic, directly or not, as in :class:`Problem`."""
        names: set[str] = set()
        for start in elements:
            element: JointElement | None = start
            while element is not None and element.name not in names:
                names.add(element.name)
                element = None if element.mimic is None else self.description.joints[element.mimic.joint]
        return {f"joint {name}" for name in names}
