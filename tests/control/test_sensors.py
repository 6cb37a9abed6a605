# SPDX-License-Identifier: MIT
"""Sensors as they are: lost samples, slow states, noise, bumps; and faults that say what they saw."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.control.status_words import REASONS, SEEN
from support.controller_inputs import SPRING, Arm, Q
from support.project import ROOT


def closed_loop(robot: ModuleType, steps: int, lost: Any, **config: Any) -> tuple[Arm, Any]:
    """Move by 0.4 rad in a second and back, with samples lost."""
    controller, arm = robot.Impedance(motor_inertia=0.1, **config), Arm(robot, Q)
    for k in range(steps):
        goal = Q + 0.2 - 0.2 * np.cos(np.pi * min(k, 2000) * 1e-3)
        out = controller.missed() if lost(k) else controller.step(q=arm.q, dq=arm.dq, q0=goal, **SPRING)
        arm.step(out.torque)
        if out.fault:
            break
    return arm, out


@pytest.mark.parametrize("share", [0.01, 0.02, 0.05])
def test_random_loss_is_no_fault(robot: ModuleType, share: float) -> None:
    """Three samples in a row were a fault before: at 5 % every 7 s. A million samples, no arm needed."""
    random = np.random.default_rng(int(1000 * share))
    controller = robot.Impedance(motor_inertia=0.1)
    for _ in range(10):
        out = controller.run(
            q=Q, dq=np.zeros(7), q0=Q, sample_valid=(random.random(20000) > share).astype(int), **SPRING
        )
        assert not out.fault.any(), out.text
    arm, out = closed_loop(robot, 4000, lambda k: random.random() < share)
    assert not out.fault, out.text
    np.testing.assert_allclose(arm.q, Q, atol=0.02)


def test_the_torque_falls_while_samples_are_missing(robot: ModuleType) -> None:
    """It is held for missed_limit calls, falls from then on, and is a fault after loss_limit."""
    controller = robot.Impedance(motor_inertia=0.1, energy_limit=20.0, frozen_window=1000000)
    for _ in range(2000):
        out = controller.step(q=Q, dq=np.zeros(7), q0=Q + 0.05, **SPRING)
    sizes, faults = [np.abs(out.torque).max()], []
    for _ in range(10):
        out = controller.missed()
        sizes.append(np.abs(out.torque).max())
        faults.append(bool(out.fault))
    assert sizes[0] > 5
    assert sizes[1] == sizes[2] == sizes[0] > sizes[3] > sizes[4] > sizes[8]
    assert faults == [False] * 9 + [True]
    assert out.reason == robot.Reason.MISSED


@pytest.mark.parametrize("speed", [0.4, 0.8])
def test_state_of_500_hz(robot: ModuleType, speed: float) -> None:
    """Each state is seen twice. Undeclared, that is a MISMATCH from half the velocity limit on."""
    velocity = speed * robot.VELOCITY
    # 0.3 of this velocity is reached within 0.2 s: no fault, and declared repeats are told
    for period in (0.0, 0.002):
        controller = robot.Impedance(motor_inertia=0.1, state_period=period, reference_velocity_limit=robot.VELOCITY)
        outs = []
        for k in range(400):
            t = 1e-3 * (k - k % 2)
            rise = min(t / 0.2, 1.0)
            way = 0.5 * t * rise if t < 0.2 else t - 0.1
            outs.append(controller.step(q=Q + way * velocity * 0.3, dq=rise * velocity * 0.3, q0=Q, **SPRING))
            if outs[-1].fault:
                break
        assert not outs[-1].fault, outs[-1].text
        repeated = [bool(out.status & robot.Status.REPEATED) for out in outs[2:]]
        assert repeated == [period > 0.0 and k % 2 == 1 for k in range(2, 400)]
    reasons = {}
    for period in (0.0, 0.002):  # all of the velocity, from the first sample on
        controller = robot.Impedance(motor_inertia=0.1, state_period=period)
        for k in range(300):
            way = velocity * 1e-3 * (k - k % 2)
            out = controller.step(q=Q - 0.2 * np.sign(velocity) + way, dq=velocity, q0=Q, **SPRING)
        reasons[period] = out.reason
    assert reasons[0.002] == robot.Reason.NONE
    assert reasons[0.0] == (robot.Reason.MISMATCH if speed > 0.5 else robot.Reason.NONE)


def test_state_period_is_bounded(robot: ModuleType) -> None:
    with pytest.raises(ValueError, match="state_period: must not be above missed_limit"):
        robot.Impedance(state_period=0.004)


def test_a_state_that_no_longer_comes_is_found(robot: ModuleType) -> None:
    """At rest a repeated state is a new one after state_period, so that standing still is no loss."""
    controller = robot.Impedance(motor_inertia=0.1, state_period=0.002)
    assert not controller.run(q=Q, dq=np.zeros((3000, 7)), q0=Q, **SPRING).fault.any()


def test_noise_of_a_kinova(robot: ModuleType) -> None:
    """Quantum 1e-4 rad and noise 0.02 rad/s, at rest and creeping: before, FROZEN within 0.7 s."""
    random = np.random.default_rng(0)
    for speed in (0.0, 0.003):
        q = (1e-4 * np.round((Q + speed * 1e-3 * np.arange(40000)[:, None]) / 1e-4)).clip(-2, 2)
        dq = speed + 0.02 * random.normal(size=q.shape)
        controller = robot.Impedance(motor_inertia=0.1, position_quantum=1e-4, velocity_noise=0.02)
        assert not controller.run(q=q, dq=dq, q0=Q, **SPRING).fault.any()


def slow_motion(robot: ModuleType, quantum: float, steps: int, **config: Any) -> tuple[Any, Any]:
    """Follow a slow motion by an encoder with steps of 1e-4 rad; quantum is what the controller is told of them."""
    controller, outs, before = robot.Impedance(motor_inertia=0.1, position_quantum=quantum, **config), [], None
    for k in range(steps):
        q = 1e-4 * np.round((Q + 0.02 * 1e-3 * k) / 1e-4)
        before = q if before is None else before
        outs.append(controller.step(q=q, dq=(q - before) / 1e-3, q0=Q, **SPRING))
        before = q
    return controller, outs


def test_the_length_of_the_velocitys_mean_is_an_output(robot: ModuleType) -> None:
    """It rises to what the rate limit needs if the encoder's step is stated, and stays 1 if it is not."""
    config = {"velocity_source": "differenced", "velocity_noise": 0.1, "torque_rate_limit": 200.0}
    for quantum, longest in ((0.0, 1), (1e-6, 1), (1e-4, 8)):
        _, outs = slow_motion(robot, quantum, 300, **config)
        assert not outs[-1].fault, outs[-1].text
        counts = [int(out.velocity_samples) for out in outs]
        assert counts[0] == 1 and max(counts) == longest, counts
        assert max(abs(np.diff(counts))) <= 1
    positions = np.array([out.position for out in outs])
    for k in (50, 299):  # velocity is the mean of so many differences
        mean = (positions[k] - positions[k - counts[k]]) / (1e-3 * counts[k])
        np.testing.assert_allclose(outs[k].velocity, mean, atol=1e-12)


def test_the_mean_goes_on_in_a_fault_and_starts_anew_after_a_gap(robot: ModuleType) -> None:
    """In a fault that lasts the damping still acts, on the same mean; a call without a sample has none."""
    config = {"velocity_source": "differenced", "velocity_noise": 0.1, "torque_rate_limit": 200.0}
    controller, outs = slow_motion(robot, 1e-4, 300, **config)
    last = 1e-4 * np.round((Q + 0.02 * 0.299) / 1e-4)
    for k in range(int(controller.config.loss_limit) + 2):
        out = controller.missed()
        assert out.velocity_samples == 0, k
    assert out.fault == robot.Fault.COMMUNICATION
    after = [controller.step(q=last, dq=np.zeros(7), q0=Q, **SPRING) for _ in range(400)]
    assert {out.fault for out in after} == {robot.Fault.COMMUNICATION}
    counts = [int(out.velocity_samples) for out in after]
    assert outs[-1].velocity_samples == 8
    assert counts == [1, 2, 3, 4, 5, 6, 7, *[8] * 393]


def test_a_bump_beyond_the_speed_limit(robot: ModuleType) -> None:
    """A joint is beyond its limit for 0.15 s: braked, no fault; for longer it is one, with its numbers."""
    for length, reason in ((150, robot.Reason.NONE), (400, robot.Reason.OVERSPEED)):
        controller, q = robot.Impedance(motor_inertia=0.1), Q.copy()
        for k in range(600):
            share = np.clip(min(k - 50, 50 + length - k) / 20, 0, 1)  # up within 20 ms, and down at the end
            dq = 1.2 * share * robot.VELOCITY * np.eye(7)[4]
            q = q + 1e-3 * dq
            out = controller.step(q=q, dq=dq, q0=Q, **SPRING)
            if out.fault:
                break
        assert out.reason == reason, out.text
    assert out.fault_joint == 4
    assert out.fault_seen == pytest.approx(1.2 * robot.VELOCITY[4])
    assert out.fault_limit == pytest.approx(robot.VELOCITY[4])


def test_faults_say_what_they_saw(robot: ModuleType) -> None:
    """Joint, meaning, numbers and the fields that change the limit, in one text, in C and in Python."""
    controller = robot.Impedance(motor_inertia=0.1)
    for k in range(400):
        q = Q + 0.3e-3 * k
        out = controller.step(
            q=q, dq=np.full(7, 0.3) * (k < 100) * (np.arange(7) == 3) + 0.3 * (np.arange(7) != 3), q0=Q, **SPRING
        )
        if out.fault:
            break
    assert out.reason == robot.Reason.FROZEN
    assert out.fault_joint == 3
    assert out.fault_seen > out.fault_limit > 0
    text = out.text
    numbers = f"{out.fault_seen:.6f}".rstrip("0"), f"limit {out.fault_limit:.6f}".rstrip("0")
    fields = "velocity_noise, position_quantum, frozen_window"
    for words in (robot.JOINTS[3], fields, *numbers, "a fault is latched", "mode RELEASE"):
        assert words in text, text
    controller.reset()
    for _ in range(50):
        out = controller.step(q=q, dq=np.zeros(7), q0=Q, **SPRING)
    assert (out.fault_joint, out.fault_seen, out.fault_limit) == (-1, 0.0, 0.0)
    assert "fault" not in out.text


def test_reasons_with_numbers_name_fields() -> None:
    reasons = {name: meaning for name, _, meaning in REASONS}
    assert set(SEEN) <= set(reasons)
    assert all("(" in reasons[name] or name == "stale" for name in SEEN)


def test_sensors_are_estimated_at_a_standstill(tmp_path: Path) -> None:
    """Quantum, noise, resolution and period of the state come back; motion is refused; the example prints them."""
    random = np.random.default_rng(4)
    q = 1e-4 * np.round((Q + 1e-4 * random.random((3000, 7))) / 1e-4)
    dq = 0.02 * random.normal(size=q.shape)
    found = stiffgen.estimate_sensors(q, dq, 1e-3)
    assert found.position_quantum == pytest.approx(1e-4)
    assert found.velocity_noise == pytest.approx(0.02, rel=0.1)
    assert found.state_period == 0.0
    coarse = stiffgen.estimate_sensors(q, 0.01 * np.round(0.004 * random.normal(size=q.shape) / 0.01), 1e-3)
    assert coarse.velocity_noise == pytest.approx(0.01)
    slow = stiffgen.estimate_sensors(np.repeat(q, 2, axis=0), np.repeat(dq, 2, axis=0), 1e-3)
    assert slow.state_period == pytest.approx(2e-3)
    with pytest.raises(stiffgen.RecordingError, match=r"joint 3 moves by 0\.3 rad"):
        stiffgen.estimate_sensors(q + np.linspace(0, 0.3, 3000)[:, None] * np.eye(7)[3], dq, 1e-3)
    log = tmp_path / "log.csv"
    names = ",".join([*(f"q_{i}" for i in range(7)), *(f"dq_{i}" for i in range(7))])
    np.savetxt(log, np.hstack([q, dq]), delimiter=",", header=names, comments="")
    command = [sys.executable, str(ROOT / "examples" / "sensors.py"), str(log)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "position_quantum=0.0001," in said
    assert "velocity_noise=0.02" in said
