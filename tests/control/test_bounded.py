# SPDX-License-Identifier: MIT
"""The controller with the bounded spring: a gradient within its limits, selected before the arm is engaged."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

import stiffgen
from stiffgen.core.opened import open_robot
from support.controller_inputs import KO, KT, SPRING, Q, walk
from support.project import URDF, Once

FORCE, MOMENT = 40.0, 5.0
CONFIG = {"spring": "bounded", "spring_moment_limit": MOMENT, "motor_inertia": 0.1, "posture_stiffness": 0.0,
          "energy_limit": 1e3, "tank_initial": 1e3, "limit_stiffness": 0.0,
          "torque_rate_limit": 1e6, "effort_limit": 1e4}  # fmt: skip


@pytest.fixture(scope="module")
def arm(once: Once) -> ModuleType:
    options = stiffgen.KernelOptions(springs=("bounded",), kernels=("spring.energy",), batches=False)
    folder = once("bounded", lambda output: stiffgen.generate(URDF, output=output, **vars(options)))
    return open_robot(folder / "iiwa14").module


def energy(pose: np.ndarray, rest: np.ndarray, force: float = FORCE, moment: float = MOMENT) -> float:
    """The definition, pseudo-Huber in displacement and chord: E (sqrt(1 + 2 V/E) - 1), E = limit^2/stiffness."""
    away, turn = pose[:3, 3] - rest[:3, 3], rest[:3, :3].T @ pose[:3, :3]
    G = np.trace(KO) / 2 * np.eye(3) - KO
    parts = (away @ KT @ away / 2, force**2 / KT.max()), (np.trace(G @ (np.eye(3) - turn)), moment**2 / KO.max())
    return float(sum(E * (np.sqrt(1 + 2 * V / E) - 1) for V, E in parts))


def swing(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed orbit of the joints that takes the tip more than half a metre away."""
    phase = 2 * np.pi * np.arange(steps + 1)[:, None] / steps
    size, start = np.array([0.9, 0.6, -0.8, 0.9, 0.5, -0.7, 0.6]), np.arange(7)
    rate = 2 * np.pi / steps * 1e3
    way = size * (np.cos(phase + start) - np.cos(start)) / 2
    return Q + way, -size * np.sin(phase + start) * rate / 2


def test_pulls_with_the_limit_and_no_more(arm: ModuleType) -> None:
    """Held at Q and moved by hand round an orbit: a gradient within the limits, whose work is zero."""
    q, dq = swing(4000)
    controller = arm.Impedance(**CONFIG)
    for _ in range(50):
        controller.step(q=Q, dq=np.zeros(7), q0=Q, **SPRING)
    hold = {name: np.tile(each, (len(q), *[1] * each.ndim)) for name, each in {"q0": Q, **SPRING}.items()}
    out = controller.run(q=q, dq=dq, **hold)
    rest = arm.forward_kinematics(Q)
    assert not out.fault.any()
    assert np.all(out.scale == 1)
    away = np.linalg.norm(arm.forward_kinematics(q)[:, :3, 3] - rest[:3, 3], axis=1)
    force, moment = (np.linalg.norm(out.spring_wrench[:, part], axis=1) for part in (slice(3), slice(3, 6)))
    assert away.max() > 0.5
    assert 0.9 * FORCE < force[away.argmax()] <= force.max() < FORCE
    assert 0.5 * MOMENT < moment.max() < MOMENT
    for k in (700, 2000, 3100):
        ahead, behind = (
            [energy(arm.forward_kinematics(q[k] + sign * d), rest) for d in 1e-6 * np.eye(7)] for sign in (1, -1)
        )
        slopes = np.subtract(ahead, behind) / 2e-6
        np.testing.assert_allclose(out.elastic_torque[k], np.negative(slopes), atol=1e-7)
        assert out.elastic_energy[k] == pytest.approx(energy(arm.forward_kinematics(q[k]), rest), rel=1e-12)
    work = np.sum(out.elastic_torque[1:] * dq[1:]) * 1e-3  # the trapezoidal rule on a closed orbit
    assert abs(work) < 1e-9
    assert np.sum(np.abs(out.elastic_torque[1:] * dq[1:])) * 1e-3 > 10


def test_limits_and_stiffness_change_within_the_account(arm: ModuleType) -> None:
    """Every change is booked; a higher limit that the tank cannot pay waits."""
    inputs = walk(np.random.default_rng(2), arm, 1200)
    controller = arm.Impedance(**{**CONFIG, "tank_initial": 2.0, "energy_limit": 5.0})
    seen = []
    for k in range(1200):
        if k % 100 == 0:
            controller.config.spring_force_limit = (10.0, 60.0, 3.0)[k // 100 % 3]
        out = controller.step(**{name: each[k] for name, each in inputs.items() if name != "sample_valid"})
        put_in = out.start_total + out.sampling_total + out.reference_total + out.stiffness_total
        assert abs(out.port_total + out.elastic_energy + out.limit_energy - put_in) < 1e-11
        assert np.linalg.norm(out.spring_wrench[:3]) < 60.0
        seen.append(out.stiffness_total)
    assert not out.fault
    assert np.ptp(seen) > 0.01


def test_another_spring_needs_a_reset(arm: ModuleType) -> None:
    controller = arm.Impedance(**CONFIG)
    for k in range(60):
        controller.config.spring = "bounded" if k < 50 else "trace"
        out = controller.step(q=Q, dq=np.zeros(7), q0=Q, **SPRING)
    assert out.reason == arm.Reason.CHANGED


def test_a_folder_without_it_refuses(robot: ModuleType) -> None:
    with pytest.raises(ValueError, match="generate it with --spring bounded"):
        robot.Impedance(spring="bounded").step(q=Q, dq=np.zeros(7), q0=Q, **SPRING)
