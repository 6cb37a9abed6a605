# SPDX-License-Identifier: MIT
"""Springs of MuJoCo lie within the intervals that examples/measure_sensor.py finds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import stiffgen
from examples import measure_sensor
from stiffgen.lab.measure.measurement import measure_stiffness
from stiffgen.lab.measure.plan import PlanOptions, plan_excitation
from stiffgen.lab.measure.rows import sensor_poses


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory):
    folder = stiffgen.generate(
        measure_sensor.URDF, tip=measure_sensor.FLANGE, kernels="hybrid,body", controller=False, name="held",
        output=tmp_path_factory.mktemp("measure"),
    )  # fmt: skip
    return stiffgen.open_robot(folder)


def exact_stiffness(model, robot, q: np.ndarray) -> np.ndarray:
    """Return Km by central differences of MuJoCo's own readings at rest, along twists of the flange."""
    data = mujoco.MjData(model)

    def reading(at: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qacc[:] = at, 0.0, 0.0
        mujoco.mj_inverse(model, data)
        return np.concatenate([data.sensor(name).data for name in ("force", "torque")])

    J = robot.module.body.jacobian(q)
    steps = 1e-4 * np.linalg.pinv(J)
    return np.stack([(reading(q + dq) - reading(q - dq)) / 2e-4 for dq in steps.T], axis=1)


def mujoco_rates(robot, runs: int) -> float:
    """Return the part of the entries of Km that lie within their intervals."""
    options = PlanOptions((3000.0,) * 3 + (30.0,) * 3, deviation=np.radians(0.02), duration=12.0, rate=100.0)
    plan, inside = plan_excitation(robot, measure_sensor.POSTURE, options), 0
    for seed in range(runs):
        model = measure_sensor.held_arm(seed)
        time, q, readings = measure_sensor.record(model, plan.q, 0.0, seed, period=0.01)
        found = measure_stiffness(time, sensor_poses(robot, q), readings, has_bias=False)
        inside += (np.abs(found.fit.Km - exact_stiffness(model, robot, q.mean(axis=0))) <= found.interval).sum()
    return inside / (36 * runs)


def test_springs_of_mujoco_lie_within_the_intervals(robot) -> None:
    assert mujoco_rates(robot, 1) >= 0.8


@pytest.mark.slow
def test_springs_of_mujoco_lie_within_the_intervals_in_nine_of_ten(robot) -> None:
    assert mujoco_rates(robot, 10) >= 0.9
