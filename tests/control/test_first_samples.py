# SPDX-License-Identifier: MIT
"""First positions that are wrong: no limit avoidance acts on them, and nothing of it counts (campaigns/starts.py)."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.controller_inputs import SPRING, Q
from support.plant.loop import Q0, Loop, N

TURN = 2.0 * np.pi
OFFSET = np.linspace(-3.0, 3.0, N)


def turned(joint: int, by: float) -> np.ndarray:
    q = Q.copy()
    q[joint] += by
    return q


ABSURD = [*(turned(joint, by) for joint in range(N) for by in (-TURN, TURN)), np.degrees(Q)]


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("absurd", range(len(ABSURD)))
def test_an_absurd_first_position_is_not_believed(robot: ModuleType, absurd: int, moving: bool) -> None:
    """The first call names joint and limit, and no call has a torque but the offset and light damping.

    Before: up to 160 N m of the limit avoidance, all of whose energy counted as the account's beginning.
    """
    q, dq = ABSURD[absurd], 0.5 * np.ones(N) * moving
    controller = robot.Impedance(motor_inertia=0.1)
    for k in range(200):
        out = controller.step(q=q + 1e-3 * k * dq, dq=dq, q0=Q, torque_offset=OFFSET, **SPRING)
        beyond = np.maximum(q - robot.UPPER, robot.LOWER - q) > 0.1
        assert out.reason == robot.Reason.POSITION
        assert beyond[out.fault_joint]
        assert not out.limit_torque[beyond].any()
        assert out.limit_energy == out.start_total == 0.0
        assert not out.elastic_torque.any()
        np.testing.assert_allclose(out.torque, out.damping_torque + out.offset_torque, atol=1e-12)
        assert np.abs(out.damping_torque).max() <= 0.1 * np.abs(dq).max() * (1 + 1e-12)
    assert out.status & robot.Status.JOINT_LIMIT
    np.testing.assert_allclose(out.offset_torque, OFFSET)


def test_an_arm_that_is_led_back_is_kept_inside_again(robot: ModuleType) -> None:
    """After a start beyond a limit the fault stays until a reset inside; then the limit avoidance is back."""
    controller = robot.Impedance(motor_inertia=0.1)
    q = Q.copy()
    q[3] = robot.LOWER[3] - 0.15
    assert controller.step(q=q, dq=np.zeros(N), q0=Q, **SPRING).reason == robot.Reason.POSITION
    while q[3] < robot.LOWER[3] + 0.2:
        q[3] += 5e-4
        out = controller.step(q=q, dq=0.5 * np.eye(N)[3], q0=Q, **SPRING)
        assert out.fault
    controller.reset()
    for _ in range(5):
        out = controller.step(q=q, dq=np.zeros(N), q0=q, **SPRING)
    assert not out.fault
    while q[3] > robot.LOWER[3] + 0.05:
        q[3] -= 2e-4
        out = controller.step(q=q, dq=-0.2 * np.eye(N)[3], q0=q, **SPRING)
    assert out.limit_torque[3] > 5


def test_a_frozen_position_in_a_limit_zone_does_not_pull(robot: ModuleType) -> None:
    """Once the frozen encoder is found, the limit avoidance of that joint ends; its energy goes to the tank.

    Before: the torque at the frozen position stayed for as long as the fault.
    """
    controller = robot.Impedance(motor_inertia=0.1)
    q, dq = Q.copy(), np.zeros(N)
    q[3] = robot.LOWER[3] + 0.15
    for k in range(400):
        dq[3] = -0.5 if q[3] > robot.LOWER[3] + 0.05 or k > 300 else 0.0
        q[3] += dq[3] * 1e-3 if k <= 300 else 0.0
        last = controller.step(q=q, dq=dq, q0=q, **SPRING)
        if last.fault:
            break
    assert last.reason == robot.Reason.FROZEN
    for _ in range(300):
        out = controller.step(q=q, dq=dq, q0=q, **SPRING)
    assert out.limit_torque[3] == 0.0
    assert out.limit_energy == 0.0


@pytest.mark.parametrize("joint", [1, 3, 5])
def test_an_encoder_that_jumps_by_a_turn_does_not_drive(loop: Loop, joint: int) -> None:
    """The account begins anew at the jumped position after some time; no limit avoidance acts there.

    Before: the arm was driven to several times its velocity limit, 0.4 s after the jump.
    """
    offset: Any = np.eye(N)[joint] * TURN
    parts = loop.segments({"wanted": Q0}, {"start": 200, "q_offset": offset})
    summary = loop.run(3000, parts, configs=loop.config())
    assert summary.faults == 1
    assert summary.speed < 0.2
