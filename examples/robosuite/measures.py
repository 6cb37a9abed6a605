# SPDX-License-Identifier: MIT
"""Measure a controller in robosuite: an episode of a task, and closed orbits of the arm alone.

Controllers are compared at equal stiffness of the tip, K = diag(STIFFNESS) in the world's axes, at the posture in which
the episode starts. OSC_POSE multiplies its gains by the tip's mass matrix Lambda, JOINT_POSITION by the joints' mass
matrix M: their gains are kp_i = K_ii / Lambda_ii and kp_j = (J^T K J)_jj / M_jj, with a damping ratio of 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import robosuite
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from examples.robosuite.controller import PART, controller_config
from examples.robosuite.motions import TASKS, targets, tip_pose

Vector = NDArray[np.float64]
STIFFNESS = (1000.0, 1000.0, 1000.0, 50.0, 50.0, 50.0)  # N/m, N m/rad
FREQUENCY = 20  # Hz, of the actions
SETTLE = 1.0  # s, for objects to come to rest
ORBIT, ORBIT_PERIOD = 0.02, 3.0  # rad and s, of the closed orbit: small enough for all effort limits
Job = tuple[str, str | None, str, int]
"""Robot, task, controller and seed; without a task a closed orbit."""
CONTROLLERS = (PART, "OSC_POSE", "JOINT_POSITION")


def make(environment: str, robot: str, controller: str, seed: int, gains: Any = None, **options: Any) -> Any:
    """Return a robosuite environment whose arm has a controller with absolute goals in the world."""
    fields: dict[str, Any] = {"input_type": "absolute", "input_ref_frame": "world", "kp": list(STIFFNESS)}
    config = controller_config(robot, **fields)
    if controller != PART:
        parts = config["body_parts"]
        for name in [name for name, part in parts.items() if part.get("type") == PART]:
            parts[name] = {**parts[name], "type": controller, "kp": gains}
    return robosuite.make(environment, robots=robot, controller_configs=config, has_renderer=False,
                          has_offscreen_renderer=False, use_camera_obs=False, control_freq=FREQUENCY,
                          ignore_done=True, seed=seed, **options)  # fmt: skip


def equal_gains(controller: str, J: Vector, M: Vector) -> list[float]:
    """Return the gains [1/s^2] of robosuite's controllers that give the tip STIFFNESS.

    Args:
        controller: OSC_POSE or JOINT_POSITION.
        J: Jacobian of the tip, shape (6, n), in the world's axes.
        M: mass matrix, shape (n, n) [kg m^2].

    """
    if controller == "JOINT_POSITION":
        return list(np.diag(J.T @ np.diag(STIFFNESS) @ J) / np.diag(M))
    blocks = [np.linalg.inv(half @ np.linalg.solve(M, half.T)) for half in (J[:3], J[3:])]
    return list(np.asarray(STIFFNESS) / np.concatenate([np.diag(block) for block in blocks]))


@dataclass
class Arm:
    """What all controllers share: indexes of the arm in MuJoCo, and its kinematics and masses from MuJoCo."""

    env: Any
    part: Any = field(init=False)
    site: int = field(init=False)
    columns: Vector = field(init=False)

    def __post_init__(self) -> None:
        self.part = self.env.robots[0].composite_controller.part_controllers["right"]
        self.site = self.env.sim.model.site_name2id(self.part.ref_name)
        self.columns = np.asarray(self.part.qvel_index)

    def jacobian(self) -> Vector:
        """Return the Jacobian (6, n) of the tip in the world's axes."""
        model = self.env.sim.model._model
        both = np.zeros((2, 3, model.nv))
        mujoco.mj_jacSite(model, self.env.sim.data._data, both[0], both[1], self.site)
        return np.asarray(both.reshape(6, -1)[:, self.columns])

    def mass_matrix(self) -> Vector:
        """Return the mass matrix (n, n) with the rotors."""
        model = self.env.sim.model._model
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, full, self.env.sim.data.qM)
        return np.asarray(full[np.ix_(self.columns, self.columns)])

    def action(self, pose: Vector, controller: str, q: Vector) -> Vector:
        """Return the action of a goal; for joints the solution of the inverse kinematics that is nearest to ``q``."""
        if controller == "JOINT_POSITION":
            return self.inverse_kinematics(pose, q)
        return np.concatenate([pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_rotvec()])

    def inverse_kinematics(self, pose: Vector, q: Vector) -> Vector:
        """Return joint positions of a pose by damped least squares, on a copy of the simulation's state."""
        model, data = self.env.sim.model._model, mujoco.MjData(self.env.sim.model._model)
        data.qpos[:] = self.env.sim.data.qpos
        places, jacobian = np.asarray(self.part.qpos_index), np.zeros((2, 3, model.nv))
        limited = model.jnt_limited[self.part.joint_index].astype(bool)
        limits = np.where(limited, model.jnt_range[self.part.joint_index].T, [[-np.inf], [np.inf]])
        q = np.array(q)
        for _ in range(10):
            data.qpos[places] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            turn = pose[:3, :3] @ data.site_xmat[self.site].reshape(3, 3).T
            error = np.concatenate([pose[:3, 3] - data.site_xpos[self.site], Rotation.from_matrix(turn).as_rotvec()])
            mujoco.mj_jacSite(model, data, jacobian[0], jacobian[1], self.site)
            J = jacobian.reshape(6, -1)[:, self.columns]
            step = J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), error)
            q = np.clip(q + np.clip(step, -0.1, 0.1), *limits)
        return q


@dataclass
class Watch:
    """Largest contact force [N] and torque changes of every step of the simulation, and errors of every action."""

    arm: Arm
    force: float = 0.0
    changes: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    faults: set[str] = field(default_factory=set)
    last: Vector | None = None

    def __post_init__(self) -> None:
        env = self.arm.env
        model, robot = env.sim.model, env.robots[0]
        own = set(robot.robot_model.contact_geoms) | set(robot.gripper["right"].contact_geoms)
        self.own = {model.geom_name2id(name) for name in own}
        update = env._update_observables

        def watched(*arguments: Any, **named: Any) -> None:
            update(*arguments, **named)
            if not named.get("force"):
                self.step()

        env._update_observables = watched  # after each step of the simulation

    def step(self) -> None:
        """Look at torques and contacts of one step of the simulation."""
        torque = np.array(self.arm.part.torques)
        if self.last is not None:
            self.changes.append(float(np.sum((torque - self.last) ** 2)))
        self.last = torque
        self.force = max(self.force, float(np.linalg.norm(self.contact_force())))
        fault = getattr(getattr(self.arm.part, "output", None), "fault", None)
        if fault:
            self.faults.add(self.arm.part.output.reason.name)

    def contact_force(self) -> Vector:
        """Return the force on arm and gripper from outside [N]: the force with which fingers squeeze cancels."""
        model, data = self.arm.env.sim.model._model, self.arm.env.sim.data._data
        total, wrench = np.zeros(3), np.zeros(6)
        for k in range(data.ncon):
            contact = data.contact[k]
            first, second = contact.geom1 in self.own, contact.geom2 in self.own
            if first != second:
                mujoco.mj_contactForce(model, data, k, wrench)
                force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geometry
                total += force if second else -force
        return total


@dataclass(frozen=True)
class Episode:
    """Measures of an episode; tracking error and torque change are root mean squares."""

    success: float
    force: float  # N
    error: float  # m
    torque_change: float  # N m in a step of the simulation
    faults: tuple[str, ...]


def start(task: str, robot: str, controller: str, seed: int) -> tuple[Any, Arm]:
    """Make a task's environment with gains of equal stiffness; other controllers than ours are made twice for that."""
    entry = TASKS[task]
    env = make(entry.environment, robot, PART, seed, **entry.options)
    if controller != PART:
        env.reset()
        gains = equal_gains(controller, Arm(env).jacobian(), Arm(env).mass_matrix())
        env.close()
        env = make(entry.environment, robot, controller, seed, gains, **entry.options)
    env.reset()
    return env, Arm(env)


def run_episode(task: str, robot: str, controller: str, seed: int) -> Episode:
    """Run a task's motion."""
    env, arm = start(task, robot, controller, seed)
    pose, q = tip_pose(env), np.array(arm.part.joint_pos)
    gripper = [] if task == "Wipe" else [-1.0]
    for _ in range(round(SETTLE * FREQUENCY)):
        env.step(np.concatenate([arm.action(pose, controller, q), gripper]))
    watch = Watch(arm)
    for goal, closing in targets(pose, TASKS[task].motion(env), 1.0 / FREQUENCY):
        action = arm.action(goal, controller, q)
        q = action if controller == "JOINT_POSITION" else q
        env.step(np.concatenate([action, [closing] if gripper else []]))
        watch.errors.append(float(np.sum((tip_pose(env)[:3, 3] - goal[:3, 3]) ** 2)))
    success = TASKS[task].success(env)
    env.close()
    return Episode(success, watch.force, float(np.sqrt(np.mean(watch.errors))),
                   float(np.sqrt(np.mean(watch.changes))), tuple(sorted(watch.faults)))  # fmt: skip


def orbit_work(robot: str, controller: str, seed: int = 1) -> float:
    """Return the work [J] that springs put out on a closed orbit of the joints, with a constant goal.

    The arm is driven through the orbit in both directions. Damping takes the same work in both, a spring with a
    potential none: half of the difference is what the springs put out in one direction and take in the other.
    """
    forward, backward = (_driven_work(robot, controller, seed, sign) for sign in (1.0, -1.0))
    return abs(forward - backward) / 2.0


def _driven_work(robot: str, controller: str, seed: int, sign: float) -> float:
    """Return the work [J] of a controller's torque on the second of two rounds, without the compensation of gravity."""
    env, arm = start("Lift", robot, controller, seed)
    sim, part = env.sim, arm.part
    q0, step = np.array(part.joint_pos), float(sim.model.opt.timestep)
    random, rate, rounds = np.random.default_rng(seed), 2.0 * np.pi / ORBIT_PERIOD, round(ORBIT_PERIOD / step)
    first, second = (ORBIT * way / np.linalg.norm(way) for way in random.normal(size=(2, len(q0))))
    part.set_goal(arm.action(tip_pose(env), controller, q0))
    work, before, last = 0.0, q0, np.zeros(len(q0))
    for k in range(2 * rounds + 1):
        phase = rate * k * step
        q = q0 + first * (np.cos(phase) - 1.0) + sign * second * np.sin(phase)
        sim.data.time = k * step
        sim.data.qpos[part.qpos_index] = q
        sim.data.qvel[part.qvel_index] = rate * (-first * np.sin(phase) + sign * second * np.cos(phase))
        sim.forward()
        env.robots[0].composite_controller.update_state()
        part.update(force=True)
        torque = np.array(part.run_controller()) - part.torque_compensation
        work += float((torque + last) @ (q - before)) / 2.0 if k > rounds else 0.0
        before, last = q, torque
    env.close()
    return work


def run_job(job: Job) -> Episode | float:
    """Run an episode, or without a task a closed orbit."""
    robot, task, controller, seed = job
    return run_episode(task, robot, controller, seed) if task else orbit_work(robot, controller, seed)
