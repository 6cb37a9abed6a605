# SPDX-License-Identifier: MIT
"""The simulated arm against the generated kernels, statics, and its own sensor."""

from __future__ import annotations

from types import ModuleType

import mujoco
import numpy as np
import pytest

import stiffgen
from examples.bowl_wiping.bowl import Bowl, bowl_plant
from examples.bowl_wiping.tool import PLATE
from examples.experiments import tool
from examples.experiments.plant import MOTOR_INERTIA, START_POSTURE, Plant
from stiffgen import StiffgenError
from support.plate import NAME, SENSOR, TOOL
from support.project import URDF

ABOVE = START_POSTURE + np.array([0.2, -0.6, 0.1, 0.2, 0.3, -0.4, 0.5])  # well clear of the bowl


def postures(count: int = 20) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.5, 1.5, (count, 7))


def test_kinematics_and_masses_are_the_generated_ones(plate: ModuleType) -> None:
    for q in postures():
        plant = bowl_plant(surface=False, q=q)
        np.testing.assert_allclose(plant.pose, plate.forward_kinematics(q), atol=1e-12)
        M = np.empty((7, 7))
        mujoco.mj_fullM(plant.model, plant.data, M)
        np.testing.assert_allclose(M - MOTOR_INERTIA * np.eye(7), plate.mass_matrix(q), atol=1e-9)


def test_without_a_tool_it_is_the_plain_arm(robot: ModuleType) -> None:
    """Compare the plant without a tool with the generated functions: pose, mass matrix, no wrench."""
    q = postures(1)[0]
    plant = Plant(q=q)
    np.testing.assert_allclose(plant.pose, robot.forward_kinematics(q), atol=1e-12)
    M = np.empty((7, 7))
    mujoco.mj_fullM(plant.model, plant.data, M)
    np.testing.assert_allclose(M - MOTOR_INERTIA * np.eye(7), robot.mass_matrix(q), atol=1e-9)
    plant.step(np.ones(7))
    felt = stiffgen.StiffnessModel(stiffgen.load_chain(URDF, sensor=SENSOR, masses=False))
    np.testing.assert_allclose(plant.wrench(felt), 0, atol=1e-12)


def test_zero_command_lets_the_arm_float() -> None:
    plant = bowl_plant(q=ABOVE)
    for _ in range(1000):
        plant.step(np.zeros(7))
    assert plant.time == pytest.approx(1.0)
    np.testing.assert_allclose(plant.q, ABOVE, atol=1e-12)


def test_coriolis_torques_are_compensated() -> None:
    """Move fast: what is left of the dynamics is M(q) ddq = torque."""
    plant = bowl_plant(surface=False, q=ABOVE)
    plant.data.qvel[:] = np.linspace(1, 2, 7)
    torque = np.linspace(-5, 5, 7)
    M = np.empty((7, 7))
    mujoco.mj_forward(plant.model, plant.data)
    mujoco.mj_fullM(plant.model, plant.data, M)
    bias = plant.data.qfrc_bias.copy()
    plant.data.qpos[:] = ABOVE
    plant.data.qvel[:] = 0
    mujoco.mj_forward(plant.model, plant.data)
    assert np.abs(bias - plant.data.qfrc_bias).max() > 0.1  # the velocity matters at all
    plant.data.qvel[:] = start = np.linspace(1, 2, 7)
    plant.step(torque)
    middle = start + 0.0005 * np.linalg.solve(M, torque)
    np.testing.assert_allclose(plant.dq, start + 0.001 * np.linalg.solve(M, torque), atol=2e-4)
    np.testing.assert_allclose(plant.q, ABOVE + 0.001 * middle, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("timestep", [0.001, 0.005])
def test_pressing_with_a_known_force(plate: ModuleType, timestep: float) -> None:
    """Press into the bowl by J^T f: at rest the environment answers with -f, in sensor and contacts."""
    plant = bowl_plant(timestep)
    assert not plant.in_contact
    for _ in range(round(4 / timestep)):
        J = plate.hybrid.jacobian(plant.q)
        plant.step(J.T @ np.array([0, 0, -30.0, 0, 0, 0]) - 5 * plant.dq)
    assert plant.in_contact
    assert not plant.arm_in_contact
    np.testing.assert_allclose(plant.dq, 0, atol=1e-3)
    np.testing.assert_allclose(plant.wrench(plate), [0, 0, 30, 0, 0, 0], atol=0.02)
    np.testing.assert_allclose(
        plant.external_torque(), plate.hybrid.jacobian(plant.q).T @ plant.wrench(plate), atol=1e-6
    )


@pytest.mark.slow
def test_sensor_agrees_with_the_contacts_in_motion(plate: ModuleType) -> None:
    """Weight and inertia of the tool do not show: sliding and bumping, sensor minus tool is the sum of the contacts."""
    plant, forces, rates = bowl_plant(), [], []
    for k in range(1500):
        J = plate.hybrid.jacobian(plant.q)
        push = np.array([20 * np.sin(0.01 * k), 20 * np.cos(0.02 * k), -60, 1.0, -2.0, 1.0])  # [N, N m], slides
        plant.step(J.T @ push - 2 * plant.dq)  # joint damping 2 N m s/rad
        np.testing.assert_allclose(plant.wrench(plate), plant.contact_wrench(), atol=1e-6)
        J = plate.hybrid.jacobian(plant.q)
        np.testing.assert_allclose(plant.external_torque(), J.T @ plant.wrench(plate), atol=1e-6)
        forces.append(np.linalg.norm(plant.contact_wrench()[:3]))
        rates.append(np.abs(plant.dq).max())
    assert max(forces) > 60  # [N] a bump beyond the push of 60 N
    assert min(forces) == 0  # [N] and time without contact
    assert max(rates) > 0.5  # [rad/s] in motion


def test_a_push_on_the_tool_shows_in_the_sensor(plate: ModuleType) -> None:
    """Push the tool's mass without contact: the sensor reads what the environment applies, with its sign."""
    plant = bowl_plant(surface=False, q=ABOVE)
    tool = plant.model.body("tool").id
    force, moment = np.array([3.0, -5.0, 7.0]), np.array([0.2, 0.5, -0.4])
    plant.data.xfrc_applied[tool] = [*force, *moment]
    lever = plant.data.xipos[tool] - plant.pose[:3, 3]
    plant.step(np.zeros(7))
    np.testing.assert_allclose(plant.wrench(plate)[:3], force, atol=1e-9)
    np.testing.assert_allclose(plant.wrench(plate)[3:], moment + np.cross(lever, force), atol=1e-4)


def test_the_surface_is_the_sphere(plate: ModuleType) -> None:
    """Contact points of the pressed plate lie on the bowl's sphere, and the forces point to its centre."""
    plant, bowl = bowl_plant(), Bowl()
    for _ in range(2000):
        plant.step(plate.hybrid.jacobian(plant.q).T @ np.array([0, 0, -30.0, 0, 0, 0]) - 5 * plant.dq)
    centre = np.array([*bowl.centre, bowl.bottom + bowl.radius])
    leaning, inward = np.zeros(3), np.zeros(3)
    for index, contact in enumerate(plant.data.contact):
        assert abs(np.linalg.norm(contact.pos - centre) - bowl.radius) < 5e-4
        assert -1e-3 < contact.dist < 0
        force = np.empty(6)
        mujoco.mj_contactForce(plant.model, plant.data, index, force)
        leaning += force[0] * contact.frame[:3]
        inward += force[0] * (centre - contact.pos) / bowl.radius
    assert np.linalg.norm(inward) > 25
    np.testing.assert_allclose(leaning, inward, atol=0.05 * np.linalg.norm(inward))


def test_the_same_torques_give_the_same_motion(plate: ModuleType) -> None:
    """Repeat a run of 500 steps: the same bits, and a wrench that is not zero."""
    ends = []
    for _ in range(2):
        plant = bowl_plant()
        for k in range(500):
            plant.step(np.array([0, 20, 0, -5, 0, 1.0, np.sin(k)]))
        ends.append(np.concatenate([plant.q, plant.dq, plant.wrench(plate)]))
    assert np.array_equal(*ends)
    assert np.any(ends[0][14:] != 0)


def test_refusals() -> None:
    with pytest.raises(StiffgenError, match="timestep"):
        Plant(timestep=0.0)
    with pytest.raises(StiffgenError, match="q has shape"):
        Plant(q=np.zeros(6))


def test_the_tests_plate_is_the_examples() -> None:
    assert (PLATE.robot, PLATE.for_generator(), tool.SENSOR) == (NAME, TOOL, SENSOR)
