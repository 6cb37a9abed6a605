# SPDX-License-Identifier: MIT
"""Step a spring at the tip implicitly in MuJoCo, by a passive callback: how stiff may it be?

MuJoCo integrates forces of its own implicitly, but has no derivative of a force that a user adds: explicit steps limit
the stiffness of a spring at the tip. The callback here adds h^2 P to the inertia M, whose factors MuJoCo then uses for
the step and its contacts, and -h P dq to the torque:

    (M + h^2 P) a = torque - h P dq + contact forces - bias          dq += h a, q += h dq

P is stiffgen's positive tangent (``--kernels all,tangents``), J^T K J or another matrix of the spring. Of the energies
that this example compares the largest may exceed the first by 5 %.

    python -m examples.implicit      prints the largest stable stiffnesses [N/m], and deviations (3 minutes)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import stiffgen

Array = NDArray[np.float64]

URDF = Path(__file__).resolve().parent.parent / "urdf" / "iiwa14.urdf"
OPTIONS: dict[str, Any] = {"kernels": ("spring", "tangents", "hybrid.jacobian"), "controller": False, "masses": False}
START: Array = np.array([0.3, 0.7, -0.4, -1.3, 0.3, 0.8, 0.2])  # rad
LEVER = 0.2  # m: rotational over translational stiffness is its square
DAMPING = 1.0  # N m s/rad, of each joint
SECONDS = 1.0
SEARCHED = 10 ** np.arange(2.0, 7.01, 0.25)  # N/m


@dataclass(frozen=True)
class Task:
    """Spring between the tip and a pose.

    Attributes:
        robot: module with the group ``spring``.
        equilibrium: (4, 4) [m].
        stiffness: [N/m]; the rotational stiffness is LEVER^2 of it [N m/rad].

    """

    robot: ModuleType
    equilibrium: Array
    stiffness: float

    @property
    def arguments(self) -> tuple[Array, Array, Array]:
        """Arguments of the spring after q."""
        return self.equilibrium, self.stiffness * np.eye(3), LEVER**2 * self.stiffness * np.eye(3)


@dataclass(frozen=True)
class Cell:
    """Deflection [m, rad], step [s], and whether a wall stands before the equilibrium."""

    away: float
    turn: float
    step: float
    wall: bool


def none(task: Task, q: Array) -> Array:
    return np.zeros((len(q), len(q)))


def congruence(task: Task, q: Array) -> Array:
    """Return J^T K J with the covariant Hessian K."""
    J = task.robot.hybrid.jacobian(q)
    return np.asarray(J.T @ task.robot.spring.task_stiffness(q, *task.arguments) @ J)


def exact(task: Task, q: Array) -> Array:
    return np.asarray(task.robot.spring.joint_stiffness(q, *task.arguments))


def positive_part(task: Task, q: Array) -> Array:
    values, vectors = np.linalg.eigh(exact(task, q))
    return np.asarray(vectors * np.maximum(values, 0) @ vectors.T)


def absolute(task: Task, q: Array) -> Array:
    values, vectors = np.linalg.eigh(exact(task, q))
    return np.asarray(vectors * np.abs(values) @ vectors.T)


def blend(task: Task, q: Array) -> Array:
    return (congruence(task, q) + absolute(task, q)) / 2


def positive(task: Task, q: Array) -> Array:
    return np.asarray(task.robot.spring.positive_tangent(q, *task.arguments))


Tangent = Callable[[Task, Array], Array]
TANGENTS: dict[str, Tangent] = {
    "explicit": none,
    "J^T K J": congruence,
    "Kq": exact,
    "max(Kq, 0)": positive_part,
    "abs(Kq)": absolute,
    "blend": blend,
    "P": positive,
}


def arm(step: float, wall: bool) -> mujoco.MjModel:
    """Return the iiwa 14 without gravity, a ball of 3 cm at its flange; a wall stands 1 mm before the ball in START."""
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False
    spec.option.timestep, spec.option.gravity[:] = step, 0.0
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [0.03, 0, 0], "mass": 0.0}
    spec.body("link_ee").add_geom(name="ball", contype=1, conaffinity=0, **ball)
    if wall:  # its normal is the tip's own z axis, turned against it
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[:] = START
        mujoco.mj_kinematics(model, data)
        axis, quaternion = data.body("link_ee").xmat.reshape(3, 3)[:, 2], np.zeros(4)
        mujoco.mju_quatZ2Vec(quaternion, -axis)
        place = {"pos": data.geom("ball").xpos + 0.031 * axis, "quat": quaternion, "size": [1, 1, 0.1]}
        spec.worldbody.add_geom(name="wall", type=mujoco.mjtGeom.mjGEOM_PLANE, contype=0, conaffinity=1, **place)
    model = spec.compile()
    model.dof_damping[:] = DAMPING
    return model


@contextmanager
def implicit_spring(task: Task, tangent: Tangent) -> Iterator[None]:
    """Let MuJoCo's steps hold a spring, implicitly: a callback for the duration of a ``with`` block."""

    def passive(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        h, P = model.opt.timestep, tangent(task, data.qpos)
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        data.M[:] += h * h * P[rows, model.M_colind]
        mujoco.mj_factorM(model, data)
        data.qfrc_passive += task.robot.spring.torque(data.qpos, *task.arguments) - h * P @ data.qvel

    mujoco.set_mjcb_passive(passive)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(None)


def tasks(robot: ModuleType, away: float, turn: float, stiffness: float, count: int = 3) -> list[Task]:
    """Return tasks whose equilibria lie ``away`` [m] in front of the tip and around, turned by ``turn`` [rad]."""
    random, made = np.random.default_rng(0), []
    for _ in range(count):
        pose = robot.forward_kinematics(START)
        direction, axis = random.normal(size=3) + np.array([0.0, 0.0, 2.0]), random.normal(size=3)
        wanted = np.array(pose)
        wanted[:3, 3] += away * pose[:3, :3] @ direction / np.linalg.norm(direction)
        quaternion, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quaternion, axis / np.linalg.norm(axis), turn)
        mujoco.mju_quat2Mat(matrix, quaternion)
        wanted[:3, :3] = matrix.reshape(3, 3) @ pose[:3, :3]
        made.append(Task(robot, wanted, stiffness))
    return made


def is_stable(model: mujoco.MjModel, task: Task, tangent: Tangent, seconds: float = SECONDS) -> bool:
    """Return whether the energy of arm and spring never exceeds its first value by 5 %, and M + h^2 P is positive."""
    data, other, h = mujoco.MjData(model), mujoco.MjData(model), model.opt.timestep
    data.qpos[:] = START
    first, M = task.robot.spring.energy(START, *task.arguments), np.zeros((7, 7))
    with implicit_spring(task, tangent):
        for _ in range(round(seconds / h) + 1):
            if not np.abs(data.qpos).max() < 50:
                return False
            other.qpos[:] = data.qpos
            mujoco.mj_fwdPosition(model, other)  # the inertia without P
            mujoco.mj_fullM(model, other, M)
            energy = task.robot.spring.energy(data.qpos, *task.arguments) + data.qvel @ M @ data.qvel / 2
            if not energy <= 1.05 * first or not np.linalg.eigvalsh(M + h * h * tangent(task, data.qpos))[0] > 0:
                return False
            mujoco.mj_step(model, data)
    return True


def stiffest(robot: ModuleType, tangent: Tangent, cell: Cell) -> float:
    """Return the largest of the SEARCHED stiffnesses [N/m] up to which all tasks are stable; 0 if none is."""
    model, lower, upper = arm(cell.step, cell.wall), 0, len(SEARCHED)
    while lower < upper:  # the first unstable one lies from lower to upper
        middle = (lower + upper) // 2
        if all(is_stable(model, task, tangent) for task in tasks(robot, cell.away, cell.turn, SEARCHED[middle])):
            lower = middle + 1
        else:
            upper = middle
    return float(SEARCHED[lower - 1]) if lower else 0.0


CELLS = tuple(
    Cell(away, turn, step, wall)
    for away, turn in ((0.05, 0.5), (0.15, 1.2))
    for step in (0.002, 0.01, 0.02)
    for wall in (False, True)
)


def path(robot: ModuleType, task: Task, tangent: Tangent, step: float, seconds: float = 0.5) -> Array:
    """Return the tip's positions every 20 ms (k, 3) [m], without a wall."""
    model = arm(step, wall=False)
    data, tips = mujoco.MjData(model), []
    data.qpos[:] = START
    every = round(0.02 / step)
    with implicit_spring(task, tangent):
        for k in range(round(seconds / step)):
            mujoco.mj_step(model, data)
            if (k + 1) % every == 0:
                tips.append(robot.forward_kinematics(data.qpos)[:3, 3])
    return np.array(tips)


def deviation(robot: ModuleType, tangent: Tangent, step: float, stiffness: float = 1000.0) -> float:
    """Return the rms distance [m] of tips from those of explicit steps of 0.2 ms, at 15 cm and 1.2 rad."""
    squares = []
    for task in tasks(robot, 0.15, 1.2, stiffness):
        away = path(robot, task, tangent, step) - path(robot, task, none, 0.0002)
        squares.append((away**2).sum(1))
    return float(np.sqrt(np.mean(squares)))


def named(cell: Cell) -> str:
    """Return the words of a cell in the table."""
    return f"{100 * cell.away:g} cm, {cell.turn} rad; {1e3 * cell.step:g} ms" + ", wall" * cell.wall


def stiffness_words(stiffness: float) -> str:
    return "end" if stiffness == SEARCHED[-1] else f"{stiffness:.1e}"


def rows(robot: ModuleType) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table."""
    yield "deflection, step", *TANGENTS
    for cell in CELLS:
        found = (stiffest(robot, tangent, cell) for tangent in TANGENTS.values())
        yield named(cell), *map(stiffness_words, found)


def deviation_rows(robot: ModuleType) -> Iterator[tuple[str, ...]]:
    """Yield how far the tip is from that of fine steps, 1000 N/m at 15 cm and 1.2 rad."""
    for step in (0.01, 0.02):
        found = (deviation(robot, tangent, step) for name, tangent in TANGENTS.items() if name != "explicit")
        yield f"{1e3 * step:g} ms: tip off by", "", *(f"{1e3 * each:.1f} mm" for each in found)


def main() -> None:
    """Print both tables."""
    robot = stiffgen.load(URDF, **OPTIONS).module
    for row in (*rows(robot), *deviation_rows(robot)):
        print(" | ".join(row), flush=True)


if __name__ == "__main__":
    main()
