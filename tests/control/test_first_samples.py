# SPDX-License-Identifier: MIT
"""First positions that are wrong: no limit zone acts on them, and nothing of them counts (campaigns/starts.py)."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.controller_inputs import SPRING, STATED, Q
from support.plant.loop import Q0, Loop, N

TURN = 2.0 * np.pi
OFFSET = np.linspace(-3.0, 3.0, N)
STILL = {**STATED, "position_quantum": 2e-6}
"""Configuration for positions that are the same to the last bit while the torque changes."""


def turned(joint: int, by: float) -> np.ndarray:
    q = Q.copy()
    q[joint] += by
    return q


ABSURD = [*(turned(joint, by) for joint in range(N) for by in (-TURN, TURN)), np.degrees(Q)]


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("absurd", range(len(ABSURD)))
def test_an_absurd_first_position_is_not_believed(robot: ModuleType, absurd: int, moving: bool) -> None:
    """The first call names joint and limit, the account does not begin, and no call has a torque but the offset.

    Before the controller of 0.2: up to 160 N m of the limit avoidance, whose energy counted as the account's beginning.
    """
    q, dq = ABSURD[absurd], 0.5 * np.ones(N) * moving
    controller = robot.Impedance(**STATED)
    beyond = np.maximum(q - robot.UPPER, robot.LOWER - q) > 0.1
    for k in range(200):
        out = controller.step(q=q + 1e-3 * k * dq, dq=dq, q0=Q, counter=k, torque_offset=OFFSET, **SPRING)
        assert out.reason == robot.Reason.POSITION and beyond[out.fault_joint]
        assert out.energy_supplied == out.stored == out.tank == 0.0
        assert not out.own_torque.any() and out.mode == robot.Mode.LIMP


def test_an_arm_that_is_led_back_is_kept_inside_again(robot: ModuleType) -> None:
    """Start beyond a limit: the fault stays until a reset inside; then the limit zone is back."""
    controller = robot.Impedance(**STILL)
    q, k = Q.copy(), 0
    q[3] = robot.LOWER[3] - 0.15
    assert controller.step(q=q, dq=np.zeros(N), q0=Q, counter=k, **SPRING).reason == robot.Reason.POSITION
    while q[3] < robot.LOWER[3] + 0.2:
        q[3], k = q[3] + 5e-4, k + 1
        out = controller.step(q=q, dq=0.5 * np.eye(N)[3], q0=Q, counter=k, **SPRING)
        assert out.fault and not out.own_torque.any()
    controller.reset()
    for _ in range(5):
        k += 1
        out = controller.step(q=q, dq=np.zeros(N), q0=q, counter=k, **SPRING)
    assert not out.fault, out.text
    while q[3] > robot.LOWER[3] + 0.05:
        q[3], k = q[3] - 2e-4, k + 1
        out = controller.step(q=q, dq=-0.2 * np.eye(N)[3], q0=q, counter=k, **SPRING)
    assert out.limit_torque[3] > 5


@pytest.mark.parametrize("signal", ["q", "dq"])
def test_one_bad_sample_at_rest_is_no_fault(robot: ModuleType, signal: str) -> None:
    """Pass one bad sample at rest: no fault. Before, its records made the next good one FROZEN."""
    controller = robot.Impedance(**STATED)
    for k in range(300):
        glitch = 3.0 * np.eye(N)[2] * (k == 200)
        sample: dict[str, Any] = {"q": Q, "dq": np.zeros(N)}
        sample[signal] = sample[signal] + glitch
        out = controller.step(**sample, q0=Q, counter=k, **SPRING)
        assert bool(out.status & robot.Status.BAD_SAMPLE) == (k == 200)
        assert not out.fault, out.text


def test_a_reset_after_a_jump_is_granted(robot: ModuleType) -> None:
    """Reset after a jump: granted. Before, the watches kept what led to the fault, and FROZEN came at once."""
    controller = robot.Impedance(**STATED)
    for k in range(500):
        q = Q + 3.0 * np.eye(N)[2] * (k in (200, 201))
        if k == 450:
            controller.reset()
        out = controller.step(q=q, dq=np.zeros(N), q0=Q, counter=k, **SPRING)
        if k == 201:
            assert out.reason == robot.Reason.JUMP
    assert not out.fault and out.mode == robot.Mode.ACTIVE


@pytest.mark.parametrize("joint", [1, 3, 5])
def test_an_encoder_that_jumps_by_a_turn_does_not_drive(loop: Loop, joint: int) -> None:
    """Let an encoder jump by a turn: the arm is not driven. Before: several times its velocity limit after 0.4 s."""
    offset: Any = np.eye(N)[joint] * TURN
    parts = loop.segments({"wanted": Q0}, {"start": 200, "q_offset": offset})
    summary = loop.run(3000, parts, configs=loop.config())
    assert summary.faults == 1
    assert summary.speed < 0.2


HOSTILE = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e9, 5e-324)


def test_absurd_commands_leave_torque_and_reference_within_their_limits(robot: ModuleType) -> None:
    """NaN, infinity and huge numbers in every command: refused or followed, never a fault or a torque beyond."""
    random = np.random.default_rng(3)
    controller = robot.Impedance(**STILL, errors="ignore")
    last, refused = np.zeros(N), 0
    good = {"q0": Q, "posture_stiffness": np.ones(N), "wrench_command": np.zeros(6), "acceleration": np.zeros(N),
            "torque_offset": np.zeros(N), **SPRING}  # fmt: skip
    for k in range(3000):
        given = {name: np.array(value, float) for name, value in good.items()}
        array = given[str(random.choice(list(given)))]
        array.flat[random.integers(array.size)] = random.choice(HOSTILE)
        out = controller.step(q=Q, dq=np.zeros(N), counter=k, shaped=bool(k % 2), **given)
        assert np.isfinite(out.torque).all() and (np.abs(out.torque) <= robot.EFFORT).all()
        assert (np.abs(out.torque - last) <= 1e-3 * controller.config.torque_rate_limit * (1 + 1e-9)).all()
        assert np.abs(out.reference - Q).max() < 0.05 and not out.fault, out.text
        last, refused = out.torque, refused + (out.refusal is not None)
    assert refused > 1500
