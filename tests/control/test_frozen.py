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
    """The springs' torque rises: FROZEN, unless the environment is known to hold the arm and the encoder is coarse."""
    goals = Q + np.linspace(0.0, 0.2, 1500)[:, None] * np.ones(7)
    for quantum in (0.0, 1e-6, 1e-5):
        outs = rest(robot, goals, position_quantum=quantum)
        assert outs[-1].reason == robot.Reason.FROZEN and len(outs) < 400
        held = rest(robot, goals, external=1.0, position_quantum=quantum)[-1]
        assert held.reason == (robot.Reason.NONE if quantum > 1e-6 else robot.Reason.FROZEN)
        assert rest(robot, goals, external=0.2, position_quantum=quantum)[-1].reason == robot.Reason.FROZEN
        assert rest(robot, goals, external=np.nan, position_quantum=quantum)[-1].reason == robot.Reason.FROZEN


def press(robot: ModuleType, hardness: float, tell: bool, seconds: float = 1.0, **config: Any) -> Any:
    """Return the last output for an arm in a clamp that gives way by the torque over ``hardness`` [N m/rad]."""
    controller = robot.Impedance(motor_inertia=0.1, velocity_source="differenced", **config)
    q, torque = Q, np.zeros(7)
    for k in range(int(1000 * seconds)):
        there = Q + torque / hardness
        told = {"external_torque": -torque} if tell else {}
        goal = Q + 0.2 * k / 1000 * np.ones(7)
        out = controller.step(q=there, dq=(there - q) / 1e-3, q0=goal, **SPRING, **told)
        q, torque = there, out.torque
        if out.fault:
            break
    return out


def test_a_clamp_that_gives_way_is_no_frozen_position(robot: ModuleType) -> None:
    """A position that moves in its last bits is not frozen, however hard the clamp whose torque is told."""
    for hardness in (1e4, 1e6, 1e8):
        assert press(robot, hardness, tell=True).reason == robot.Reason.NONE
    assert press(robot, np.inf, tell=True).reason == robot.Reason.FROZEN


@pytest.mark.parametrize("bits", ["same", "one toggles", "one toggles rarely"])
def test_a_range_of_torque_under_a_position_of_the_same_bits(robot: ModuleType, bits: str) -> None:
    """The joint is FROZEN 20 ms after the torque's range exceeds 3 % of the limit: seen is the range [N m].

    The fault of two samples in a row is latched; the environment's torque explains all, and changes nothing.
    """
    controller = robot.Impedance(motor_inertia=0.1, velocity_source="differenced", position_quantum=1e-6)
    torque, torques = np.zeros(7), []
    for k in range(5000):
        q = Q.copy()
        if bits != "same" and k % (2 if bits == "one toggles" else 50) == 0:
            q.view(np.uint64)[:] ^= np.uint64(1)
        goal = Q + 2e-5 * k * np.ones(7)
        out = controller.step(q=q, dq=np.zeros(7), q0=goal, external_torque=-torque, **SPRING)
        torque = out.torque
        if out.fault:
            break
        torques.append(torque)
    joint, limit = out.fault_joint, 0.03 * controller.config.effort_limit
    assert out.reason == robot.Reason.FROZEN and out.fault_limit == pytest.approx(limit[joint])
    assert limit[joint] < out.fault_seen < 1.2 * limit[joint]
    assert np.ptp(torques[:-2], axis=0)[joint] <= limit[joint] * 1.1


def test_a_torque_that_falls_behind_brakes_is_no_frozen_position(robot: ModuleType) -> None:
    """In a fault of another kind the torque falls to 0 while brakes hold the arm: the samples are good again."""
    controller = robot.Impedance(motor_inertia=0.1, velocity_source="differenced")
    arm, before = Arm(robot, Q), Q
    for _ in range(60):
        out = controller.step(q=arm.q, dq=(arm.q - before) / 1e-3, q0=Q + 0.1, **SPRING)
        before = arm.q
        arm.step(out.torque)
    while not out.fault:
        out = controller.step(q=np.full(7, np.nan), dq=np.zeros(7), q0=Q, **SPRING)
    assert np.abs(out.torque / robot.EFFORT).max() > 0.05
    for k in range(600):
        out = controller.step(q=arm.q, dq=np.zeros(7), q0=arm.q, **SPRING)
        assert k < 100 or not out.status & robot.Status.BAD_SAMPLE
    assert out.reason == robot.Reason.NOT_FINITE and not np.any(out.torque)


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
