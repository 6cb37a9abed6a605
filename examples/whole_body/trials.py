# SPDX-License-Identifier: MIT
"""Simulate trials: kicks that excite the stance, and a foot that presses on a wall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from examples.whole_body import identify
from examples.whole_body.law import WholeBodyLaw, on_base
from examples.whole_body.plant import TIMESTEP, Plant, Wall
from examples.whole_body.stance import FEET, GROUND, LEG, MOTIONLESS, POSTURE, Springs, Stance, feet, level

Array = NDArray[np.float64]
Progress = Callable[[], None]

KICK = 1e-4
"""[m/s] and [rad/s] of a kick: deflections of some micrometres, where springs are linear to six digits."""
SAMPLE_TIME = 0.004
"""[s] between recorded samples."""
DIRECTIONS = 6


def simulated(stance: Stance) -> Plant:
    """Return the plant at a stance: same contact springs, same load."""
    places = zip(FEET, stance.contacts.equilibria, stance.contacts.translation, strict=True)
    contacts = {foot: (equilibrium[:3, 3], stiffness) for foot, equilibrium, stiffness in places}
    return Plant(stance.base_pose, stance.q, contacts, stance.load)


def legs_law(stance: Stance) -> Callable[[Array, Array, Array], Array]:
    """Return the springs between feet and base as torques; no damping."""
    springs, robot = stance.legs.parameters, stance.robot

    def law(_: Array, q: Array, __: Array) -> Array:
        return np.asarray(robot.spring.torque_total(MOTIONLESS, q, *springs)[6:])

    return law


def ring(stance: Stance, duration: float, progress: Progress = lambda: None) -> Array:
    """Return the free motion after kicks along each direction of the base: (samples, 18, kicks) in Kq's coordinates."""
    M, responses = np.diag(stance.mass_matrix()), []
    for direction in range(DIRECTIONS):
        responses.append(_free_motion(stance, _kick(M, direction), duration))
        progress()
    return np.asarray(responses).transpose(1, 2, 0)


def _kick(M: Array, direction: int) -> Array:
    """Return an impulse (18) that gives KICK to one direction of the base, and to two joints, so that feet swing.

    M is the diagonal (18) of the mass matrix.
    """
    joints = slice(6 + 2 * direction, 8 + 2 * direction)
    impulse = np.zeros(18)
    impulse[direction] = KICK * M[direction]
    impulse[joints] = KICK * M[joints]
    return impulse


def _free_motion(stance: Stance, impulse: Array, duration: float) -> list[Array]:
    """Return the samples (18) of the motion after an impulse: base [m, rad] and joints, less those of the stance."""
    law = legs_law(stance)
    turn, origin = stance.base_pose[:3, :3], stance.base_pose[:3, 3]
    plant = simulated(stance)
    plant.kick(impulse)
    recorded = []
    for step in range(round(duration / TIMESTEP)):
        if step % round(SAMPLE_TIME / TIMESTEP) == 0:
            pose = plant.base_pose
            moved = turn.T @ (pose[:3, 3] - origin)
            turned = Rotation.from_matrix(turn.T @ pose[:3, :3]).as_rotvec()
            recorded.append(np.concatenate([moved, turned, plant.q - stance.q]))
        plant.step(law)
    return recorded


def identified(stance: Stance, duration: float, progress: Progress = lambda: None) -> list[identify.Found]:
    """Return the modes of the simulated stance, softest first."""
    return identify.modes(ring(stance, duration, progress), SAMPLE_TIME, order=2 * len(stance.gradient()))


PRESSING = "FL_FOOT"
STANDING = tuple(foot for foot in FEET if foot != PRESSING)
WALL = Wall(PRESSING, 0.26, 4000.0)
LEAN: Array = np.array([-0.05, -0.04, 0.0])
"""[m] by which the base leans over the three feet that stand."""
DEPTH = 0.03
"""[m] behind the wall to which the spring of the fourth foot is moved; REACH times it is the force."""
REACH: Array = np.diag([150.0, 150.0, 150.0])
"""Stiffness of the spring between that foot and the ground [N/m]."""
DAMPING = 0.12
"""[N m s/rad] of every joint."""
CONTROL_STEPS = 5
"""Steps of the physics for which a command is held: a loop of 1 kHz."""
APPROACH, PUSHED, END = (0.5, 1.0), (3.0, 3.2), 5.5
"""[s]: the spring moves into the wall, the base is pushed, the trial ends."""
PUSH: Array = np.array([0.0, 3.0, 0.0])
"""[N] on the base."""


@dataclass(frozen=True)
class Trace:
    """A trial at the wall; one row a sample.

    Args:
        time: [s].
        asked: (samples, 6) wrench on the base that the law reports.
        supplied: (samples, 6) that the ground's forces make there.
        base: (samples, 3) place of the base [m].
        foot: (samples, 3) place of the pressing foot [m].
        wall: (samples, 3) force of the wall on it [N].
        ground: (samples, feet, 3) forces of the ground [N].

    """

    time: Array
    asked: Array
    supplied: Array
    base: Array
    foot: Array
    wall: Array
    ground: Array


def at_wall(robot: ModuleType, *, supplies: bool, progress: Progress = lambda: None) -> Trace:
    """Stand on three feet, press on the wall with the fourth; ``supplies`` as :class:`WholeBodyLaw` takes it."""
    base, places = _leaning_base(robot)
    reached = places.copy()  # (4, 4, 4): poses of the feet, the fourth one at the wall
    reached[FEET.index(PRESSING), :3, 3] = WALL.at - 0.01, 0.14, 0.07  # [m] 1 cm before the wall
    q = _with_feet_at(robot, base, reached)
    law = _wall_law(robot, base, reached, supplies=supplies)
    plant = Plant(base, q, {foot: (places[FEET.index(foot), :3, 3], GROUND) for foot in STANDING}, wall=WALL)
    rows = []
    for step in range(round(END / TIMESTEP)):
        time = step * TIMESTEP
        if step % CONTROL_STEPS == 0:
            law = replace(law, of_ground=replace(law.of_ground, equilibria=_pressed(reached, time)))
            command = law.command(plant.base_pose, plant.q, plant.rates[6:])
            progress()
        # The plant's step is shorter than the controller's, whose torque is held in between.
        held = command.torque
        pose, joints = plant.base_pose, plant.q
        plant.step(lambda *_, held=held: held, PUSH if PUSHED[0] <= time < PUSHED[1] else None)
        if step % (10 * CONTROL_STEPS) == 0:
            supplied = on_base(robot, pose, joints, plant.ground)
            foot = feet(robot, pose, joints)[FEET.index(PRESSING), :3, 3]
            rows.append((time, command.on_base, supplied, pose[:3, 3], foot, plant.wall, plant.ground))
    return Trace(*map(np.array, zip(*rows, strict=True)))  # columns in the order of the fields


def _leaning_base(robot: ModuleType) -> tuple[Array, Array]:
    """Return the base's pose, at the height where the feet stand and leaning by LEAN, and the feet's (4, 4, 4)."""
    base = np.eye(4)
    base[2, 3] = -feet(robot, np.eye(4), POSTURE)[:, 2, 3].mean()
    places = level(feet(robot, base, POSTURE))
    base[:3, 3] += LEAN
    return base, places


def _wall_law(robot: ModuleType, base: Array, reached: Array, *, supplies: bool) -> WholeBodyLaw:
    """Return the law: springs from the base to the feet that stand, from the ground to the one that presses."""
    zero = np.zeros((3, 3))
    no_rotation = np.zeros((len(FEET), 3, 3))
    in_base = reached.copy()
    in_base[:, :3, 3] -= base[:3, 3]
    return WholeBodyLaw(
        robot,
        of_base=Springs(in_base, np.stack([zero if foot == PRESSING else LEG for foot in FEET]), no_rotation),
        of_ground=Springs(reached, np.stack([REACH if foot == PRESSING else zero for foot in FEET]), no_rotation),
        standing=STANDING,
        damping=DAMPING,
        supplies=supplies,
    )


def _pressed(reached: Array, time: float) -> Array:
    """Return the feet's equilibria: that of the fourth moves into the wall, up to DEPTH behind its surface."""
    start = reached[FEET.index(PRESSING), 0, 3]
    share = np.clip((time - APPROACH[0]) / (APPROACH[1] - APPROACH[0]), 0, 1)
    targets = reached.copy()
    targets[FEET.index(PRESSING), 0, 3] = start + share * (WALL.at + DEPTH - start)
    return targets


CONTROL_CYCLES = round(END / TIMESTEP) // CONTROL_STEPS
"""Calls of ``progress`` in a trial at the wall."""


def _with_feet_at(robot: ModuleType, base_pose: Array, places: Array) -> Array:
    """Return joint positions (12) that put the feet at places, from POSTURE by Newton's method."""
    q = POSTURE.copy()
    for _ in range(60):
        missing = (places - feet(robot, base_pose, q))[:, :3, 3].ravel()
        J = np.vstack([getattr(robot, foot).hybrid.jacobian(base_pose, q)[:3, 6:] for foot in FEET])
        step = np.linalg.solve(J, missing)
        q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-300))
    return q
