# SPDX-License-Identifier: MIT
"""Caps of a stiffness where the mass matrix is singular: a point mass that a slide carries onto a hinge's axis."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot

LIMIT = '<limit lower="-2" upper="2" effort="100" velocity="4"/>'
POINT = (
    '<robot name="point"><link name="base"/><link name="crank"/><link name="mass"><inertial><mass value="2"/>'
    '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>'
    f'<joint name="hinge" type="revolute"><parent link="base"/><child link="crank"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
    f'<joint name="slide" type="prismatic"><parent link="crank"/><child link="mass"/><axis xyz="1 0 0"/>{LIMIT}</joint>'
    "</robot>"
)


def test_capped_springs_stay_where_the_mass_matrix_is_singular(tmp_path: Path) -> None:
    """No command is accepted there, and mobilities have no number: the stiffness in force stays. Before, it fell."""
    (tmp_path / "point.urdf").write_text(POINT)
    arm = open_robot(stiffgen.generate(tmp_path / "point.urdf", tip="mass", output=tmp_path, batches=False)).module
    controller = arm.Impedance(
        stiffness_cap="accept", motor_inertia=0.0, stiffness_time=0.01, limit_stiffness=0.0, errors="ignore"
    )
    springs = {"translation_stiffness": 300 * np.eye(3), "rotation_stiffness": 20 * np.eye(3)}
    rest, axis = np.array([0.1, 0.003]), np.array([0.1, 0.0])
    for k in range(200):
        out = controller.step(q=rest, dq=np.full(2, 1e-6 * (-1) ** k), q0=rest, **springs)
    assert out.status & arm.Status.STIFFNESS_CAPPED
    before = out.rotation_stiffness
    assert 0.1 < before[2, 2] < 2.0  # of 20 N m/rad
    for k in range(40):
        dq = np.array([1e-6 * (-1) ** k, -3.0 * (k == 0)])
        out = controller.step(q=axis, dq=dq, q0=np.full(2, np.nan), **springs)
    assert out.status & arm.Status.COMMAND_REFUSED
    assert not out.fault
    np.testing.assert_array_equal(out.rotation_stiffness, before)


def least_ratio(M: np.ndarray, K: np.ndarray, B: np.ndarray, delay: int, averaged: int, filter_samples: float) -> float:
    """Return the least damping ratio of a sampled loop, from the eigenvalues of its transition over one sample time.

    An arm with M moves freely under a torque that is held, and that comes late: -K x - B v, with the mean of the last
    velocities behind a low pass. Units of time are sample times.
    """
    n = len(M)
    inverse, eye = np.linalg.inv(M), np.eye(n)
    size = n * (3 + averaged - 1 + delay)  # x, v, velocity behind the low pass, older velocities, torques on their way
    A = np.zeros((size, size))
    x, v, low = slice(0, n), slice(n, 2 * n), slice(2 * n, 3 * n)
    older = [slice(n * k, n * (k + 1)) for k in range(3, 2 + averaged)]
    late = [slice(n * k, n * (k + 1)) for k in range(2 + averaged, 2 + averaged + delay)]
    passed = 1.0 / (1.0 + filter_samples)
    A[low, low] = (1.0 - passed) * eye
    for part in (v, *older):
        A[low, part] = passed / averaged * eye
    torque = -B @ A[low]
    torque[:, x] -= K
    acting = torque if delay == 0 else np.eye(size)[late[0]]
    A[x], A[v] = np.eye(size)[x] + np.eye(size)[v] + 0.5 * inverse @ acting, np.eye(size)[v] + inverse @ acting
    for part, source in [*zip(older, (v, *older), strict=False), *pairwise(late)]:
        A[part] = np.eye(size)[source]
    if late:
        A[late[-1]] = torque
    roots = np.linalg.eigvals(A)
    exponents = np.log(roots[np.abs(roots) > 1e-6].astype(complex))
    return float(np.min(-exponents.real / np.abs(exponents)))


@pytest.mark.parametrize("posture", [0, 1, 2])
@pytest.mark.parametrize("delay", [0, 1, 2, 5])
@pytest.mark.parametrize(("filter_time", "quantum"), [
    (0.0, 0.0), (0.002, 0.0), (0.004, 0.0), (0.02, 0.0), (0.0, 1e-5), (0.0, 1e-4), (0.004, 1e-5),
])  # fmt: skip
def test_a_capped_stiffness_stays_damped_behind_a_smoothed_velocity(
    robot: ModuleType, posture: int, delay: int, filter_time: float, quantum: float
) -> None:
    """At the cap, the sampled loop has a damping ratio of 0.15 at least; before, a filter of 4 ms left it unstable."""
    fields = {"delay_samples": delay, "velocity_filter_time": filter_time, "position_quantum": quantum}
    limits = {"translation_stiffness_limit": 2e5, "rotation_stiffness_limit": 2e4}
    controller = robot.Impedance(stiffness_cap="accept", motor_inertia=0.1, stiffness_time=0.01, **limits, **fields)
    q = np.random.default_rng(posture).uniform(-1.5, 1.5, robot.DOF)
    q = np.clip(q, robot.LOWER + 0.3, robot.UPPER - 0.3)
    springs = {"translation_stiffness": 1e5 * np.eye(3), "rotation_stiffness": 1e4 * np.eye(3)}
    for k in range(1000):
        out = controller.step(q=q, dq=np.full(7, 1e-6 * (-1) ** k), q0=q, **springs)
    assert not out.fault and out.status & robot.Status.STIFFNESS_CAPPED
    step = controller.step(q=q, dq=np.full(7, 2e-3), q0=q, **springs)
    share = 1.0 / (1.0 + filter_time / 1e-3)
    seen = (step.velocity[0] - (1.0 - share) * out.velocity[0]) / share  # the mean after one sample at another velocity
    averaged = round(2e-3 / seen)
    assert 1 <= averaged <= (8 if quantum > 0.0 else 1)
    assert averaged > 1 or quantum < 1e-4
    T = 1e-3
    ratio = least_ratio(out.mass_matrix, out.scale * out.joint_stiffness * T**2, out.damping * T, delay, averaged,
                        filter_time / T)  # fmt: skip
    assert ratio > 0.15
