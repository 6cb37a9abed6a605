"""Designs of the controller, and random motions for it, sound and hostile."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

K = np.diag([700.0, 700, 800, 30, 30, 30])
Q = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
WRENCH = np.array([10.0, -5, 8, 1, 2, -1.5])
TASK_DAMPING = np.diag([40.0, 40, 40, 12, 12, 12])
QUICK = {"return_time": 0.0, "torque_rate_limit": 1e9, "stiffness_rate_limit": 1e12, "tank": "off"}
"""No history: one step gives the controller's torque."""


def walk(random: np.random.Generator, robot: ModuleType, steps: int, **overrides: Any) -> dict[str, np.ndarray]:
    """Inputs of a slow random motion within the limits, with reference, wrench and task stiffness that vary."""
    time = np.arange(steps)[:, None] * 1e-3
    n = robot.DOF

    def wave(size: int, scale: Any) -> tuple[np.ndarray, np.ndarray]:
        rate, phase = random.uniform(0.5, 6, size), random.uniform(0, 6, size)
        return scale * np.sin(rate * time + phase), scale * rate * np.cos(rate * time + phase)

    q, dq = wave(n, 0.15)
    q0, dq0 = wave(n, 0.2)
    growth = 1 + 0.5 * wave(1, 1.0)[0]
    A = random.normal(size=(6, 6)) * np.sqrt([10, 10, 10, 1, 1, 1])
    return {
        "q": Q + q,
        "dq": dq,
        "q0": Q + q0,
        "dq0": dq0,
        "wrench": wave(6, np.array([30.0, 30, 30, 8, 8, 8]))[0] + random.normal(size=(steps, 6)),
        "task_stiffness": growth[:, :, None] * (K + A @ A.T),
        "sample_valid": np.ones(steps, int),
        **overrides,
    }


DESIGNS: list[dict[str, Any]] = [
    {},
    {"representation": "body"},
    {"representation": "spatial", "nullspace": "off", "nullspace_stiffness": 0.0},
    {"stiffness_formula": "conventional"},
    {"damping_design": "factorised", "damping_ratio": 0.5},
    {"damping_design": "task", "task_damping": TASK_DAMPING},
    {"nullspace": "projected", "nullspace_stiffness": 5.0, "singularity_threshold": 1e-9},
    {"stiffness_sign": "positive_part", "representation": "body"},
    {"wrench_filter": "off", "stiffness_rate_limit": 300.0},
    {"wrench_filter": "moving_average", "wrench_window": 7},
    {"limit_zone": 0.9, "limit_stiffness": 20.0},
    {"damping_ratio": np.linspace(0.1, 1.2, 7), "torque_rate_limit": 200.0, "effort_limit": 10.0},
    {"missed_limit": 2, "return_time": 0.05, "velocity_decay_time": 0.005},
]


def hostile(random: np.random.Generator, robot: ModuleType, steps: int, share: float) -> tuple[Any, np.ndarray]:
    inputs = walk(random, robot, steps)
    bad = np.flatnonzero(random.random(steps) < share)
    values = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e9)
    for step in bad:
        name = ("q", "dq", "q0", "dq0", "wrench", "task_stiffness")[random.integers(0, 6)]
        array = inputs[name][step]
        array.flat[random.integers(0, array.size)] = values[random.integers(0, len(values))]
    tiny = np.flatnonzero(random.random(steps) < share)
    inputs["wrench"][tiny, 0], inputs["dq"][tiny, 1] = 5e-324, -1e-310
    inputs["sample_valid"][random.random(steps) < share] = 0
    return inputs, bad
