# SPDX-License-Identifier: MIT
"""Positions that stand still, with a velocity that is computed from them (velocity_source differenced)."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.controller_inputs import SPRING, Arm, Q

BEGIN = 1000
"""Sample from which on positions stand still."""


def drive(robot: ModuleType, joints: list[int], bit: int | None = None, seconds: float = 2.0, **config: Any) -> Any:
    """Move along sines; return the arm, the last output and the sample, when a fault or the end came."""
    controller = robot.Impedance(motor_inertia=0.1, **config)
    arm, before, stood = Arm(robot, Q), Q, Q
    for k in range(int(1000 * seconds)):
        told = arm.q.copy()
        stood = told if k <= BEGIN else stood
        told[joints] = stood[joints]
        if bit is not None and k > BEGIN and k % 2:
            told.view(np.uint64)[joints] ^= np.uint64(1) << np.uint64(bit)
        goal = Q + 0.3 * np.sin(2.0 * np.pi * 0.3 * k * 1e-3) * np.array([1, -1, 1, 1, -1, 1, 1])
        out = controller.step(q=told, dq=(told - before) / 1e-3, q0=goal, **SPRING)
        if out.fault:
            break
        before = told
        arm.step(out.torque)
    return arm, out, k


@pytest.mark.parametrize("joints", [*([i] for i in range(7)), [1, 4], list(range(7))], ids=str)
def test_a_position_that_freezes_is_found(robot: ModuleType, joints: list[int]) -> None:
    """Before, an arm with A6 frozen ran into its limits without a fault: q and dq agreed."""
    arm, out, k = drive(robot, joints, velocity_source="differenced")
    assert out.reason == robot.Reason.FROZEN, out.text
    assert out.fault_joint in joints
    assert BEGIN < k < BEGIN + 150
    assert (np.abs(arm.dq) < robot.VELOCITY).all()
    assert "velocity_source" in out.text


def test_the_same_is_not_found_with_a_velocity_that_counts_as_measured(robot: ModuleType) -> None:
    _, out, _ = drive(robot, [5])
    assert not out.fault


@pytest.mark.parametrize("bit", [0, 20, 30, 40])
def test_one_bit_that_toggles_is_no_motion(robot: ModuleType, bit: int) -> None:
    _, out, k = drive(robot, [3], bit, velocity_source="differenced")
    assert out.fault and k < BEGIN + 150, out.text


def test_an_arm_in_motion_has_no_fault(robot: ModuleType) -> None:
    _, out, _ = drive(robot, [], seconds=6.0, velocity_source="differenced")
    assert not out.fault, out.text


def rest(robot: ModuleType, goals: np.ndarray, external: Any = None, **config: Any) -> Any:
    """Return the outputs for an arm that never moves; ``external``: share of the torque that is explained."""
    controller, outs = robot.Impedance(motor_inertia=0.1, velocity_source="differenced", **config), []
    torque = np.zeros(7)
    for goal in goals:
        told = {} if external is None else {"external_torque": -external * torque}
        outs.append(controller.step(q=Q, dq=np.zeros(7), q0=goal, **SPRING, **told))
        torque = outs[-1].torque
        if outs[-1].fault:
            break
    return outs


def test_an_arm_at_rest_may_stand_still_for_ever(robot: ModuleType) -> None:
    """An arm that rests is identical to the last bit: under no torque, and under one that stays."""
    assert not rest(robot, np.tile(Q, (20000, 1)))[-1].fault
    controller = robot.Impedance(motor_inertia=0.1, velocity_source="differenced")
    arm = Arm(robot, Q)
    load = np.array([0.0, 0, -20, 0, 0, 0])
    for k in range(6000):  # a load is put on, and hangs
        q = np.round(arm.q / 1e-6) * 1e-6
        out = controller.step(q=q, dq=arm.dq if k < 4000 else np.zeros(7), q0=Q, **SPRING)
        assert not out.fault, out.text
        if k < 4000:
            arm.step(out.torque, load)


def test_a_torque_that_rises_under_a_joint_that_stands_still(robot: ModuleType) -> None:
    """The springs' torque rises: FROZEN, unless the environment is known to hold the arm."""
    goals = Q + np.linspace(0.0, 0.2, 1500)[:, None] * np.ones(7)
    outs = rest(robot, goals)
    assert outs[-1].reason == robot.Reason.FROZEN and len(outs) < 400
    assert not rest(robot, goals, external=1.0)[-1].fault
    assert rest(robot, goals, external=0.2)[-1].reason == robot.Reason.FROZEN
    assert rest(robot, goals, external=np.nan)[-1].reason == robot.Reason.FROZEN


def test_the_springs_of_a_frozen_joint_are_released_and_a_reset_begins_anew(robot: ModuleType) -> None:
    """The torque is 0 while the fault lasts; after the reset there is none."""
    goals = Q + np.linspace(0.0, 0.2, 1500)[:, None] * np.ones(7)
    controller = robot.Impedance(motor_inertia=0.1, velocity_source="differenced")
    for goal in goals:
        out = controller.step(q=Q, dq=np.zeros(7), q0=goal, **SPRING)
        if out.fault:
            break
    for _ in range(300):
        out = controller.step(q=Q, dq=np.zeros(7), q0=goal, **SPRING)
    assert out.fault and np.abs(out.torque).max() == 0.0
    controller.reset()
    for _ in range(10):
        out = controller.step(q=Q, dq=np.zeros(7), q0=Q, **SPRING)
    assert not out.fault, out.text
