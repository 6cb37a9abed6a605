# SPDX-License-Identifier: MIT
"""The controller's step: values against a NumPy reference, faults, governor, configuration, and hostile input."""

from __future__ import annotations

import ctypes
import inspect
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.control.fields import CONFIG
from stiffgen.control.sessions.check import check_controller, elastic_torque, joint_hessian, modal_damping
from stiffgen.control.sessions.check import wrench as spring_wrench
from stiffgen.control.signals import INPUT, OUTPUT
from stiffgen.control.status_words import FAULTS, REASONS, STATUS
from stiffgen.core.symbolic.placement import Placement
from support.controller_inputs import KO, KT, SPRING, Arm, Q, hostile, run_with_resets, walk
from support.controller_library import WARNINGS, compile_c
from support.project import ROOT, Once

STILL = {"dq": np.zeros(7), "q0": Q, **SPRING}
SLOW = {"tip_velocity_limit": 0.5, "tip_rotation_limit": 1.5}
FAST = {"torque_rate_limit": 1e7, "effort_limit": 1e4, "frozen_window": 1000000, "limit_stiffness": 0.0}


def settled(robot: ModuleType, q: np.ndarray, **fields: Any) -> tuple[Any, Any]:
    """A controller engaged at Q whose arm is then moved to q within half a second; and its last output."""
    controller = robot.Impedance(**{**FAST, "motor_inertia": 0.1, **fields})
    for k in range(550):
        phase = np.pi * min(1, k / 500)
        way, rate = 0.5 - 0.5 * np.cos(phase), np.pi * np.sin(phase)
        out = controller.step(q=Q + way * (q - Q), dq=rate * (q - Q), q0=Q, **SPRING)
    return controller, out


# ---- the law


def test_torque_is_the_gradient_of_the_springs_energy(robot: ModuleType) -> None:
    """Torque and stiffness of an arm away from its equilibrium at Q, against differences of the energy."""
    random = np.random.default_rng(0)
    for _ in range(5):
        q = Q + random.uniform(-0.2, 0.2, 7)
        _, out = settled(robot, q, posture_stiffness=2.5)
        assert not out.fault, repr(out)
        expected = elastic_torque(robot.forward_kinematics, q, robot.forward_kinematics(Q), Q, KT, KO, 2.5)
        np.testing.assert_allclose(out.elastic_torque, expected, atol=1e-7)
        np.testing.assert_allclose(out.torque, expected, atol=1e-7)  # at rest
        H = joint_hessian(robot.forward_kinematics, q, robot.forward_kinematics(Q), Q, KT, KO, 2.5)
        np.testing.assert_allclose(out.joint_stiffness, H, atol=2e-4)
        assert np.array_equal(out.joint_stiffness, out.joint_stiffness.T)
        J = robot.hybrid.jacobian(q)
        of_posture = 2.5 * (Q - q)
        np.testing.assert_allclose(J.T @ out.spring_wrench, of_posture - expected, atol=1e-7)  # F = dU


@pytest.mark.parametrize("delay", [0, 1, 2, 5])
def test_damping_design(robot: ModuleType, delay: int) -> None:
    """Each mode has its damping ratio, at any delay, below the cap for the sample time (docs/controller.md)."""
    random = np.random.default_rng(delay)
    ratio = np.linspace(0.4, 1.0, 7)
    for _ in range(3):
        q = Q + random.uniform(-0.1, 0.1, 7)
        fields: dict[str, Any] = {"delay_samples": delay, "stiffness_cap": "accept"}
        _, out = settled(robot, q, damping_ratio=ratio, joint_damping=0.05, **fields)
        M = robot.mass_matrix(q) + 0.1 * np.eye(7)
        np.testing.assert_allclose(out.mass_matrix, M, rtol=1e-12)
        most = min(0.25, 0.75 / (1 + delay)) * 1e3  # largest eigenvalue of M^-1 B [1/s]
        expected = modal_damping(out.joint_stiffness, M, ratio, (delay + 0.5) * 1e-3, most, 0.05)
        np.testing.assert_allclose(out.damping, expected, rtol=1e-6, atol=1e-6)
        assert not out.status & robot.Status.DAMPING_CAPPED


def test_caps_for_the_sample_time(robot: ModuleType) -> None:
    """A wrist without its rotors is too light for the stiffness at 1 ms: damping and spring are capped, and say so."""
    controller = robot.Impedance(motor_inertia=0.0, stiffness_cap="accept")
    for _ in range(400):
        out = controller.step(q=Q, **{**STILL, "rotation_stiffness": 50 * np.eye(3)})
    assert out.status & robot.Status.STIFFNESS_CAPPED
    assert out.status & robot.Status.DAMPING_CAPPED
    rate = np.linalg.eigvals(np.linalg.solve(out.mass_matrix, out.damping)).real.max()
    assert rate * 1e-3 <= 0.25 * (1 + 1e-9)
    assert out.scale * out.eigenvalues[-1] * 1e-6 <= 0.0625 * (1 + 1e-9)
    assert out.scale == 1
    assert 0.1 < out.stiffness_share < 1


def test_damping_is_relative_to_the_governors_velocity(robot: ModuleType) -> None:
    """The goal moves at 0.1 rad/s, the arm at 0.09: the damper acts on the difference."""
    controller = robot.Impedance(**FAST, motor_inertia=0.1)
    for k in range(300):
        target = Q + 1e-4 * k
        out = controller.step(q=Q + 0.9e-4 * k, dq=np.full(7, 0.09), q0=target, **SPRING)
    np.testing.assert_allclose(out.reference, target, atol=1e-12)
    np.testing.assert_allclose(out.reference_velocity, 0.1, atol=1e-9)
    np.testing.assert_allclose(out.damping_torque, out.damping @ np.full(7, 0.01), atol=1e-9)


def test_fast_joints_are_braked(robot: ModuleType) -> None:
    """Beyond 0.9 of its reference's limit a joint gets what damping the sample time still allows, others nothing."""
    velocity = np.zeros(7)
    velocity[3] = 0.6 * robot.VELOCITY[3]
    controller = robot.Impedance(motor_inertia=0.1, reference_velocity_limit=0.5 * robot.VELOCITY)
    for k in range(200):
        out = controller.step(q=Q + 1e-3 * k * velocity, dq=velocity, q0=Q + 1e-3 * k * velocity, **SPRING)
    assert not out.fault
    limit = 0.9 * controller.config.reference_velocity_limit[3]
    braked = out.damping_torque - out.damping @ (out.reference_velocity - velocity)
    inverse, d = np.linalg.inv(out.mass_matrix), controller.config.joint_damping
    largest = np.linalg.eigvals(inverse @ (out.damping - d * np.eye(7))).real.max()
    expected = (0.25 / 1e-3 - d * np.trace(inverse) - largest) / inverse[3, 3] * (velocity[3] - limit)
    assert expected > 3
    np.testing.assert_allclose(braked, -expected * np.eye(7)[3], rtol=1e-9, atol=1e-9)
    controller.config.reference_velocity_limit = robot.VELOCITY
    out = controller.step(q=Q + 0.2 * velocity, dq=velocity, q0=Q + 0.2 * velocity, **SPRING)
    expected_torque = out.damping @ (out.reference_velocity - velocity)
    np.testing.assert_allclose(out.damping_torque, expected_torque, atol=1e-9)


# ---- governor


@pytest.mark.parametrize("distance", [1.0, 1.5])
def test_start_away_and_jumps(robot: ModuleType, distance: float) -> None:
    """The old law started 1.0 (1.5) rad away at 2.2 (3.3) times the velocity limit."""
    away = Q + distance * np.array([1, -0.5, 0.5, 0.3, -0.5, 0.5, 0.4])
    controller, arm = robot.Impedance(motor_inertia=0.1), Arm(robot, away)
    limits = controller.config
    last = away
    for k in range(7000):
        out = controller.step(q=arm.q, dq=arm.dq, q0=Q if k < 5000 else away, **SPRING)
        arm.step(out.torque)
        assert not out.fault, repr(out)
        assert np.all(np.abs(out.reference - last) <= limits.reference_velocity_limit * 1e-3 * (1 + 1e-9))
        assert np.all(np.abs(arm.dq) <= 1.1 * limits.reference_velocity_limit)
        assert out.elastic_energy < out.energy_limit
        last = out.reference.copy()
        if k == 4999:
            np.testing.assert_allclose(arm.q, Q, atol=0.02)


def test_energy_limit_holds_the_equilibrium_back(robot: ModuleType) -> None:
    """A held arm: the tip's spring is wound up to the limit, not further; a load above it lets only moves down pass."""

    def tip_energy(out: Any) -> float:
        return float(out.elastic_energy - 0.5 * np.sum(controller.config.posture_stiffness * (Q - out.reference) ** 2))

    controller = robot.Impedance(motor_inertia=0.1, energy_limit=0.5, frozen_window=1000000)
    goal = Q + 0.5
    for _ in range(3000):
        out = controller.step(q=Q, dq=np.zeros(7), q0=goal, **SPRING)
        assert tip_energy(out) <= 0.5 + 1e-12
    assert tip_energy(out) > 0.45
    assert out.status & robot.Status.GOVERNOR
    assert not out.fault
    stored = out.elastic_energy
    for _ in range(2000):
        out = controller.step(q=Q, dq=np.zeros(7), q0=Q, **SPRING)
        assert out.elastic_energy <= stored + 1e-12
    np.testing.assert_allclose(out.reference, Q, atol=1e-9)


def test_engagement_limit(robot: ModuleType) -> None:
    """The equilibrium wound up against a hand that gives way and holds again: no more work than the limit."""
    controller = robot.Impedance(motor_inertia=0.1, energy_limit=0.5, engagement_limit=0.8, tank_initial=1.0)
    q, goal, held = Q.copy(), Q + 1.2, False
    for k in range(6000):
        out = controller.step(q=q, dq=np.full(7, 0.2 * (k > 0)), q0=goal, **SPRING)
        q = q + 2e-4
        assert out.engagement >= -1e-12
        returned = 1.0 - out.tank_energy - out.sampling_total - out.stiffness_total  # income of a full tank
        assert out.reference_total <= 0.8 + returned + 1e-9
        held |= bool(out.status & robot.Status.GOVERNOR)
    assert held


def test_poses_as_command(robot: ModuleType) -> None:
    """An equilibrium moves along a line and about one axis, at bounded velocity; the arm follows; back to positions."""
    controller, arm = robot.Impedance(**SLOW, motor_inertia=0.1, ramp_time=0.1), Arm(robot, Q)
    start = robot.forward_kinematics(Q)
    goal = start.copy()
    goal[:3, 3] += [0.05, -0.06, 0.04]
    angle = 0.6
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    goal[:3, :3] = turn @ start[:3, :3]
    last = start
    for k in range(4000):
        out = controller.step(q=arm.q, dq=arm.dq, equilibrium=start if k < 10 else goal, posture=Q, **SPRING)
        arm.step(out.torque)
        E = out.equilibrium
        assert np.linalg.norm(E[:3, 3] - last[:3, 3]) <= 0.5e-3 * (1 + 1e-9)
        assert np.linalg.norm(E[:3, :3] - last[:3, :3]) <= np.sqrt(2) * 1.5e-3 * (1 + 1e-6)
        np.testing.assert_allclose(E[:3, :3].T @ E[:3, :3], np.eye(3), atol=1e-12)
        line = E[:3, 3] - start[:3, 3]
        np.testing.assert_allclose(np.cross(line, goal[:3, 3] - start[:3, 3]), 0, atol=1e-12)
        np.testing.assert_allclose((E[:3, :3] @ start[:3, :3].T)[:, 2], [0, 0, 1], atol=1e-12)
        last = E.copy()
    assert not out.fault
    np.testing.assert_allclose(out.equilibrium, goal, atol=1e-9)
    assert np.linalg.norm(robot.forward_kinematics(arm.q)[:3, 3] - goal[:3, 3]) < 0.005
    for _ in range(4000):
        out = controller.step(q=arm.q, dq=arm.dq, q0=Q, **SPRING)
        arm.step(out.torque)
    np.testing.assert_allclose(out.equilibrium, start, atol=1e-9)
    np.testing.assert_allclose(arm.q, Q, atol=0.02)


def test_a_refused_command_on_the_way_from_poses_to_positions(robot: ModuleType) -> None:
    """The equilibrium goes on from where it is: it must not be taken for having arrived, and jump."""
    controller, zero = robot.Impedance(**SLOW, motor_inertia=0.1, ramp_time=0.1, errors="ignore"), np.zeros(7)
    goal = robot.forward_kinematics(Q)
    goal[0, 3] += 0.1
    for _ in range(800):
        out = controller.step(q=Q, dq=zero, equilibrium=goal, posture=Q, **SPRING)
    np.testing.assert_allclose(out.equilibrium, goal, atol=1e-9)
    for k in range(1500):
        last = out.equilibrium
        q0 = Q if k % 10 != 5 else np.full(7, np.nan)
        out = controller.step(q=Q, dq=zero, q0=q0, **SPRING)
        assert bool(out.status & robot.Status.COMMAND_REFUSED) == (q0 is not Q)
        assert np.linalg.norm(out.equilibrium[:3, 3] - last[:3, 3]) <= 0.5e-3 * (1 + 1e-9)
    assert not out.fault
    np.testing.assert_allclose(out.equilibrium, robot.forward_kinematics(Q), atol=1e-9)


def test_refused_commands_hold_what_there_is(robot: ModuleType) -> None:
    """Neither equilibrium nor stiffness changes, and a refused command is no fault."""
    controller = robot.Impedance(**FAST, motor_inertia=0.1, errors="ignore")
    for _ in range(30):
        before = controller.step(q=Q, **STILL)
    bad: list[dict[str, Any]] = [
        {"q0": np.full(7, np.nan)},
        {"q0": np.full(7, 1e300)},
        {"translation_stiffness": np.diag([1.0, 1, -1])},
        {"translation_stiffness": np.diag([1.0, 1, 1e9])},
        {"rotation_stiffness": np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]])},
        {"rotation_stiffness": np.full((3, 3), np.inf)},
    ]
    for change in bad:
        out = controller.step(**{"q": Q, **STILL, **change})
        assert out.status & robot.Status.COMMAND_REFUSED
        assert not out.fault
        np.testing.assert_array_equal(out.reference, before.reference)
        np.testing.assert_array_equal(out.translation_stiffness, before.translation_stiffness)
    mirrored = np.diag([1.0, 1, -1, 1])
    for equilibrium in (mirrored, np.zeros((4, 4)), np.full((4, 4), np.nan), 2 * np.eye(4)):
        out = controller.step(q=Q, dq=np.zeros(7), equilibrium=equilibrium, posture=Q, **SPRING)
        assert out.status & robot.Status.COMMAND_REFUSED


# ---- plausibility and faults


def spoil(robot: ModuleType, change: Any, steps: int = 60) -> list[Any]:
    """A slow motion; from step 100 on the sample goes through ``change``(k, sample)."""
    controller = robot.Impedance(motor_inertia=0.1)
    outs = []
    for k in range(100 + steps):
        t = 1e-3 * k
        sample = {"q": Q + 0.2 * np.sin(2 * t), "dq": np.full(7, 0.4 * np.cos(2 * t)), "counter": k}
        if k >= 100:
            change(k - 100, sample)
        valid = sample.pop("valid", True)
        outs.append(controller.step(q0=Q, **SPRING, **sample) if valid else controller.missed())
    assert not any(out.fault for out in outs[:100])
    return outs[100:]


def setter(name: str, value: Any) -> Any:
    return lambda k, sample: sample.update({name: value(sample[name]) if callable(value) else value})


@pytest.mark.parametrize(
    ("change", "reason", "latest"),
    [
        (setter("q", np.full(7, np.nan)), "NOT_FINITE", 1),
        (setter("dq", lambda dq: dq * np.inf), "NOT_FINITE", 1),
        (setter("q", lambda q: q + np.eye(7)[1]), "JUMP", 1),
        (lambda k, s: s.update(q=s["q"] + np.eye(7)[3], dq=np.zeros(7)), "JUMP", 1),
        (setter("dq", lambda dq: -3 * dq), "MISMATCH", 1),
        (setter("dq", np.zeros(7)), "FROZEN", 40),
        (lambda k, s: s.update(q=Q + 0.2 * np.sin(0.2)), "FROZEN", 40),
        (setter("counter", 99), "STALE", 1),
        (lambda k, s: s.update(valid=False), "MISSED", 9),
        (lambda k, s: s.update(counter=s["counter"] + 5, q=Q + 0.2 * np.sin(2e-3 * (s["counter"] + 5))), "SKIPPED", 0),
    ],
)
def test_every_reason_of_the_samples(robot: ModuleType, change: Any, reason: str, latest: int) -> None:
    """A fault of its reason and class comes after ``latest`` steps at most, stays, and lets the springs go."""
    outs = spoil(robot, change)
    latched = next((k for k, out in enumerate(outs) if out.fault), None)
    assert latched is not None
    assert latched <= latest
    assert outs[latched].reason == robot.Reason[reason]
    assert outs[latched].fault == robot.Fault[{r: f for r, f, _ in REASONS}[reason.lower()].upper()]
    assert all(out.fault == outs[latched].fault for out in outs[latched:])  # it stays
    assert outs[-1].scale == 0
    assert outs[-1].elastic_energy == 0


def test_one_bad_sample_of_three_is_no_fault(robot: ModuleType) -> None:
    """Two bad ones of three are, and so are two missing ones of three, but for a short time."""
    outs = spoil(robot, lambda k, s: s.update(q=np.full(7, np.nan)) if k % 3 == 0 else None)
    assert not any(out.fault for out in outs)
    assert all(bool(out.status & robot.Status.BAD_SAMPLE) == (k % 3 == 0) for k, out in enumerate(outs))
    outs = spoil(robot, lambda k, s: s.update(valid=k % 3 == 2 or k > 2))  # two missed in a row, limit three
    assert not any(out.fault for out in outs)
    outs = spoil(robot, lambda k, s: s.update(valid=k % 3 != 0))
    assert not any(out.fault for out in outs)
    outs = spoil(robot, lambda k, s: s.update(valid=k % 3 == 2))
    assert outs[-1].fault, "two of three missed for long: a first version held its torque for most of 0.4 s, 68 J"
    outs = spoil(robot, lambda k, s: s.update(q=np.full(7, np.nan)) if k % 2 == 0 else None)
    assert outs[2].fault == robot.Fault.SENSOR


def test_an_encoder_jump_is_not_believed(robot: ModuleType) -> None:
    """1 rad with dq = 0: the old controller pulled with 320 N m after 100 ms."""
    calm = spoil(robot, lambda k, s: None, 1)[0]
    outs = spoil(robot, lambda k, s: s.update(q=s["q"] + np.eye(7)[1], dq=np.zeros(7)), 300)
    assert max(np.abs(out.torque).max() for out in outs) < 1.05 * np.abs(calm.torque).max()
    assert np.abs(outs[-1].torque).max() < 0.3 * np.abs(calm.torque).max()
    assert outs[-1].unaccounted == 1


def test_a_joint_beyond_its_velocity_limit_is_believed_and_braked(robot: ModuleType) -> None:
    """The first joint accelerates by 8 rad/s^2 to the limit, a fault, and by 30 rad/s^2 beyond: no torque then."""
    controller = robot.Impedance(motor_inertia=0.1, overspeed_time=0.0)
    q, dq = Q.copy(), np.zeros(7)
    for k in range(400):
        dq = 8.0 * k * 1e-3 * np.eye(7)[0]
        q = q + dq * 1e-3
        out = controller.step(q=q, dq=dq, q0=Q, **SPRING)
        if out.fault:
            break
    assert out.reason == robot.Reason.OVERSPEED
    assert dq[0] == pytest.approx(robot.VELOCITY[0], rel=0.02)
    for k in range(60):
        dq = dq + 0.03 * np.eye(7)[0]
        q = q + dq * 1e-3
        out = controller.step(q=q, dq=dq, q0=Q, **SPRING)
        assert not out.status & robot.Status.BAD_SAMPLE
        assert k > 7 or out.damping_torque[0] < -5
    assert out.reason == robot.Reason.DISSIPATION and out.fault_joint == 0
    assert not out.damping_torque.any() and not out.torque.any()


def test_a_joint_is_pushed_back_from_its_position_limit(robot: ModuleType) -> None:
    """The fourth joint moves at 0.5 rad/s through its limit zone (0.2 rad) and as far beyond: a fault."""
    controller, zone = robot.Impedance(motor_inertia=0.1, limit_zone=0.2), 0.2
    q = Q.copy()
    q[3] = -1.9
    while q[3] > robot.LOWER[3] - 0.2:
        q[3] -= 0.5e-3
        out = controller.step(q=q, dq=-0.5 * np.eye(7)[3], q0=Q, **SPRING)
        depth = max(0.0, robot.LOWER[3] + zone - q[3])
        # the default of limit_stiffness is the effort limit per radian
        assert out.limit_torque[3] == pytest.approx(min(depth * robot.EFFORT[3], robot.EFFORT[3]), abs=1e-9)
    assert out.reason == robot.Reason.POSITION
    assert out.limit_torque[3] > 50  # still there in the fault, where it is needed most


def test_a_fault_lasts_until_its_reset(robot: ModuleType) -> None:
    """Two bad samples release the arm, which a hand then pushes away; after the reset it goes back to Q."""
    controller, arm = robot.Impedance(motor_inertia=0.1), Arm(robot, Q)
    load = np.array([20.0, 0, 0, 0, 0, 0])
    modes, faults = [], []
    for k in range(6000):
        q = np.full(7, np.nan) if k in (500, 501) else arm.q
        if k == 2000:
            controller.reset()
        out = controller.step(q=q, dq=arm.dq, q0=Q, **SPRING)
        arm.step(out.torque, load if 600 < k < 1200 else None)
        modes.append(out.mode)
        faults.append(out.fault)
        if 700 < k < 2000:
            np.testing.assert_array_equal(out.reference, out.position)  # the equilibrium follows the arm
    assert modes[499] == robot.Mode.ACTIVE
    assert modes[501] == robot.Mode.RELEASE
    assert modes[1999] == robot.Mode.FOLLOW
    assert modes[2001] == robot.Mode.ACTIVE
    assert faults[1999] == robot.Fault.SENSOR
    assert faults[2001] == robot.Fault.NONE
    np.testing.assert_allclose(arm.q, Q, atol=0.03)


def test_the_release_is_as_fast_as_the_rate_limit(robot: ModuleType) -> None:
    """What acts stays the gradient of l U, and the torque falls at about its rate limit."""
    q = Q + np.array([0, 0.1, 0, 0.1, 0, 0, 0])
    controller, out = settled(robot, q, torque_rate_limit=robot.EFFORT * 10, effort_limit=robot.EFFORT)
    start, steps = np.abs(out.torque).max(), 0
    torque = out.torque
    for _ in range(3):
        out = controller.step(q=np.full(7, np.nan), **STILL)
    while out.scale > 0:
        out = controller.step(q=q, **STILL)
        expected = out.scale * elastic_torque(robot.forward_kinematics, q, robot.forward_kinematics(Q), Q, KT, KO, 1.0)
        np.testing.assert_allclose(out.elastic_torque, expected, atol=1e-6)
        np.testing.assert_allclose(out.torque, out.elastic_torque, atol=1e-6)  # nothing is cut
        steps += 1
        assert steps < 200
    assert steps <= 1.3 * (np.abs(torque) / (robot.EFFORT * 0.01)).max() + 3
    assert start > 10


def test_wrench_is_observed(robot: ModuleType) -> None:
    controller = robot.Impedance()
    wrench = np.arange(6.0)
    np.testing.assert_array_equal(controller.step(q=Q, **STILL, wrench=wrench).wrench, wrench)
    plain = controller.step(q=Q, **STILL)
    out = controller.step(q=Q, **STILL, wrench=np.full(6, np.nan))
    assert out.status & robot.Status.WRENCH_REFUSED
    assert not out.fault
    np.testing.assert_array_equal(out.torque, plain.torque)


# ---- torque contract


def contract(robot: ModuleType, controller: Any, out: Any, start: Any = 0.0) -> None:
    """All outputs are finite, and the torque keeps its rate limit from ``start`` on."""
    for name in out.names:
        assert np.all(np.isfinite(out[name])), name
    steps = np.abs(np.diff(np.vstack([np.zeros(7) + start, out.torque]), axis=0))
    assert np.all(steps <= controller.config.torque_rate_limit * controller.config.sample_time * (1 + 1e-12))


@pytest.mark.parametrize("seed", range(4))
def test_hostile_input(robot: ModuleType, seed: int) -> None:
    """The torque keeps its limits, each bad row is named, and good samples bring the controller back."""
    inputs, bad = hostile(np.random.default_rng(seed), robot, 5000, 0.01)
    fields: dict[str, Any] = [{}, {"delay_samples": 2}, {"damping_ratio": 0.3},
                              {"effort_limit": 5.0, "torque_rate_limit": 20.0}][seed]  # fmt: skip
    controller = robot.Impedance(motor_inertia=0.1, errors="ignore", **fields)
    out = run_with_resets(controller, inputs, 20)
    contract(robot, controller, out)
    assert np.all(np.abs(out.torque) <= controller.config.effort_limit)
    seen = bad[inputs["sample_valid"][bad] == 1]  # rows that are spoilt, and not missing
    either = int(robot.Status.BAD_SAMPLE | robot.Status.COMMAND_REFUSED)
    assert np.all(out.status[seen] & either)
    assert np.all(out.status[inputs["sample_valid"] == 0] & int(robot.Status.MISSED))
    later = walk(np.random.default_rng(7), robot, 1500, sample_valid=np.ones(1500, int))
    recovered = run_with_resets(controller, later, 20)
    assert not np.any(recovered.status[1000:] & int(robot.Status.FAULT))


def test_extreme_accepted_values(robot: ModuleType) -> None:
    """Every field at both ends of its range, alone and many at once: no product overflows."""
    random = np.random.default_rng(1)
    inputs = walk(random, robot, 120)
    numbers = [field for field in CONFIG if not field.choices and np.isfinite(field.most)]
    kinds = {field.name: int if field.type == "int" else float for field in numbers}
    ends = {field.name: (kinds[field.name](field.least), kinds[field.name](field.most)) for field in numbers}
    tried = 0
    cases = [{name: value} for name, pair in ends.items() for value in pair]
    cases += [{name: pair[random.integers(0, 2)] for name, pair in ends.items() if random.random() < 0.5}
              for _ in range(60)]  # fmt: skip
    for case in cases:
        try:
            controller = robot.Impedance(case, errors="ignore")
        except ValueError:
            continue  # a cross-field rule
        tried += 1
        contract(robot, controller, controller.run(**inputs))
    assert tried > 80


def test_gains_change_without_a_bump(robot: ModuleType) -> None:
    """A lowered effort limit comes down at the rate limit (the old one jumped by 184 N m), as do all other changes."""
    controller, out = settled(robot, Q + 0.12, torque_rate_limit=robot.EFFORT * 10, effort_limit=robot.EFFORT)
    assert np.abs(out.torque).max() > 20
    changes = [("effort_limit", 1.0), ("effort_limit", robot.EFFORT), ("damping_ratio", 5.0), ("motor_inertia", 10.0),
               ("posture_stiffness", 500.0), ("joint_damping", 50.0)]  # fmt: skip
    last = out.torque
    for name, value in changes:
        setattr(controller.config, name, value)
        for _ in range(60):
            out = controller.step(q=Q + 0.12, dq=np.zeros(7), q0=Q, **SPRING)
            assert np.all(np.abs(out.torque - last) <= robot.EFFORT * 0.01 * (1 + 1e-12)), name
            last = out.torque
        if name == "effort_limit" and np.ndim(value) == 0:
            assert np.abs(out.torque).max() <= 1.0


def test_initial_torque(robot: ModuleType) -> None:
    """A torque in force at the start falls at the rate limit; one beyond the effort limit is refused."""
    torque = 0.9 * robot.EFFORT
    controller = robot.Impedance(torque=torque, motor_inertia=0.1)
    out = controller.run(q=np.tile(Q, (150, 1)), **STILL)
    contract(robot, controller, out, torque)
    np.testing.assert_allclose(out.torque[0], torque - robot.EFFORT * 0.01)
    assert np.abs(out.torque[-1]).max() < 1e-6
    for bad in (2 * robot.EFFORT, np.full(7, np.nan)):
        with pytest.raises(ValueError, match="initial torque"):
            robot.Impedance(torque=bad)


def test_flipped_bits_of_the_state(robot: ModuleType) -> None:
    """Any single bit: the torque stays finite and within its limits; a flip that matters is a fault."""
    random = np.random.default_rng(2)
    inputs = walk(random, robot, 1)
    one = {name: value[0] for name, value in inputs.items() if name != "sample_valid"}
    controller = robot.Impedance(motor_inertia=0.1)
    for k in range(200):
        out = controller.step(**{**one, "q": one["q"] + 1e-5 * k, "dq": np.full(7, 0.01)})
    kept, counter, seen = controller._state.copy(), controller._counter, set()
    size = kept.nbytes * 8
    for bit in random.choice(size, 4000, replace=False):
        controller._state[:] = kept
        controller._counter = counter
        controller._state.view(np.uint8)[bit // 8] ^= np.uint8(1 << (bit % 8))
        last = out.torque
        for k in range(200, 203):
            new = controller.step(**{**one, "q": one["q"] + 1e-5 * k, "dq": np.full(7, 0.01)})
            assert np.all(np.isfinite(new.torque))
            assert np.all(np.abs(new.torque - last) <= robot.EFFORT * 0.01 * (1 + 1e-12))
            last = new.torque
        seen.add(new.reason)
    assert robot.Reason.STATE in seen
    assert seen <= {robot.Reason.STATE, robot.Reason.NONE}


def test_invalid_configuration_while_running(robot: ModuleType) -> None:
    """A field that is overwritten behind Python's checks is refused by the step, and is a fault afterwards."""
    controller, out = settled(robot, Q + 0.05)
    controller._config._values[0]["sample_time"] = -1.0
    before = out.torque
    inputs = {"q": Q + 0.05, **STILL}
    with pytest.raises(ValueError, match="sample_time: must lie between"):
        controller.step(**inputs)
    controller._config._values[0]["sample_time"] = 1e-3
    out = controller.step(**inputs)
    assert out.reason == robot.Reason.CONFIG
    assert np.abs(out.torque - before).max() < 1e4


# ---- configuration and Python


def test_every_field_is_checked(robot: ModuleType) -> None:
    """A value just beyond a field's bounds is refused by its name; so are wrong choices, shapes and unknown names."""
    for field in CONFIG:
        if field.choices:
            with pytest.raises(ValueError, match=f"{field.name}: no value 'nonsense'; it takes"):
                robot.Impedance({field.name: "nonsense"})
            continue
        for value in (np.nan, *([field.least - 1, field.most + 1] if np.isfinite(field.most) else [])):
            if field.type == "int":
                if np.isnan(value):
                    continue
                value = int(value)
            with pytest.raises(ValueError, match=f"{field.name}.*: |position_limits|lower_limit"):
                robot.Impedance({field.name: value})
    for fields, words in (
        ({"lower_limit": 1.0, "upper_limit": 0.0}, "lower must be below upper"),
        ({"state_period": 0.5}, "missed_limit times sample_time"),
        ({"missed_limit": 2.5}, "no whole number"),
        ({"missed_limit": 2**32 + 3}, "missed_limit: must lie between 1 and 1000"),  # 3 in 32 bits
        ({"delay_samples": np.int64(-(2**32))}, "delay_samples: must lie between"),
        ({"loss_limit": 2**70}, "loss_limit: must lie between"),
        ({"effort_limit": np.ones(3)}, "shape"),
    ):
        with pytest.raises(ValueError, match=words):
            robot.Impedance(fields)
    with pytest.raises(TypeError, match="no configuration field 'nullspace'"):
        robot.Impedance(nullspace="off")


def test_configuration_while_running(robot: ModuleType) -> None:
    """A field is set with its check, a refused value leaves the old one, and an unknown name is an error."""
    controller = robot.Impedance()
    controller.config.damping_ratio = 0.5
    np.testing.assert_array_equal(controller.config.damping_ratio, np.full(7, 0.5))
    assert controller.config.spring == "trace"
    with pytest.raises(ValueError, match="damping_ratio: every entry must lie between 0 and 100"):
        controller.config.damping_ratio = -1
    np.testing.assert_array_equal(controller.config.damping_ratio, np.full(7, 0.5))
    with pytest.raises(AttributeError, match="no configuration field 'dampingratio'"):
        controller.config.dampingratio = 1
    with pytest.raises(AttributeError, match="there are"):
        _ = controller.config.nothing
    controller.config.update({"state_period": 0.004, "missed_limit": 4})
    assert "damping_ratio" in repr(controller.config)


def test_an_entry_of_a_field_is_not_lost(robot: ModuleType) -> None:
    """Before, ``config.velocity_limit[0] = 0.1`` set an entry of a copy, and the controller had another limit."""
    controller = robot.Impedance()
    with pytest.raises(ValueError, match="read-only"):
        controller.config.velocity_limit[0] = 0.1
    controller.config.velocity_limit = 0.5 * controller.config.velocity_limit
    np.testing.assert_allclose(controller.config.velocity_limit, 0.5 * robot.VELOCITY)


@pytest.mark.parametrize("fields", [{"sample_time": 0.01}, {"sample_time": 0.005, "delay_samples": 3}])
def test_a_refused_stiffness_names_what_is_allowed(robot: ModuleType, fields: dict[str, Any]) -> None:
    """The named limits are accepted, and a tenth more of either is refused."""
    with pytest.raises(ValueError, match="lower the limits") as refused:
        robot.Impedance(fields)
    words = re.search(r"at (\d+) Hz and delay_samples (\d) at most (\S+) N/m and (\S+) N m/rad\)$", str(refused.value))
    assert words, refused.value
    assert float(words[1]) * fields["sample_time"] == 1 and int(words[2]) == fields.get("delay_samples", 0)
    limits = {"translation_stiffness_limit": float(words[3]), "rotation_stiffness_limit": float(words[4])}
    robot.Impedance(fields | limits)
    for name, limit in limits.items():
        if limit < getattr(robot.Impedance().config, name):
            with pytest.raises(ValueError, match="lower the limits"):
                robot.Impedance(fields | limits | {name: 1.11 * limit})


def test_inputs_are_required(robot: ModuleType) -> None:
    """Each call that lacks an input, or has too many or wrong ones, says which."""
    controller = robot.Impedance()
    zero = np.zeros(7)
    with pytest.raises(TypeError, match="either q0, or equilibrium and posture"):
        controller.step(q=Q, dq=zero, **SPRING)
    with pytest.raises(TypeError, match="either q0, or equilibrium and posture"):
        controller.step(q=Q, dq=zero, q0=Q, posture=Q, **SPRING)
    with pytest.raises(TypeError, match="needs posture"):
        controller.step(q=Q, dq=zero, equilibrium=np.eye(4), **SPRING)
    with pytest.raises(TypeError, match="needs rotation_stiffness"):
        controller.step(q=Q, dq=zero, q0=Q, translation_stiffness=KT)
    with pytest.raises(TypeError):
        controller.step(Q, zero, Q)
    with pytest.raises(TypeError, match="no input 'q1'"):
        controller.run(q=Q, dq=zero, q1=Q, **SPRING)
    with pytest.raises(ValueError, match="q0: shape"):
        controller.step(q=Q, dq=zero, q0=0.0, **SPRING)
    with pytest.raises(ValueError, match="different lengths"):
        controller.run(q=np.tile(Q, (3, 1)), dq=np.zeros((4, 7)), q0=Q, **SPRING)


def test_outputs_print_with_names(robot: ModuleType) -> None:
    """Status, mode and fault print as words, also combined; an unknown field is an error."""
    controller = robot.Impedance()
    controller.step(q=Q, **STILL)
    out = controller.step(q=np.full(7, np.nan), **{**STILL, "q0": Q + 0.1})
    both = out.status | robot.Status.MISSED | robot.Status.BAD_SAMPLE
    assert isinstance(both, robot.Status)
    assert robot.Status(both) == both
    text = repr(out)
    for word in ("torque", "BAD_SAMPLE", "ACTIVE", "NONE"):
        assert word in text
    assert out["torque"] is not None
    with pytest.raises(AttributeError, match="no field 'torques'"):
        _ = out.torques
    assert "Record of 3 steps" in repr(controller.run(q=np.tile(Q, (3, 1)), **STILL))


def test_steps_and_runs_agree_and_are_recorded(robot: ModuleType) -> None:
    """One by one or in one call, the bits are the same; the trace has the last 25, and restart begins anew."""
    inputs = walk(np.random.default_rng(8), robot, 40)
    del inputs["sample_valid"]
    a, b = robot.Impedance(record=25), robot.Impedance()
    one = [a.step(**{name: value[k] for name, value in inputs.items()}) for k in range(40)]
    many = b.run(**inputs)
    assert np.array_equal(np.array([record.torque for record in one]), many.torque)
    recorded_inputs, recorded = a.trace
    assert len(recorded) == 25
    assert np.array_equal(recorded.torque, many.torque[-25:])
    assert np.array_equal(recorded_inputs.q, inputs["q"][-25:])
    assert len(b.trace[0]) == 0
    a.restart()
    assert np.array_equal(a.run(**inputs).joint_stiffness, many.joint_stiffness)


def test_threads_do_not_disturb_one_another(robot: ModuleType) -> None:
    inputs = walk(np.random.default_rng(9), robot, 2000)
    expected = robot.Impedance().run(**inputs).torque
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda _: robot.Impedance().run(**inputs).torque, range(8)))
    assert all(np.array_equal(result, expected) for result in results)


def test_the_tables_of_fields_and_bits(robot: ModuleType) -> None:
    """Python has the names of the tables, in their order, and the robot's limits as defaults."""
    controller = robot.Impedance(record=1)
    assert tuple(controller.config) == tuple(field.name for field in CONFIG)
    assert controller.trace[0].names == tuple(field.name for field in INPUT if field.when != "tool")
    assert controller.trace[1].names == tuple(field.name for field in OUTPUT)
    assert [flag.name for flag in robot.Status] == [name.upper() for name, _ in STATUS]
    assert [fault.name for fault in robot.Fault] == [name.upper() for name, _ in FAULTS]
    assert [reason.name for reason in robot.Reason] == [name.upper() for name, _, _ in REASONS]
    np.testing.assert_array_equal(controller.config.lower_limit, robot.LOWER)
    np.testing.assert_array_equal(controller.config.effort_limit, robot.EFFORT)


# ---- C


@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++", "clang++"])
def test_compiles_without_warnings(robot_folder: Path, compiler: str, tmp_path: Path) -> None:
    language = ("-x", "c++", "-O0") if compiler.endswith("++") else ("-std=c99", "-O2")
    if compiler.startswith("clang"):  # warns before it optimises
        language = (*language[:-1], "-fsyntax-only")
    compile_c(tmp_path / "x.o", *language, *WARNINGS, "-c", robot_folder / "iiwa14_impedance.c", compiler=compiler)


@pytest.fixture(scope="module")
def objects(once: Once, robot_folder: Path) -> Path:
    """Object files of kernels and controller, and what each function takes of the stack."""

    def make(folder: Path) -> None:
        for source in ("iiwa14.c", "iiwa14_impedance.c"):
            made = (folder / source).with_suffix(".o")
            flags = ("-std=c99", "-O2", "-fno-pie", "-fstack-usage")
            compile_c(made, *flags, "-c", robot_folder / source, compiler="gcc")

    return once("impedance-objects", make)


def test_names_and_libraries(robot_folder: Path, objects: Path) -> None:
    """Exported names have the robot's prefix, undefined ones are mathematics and memory; nothing that changes."""
    allowed = {"cos", "sin", "sincos", "sqrt", "cbrt", "exp", "fabs", "atan2", "fmax", "fmin",
               "memcpy", "memset", "memmove", "memcmp", "bcmp"}  # fmt: skip
    own, undefined = set(), set()
    for source in ("iiwa14.c", "iiwa14_impedance.c"):
        made = (objects / source).with_suffix(".o")
        done = subprocess.run(["nm", made], capture_output=True, text=True, check=True)
        for line in done.stdout.splitlines():
            *_, kind, name = line.split()
            (undefined if kind == "U" else own).add(name)
            # what self_check reads is const and volatile, which compilers may put beside variables
            constant = name.split(".")[0] in ("angles", "large", "quiet_nan")
            assert kind not in "dDbBC" or constant, f"{source} has a variable that changes: {name}"
            assert kind.islower() or kind == "U" or name.startswith("iiwa14_"), name
    assert undefined - own - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"} <= allowed
    for header in robot_folder.glob("*.h"):
        assert header.name.startswith("iiwa14")


def test_stack_of_the_call_path(objects: Path) -> None:
    """The sum over ALL functions, more than any path, with the deepest kernel twice, stays below 32 KiB.

    All but the self-check and the search for a posture: no step calls them, so that they are not on the path.
    """
    total, kernels = 0, [0]
    for source in ("iiwa14.c", "iiwa14_impedance.c"):
        for line in (objects / source).with_suffix(".su").read_text().splitlines():
            function, size, kind = line.split("\t")
            assert kind in ("static", "dynamic,bounded")
            if function.endswith("impedance_self_check"):
                assert int(size) < 16 * 1024  # a state, and what a step reads and writes
                continue
            if ":search_posture" in function:
                assert int(size) < 8 * 1024  # a memory
                continue
            if source == "iiwa14.c":
                kernels.append(int(size))
            else:
                total += int(size)
    print(f"stack of the controller {total} B, deepest kernel {max(kernels)} B")
    assert total + 2 * max(kernels) < 32 * 1024


def test_null_and_uninitialised(robot_folder: Path, tmp_path: Path) -> None:
    """Null pointers, a state of zeros and a configuration of zeros have errors with their remedy."""
    controller = [robot_folder / "iiwa14_impedance.c", "-std=c99", "-O2", "-fPIC", "-c"]
    kernels = [robot_folder / "iiwa14.c", "-std=c99", "-O0", "-fPIC"]
    linked = ["-shared", compile_c(tmp_path / "controller.o", *controller), "-lm"]
    library = ctypes.CDLL(str(compile_c(tmp_path / "controller.so", *kernels, *linked)))
    library.iiwa14_impedance_error_text.restype = ctypes.c_char_p
    config, state, sample, out = (ctypes.create_string_buffer(1 << 16) for _ in range(4))
    library.iiwa14_impedance_default_config(config)
    step, text = library.iiwa14_impedance_step, library.iiwa14_impedance_error_text
    assert b"NULL" in text(step(config, state, sample, None))
    assert b"NULL" in text(step(config, None, sample, out))
    assert b"iiwa14_impedance_init" in text(step(config, state, sample, out))
    assert b"iiwa14_impedance_init" in text(library.iiwa14_impedance_reset(state))
    assert library.iiwa14_impedance_init(config, state, None) == 0
    assert step(config, state, sample, out) == 0  # zeros are a missed sample
    assert b"NULL" in text(step(None, state, sample, out))
    assert b"NULL" in text(library.iiwa14_impedance_reset(None))
    assert b"NULL" in text(library.iiwa14_impedance_validate(None))
    zeros = ctypes.create_string_buffer(1 << 16)
    assert b"sample_time" in text(library.iiwa14_impedance_validate(zeros))
    assert text(12345) == b"unknown error"


# ---- other robots


def chain_of(joints: int, folder: Path) -> Path:
    """The file of a serial arm of equal links, whose axes are z, y, x in turn."""
    inertial = '<inertial><mass value="1"/><origin xyz="0.05 0 0"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
    inertial += 'ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="l{k}">{inertial}</link>' for k in range(joints + 1))
    limit = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'
    moving = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0.1 0 0"/>'
        f'<axis xyz="{["0 0 1", "0 1 0", "1 0 0"][k % 3]}"/>{limit}</joint>'
        for k in range(joints)
    )
    path = folder / f"chain{joints}.urdf"
    path.write_text(f'<robot name="chain{joints}">{links}{moving}</robot>')
    return path


@pytest.mark.wide(instead="test_several_tips_and_tools")
def test_controller_of_40_joints_and_none_beyond(tmp_path: Path) -> None:
    """A chain of 40 joints has the springs' torque; one of 41 has no controller, and its README says why."""
    folder = stiffgen.generate(chain_of(40, tmp_path), output=tmp_path)
    arm = open_robot(folder).module
    random = np.random.default_rng(0)
    q0 = random.uniform(-0.3, 0.3, 40)
    q = q0 + 0.002 * np.sin(np.arange(300)[:, None] * 1e-2 + random.uniform(0, 6, 40)) * np.linspace(0, 1, 300)[:, None]
    controller = arm.Impedance(motor_inertia=0.5, limit_stiffness=0.0, torque_rate_limit=1e6, tank_initial=5000.0)
    out = controller.run(q=q, dq=np.gradient(q, 1e-3, axis=0), q0=q0, **SPRING)
    assert not out.fault.any(), arm.Reason(out.reason[-1])
    expected = elastic_torque(arm.forward_kinematics, q[-1], out.equilibrium[-1], out.reference[-1], KT, KO, 1.0)
    np.testing.assert_allclose(out.elastic_torque[-1], out.scale[-1] * expected, atol=1e-7)
    beyond = stiffgen.generate(chain_of(41, tmp_path), output=tmp_path, build=False)
    assert not list(beyond.glob("*impedance*"))
    assert "40 coordinates" in (beyond / "README.md").read_text()


def steps_arguments(arm: Any, q0: np.ndarray, tool: np.ndarray, **more: Any) -> tuple[bool, str]:
    """Whether a step's signature has the tool's pose, and what a step says that takes it wrongly."""
    parameter = inspect.signature(arm.Impedance.step).parameters.get("tool_pose")
    assert parameter is None or (parameter.default, parameter.annotation) == (parameter.empty, "ArrayLike")
    wrong = {"tool_pose": tool} if parameter is None else {}
    with pytest.raises(TypeError) as error:
        arm.Impedance(**more).step(q=q0, dq=0 * q0, q0=q0, translation_stiffness=KT, rotation_stiffness=KO, **wrong)
    return parameter is not None, str(error.value)


def test_a_step_takes_a_tool_only_of_robots_that_have_it_at_run_time(robot: ModuleType) -> None:
    """test_several_tips_and_tools has a robot with one."""
    message = "Impedance.step() got an unexpected keyword argument 'tool_pose'"
    assert steps_arguments(robot, np.zeros(7), np.eye(4)) == (False, message)


@pytest.mark.slow
@pytest.mark.parametrize("runtime_tool", [False, True])
def test_several_tips_and_tools(tmp_path: Path, runtime_tool: bool) -> None:
    """Two springs on one q: the torque is the sum of both gradients; another tool needs a new start."""
    urdf = ROOT / "tests" / "data" / "dual_arm.urdf"
    folder = stiffgen.generate(urdf, tip=["left hand", "right-hand"], output=tmp_path, runtime_tool=runtime_tool)
    arm = open_robot(folder).module
    n, random = arm.DOF, np.random.default_rng(3)
    tools = np.tile(np.eye(4), (2, 1, 1))
    tools[:, :3, 3] = random.uniform(-0.1, 0.1, (2, 3))
    extra = {"tool_pose": tools} if runtime_tool else {}
    q0 = np.clip(np.full(n, 0.3), arm.LOWER + 0.3, arm.UPPER - 0.3)
    Kt, Ko = np.stack([KT, KT / 2]), np.stack([KO, KO * 2])
    springs = {"translation_stiffness": Kt, "rotation_stiffness": Ko, **extra}
    limits = {"effort_limit": 100.0, "torque_rate_limit": 1e6, "velocity_limit": 2.0, "reference_velocity_limit": 1.0}
    if runtime_tool:
        assert steps_arguments(arm, q0, tools, motor_inertia=0.3, limit_stiffness=0.0, **limits) == (
            True,
            "a step needs tool_pose",
        )
    controller = arm.Impedance(motor_inertia=0.3, limit_stiffness=0.0, **limits)
    way = random.uniform(-0.03, 0.03, n)
    for k in range(300):
        share = 0.5 - 0.5 * np.cos(np.pi * min(1, k / 200))
        rate = np.pi / 0.2 * 0.5 * np.sin(np.pi * min(1, k / 200))
        out = controller.step(q=q0 + share * way, dq=rate * way, q0=q0, **springs)
    assert not out.fault, repr(out)
    expected = 1.0 * (q0 - out.position)
    for t, name in enumerate(("left_hand", "right_hand")):
        kernels = getattr(arm, name)
        given = (tools[t],) if runtime_tool else ()
        F = spring_wrench(
            kernels.forward_kinematics(out.position, *given), kernels.forward_kinematics(q0, *given), Kt[t], Ko[t]
        )
        np.testing.assert_allclose(out.spring_wrench[t], out.scale * F, atol=1e-6)
        expected = expected - kernels.hybrid.jacobian(out.position, *given).T @ F
    np.testing.assert_allclose(out.elastic_torque, out.scale * expected, atol=1e-6)
    if runtime_tool:
        tools[1, 0, 3] += 0.01
        before = out
        with pytest.warns(arm.CommandWarning, match="tool_pose, entry 19"):
            out = controller.step(q=q0 + way, dq=np.zeros(n), q0=q0, **springs)
        assert (out.refusal, out.refusal_entry) == (arm.Refusal.ENGAGED, 19)
        assert out.refusal_seen == pytest.approx(out.refusal_limit + 0.01)
        np.testing.assert_allclose(out.spring_wrench, before.spring_wrench, rtol=0.05)
        controller.restart(torque=out.torque)
        for _ in range(200):
            out = controller.step(q=q0 + way, dq=np.zeros(n), q0=q0, **springs)
        assert not out.fault and not out.refusal, repr(out)
        F = spring_wrench(arm.right_hand.forward_kinematics(out.position, tools[1]), out.equilibrium[1], Kt[1], Ko[1])
        np.testing.assert_allclose(out.spring_wrench[1], out.scale * F, atol=1e-6)


@pytest.mark.slow
def test_the_spring_lies_where_the_kernels_have_it(tmp_path: Path) -> None:
    """Centre of stiffness and axes are the robot's: --placement holds for the controller."""
    where = Placement("tip", "base", (0.05, -0.1, 0.2))
    robot = open_robot(stiffgen.generate(ROOT / "urdf" / "iiwa14.urdf", output=tmp_path, placement=where))
    arm = robot.module
    controller = arm.Impedance(**FAST, motor_inertia=0.1, energy_limit=1e4)
    Kt = KT + 100 * np.ones((3, 3))
    for k in range(1500):
        share = min(1, k / 1000)
        out = controller.step(
            q=Q + 0.2 * share, dq=np.full(7, 0.2 * (k < 1000)), q0=Q, translation_stiffness=Kt, rotation_stiffness=KO
        )
    assert not out.fault, repr(out)
    given = (arm.forward_kinematics, Q + 0.2, arm.forward_kinematics(Q), Q, Kt, KO, 1.0)
    assert np.abs(elastic_torque(*given) - elastic_torque(*given, where)).max() > 1.0
    np.testing.assert_allclose(out.elastic_torque, elastic_torque(*given, where), atol=1e-6)
    np.testing.assert_allclose(out.joint_stiffness, joint_hessian(*given, where), atol=1e-3)
    assert not [check for check in check_controller(robot, 1) if not check.passed]


def test_a_clock_tells_of_calls_that_are_left_out(robot: ModuleType) -> None:
    """Late calls count as missing samples, jitter does not; each result is that of the counter a real-time loop has."""
    random, clocked, counted = (
        np.random.default_rng(4),
        robot.Impedance(motor_inertia=0.1),
        robot.Impedance(motor_inertia=0.1),
    )
    count, missing = 2**31 - 40, 0
    counted._counter = clocked._counter = count
    for k in range(300):
        left_out = 3 if k % 50 == 20 else 0
        count += 1 + left_out
        time = 1e-3 * (count + random.uniform(-0.2, 0.2))
        given = {"q": Q, "dq": np.zeros(7), "q0": Q + 0.1, **SPRING}
        if k % 50 == 30:
            clocked.missed()
            counted.missed()
            count += 1
            time += 1e-3
        a, b = clocked.step(time=1e6 + time, **given), counted.step(counter=count, **given)
        missing += bool(a.status & robot.Status.MISSED)
        assert bytes(a._rows) == bytes(b._rows)
    assert missing == 6
    plain = robot.Impedance()
    for time in (0.0, 0.0, -5.0, -4.999):  # a clock that stands still or goes back counts as one
        assert not plain.step(time=time, **given).status & (robot.Status.MISSED | robot.Status.BAD_SAMPLE)
    with pytest.raises(TypeError, match="either counter or time"):
        plain.step(time=0.0, counter=1, **given)
    with pytest.raises(ValueError, match="not finite"):
        plain.step(time=np.nan, **given)


@pytest.mark.parametrize(("noise", "bias"), [(0.01, 0.0), (0.001, 0.0), (0.0, 1e-4)])
def test_velocity_noise_at_rest_is_no_fault(robot: ModuleType, noise: float, bias: float) -> None:
    """q stands still and dq has noise or a bias [rad/s]. Before: frozen after 1.2 to 5 s."""
    controller, random = robot.Impedance(motor_inertia=0.1), np.random.default_rng(1)
    for _ in range(6):
        dq = bias + noise * random.normal(size=(5000, 7))
        assert not controller.run(q=Q, dq=dq, q0=Q, **SPRING).fault.any()


def test_rounded_commands_are_accepted(robot: ModuleType) -> None:
    """A turned stiffness in single precision and a pose of five digits are used, symmetric and orthonormal."""
    random = np.random.default_rng(2)
    for seed in range(5):
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0].astype(np.float32)
        Kt = (turn @ np.diag([900, 400, 0]).astype(np.float32) @ turn.T).astype(float)
        pose = robot.forward_kinematics(Q + 0.01 * random.normal(size=7))
        controller = robot.Impedance(motor_inertia=0.1, errors="ignore")
        command = {"translation_stiffness": Kt, "rotation_stiffness": KO, "posture": Q, "equilibrium": pose.round(5)}
        assert not controller.run(q=Q, dq=np.zeros((1500, 7)), **command).fault.any()
        out = controller.step(q=Q, dq=np.zeros(7), **command)
        assert not out.status & robot.Status.COMMAND_REFUSED, seed
        np.testing.assert_array_equal(out.translation_stiffness, out.translation_stiffness.T)
        np.testing.assert_allclose(out.equilibrium, pose, atol=2e-5)
        np.testing.assert_allclose(out.equilibrium[:3, :3].T @ out.equilibrium[:3, :3], np.eye(3), atol=1e-12)
        for name, wrong in (
            ("translation_stiffness", Kt + 0.1 * np.eye(3)[::-1] * [1, 0, 0]),
            ("equilibrium", 1.001 * pose),
        ):
            out = controller.step(q=Q, dq=np.zeros(7), **(command | {name: wrong}))
            assert out.status & robot.Status.COMMAND_REFUSED, name
