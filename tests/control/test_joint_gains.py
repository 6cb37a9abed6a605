# SPDX-License-Identifier: MIT
"""Motors with a controller inside: the split of a torque into gains, and the work that their own loops do."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

SPEED = np.array([1.5, 1.5, 1.7, 1.3, 2.3, 2.3, 2.3])


def applied(command: Any, q: np.ndarray, dq: np.ndarray, q_des: Any, dq_des: Any = 0.0) -> np.ndarray:
    """Return the torque of the motors."""
    return np.asarray(command.tau_ff + command.kp * (q_des - q) + command.kd * (dq_des - dq))


def states(seed: int, count: int) -> Any:
    """Yield random states with stiffness, damping and limits of gains, in SI units."""
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
    """Split torques into gains and feed-forward: their sum is exact, and each gain is the nearest allowed one."""
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


@pytest.mark.slow
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
