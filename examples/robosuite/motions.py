# SPDX-License-Identifier: MIT
"""Scripted motions for robosuite's tasks: the same poses of the tip for every controller.

A motion is a list of legs. It is computed from the state of the simulation, once the objects have settled, and takes no
feedback afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

Vector = NDArray[np.float64]
OPEN, CLOSED = -1.0, 1.0


@dataclass(frozen=True)
class Leg:
    """Straight way to a pose (4, 4) of the tip in the world [m], its duration [s], and the gripper's action."""

    pose: Vector
    seconds: float
    gripper: float


def targets(start: Vector, legs: list[Leg], period: float) -> list[tuple[Vector, float]]:
    """Return pose and gripper action of every action, from the pose ``start`` on; ``period`` [s] between actions."""
    found: list[tuple[Vector, float]] = []
    for leg in legs:
        count = max(1, round(leg.seconds / period))
        turn = Slerp([0.0, 1.0], Rotation.from_matrix([start[:3, :3], leg.pose[:3, :3]]))
        for k in range(1, count + 1):
            pose = np.eye(4)
            pose[:3, :3] = turn(k / count).as_matrix()
            pose[:3, 3] = start[:3, 3] + (leg.pose[:3, 3] - start[:3, 3]) * k / count
            found.append((pose, leg.gripper))
        start = leg.pose
    return found


def placed(rotation: Vector, *position: float) -> Vector:
    """Return a pose (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def closing_axis(env: Any) -> Vector:
    """Return the direction in which the fingers close, in the axes of the tip, normal to its z axis."""
    robot, sim = env.robots[0], env.sim
    pads = [robot.gripper["right"].important_geoms[f"{side}_fingerpad"] for side in ("left", "right")]
    places = [np.mean([sim.data.geom_xpos[sim.model.geom_name2id(name)] for name in pad], axis=0) for pad in pads]
    axis = tip_pose(env)[:3, :3].T @ (places[1] - places[0])
    axis[2] = 0.0
    return np.asarray(axis / np.linalg.norm(axis))


def tip_pose(env: Any) -> Vector:
    """Return the pose of the grip site in the world."""
    part = env.robots[0].composite_controller.part_controllers["right"]
    site = env.sim.model.site_name2id(part.ref_name)
    return placed(env.sim.data.site_xmat[site].reshape(3, 3), *env.sim.data.site_xpos[site])


def grasp_from_above(env: Any, across: Vector) -> Vector:
    """Return the rotation of a tip that points down and closes along ``across`` or against it, whichever is nearer."""
    now, closing, down = tip_pose(env)[:3, :3], closing_axis(env), np.array([0.0, 0.0, -1.0])
    own = np.column_stack([closing, np.array([0.0, 0.0, 1.0]), np.cross(closing, [0.0, 0.0, 1.0])])
    across = np.array([across[0], across[1], 0.0]) / np.linalg.norm(across[:2])
    choices = [np.column_stack([d, down, np.cross(d, down)]) @ own.T for d in (across, -across)]
    return np.asarray(max(choices, key=lambda R: np.trace(now.T @ R)))


def lift(env: Any) -> list[Leg]:
    """Grasp the cube across the faces that are nearer to the fingers, and lift it by 0.15 m."""
    sim = env.sim
    x, y, z = sim.data.body_xpos[env.cube_body_id]
    faces = sim.data.body_xmat[env.cube_body_id].reshape(3, 3).T[:2]
    nearest = tip_pose(env)[:3, :3] @ closing_axis(env)
    rotation = grasp_from_above(env, max(faces, key=lambda face: abs(float(face @ nearest))))
    return [
        Leg(placed(rotation, x, y, z + 0.1), 2.0, OPEN),
        Leg(placed(rotation, x, y, z), 1.5, OPEN),
        Leg(placed(rotation, x, y, z), 1.0, CLOSED),
        Leg(placed(rotation, x, y, z + 0.15), 2.0, CLOSED),
        Leg(placed(rotation, x, y, z + 0.15), 0.5, CLOSED),
    ]


def door(env: Any) -> list[Leg]:
    """Grasp the handle from above and pull the door open along its arc; the door has no latch."""
    sim = env.sim
    handle, hinge = np.array(env._handle_xpos), sim.model.joint_name2id(env.door.joints[0])
    centre, axis = np.array(sim.data.xanchor[hinge]), np.array(sim.data.xaxis[hinge])
    across = sim.data.body_xmat[env.object_body_ids["door"]].reshape(3, 3)[:, 1]  # normal of the door
    grasp = placed(grasp_from_above(env, across), *handle)
    above = grasp.copy()
    above[2, 3] += 0.12
    legs = [Leg(above, 2.5, OPEN), Leg(grasp, 1.5, OPEN), Leg(grasp, 1.0, CLOSED)]
    for angle in np.linspace(0.05, 0.5, 10):
        turn = Rotation.from_rotvec(angle * axis).as_matrix()
        legs.append(Leg(placed(turn @ grasp[:3, :3], *(centre + turn @ (grasp[:3, 3] - centre))), 0.4, CLOSED))
    return legs


def nut_assembly(env: Any) -> list[Leg]:
    """Grasp the square nut at its handle and put it over its peg."""
    sim, nut = env.sim, env.nuts[env.nut_id]
    body = env.obj_body_id[nut.name]
    handle = np.array(sim.data.site_xpos[sim.model.site_name2id(nut.important_sites["handle"])])
    rotation = sim.data.body_xmat[body].reshape(3, 3)
    grasp = placed(grasp_from_above(env, rotation[:, 1]), *handle)
    peg = np.array(sim.data.body_xpos[env.peg1_body_id])
    turn, offset = _over_peg(env, rotation, handle - np.array(sim.data.body_xpos[body]), peg)

    def over(height: float) -> Vector:
        return placed(turn @ grasp[:3, :3], peg[0] + offset[0], peg[1] + offset[1], handle[2] + height)

    above = [grasp.copy(), grasp.copy()]
    above[0][2, 3] += 0.12
    above[1][2, 3] += 0.2
    return [
        Leg(above[0], 2.5, OPEN),
        Leg(grasp, 1.5, OPEN),
        Leg(grasp, 1.0, CLOSED),
        Leg(above[1], 2.0, CLOSED),
        Leg(over(0.2), 3.0, CLOSED),
        Leg(over(0.2), 0.5, CLOSED),
        Leg(over(0.02), 2.0, CLOSED),
        Leg(over(0.02), 0.5, OPEN),
        Leg(over(0.15), 1.0, OPEN),
    ]


def _over_peg(env: Any, rotation: Vector, offset: Vector, peg: Vector) -> tuple[Vector, Vector]:
    """Return the rotation that aligns nut and peg, and the turned offset of the handle.

    Of the nearest yaw and those a quarter turn away, it is the one with the handle nearest to the robot: a peg at the
    end of the reach is not to be passed by the hand.
    """
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    nearest = np.round(yaw / (np.pi / 2)) * np.pi / 2 - yaw
    base = np.array(env.robots[0].base_pos)
    turns = [Rotation.from_euler("z", nearest + quarter * np.pi / 2).as_matrix() for quarter in (0, -1, 1)]
    best = min(turns, key=lambda turn: float(np.linalg.norm((peg + turn @ offset - base)[:2])))
    return best, best @ offset


def wipe(env: Any, depth: float = 0.015, speed: float = 0.1) -> list[Leg]:
    """Move over all markers at ``speed`` [m/s], with the goal ``depth`` [m] below the table."""
    sim = env.sim
    rotation = flat_wiper(env)
    names = [marker.root_body for marker in env.model.mujoco_arena.markers]
    places = np.array([sim.data.body_xpos[sim.model.body_name2id(name)] for name in names])[::4]
    table = float(places[0, 2])
    legs = [Leg(placed(rotation, places[0, 0], places[0, 1], table + 0.05), 2.0, 0.0)]
    legs.append(Leg(placed(rotation, places[0, 0], places[0, 1], table - depth), 1.0, 0.0))
    for before, place in pairwise(places):
        seconds = max(0.05, float(np.linalg.norm(place - before)) / speed)
        legs.append(Leg(placed(rotation, place[0], place[1], table - depth), seconds, 0.0))
    return [*legs, Leg(legs[-1].pose, 0.5, 0.0)]


def flat_wiper(env: Any) -> Vector:
    """Return the rotation nearest to the present one with which the wiper lies flat on the table."""
    now = tip_pose(env)[:3, :3]
    down = np.array([0.0, 0.0, -1.0])
    x = now[:, 0] - down * float(down @ now[:, 0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(down, x), down])


@dataclass(frozen=True)
class Task:
    """A task of robosuite: its name there, options, its motion, and what counts as success."""

    environment: str
    motion: Callable[[Any], list[Leg]]
    options: dict[str, Any]
    success: Callable[[Any], float]


def _solved(env: Any) -> float:
    return float(env._check_success())


def _wiped(env: Any) -> float:
    return len(env.wiped_markers) / float(env.num_markers)


TASKS = {
    "Lift": Task("Lift", lift, {}, _solved),
    "Door": Task("Door", door, {"use_latch": False}, _solved),
    "NutAssembly": Task("NutAssemblySquare", nut_assembly, {}, _solved),
    "Wipe": Task("Wipe", wipe, {}, _wiped),
}
