# SPDX-License-Identifier: MIT
"""Positions that stand still, with a velocity of its own or one that is computed from them."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.controller_inputs import SPRING, STATED, Arm, Q

BEGIN = 1000
"""Sample from which on positions stand still."""


def drive(
    robot: ModuleType, joints: list[int], bit: int | None = None, seconds: float = 2.0, measured: bool = False
) -> Any:
    """Move along sines; return the arm, the last output and the sample, when a fault or the end came."""
    controller = robot.Impedance(**STATED)
    arm, before, stood = Arm(robot, Q), Q, Q
    for k in range(int(1000 * seconds)):
        told = arm.q.copy()
        stood = told if k <= BEGIN else stood
        told[joints] = stood[joints]
        if bit is not None and k > BEGIN and k % 2:
            told.view(np.uint64)[joints] ^= np.uint64(1) << np.uint64(bit)
        goal = Q + 0.3 * np.sin(2.0 * np.pi * 0.3 * k * 1e-3) * np.array([1, -1, 1, 1, -1, 1, 1])
        out = controller.step(q=told, dq=arm.dq if measured else (told - before) / 1e-3, q0=goal, counter=k, **SPRING)
        if out.fault:
            break
        before = told
        arm.step(out.torque)
    return arm, out, k


@pytest.mark.parametrize("joints", [*([i] for i in range(7)), [1, 4], list(range(7))], ids=str)
def test_a_position_that_freezes_is_found(robot: ModuleType, joints: list[int]) -> None:
    """A joint is FROZEN once its torque has ranged over 3 % of its limit, which friction may hold.

    Below nothing is found: A5 needs less, and may drift while its encoder and the velocity from it are frozen.
    """
    _, out, k = drive(robot, joints)
    if out.fault or set(joints) & {1, 2, 3, 5}:
        assert out.reason == robot.Reason.FROZEN, out.text
        assert out.fault_joint in joints
        assert BEGIN < k < BEGIN + 400


@pytest.mark.parametrize("joint", range(7))
def test_a_position_that_freezes_beside_a_measured_velocity(robot: ModuleType, joint: int) -> None:
    _, out, k = drive(robot, [joint], measured=True)
    assert out.reason == robot.Reason.FROZEN and out.fault_joint == joint
    assert BEGIN < k < BEGIN + 150


def test_a_last_bit_that_toggles_is_no_motion(robot: ModuleType) -> None:
    _, out, k = drive(robot, [3], 0)
    assert out.reason == robot.Reason.FROZEN and k < BEGIN + 150, out.text


def test_an_arm_in_motion_has_no_fault(robot: ModuleType) -> None:
    _, out, _ = drive(robot, [], seconds=6.0)
    assert not out.fault, out.text


def test_a_clamp_that_gives_way_is_no_frozen_position(robot: ModuleType) -> None:
    """Clamp an arm whose position moves in its last bits: not frozen, however hard the clamp."""
    for hardness in (1e6, 1e8):
        controller = robot.Impedance(**STATED)
        q, torque = Q, np.zeros(7)
        for k in range(1000):
            there = Q + torque / hardness
            out = controller.step(q=there, dq=(there - q) / 1e-3, q0=Q + 2e-4 * k, counter=k, **SPRING)
            q, torque = there, out.torque
            assert not out.fault, out.text


def test_a_coarse_encoder_that_is_declared_may_stand_still(robot: ModuleType) -> None:
    controller = robot.Impedance(**STATED, position_quantum=1e-5)
    for k in range(1500):
        out = controller.step(q=Q, dq=np.zeros(7), q0=Q + 1e-4 * k, counter=k, **SPRING)
    assert not out.fault and np.abs(out.torque / robot.EFFORT).max() > 0.03


def test_an_arm_at_rest_may_stand_still_for_ever(robot: ModuleType) -> None:
    """An arm that rests is identical to the last bit."""
    steps = 20000
    out = robot.Impedance(**STATED).run(q=Q, dq=np.zeros(7), q0=Q, counter=np.arange(steps), **SPRING)
    assert not out.fault.any()


def test_a_restart_under_gravity_is_no_frozen_position(robot: ModuleType) -> None:
    """Restart under gravity, where own and caller's torque keep their sum: not frozen. Before, it was."""
    controller, gravity = robot.Impedance(**STATED, torque_rate_limit=1000.0), np.array([0, 42.0, 0, -20, 0, 1, 0])
    controller.restart(gravity)
    for k in range(400):
        out = controller.step(q=Q, dq=np.zeros(7), q0=Q, counter=k, torque_offset=gravity, **SPRING)
        assert not out.fault, out.text
        np.testing.assert_allclose(out.torque, gravity, atol=1e-9)
