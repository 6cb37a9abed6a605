# SPDX-License-Identifier: MIT
"""Motors with a controller inside: the split of a torque into gains, and the work that their own loops do."""

from __future__ import annotations

import itertools
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stiffgen.control.sessions.check import joint_hessian, modal_damping
from support.controller_inputs import KO, KT, SPRING, Q, walk
from support.pinocchio_oracle import PinocchioChain
from support.project import ROOT

LOOSE = {"kp_limit": 1e6, "kd_limit": 1e5, "motor_inertia": 0.1}
SPEED = np.array([1.5, 1.5, 1.7, 1.3, 2.3, 2.3, 2.3])


def applied(command: Any, q: np.ndarray, dq: np.ndarray, q_des: Any, dq_des: Any = 0.0) -> np.ndarray:
    """Return the torque of the motors."""
    return np.asarray(command.tau_ff + command.kp * (q_des - q) + command.kd * (dq_des - dq))


def states(seed: int, count: int) -> Any:
    random = np.random.default_rng(seed)
    for _ in range(count):
        A, B = random.normal(size=(2, 7, 7))
        yield {
            **{name: random.normal(size=7) for name in ("q", "dq", "q_des", "dq_des")},
            "torque": 30 * random.normal(size=7),
            "joint_stiffness": 300 * (A + A.T),
            "damping": 5 * B @ B.T,
            "kp_limit": 10 ** random.uniform(0, 3, 7),
            "kd_limit": 10 ** random.uniform(-2, 2, 7),
        }


def test_the_split_is_exact_and_within_bounds(robot: ModuleType) -> None:
    bounded = set()
    for state in states(1, 50):
        gains = robot.joint_gains(**state)
        torque = applied(gains, state["q"], state["dq"], state["q_des"], state["dq_des"])
        np.testing.assert_allclose(torque, state["torque"], rtol=0, atol=1e-12 * max(1, np.abs(gains.tau_ff).max()))
        for gain, matrix, limit in (
            (gains.kp, state["joint_stiffness"], state["kp_limit"]),
            (gains.kd, state["damping"], state["kd_limit"]),
        ):
            assert np.all(gain >= 0)
            assert np.all(gain <= limit)
            # no other diagonal within the bounds is nearer
            for other in (gain - 1e-3 * limit, gain + 1e-3 * limit):
                allowed = (other >= 0) & (other <= limit)
                nearer = np.abs(np.diag(matrix) - other) < np.abs(np.diag(matrix) - gain)
                assert not np.any(nearer & allowed)
            bounded |= {*np.where(gain == 0, "zero", np.where(gain == limit, "limit", "inside"))}
    assert bounded == {"zero", "limit", "inside"}


@pytest.mark.parametrize("name", ["q", "dq", "q_des", "dq_des", "torque", "joint_stiffness", "damping", "kp_limit"])
def test_no_gains_from_bad_numbers(robot: ModuleType, name: str) -> None:
    for bad in (np.nan, np.inf, -np.inf) if name != "kp_limit" else (np.nan, -1.0):
        state = next(states(2, 1))
        state[name].flat[3] = bad
        with pytest.raises(ValueError, match="joint_gains"):
            robot.joint_gains(**state)


def outputs(robot: ModuleType, **config: Any) -> tuple[Any, dict[str, np.ndarray]]:
    inputs = walk(np.random.default_rng(3), robot, 300)
    return robot.Impedance(**config).run(**inputs), inputs


def test_the_motors_apply_the_torque_of_the_springs(robot: ModuleType) -> None:
    """At the sample the motors' torque is that of torque mode, as long as no limit acts, and the status is the same."""
    limits = {"torque_rate_limit": 1e6, "tank_initial": 100.0, "effort_limit": 1e3}
    plain, inputs = outputs(robot, motor_inertia=0.1, **limits)
    motors, _ = outputs(robot, actuation="gains", **LOOSE, **limits)
    scale = np.abs(plain.torque).max()
    assert scale > 5
    np.testing.assert_allclose(motors.torque, plain.torque, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(applied(motors, inputs["q"], inputs["dq"], motors.q_des), plain.torque, atol=1e-11)
    np.testing.assert_array_equal(motors.status, plain.status)
    np.testing.assert_array_equal(plain.tau_ff, plain.torque)
    assert not np.any(plain.kp)
    assert not np.any(plain.kd)


def test_the_motors_render_the_diagonal_of_stiffness_and_damping(robot: ModuleType) -> None:
    """Stiffness against differences of the springs' energy along Pinocchio's poses, damping against a bisection."""
    arm = PinocchioChain((ROOT / "urdf" / "iiwa14.urdf").read_bytes(), "link_ee")
    config = {"actuation": "gains", "posture_stiffness": 3.0, "limit_stiffness": 0.0, **LOOSE}
    controller = robot.Impedance(**config)
    for k in range(400):
        phase = 2e-3 * k + np.arange(7)
        q = Q + 0.05 * np.sin(phase)
        out = controller.step(q=q, dq=0.1 * np.cos(phase), q0=Q + 0.1, **SPRING)
    assert out.fault == 0
    spring = (out.equilibrium, out.reference, out.translation_stiffness, out.rotation_stiffness, np.full(7, 3.0))
    np.testing.assert_allclose(out.translation_stiffness, KT, atol=1e-3)
    np.testing.assert_allclose(out.rotation_stiffness, KO, atol=1e-3)
    K = joint_hessian(lambda at: arm.at(at).pose, q, *spring)
    h = 1e-4
    slope = [-(applied(out, q + step, 0 * q, out.q_des) - applied(out, q - step, 0 * q, out.q_des)) / (2 * h)
             for step in h * np.eye(7)]  # fmt: skip
    np.testing.assert_allclose(slope, np.diag(np.diag(K)), atol=1e-6 * np.abs(K).max())
    M = arm.at(q).mass_matrix + 0.1 * np.eye(7)
    B = modal_damping(K, M, 0.7, 0.5e-3, 0.25e3, 0.1)
    np.testing.assert_allclose(out.kd, np.diag(B), rtol=1e-6)


def test_gains_stay_within_the_bounds_of_the_motors(robot: ModuleType) -> None:
    out, _ = outputs(robot, actuation="gains", kp_limit=60.0, kd_limit=1.0, motor_inertia=0.1)
    for gain, limit in ((out.kp, 60.0), (out.kd, 1.0)):
        assert np.all((gain >= 0) & (gain <= limit))
        assert np.any(gain == limit)


@pytest.mark.parametrize("fields", [{"delay_samples": 1}, {"delay_samples": 5}])
def test_gains_are_refused_where_their_account_does_not_hold(robot: ModuleType, fields: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="actuation"):
        robot.Impedance(actuation="gains", motor_inertia=0.1, stiffness_cap="accept", **fields)


def test_a_late_host_leaves_springs_that_fade(robot: ModuleType) -> None:
    controller = robot.Impedance(actuation="gains", missed_limit=3, **LOOSE)
    for _ in range(300):
        out = controller.step(q=Q + 0.01, dq=0 * Q, q0=Q, **SPRING)
    held = [controller.missed() for _ in range(60)]
    for later in held[: out.hold - 1]:
        np.testing.assert_array_equal(later.kp, out.kp)
        np.testing.assert_array_equal(later.tau_ff, out.tau_ff)
    for before, after in itertools.pairwise(held):
        assert np.all(after.kp <= before.kp)
        np.testing.assert_array_equal(after.q_des, Q + 0.01)
        np.testing.assert_array_equal(after.kd, out.kd)
    assert np.all(held[-1].kp < 0.01 * out.kp)
    np.testing.assert_allclose(held[-1].tau_ff, 0, atol=1e-12)


def motion_work(command: dict[str, Any], speeds: np.ndarray, time: float) -> float:
    """Return the work of motors along a motion with constant speeds, one row per interval of equal length, exactly."""
    step, q, work = time / len(speeds), command["q"].copy(), 0.0
    for v in speeds:
        middle = q + step * v / 2  # the torque is linear in time
        torque = command["tau_ff"] + command["kp"] * (command["q_des"] - middle)
        work += step * float((torque + command["kd"] * (command["dq_des"] - v)) @ v)
        q = q + step * v
    return work


def commands(seed: int) -> tuple[dict[str, Any], float]:
    random = np.random.default_rng(seed)
    command = {name: random.normal(size=7) * 0.1 for name in ("q", "q_des", "dq_des")}
    command |= {"tau_ff": 10 * random.normal(size=7), "kp": 10 ** random.uniform(0, 4, 7)}
    return command | {"kd": 10 ** random.uniform(-2, 2, 7) * (random.random(7) < 0.7)}, 10 ** random.uniform(-3, -1)


@pytest.mark.parametrize("seed", range(8))
def test_no_motion_takes_more_than_the_late_work(robot: ModuleType, seed: int) -> None:
    """Hill climbing over motions of up to the hold comes near the bound, and never beyond."""
    random = np.random.default_rng(seed)
    command, hold = commands(seed)
    bound = robot.late_work(**command, velocity_limit=SPEED, hold=hold)
    best, time, most = np.zeros((4, 7)), hold, 0.0
    for trial in range(4000):
        size = 10 ** random.uniform(-3, 0)
        speeds = np.clip(best + size * SPEED * random.normal(size=(4, 7)), -SPEED, SPEED)
        if trial % 2:
            speeds[:] = speeds.mean(axis=0)
        late = min(hold, time * np.exp(0.1 * random.normal()))
        work = motion_work(command, speeds, late)
        assert work <= bound * (1 + 1e-12)
        if work >= most:
            best, time, most = speeds, late, work
    assert most > 0.9 * bound


def test_no_late_work_from_bad_numbers(robot: ModuleType) -> None:
    command, hold = commands(0)
    assert np.isnan(robot.late_work(**command, velocity_limit=SPEED, hold=0.0))
    for name in command:
        bad = {**command, name: np.where(np.arange(7) == 2, np.nan, command[name])}
        assert np.isnan(robot.late_work(**bad, velocity_limit=SPEED, hold=hold))
    assert np.isnan(robot.late_work(**{**command, "kp": -command["kp"]}, velocity_limit=SPEED, hold=hold))


def test_the_account_bounds_the_work_of_the_motors(robot: ModuleType) -> None:
    """Motions between samples are not straight: the account books no less than their work, and not much more."""
    random = np.random.default_rng(7)
    controller = robot.Impedance(actuation="gains", **LOOSE)
    q, dq, work, exact, booked = Q.copy(), np.zeros(7), 0.0, [], []
    for k in range(1500):
        out = controller.step(q=q, dq=dq, q0=Q + 0.05 * np.sin(0.003 * k), **SPRING)
        booked.append(out.port_total)
        exact.append(work)
        command = {"q": q, "q_des": out.q_des, "dq_des": 0 * q, "tau_ff": out.tau_ff, "kp": out.kp, "kd": out.kd}
        speeds = 0.3 * np.cos(0.005 * k + np.arange(7)) + 0.02 * random.normal(size=(5, 7))
        work += motion_work(command, speeds, 1e-3)
        q, dq = q + 1e-3 * speeds.mean(axis=0), speeds[-1]
    surplus = np.array(booked) - exact
    assert np.all(np.diff(surplus) > -1e-12)
    assert 0 < surplus[-1] < 0.2 * np.abs(exact).max()
    assert out.fault == 0
