# SPDX-License-Identifier: MIT
"""Run one trial: the plant under a law with the paper's gains, recorded step by step.

Four laws: the paper's (NAME_paper.h) with the ``corrected`` and with the ``conventional`` stiffness; ``potential``, the
controller's gradient of a spring with the same gains at the tool point; and ``cartesian``, the law in common use
(cartesian.py).
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from examples.experiments.cartesian import CartesianLaw
from examples.experiments.motion import Motion
from examples.experiments.plant import MOTOR_INERTIA, Plant

Array = NDArray[np.float64]
Trace = dict[str, NDArray[Any]]

TASK_STIFFNESS: Array = np.diag([700.0, 700.0, 800.0, 30.0, 30.0, 30.0])
"""K [N/m, N m/rad], hybrid frame."""
SPRING: dict[str, Array] = {
    "translation_stiffness": TASK_STIFFNESS[:3, :3],
    "rotation_stiffness": TASK_STIFFNESS[3:, 3:],
}
"""The same for the potential law; rotational axes are the tool's, which does not matter where they are equal."""
TASK_DAMPING: Array = np.diag([40.0, 40.0, 40.0, 12.0, 12.0, 12.0])
"""B [N s/m, N m s/rad] of the Cartesian law, hybrid frame: the gains of the paper's code."""
DAMPING_RATIO = 0.7
"""Damping ratio of the other laws, which design their damping from the joint stiffness and the mass matrix."""
FORCE_NOISE, MOMENT_NOISE = 0.05, 0.002
"""[N], [N m] standard deviation of the force/torque sensor's noise, seeded."""
POSTURE_STIFFNESS, JOINT_DAMPING = 1.0, 0.1
"""[N m/rad], [N m s/rad] of the nullspace."""
HEAVIEST = (150.0, 40.0)
"""[N], [N m] heaviest wrench of the potential law's springs: 1.5 times that of the wiping."""
LAWS = ("corrected", "conventional", "potential", "cartesian")
"""The trials, in this order."""
EXPECTED = ("MOVING",)
"""Status bits that are no fault: the reference moves. All others must not show."""

COLUMNS = {
    "trial": "0 corrected, 1 conventional, 2 potential, 3 cartesian",
    "time": "[s] since the trial's start",
    "pressing": "whether the zero-force trajectory runs; before it the approach",
    "q": "[rad] joint positions",
    "dq": "[rad/s] joint velocities",
    "q0": "[rad] zero-force joint positions",
    "dq0": "[rad/s] zero-force joint velocities",
    "wrench": "[N, N m] of the environment on the robot at the tool point, base axes, as measured",
    "contact_wrench": "[N, N m] the same as the sum of the simulated contacts, without a sensor",
    "wrench_used": "[N, N m] the mean of its last three samples: what the paper's stiffness was computed with",
    "torque": "[N m] command of the controller, without gravity and Coriolis compensation",
    "damping_torque": "[N m] the damping's share of it",
    "status": "status bits of the controller (NAME_impedance.h); 0 in the other laws",
    "contact": "whether tool and surface touch",
    "arm_contact": "whether a link of the arm touches the surface",
    "position": "[m] of the tool point, base frame",
    "error": "[rad] deflection r - q from the equilibrium posture, q0 - q without one",
    "stiffness": "[N m/rad] joint stiffness Kq, posture stiffness included: applied in the paper's law, the tangent "
    "of the energy in the potential law, -d torque/dq at rest by differences in the Cartesian law",
    "symmetric": "[N m/rad] largest singular value of the symmetric part of the controller's joint stiffness",
    "antisymmetric": "[N m/rad] the same of its antisymmetric part",
    "eigenvalues": "[N m/rad] of the symmetric part, ascending",
    "elastic_energy": "[J] of the springs; 0 in the laws that have none",
    "port_total": "[J] put out at the robot's port since the start",
    "supplied_total": "[J] the controller's bound on it (energy_supplied); the work itself in laws that have none",
    "tank_energy": "[J] in the controller's tank; 0 in the laws that have none",
}
"""Arrays of the trace: name and content; the first axis is time."""


def controller(robot: ModuleType, sample_time: float, steps: int) -> Any:
    """Return the controller of the potential law: the paper's gains, limits that do not bind, no limit avoidance.

    Args:
        robot: generated module of the arm with its tool.
        sample_time: [s].
        steps: to be recorded.

    """
    return robot.Impedance(
        sample_time=sample_time,
        delay_samples=0,
        motor_inertia=MOTOR_INERTIA,
        heaviest_wrench=HEAVIEST,
        lower_limit=-np.inf,
        upper_limit=np.inf,
        torque_rate_limit=robot.EFFORT / sample_time,
        damping_ratio=DAMPING_RATIO,
        record=steps,
    )


def paper_law(robot: ModuleType, formula: str, sample_time: float) -> Any:
    """Return the paper's law with the paper's gains, and limits that do not bind."""
    return robot.PaperLaw(
        formula,
        sample_time=sample_time,
        damping_ratio=DAMPING_RATIO,
        posture_stiffness=POSTURE_STIFFNESS,
        joint_damping=JOINT_DAMPING,
        motor_inertia=MOTOR_INERTIA,
        torque_rate_limit=robot.EFFORT / sample_time,
    )


def run(
    robot: ModuleType,
    law: str,
    plant: Plant,
    motion: Motion,
    *,
    seed: int = 0,
    progress: Callable[[], None] = lambda: None,
) -> Trace:
    """Run one trial.

    Args:
        robot: generated module of the arm with its tool.
        law: one of :data:`LAWS`.
        plant: the arm at the trial's start; its time step is the controller's, with the torque held.
        motion: the equilibrium's, on the plant's time steps.
        seed: of the sensor's noise; the same for all trials, so that they differ by the law alone.
        progress: called after every step.

    Returns:
        Arrays with a leading time axis: all of COLUMNS but ``trial``.

    """
    count = len(motion.time)
    steps = _steps(robot, law, plant.timestep, count)
    noise = np.random.default_rng(seed).normal(scale=[FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3, size=(count, 6))
    position, contact, arm_contact = np.empty((count, 3)), np.empty(count, bool), np.empty(count, bool)
    measured, used, contacts = (np.empty((count, 6)) for _ in range(3))
    for k in range(count):
        position[k], contact[k], arm_contact[k] = plant.pose[:3, 3], plant.in_contact, plant.arm_in_contact
        measured[k], contacts[k] = plant.wrench(robot) + noise[k], plant.contact_wrench()
        used[k] = measured[max(0, k - 2) : k + 1].mean(axis=0)
        plant.step(steps.torque(plant, motion.q0[k], used[k]))
        progress()
    columns = steps.columns()
    symmetric, antisymmetric = parts(columns["stiffness"])
    return {
        "time": motion.time,
        "pressing": motion.pressing,
        "q0": motion.q0,
        "dq0": motion.dq0,
        "wrench": measured,
        "contact_wrench": contacts,
        "wrench_used": used,
        "contact": contact,
        "arm_contact": arm_contact,
        "position": position,
        "symmetric": np.linalg.norm(symmetric, 2, axis=(1, 2)),
        "antisymmetric": np.linalg.norm(antisymmetric, 2, axis=(1, 2)),
        "eigenvalues": np.linalg.eigvalsh(symmetric),
        **columns,
    }


def _steps(robot: ModuleType, law: str, sample_time: float, count: int) -> _ControllerSteps | _RecordedSteps:
    if law == "potential":
        return _ControllerSteps(robot, controller(robot, sample_time, count))
    if law == "cartesian":
        return _CartesianSteps(robot)
    return _PaperSteps(paper_law(robot, law, sample_time))


class _ControllerSteps:
    """Steps of the C controller, which records what it does."""

    def __init__(self, robot: ModuleType, impedance: Any) -> None:
        self._robot, self._impedance, self._count = robot, impedance, 0

    def torque(self, plant: Plant, q0: Array, wrench: Array) -> Array:
        self._count += 1
        output = self._impedance.step(
            q=plant.q, dq=plant.dq, q0=q0, shaped=True, counter=self._count, posture_stiffness=POSTURE_STIFFNESS,
            **SPRING,
        )  # fmt: skip
        return np.asarray(output.torque)

    def columns(self) -> Trace:
        """Return the trial's columns, each with a row per sample: states, torques, energies [J]."""
        inputs, outputs = self._impedance.trace
        q, torque = np.array(inputs["q"]), np.array(outputs["torque"])
        springs = (self._robot.forward_kinematics(outputs.reference), *SPRING.values())
        tangent = self._robot.spring.joint_stiffness(q, *springs)
        return {
            **{name: np.array(outputs[name]) for name in ("damping_torque", "status")},
            "q": q,
            "dq": np.array(inputs["dq"]),
            "torque": torque,
            "error": np.array(outputs.reference) - q,
            "stiffness": tangent + POSTURE_STIFFNESS * np.eye(q.shape[1]),
            "elastic_energy": np.array(outputs.stored),
            "port_total": work(torque, q),
            "supplied_total": np.array(outputs.energy_supplied),
            "tank_energy": np.array(outputs.tank),
        }


class _RecordedSteps:
    """Steps of a law that has no energy and no status; they are recorded here."""

    def __init__(self) -> None:
        self._rows: dict[str, list[Any]] = {
            name: [] for name in ("q", "dq", "torque", "damping_torque", "error", "stiffness")
        }

    def command(self, plant: Plant, q0: Array, wrench: Array) -> tuple[Array, Array, Array]:
        """Return the torque, the damping's share of it, and the joint stiffness."""
        raise NotImplementedError

    def torque(self, plant: Plant, q0: Array, wrench: Array) -> Array:
        torque, damping, stiffness = self.command(plant, q0, wrench)
        values = (plant.q, plant.dq, torque, damping, q0 - plant.q, stiffness)
        for rows, value in zip(self._rows.values(), values, strict=True):
            rows.append(value)
        return torque

    def columns(self) -> Trace:
        columns = {name: np.array(rows) for name, rows in self._rows.items()}
        done = work(columns["torque"], columns["q"])
        none = {"elastic_energy": np.zeros(len(done)), "tank_energy": np.zeros(len(done))}
        status = np.zeros(len(done), np.uint32)
        return {**columns, **none, "status": status, "port_total": done, "supplied_total": done}


class _PaperSteps(_RecordedSteps):
    """Steps of the paper's law."""

    def __init__(self, law: Any) -> None:
        super().__init__()
        self._law = law

    def command(self, plant: Plant, q0: Array, wrench: Array) -> tuple[Array, Array, Array]:
        output = self._law.step(q=plant.q, dq=plant.dq, q0=q0, wrench=wrench, task_stiffness=TASK_STIFFNESS)
        return output.torque, output.damping_torque, output.joint_stiffness


class _CartesianSteps(_RecordedSteps):
    """Steps of the Cartesian law."""

    def __init__(self, robot: ModuleType) -> None:
        super().__init__()
        self._law = CartesianLaw(robot, TASK_STIFFNESS, TASK_DAMPING, POSTURE_STIFFNESS, JOINT_DAMPING)

    def command(self, plant: Plant, q0: Array, wrench: Array) -> tuple[Array, Array, Array]:
        spring, damping = self._law.torques(plant.q, plant.dq, q0)
        return spring + damping, damping, self._law.stiffness(plant.q, q0)


def work(torque: Array, q: Array) -> Array:
    """Return the work (N,) [J] that torques (N, n) have put out at each sample; each acts until the next one."""
    moved = np.sum(torque[:-1] * np.diff(q, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(moved)])


def parts(stiffness: Array) -> tuple[Array, Array]:
    """Return the symmetric and the antisymmetric part of matrices (..., n, n)."""
    transposed = np.swapaxes(stiffness, -1, -2)
    return (stiffness + transposed) / 2, (stiffness - transposed) / 2


def faults(robot: ModuleType, status: NDArray[np.uint32]) -> dict[str, int]:
    """Return the status bits that count as faults in a trial, with the number of steps."""
    counts = {bit.name: int(np.count_nonzero(status & int(bit))) for bit in robot.Status}
    return {name: count for name, count in counts.items() if count and name not in EXPECTED}


def join(trials: list[Trace]) -> Trace:
    """Join the traces of several trials, with a column ``trial`` that counts them."""
    counted = [{"trial": np.full(len(trace["time"]), index), **trace} for index, trace in enumerate(trials)]
    return {name: np.concatenate([trace[name] for trace in counted]) for name in COLUMNS}
