# SPDX-License-Identifier: MIT
"""The plant of the closed-loop tests against the examples' arm in MuJoCo: another reader, other dynamics."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from examples.experiments.plant import Plant
from support.plant.fixture import loop
from support.plant.loop import FREE, KERNELS, Q0, Loop

__all__ = ["loop"]

MOTOR = 0.1
TRANSLATION, ROTATION = np.diag([700.0, 700, 800]), np.diag([30.0, 30, 30])


@pytest.mark.slow
def test_inertia_and_bias_are_mujocos(robot_folder: Path, tmp_path: Path) -> None:
    """Compare two readers and two dynamics: mass matrix to 1e-9, Coriolis and centrifugal forces to 1e-6."""
    free, random = Loop(tmp_path, robot_folder, FREE, KERNELS), np.random.default_rng(3)
    other = Plant()
    other.model.opt.gravity[:] = 0
    motor = np.diag(other.model.dof_armature)
    for _ in range(20):
        q, v = random.uniform(-1.5, 1.5, 7), random.normal(size=7)
        other.data.qpos[:], other.data.qvel[:] = q, v
        mujoco.mj_forward(other.model, other.data)
        M = np.empty((7, 7))
        mujoco.mj_fullM(other.model, other.data, M)
        assert np.abs(M - motor - free.mass_matrix(q)).max() < 1e-9
        assert np.abs(other.data.qfrc_bias - free.bias(q, v)).max() < 1e-6


def test_mujoco_sees_the_same(loop: Loop) -> None:
    """Load and move in both simulations: the same motion to 1e-4 rad."""
    load, wanted = np.array([5.0, -3, -20, 1, 0.5, -1]), Q0 + 0.2  # [N], [N m]; [rad]
    config = loop.config(motor_inertia=MOTOR, position_quantum=0.0)
    rows = loop.run(2000, loop.segments({"load": load}, {"start": 300, "wanted": wanted}), configs=config, rows=True)[1]
    arm = Plant(q=Q0)
    model, data = arm.model, arm.data
    model.opt.gravity[:] = 0
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.timestep = 2e-4
    model.dof_armature[:] = MOTOR
    site = model.site("tip").id
    step = loop.stepper(config)
    springs = {"translation": TRANSLATION, "rotation": ROTATION, "joint": 1.0}  # those of a segment
    J = np.zeros((6, 7))
    for k in range(2000):
        command = step(q=data.qpos, dq=data.qvel, wanted=Q0 if k < 300 else wanted, **springs)
        for _ in range(5):  # steps of 0.2 ms in a sample of 1 ms
            mujoco.mj_forward(model, data)
            mujoco.mj_jacSite(model, data, J[:3], J[3:], site)
            data.qfrc_applied[:] = np.array(command.torque) + J.T @ load
            mujoco.mj_step(model, data)
        assert np.abs(data.qpos - rows["q"][k]).max() < 1e-4, k
    assert np.abs(data.qpos - Q0).max() > 0.15  # [rad] it has moved
