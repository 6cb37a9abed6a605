# SPDX-License-Identifier: MIT
"""Generate random motions for the controller, valid and hostile."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

KT = np.diag([700.0, 700, 800])
KO = np.diag([30.0, 20, 10])
TASK_STIFFNESS = np.diag([700.0, 700, 800, 30, 30, 30])
Q = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
STATED: dict[str, Any] = {
    "sample_time": 1e-3,
    "delay_samples": 0,
    "motor_inertia": 0.1,
    "heaviest_wrench": (100.0, 20.0),
}
"""Configuration fields without a default, for the arm of these tests."""
SPRING = {"translation_stiffness": KT, "rotation_stiffness": KO}


def positive(random: np.random.Generator, size: float) -> np.ndarray:
    A = random.normal(size=(3, 3))
    return np.asarray(size * (A @ A.T / 3 + 0.2 * np.eye(3)))


def walk(random: np.random.Generator, robot: ModuleType, steps: int, **overrides: Any) -> dict[str, np.ndarray]:
    """Yield inputs of a slow random motion within the limits, with an equilibrium and stiffnesses that vary."""
    time = np.arange(steps)[:, None] * 1e-3
    n = robot.DOF

    def wave(scale: float) -> tuple[np.ndarray, np.ndarray]:
        rate, phase = random.uniform(0.5, 6, n), random.uniform(0, 6, n)
        return scale * np.sin(rate * time + phase), scale * rate * np.cos(rate * time + phase)

    q, dq = wave(0.1)
    q0, _ = wave(0.15)
    middle = Q if n == len(Q) else np.clip(np.zeros(n), robot.LOWER + 0.5, robot.UPPER - 0.5)
    growth = 1 + 0.4 * np.sin(2 * time + random.uniform(0, 6))[:, :, None]
    return {
        "q": middle + q,
        "dq": dq,
        "q0": middle + q0,
        "translation_stiffness": growth * positive(random, 700),
        "rotation_stiffness": growth * positive(random, 30),
        "counter": np.arange(steps),
        "sample_valid": np.ones(steps, int),
        **overrides,
    }


def hostile(random: np.random.Generator, robot: ModuleType, steps: int, share: float) -> tuple[Any, np.ndarray]:
    """Yield the same inputs with NaN, infinity and huge numbers in some places, and these places."""
    inputs = walk(random, robot, steps)
    bad = np.flatnonzero(random.random(steps) < share)
    values = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e9)
    for step in bad:
        name = ("q", "dq", "q0", "translation_stiffness", "rotation_stiffness")[random.integers(0, 5)]
        array = inputs[name][step]
        array.flat[random.integers(0, array.size)] = values[random.integers(0, len(values))]
    tiny = np.flatnonzero(random.random(steps) < share)
    inputs["rotation_stiffness"][tiny, 0, 1] = inputs["rotation_stiffness"][tiny, 1, 0] = 5e-324
    inputs["sample_valid"][random.random(steps) < share] = 0
    return inputs, bad


def run_with_resets(controller: Any, inputs: Any, samples: int) -> Any:
    """Run the controller, and ask for a reset every so many samples; return the outputs of all steps."""
    rows = []
    for start in range(0, len(inputs["q"]), samples):
        controller.reset()
        part = controller.run(**{name: values[start : start + samples] for name, values in inputs.items()})
        rows.append(part._rows)
    return type(part)(np.concatenate(rows))


class Arm:
    """Simple arm for unit tests, with the mass matrix of the kernels.

    M(q) and the torque are taken at the sample, without Coriolis torques; test_closed_loop.py has closed loops on an
    exact plant.
    """

    def __init__(self, robot: ModuleType, q: Any, inertia: float = 0.1) -> None:
        self.robot, self.q, self.dq, self.inertia = robot, np.array(q, float), np.zeros(robot.DOF), inertia

    def step(self, torque: Any, load: Any = None, time: float = 1e-3) -> None:
        total = torque if load is None else torque + self.robot.hybrid.jacobian(self.q).T @ load
        M = self.robot.mass_matrix(self.q) + self.inertia * np.eye(self.robot.DOF)
        self.dq = self.dq + time * np.linalg.solve(M, total)
        self.q = self.q + time * self.dq
