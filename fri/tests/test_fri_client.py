# SPDX-License-Identifier: MIT
"""The wiping client in process: torque, position, lost samples, hostile sessions."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from fri.robot.replay import replayed_torque
from fri.support.session import (
    POSTURE,
    TRAJECTORY,
    Programs,
    button,
    write_short_trajectory,
)
from fri.support.wiping import (
    COMMANDING_ACTIVE,
    COMMANDING_WAIT,
    IDLE,
    MONITORING_READY,
    MONITORING_WAIT,
    Wiped,
    assert_safe,
    minimum_jerk,
    moving,
    moving_script,
    position_mode,
)


def test_torque_is_that_of_the_controller_stepped_in_python_on_what_the_robot_said(
    programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Everything anew in Python; the torque from the logged rounding, which decides what the governor tries."""
    cycles = 1500  # the move, and half a second into the trajectory
    wiped = Wiped(programs, moving_script(programs, robot, cycles), tmp_path)
    trajectory = np.loadtxt(TRAJECTORY, delimiter=",").T
    controller = robot.Impedance(
        sample_time=0.005, delay_samples=0, motor_inertia=0.1, heaviest_wrench=[150.0, 20.0],
        tip_velocity_limit=[2.0, 6.0],
    )  # fmt: skip
    springs = {"translation_stiffness": np.diag([700.0, 700.0, 800.0]), "rotation_stiffness": 30.0 * np.eye(3)}
    springs |= {"posture_stiffness": 10.0, "shaped": True}
    worst, known = 0.0, [POSTURE, POSTURE]
    for k in range(cycles):
        q, wrench, torque = moving(robot, k * 0.005)
        velocity = (q - known[-2]) / 0.010  # over 8 ms at least
        known.append(q)
        J = robot.hybrid.jacobian(q)
        measured = np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), J @ torque)  # damped least squares, 0.01^2
        assert np.linalg.norm(measured - wrench) <= 0.02 * np.linalg.norm(wrench) + 1e-12  # the damping's share
        t = k * 0.005
        if t < 5.0:
            q0, _ = minimum_jerk(t, 5.0, moving(robot, 0.0)[0], trajectory[0])
        else:
            q0 = trajectory[round((t - 5.0) / 0.005)]
        for name, value in (("q", q), ("dq", velocity), ("q0", q0), ("wrench", measured)):
            np.testing.assert_allclose(wiped.log[name][k], value, rtol=0, atol=1e-9)
        out = controller.step(q=q, dq=wiped.log["dq"][k], q0=wiped.log["q0"][k], counter=k, **springs)
        command = wiped.commands[9 + k]
        assert command is not None
        worst = np.maximum(worst, np.abs(command.torque - out.torque).max())  # max() would lose a NaN
    assert worst <= 1e-9
    assert wiped.summary["controller"]["heaviest_wrench"] == [150.0, 20.0]
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])
    assert wiped.summary["cycles"] == cycles + 9 and wiped.summary["commanding_cycles"] == cycles
    assert not {k: v for k, v in wiped.faults.items() if v and k not in ("saturated", "rate_limited", "late_answers")}


def test_position_follows_the_measured_one_without_a_transient(
    programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Compare the commanded position with the measured one through a low-pass filter of 8 ms, in closed form."""
    wiped = Wiped(programs, moving_script(programs, robot, 400), tmp_path)
    y = x = POSTURE
    for command in wiped.commands[6:9]:  # waiting: the interpolator's position, and torque
        assert command is not None and np.array_equal(command.position, POSTURE) and not command.torque.any()
    decay, mean = np.exp(-0.005 / 0.008), 0.008 / 0.005 * (1 - np.exp(-0.005 / 0.008))
    for k in range(400):
        q, _, _ = moving(robot, k * 0.005)
        y, x = decay * y + (mean - decay) * x + (1 - mean) * q, q  # exact for an input that is straight in between
        command = wiped.commands[9 + k]
        assert command is not None
        np.testing.assert_allclose(command.position, y, rtol=0, atol=1e-12)


@pytest.mark.parametrize("period", [1, 5, 10])
def test_position_lags_by_8_ms_at_every_period_and_after_a_gap(period: int, one: Programs, tmp_path: Path) -> None:
    """A7 at its full speed, and 40 messages lost on the way."""
    speed, lag = 2.356, 0.008
    script = one.script(period)
    script.begin()
    sent = []
    for k in range(1000 // period):
        if k == 600 // period:
            script.lose(40)
        time = (script.sequence + 1 - 10) * period / 1000
        sent.append(POSTURE + np.array([0, 0, 0, 0, 0, 0, -speed * time]))
        script.add(COMMANDING_ACTIVE, position=sent[-1])
    wiped = Wiped(one, script, tmp_path, "--speed-share", "1")
    off = np.array([c.position - q for c, q in zip(wiped.commands[9:], sent, strict=True) if c is not None])
    settled = 100 // period
    np.testing.assert_allclose(off[settled:, 6], speed * lag, rtol=1e-5)  # the gap's end among them
    assert np.abs(off[:, 6]).max() + speed * period / 1000 < np.radians(3)


@pytest.mark.parametrize("law", ["paper", "conventional"])
def test_the_papers_law_is_the_controllers_offset(
    law: str, open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    wiped = Wiped(open_programs, moving_script(open_programs, robot, 100), tmp_path, "--law", law)
    assert np.abs(wiped.log["torque"]).max() > 1.0
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])


def test_friction_is_fed_forward(open_programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """The controller has the stated friction, and its torque is another one than without."""
    wiped = Wiped(open_programs, moving_script(open_programs, robot, 300), tmp_path, "--friction", "3,3,2,2,1,1,0.5")
    assert wiped.summary["controller"]["coulomb_friction"] == [3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 0.5]
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])
    wiped.log.summary["controller"]["coulomb_friction"] = 0.0
    assert np.abs(replayed_torque(robot, wiped.log) - wiped.log["torque"]).max() > 0.5


def test_the_counter_tells_of_lost_messages(programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """Lose 2 of 100 messages: the client counts them, keeps the time of samples, and dq is the mean over the gap."""
    script = moving_script(programs, robot, 100)
    del script.datagrams[40:42]  # 9 messages before the first sample: samples 31 and 32 are lost
    wiped = Wiped(programs, script, tmp_path)
    assert wiped.faults["lost_cycles"] == 2 and wiped.faults["controller_faults"] == 0
    assert wiped.log["sample_valid"].all() and len(wiped.log) == 98
    steps = np.where(np.arange(97) == 30, 3, 1)  # the gap of three periods follows sample 30
    np.testing.assert_array_equal(np.diff(wiped.log["counter"]), steps)
    np.testing.assert_allclose(np.diff(wiped.log["time"]), 0.005 * steps, atol=1e-9)
    mean = (moving(robot, 33 * 0.005)[0] - moving(robot, 30 * 0.005)[0]) / 0.015  # three periods of 5 ms
    np.testing.assert_allclose(wiped.log["dq"][31], mean, atol=1e-12)
    assert_safe(wiped, robot)


def test_silence_leads_to_the_fallback_and_back(programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """Lose 40 messages (200 ms): the controller reports a fault, and then starts again from the measured position."""
    script = moving_script(programs, robot, 400)
    del script.datagrams[109:149]  # 200 ms in the middle
    wiped = Wiped(programs, script, tmp_path)
    assert wiped.faults["lost_cycles"] == wiped.faults["lost_cycles_commanding"] == 40
    assert wiped.faults["controller_faults"] == 1
    status = wiped.log["status"].astype(int)
    assert status[100] & robot.Status.FAULT and not status[-1] & robot.Status.FAULT
    assert wiped.log["reset"].sum() == 1
    reset = np.flatnonzero(wiped.log["reset"])[0]
    np.testing.assert_array_equal(wiped.log["q0"][reset], wiped.log["q"][reset])  # from where it is
    assert_safe(wiped, robot)
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])


def test_a_fault_is_reset_after_good_samples_and_not_after_gaps(
    one: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Give 0.2 s of samples after a silence, with gaps: the fault is reset by those that came, lost ones do not
    count.
    """
    script = moving_script(one, robot, 600)
    kept = [k < 100 or (k >= 140 and (k % 20 == 0 or k >= 400)) for k in range(600)]  # silence, then one in twenty
    script.datagrams[9:] = [d for d, keep in zip(script.datagrams[9:], kept, strict=True) if keep]
    wiped = Wiped(one, script, tmp_path)
    reset = np.flatnonzero(wiped.log["reset"])
    valid = np.cumsum(wiped.log["sample_valid"])
    assert len(reset) == 1
    # good samples until then: 100 before the silence, 14 between gaps, and 40 in 0.2 s
    assert valid[reset[0]] == 100 + 14 + 40
    assert wiped.faults["controller_faults"] == 1


def test_hostile_session_never_makes_an_unsafe_torque(
    open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Losses, duplicates, garbage, missing fields, wild values, state drops; each fault of a kind is counted."""
    rng = np.random.default_rng(8)
    script = open_programs.script()
    script.begin()
    wild = [np.nan, np.inf, -np.inf, 1e308, -1e6, 5e-324]
    missing = ("measuredJointPosition", "externalTorque", "timestamp")
    put = dict.fromkeys(("lose", "garbage", "duplicate", "missing", "wild", "mode"), 0)
    for k in range(3000):
        q, _, torque = moving(robot, k * 0.005)
        if k % 1000 == 999:  # the motion is broken off and started again
            script.begin(3, 10)
        kind = rng.choice([*put, "sound"], p=[0.02] * len(put) + [1 - 0.02 * len(put)])
        if kind == "lose":
            script.lose(int(rng.integers(1, 50)))
        elif kind == "garbage":
            script.datagrams.append(rng.bytes(int(rng.integers(1, 1500))))
        elif kind == "duplicate":
            script.datagrams.append(script.datagrams[-1])
        elif kind == "missing":
            field = missing[int(rng.integers(3))]
            script.add(COMMANDING_ACTIVE, change=lambda m, f=field: m.monitorData.ClearField(f), position=q,
                       external_torque=torque)  # fmt: skip
        elif kind == "wild":
            q, torque = q.copy(), torque.copy()
            # A position within the limits that jumps is not believed for good: no part of this session.
            array, values = (q, wild[:-1]) if rng.integers(2) else (torque, wild)
            array[int(rng.integers(7))] = values[int(rng.integers(len(values)))]
            script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
        elif kind == "mode":
            script.add(COMMANDING_ACTIVE, change=position_mode, position=q, external_torque=torque)
        else:
            script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
        put[str(kind)] = put.get(str(kind), 0) + 1
    wiped = Wiped(open_programs, script, tmp_path)
    assert all(step["step"] for step in wiped.steps)
    assert_safe(wiped, robot)
    assert wiped.faults["bad_datagrams"] == put["garbage"] + put["duplicate"]
    assert wiped.faults["no_torque_mode"] == put["mode"]
    assert wiped.faults["state_drops"] == 3
    assert not (wiped.log["events"].astype(int) & 1 << 17).any()  # never let go: hostile to the end
    assert wiped.faults["controller_faults"] > 10
    np.testing.assert_array_equal(replayed_torque(robot, wiped.log), wiped.log["torque"])


@pytest.mark.parametrize("field", ["measuredJointPosition", "externalTorque", "timestamp"])
def test_missing_field_is_counted_and_holds_the_torque(
    field: str, open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Leave a field out of sample 60: the torque is held for one sample, or the time is taken from the counter."""
    script = open_programs.script()
    script.begin()
    for k in range(100):
        q, _, torque = moving(robot, k * 0.005)
        change = (lambda m: m.monitorData.ClearField(field)) if k == 60 else None
        script.add(COMMANDING_ACTIVE, change=change, position=q, external_torque=torque)
    wiped = Wiped(open_programs, script, tmp_path)
    before, at = wiped.commands[68], wiped.commands[69]  # samples 59 and 60, after 9 messages without commands
    assert before is not None and at is not None
    if field == "timestamp":
        assert wiped.faults["bad_timestamps"] == 1 and wiped.log["sample_valid"].all()
    else:
        assert wiped.faults["missing_fields"] == 1
        assert np.array_equal(before.torque, at.torque)
        assert list(np.flatnonzero(wiped.log["sample_valid"] == 0)) == [60]
    assert wiped.faults["lost_cycles"] == wiped.faults["controller_faults"] == 0


@pytest.mark.parametrize("value", [1e308, -4.0])
def test_wild_position_does_not_stay_in_the_filters(
    value: float, open_programs: Programs, robot: ModuleType, tmp_path: Path
) -> None:
    """Send one wild position [rad] of joint 3 in sample 60: later commands and velocities are those without it."""
    script = open_programs.script()
    script.begin()
    for k in range(100):
        q, _, torque = moving(robot, k * 0.005)
        if k == 60:
            q = q + value * np.eye(7)[2]
        script.add(COMMANDING_ACTIVE, position=q, external_torque=torque)
    wiped = Wiped(open_programs, script, tmp_path)
    assert wiped.faults["implausible_positions"] == 1 and wiped.faults["controller_faults"] == 0
    for k in range(60, 100):
        command = wiped.commands[9 + k]
        assert command is not None
        np.testing.assert_allclose(command.position, moving(robot, k * 0.005)[0], atol=0.02)
    assert np.abs(wiped.log["dq"][61:]).max() < 1.0  # [rad/s] the true motion is slower
    assert_safe(wiped, robot)


def test_button_holds_the_trajectory_and_need_not_exist(programs: Programs, tmp_path: Path) -> None:
    """Press the button during samples 200 to 399 (1 s): the reference comes to rest, and moves again after the
    release.
    """
    script = programs.script()
    for state in (MONITORING_READY, COMMANDING_WAIT):
        script.add(state, 3, ios=[button(False)])
    for k in range(600):  # at rest, but for the noise of encoders
        script.add(COMMANDING_ACTIVE, ios=[button(200 <= k < 400)], position=POSTURE + 1e-5 * (k % 3))
    wiped = Wiped(programs, script, tmp_path)
    q0 = wiped.log["q0"]
    assert np.ptp(q0[260:400], axis=0).max() == 0.0
    assert np.abs(np.diff(q0, 2, axis=0)).max() < 0.01 * 0.005  # comes to a stand and goes on smoothly
    assert np.abs(q0[599] - q0[400]).max() > 0.01  # [rad] the trajectory continues
    assert (wiped.log["events"][200:400].astype(int) & 1 << 8).all()  # bit 8: the button is pressed
    assert wiped.faults["missing_fields"] == wiped.faults["exceptions"] == 0


def test_external_torque_of_the_other_sign(open_programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    script = moving_script(open_programs, robot, 60)
    plain = Wiped(open_programs, script, tmp_path)
    turned = Wiped(open_programs, script, tmp_path, "--external-torque-sign", "-1")
    assert np.abs(plain.log["wrench"]).max() > 1.0
    np.testing.assert_array_equal(plain.log["wrench"], -turned.log["wrench"])


def test_dry_run_sends_zero(open_programs: Programs, robot: ModuleType, tmp_path: Path) -> None:
    wiped = Wiped(open_programs, moving_script(open_programs, robot, 60), tmp_path, "--dry-run")
    assert np.abs(wiped.log["torque"]).max() > 0.5
    assert all(not command.torque.any() for command in wiped.commands[9:] if command is not None)


def test_an_arm_led_by_hand_in_a_dry_run_is_not_let_go(one: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """Lead the arm to ten poses far from the trajectory, as a calibration asks for: the log has each at rest."""
    rng, script = np.random.default_rng(4), one.script()
    script.begin()
    poses = [POSTURE, *(POSTURE + rng.uniform(-0.5, 0.5, (10, 7)) * [0.5, 0.5, 0.5, 0.5, 1, 1, 1])]
    for before, pose in pairwise(poses):
        for k in range(400):  # a second there, a second of rest
            place = minimum_jerk(0.005 * k, 1.0, before, pose)[0]
            script.add(COMMANDING_ACTIVE, position=place + 1e-5 * np.cos(k * np.arange(1, 8)))
    # A limit of 0 is none: the hand moves the arm away from the trajectory.
    limits = [f"--{name}-limit" for name in ("error", "lag", "energy")]
    options = [word for name in limits for word in (name, "0")]
    wiped = Wiped(one, script, tmp_path, "--effort-share", "0.25", "--force-limit", "150", *options, "--dry-run")
    assert len(wiped.log) == 4000 and wiped.log["sample_valid"].all()
    # Bit 17: the client let go.
    assert not (wiped.log["events"].astype(int) & 1 << 17).any() and wiped.faults["controller_faults"] == 0
    assert not any(command.torque.any() for command in wiped.commands[9:] if command and command.torque is not None)
    for k, pose in enumerate(poses[1:]):
        np.testing.assert_allclose(wiped.log["q"][400 * k + 200 : 400 * k + 400], np.tile(pose, (200, 1)), atol=1e-4)


def test_quality_drop_is_counted(open_programs: Programs, tmp_path: Path) -> None:
    """Let the quality fall once: one drop is counted, and its event (bit 3) stands in one row of the log."""
    script = open_programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 5)
    script.add(COMMANDING_ACTIVE, 5, quality=1)
    wiped = Wiped(open_programs, script, tmp_path)
    assert wiped.faults["quality_drops"] == 1
    assert wiped.log["events"].astype(int).tolist() == 5 * [0] + [1 << 3] + 4 * [0]


def test_clock_that_was_set_costs_no_cycles(open_programs: Programs, tmp_path: Path) -> None:
    """Set the robot's clock an hour ahead, then two back: both stamps count as bad, and the sample time stays 5 ms."""
    script = open_programs.script()
    script.begin()
    script.add(COMMANDING_ACTIVE, 5)
    script.clock += 3600 * 10**9  # [ns]
    script.add(COMMANDING_ACTIVE, 5)
    script.clock -= 7200 * 10**9
    script.add(COMMANDING_ACTIVE, 5)
    wiped = Wiped(open_programs, script, tmp_path)
    assert wiped.faults["lost_cycles"] == 0 and wiped.faults["bad_timestamps"] == 2
    assert wiped.log["sample_valid"].all()
    np.testing.assert_allclose(np.diff(wiped.log["time"]), 0.005, atol=1e-9)


def test_trajectory_with_a_column_a_joint_is_the_same(one: Programs, robot: ModuleType, tmp_path: Path) -> None:
    turned = tmp_path / "columns.csv"
    np.savetxt(turned, np.loadtxt(TRAJECTORY, delimiter=",", dtype=object).T, delimiter=",", fmt="%s")
    script = moving_script(one, robot, 50)
    rows = Wiped(one, script, tmp_path)
    columns = Wiped(one, script, tmp_path, "--trajectory", str(turned))
    np.testing.assert_array_equal(rows.log["torque"], columns.log["torque"])


def test_after_the_trajectory_a_long_way_back_is_not_gone(one: Programs, tmp_path: Path) -> None:
    """Move the arm away between two motions: the client does not go back the long way by itself."""
    short = write_short_trajectory(tmp_path / "short.csv")
    end = np.loadtxt(short, delimiter=",")[-1]
    script = one.script()
    script.begin()
    for k in range(300):
        s = min(max(k - 20, 0) / 200, 1.0)
        place = 10 * s**3 - 15 * s**4 + 6 * s**5
        script.add(COMMANDING_ACTIVE, position=POSTURE + place * (end - POSTURE))
    away = end + 1.0 * np.eye(7)[0]
    script.add(MONITORING_READY, 50, position=away)
    script.add(COMMANDING_WAIT, 10, position=away, ipo=away)
    wiped = Wiped(one, script, tmp_path, "--trajectory", str(short), "--approach", "0.1", "--speed-share", "1")
    assert wiped.summary["trajectory_done"]
    assert len(wiped.steps) == 9 + 300 + 50 + 1  # refused at once


@pytest.mark.slow
def test_sanitizers_find_nothing_in_a_hostile_session(sanitized: Programs, robot: ModuleType, tmp_path: Path) -> None:
    """Send garbage and missing fields to a client with sanitizers, which end it at the first undefined access."""
    script = moving_script(sanitized, robot, 200)
    script.datagrams += [b"", b"\xff" * 1600, *[os.urandom(200) for _ in range(20)]]
    script.add(COMMANDING_ACTIVE, 5, change=lambda m: m.ClearField("monitorData"))
    script.add(MONITORING_WAIT, 5)
    script.begin()
    script.add(COMMANDING_ACTIVE, 50)
    script.add(IDLE)
    wiped = Wiped(sanitized, script, tmp_path)
    assert_safe(wiped, robot)
