# SPDX-License-Identifier: MIT
"""Compute the law of a potential on a robot whose base has no motor: joint torques and required contact forces.

The potential U of springs at several tips has a gradient of 6 + n entries. The last n entries of -dU are joint torques,
which the motors apply. The first six are a wrench on the base, which no motor can apply. The contacts must supply this
wrench by forces f of the ground on the standing feet, with

    sum over the standing feet of (J^T f) on the base  =  -dU/d(base) + gradient of gravity's energy on the base

The legs add the torques -J^T f, so that the ground pushes back with f, provided that the feet do not move.

A spring between a tip and the base needs no contact forces, because it pulls the tip and pushes the base.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from examples.whole_body.stance import FEET, GRAVITY, MOTIONLESS, Springs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Command:
    """Torques and wrench that the law demands.

    Args:
        torque: (12) of the joints [N m].
        on_base: (6) wrench that the contacts must supply on the base, in its axes, at its origin [N, N m].
        contact_forces: (feet, 3) forces of the ground that supply it, world axes [N]; 0 where no foot stands.

    """

    torque: Array
    on_base: Array
    contact_forces: Array


@dataclass(frozen=True)
class WholeBodyLaw:
    """Springs at all tips at once, gravity cancelled, and the base's part handed to the standing feet.

    Args:
        robot: the generated module.
        of_base: springs between feet and base, equilibria seen from the base.
        of_ground: springs between feet and ground, equilibria in the world.
        standing: feet that the ground carries.
        damping: of every joint [N m s/rad].
        supplies: whether the standing legs press on the ground for the base's part; without, it is only reported.

    """

    robot: ModuleType
    of_base: Springs
    of_ground: Springs
    standing: tuple[str, ...]
    damping: float
    supplies: bool = True

    def command(self, base_pose: Array, q: Array, dq: Array) -> Command:
        """Return the command at a base pose (4, 4), joint positions (12) and rates (12).

        The springs and gravity ask for a generalised force (18): the base's part (6), which contact forces f must
        supply, J_base^T f, and the joints' part (12), from which the standing legs take J_joints^T f.
        """
        robot, where = self.robot, (base_pose, q)
        force = np.asarray(robot.spring.torque_total(*where, *self.of_ground.parameters))
        force = force + robot.gravity.gradient(*where, GRAVITY)
        force[6:] += robot.spring.torque_total(MOTIONLESS, q, *self.of_base.parameters)[6:]
        J = np.vstack([getattr(robot, foot).hybrid.jacobian(*where)[:3] for foot in self.standing])  # (3 feet, 18)
        f = np.linalg.lstsq(J[:, :6].T, force[:6], rcond=None)[0]  # the smallest forces that supply the wrench
        contact_forces = np.zeros((len(FEET), 3))
        contact_forces[[FEET.index(foot) for foot in self.standing]] = f.reshape(-1, 3)
        torque = force[6:] - self.damping * dq - (J[:, 6:].T @ f if self.supplies else 0)
        return Command(torque=torque, on_base=force[:6], contact_forces=contact_forces)


def on_base(robot: ModuleType, base_pose: Array, q: Array, forces: Array) -> Array:
    """Return the wrench (6) on the base, in its axes, of world forces (feet, 3) on the feet [N, N m]."""
    J = np.vstack([getattr(robot, foot).hybrid.jacobian(base_pose, q)[:3] for foot in FEET])
    return np.asarray(J[:, :6].T @ forces.ravel())
