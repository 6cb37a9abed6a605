# SPDX-License-Identifier: MIT
"""An arm whose wiring is not the URDF's: the damping drives it, and the controller ends with no torque."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.controller_inputs import KO, STATED, Arm, Q

Wiring = Callable[[np.ndarray], np.ndarray]
LOAD = np.array([0.0, 0, -3 * 9.81, 0, 0, 0])
SPRINGS = {"translation_stiffness": 400 * np.eye(3), "rotation_stiffness": KO}


def flip(joint: int) -> Wiring:
    """Return what measures a joint with the wrong sign; its torque has the right one."""
    signs = np.where(np.arange(7) == joint, -1.0, 1.0)
    return lambda x: signs * x


def swap(joint: int) -> Wiring:
    """Return what measures two neighbours in the wrong order."""
    order = np.arange(7)
    order[[joint, joint + 1]] = joint + 1, joint
    return lambda x: x[order]


def hang_on(robot: ModuleType, wiring: Wiring, samples: int = 2500, **inputs: Any) -> tuple[float, float, Any]:
    """Hang a load on an arm that rests; the joints are measured through the wiring.

    Return the work of the torque [J] at its peak, that after the last half of the session, and the last output.
    """
    controller = robot.Impedance(**STATED, errors="ignore", **inputs.pop("fields", {}))
    arm, work, peak, half = Arm(robot, Q), 0.0, 0.0, 0.0
    for k in range(samples):
        out = controller.step(q=wiring(arm.q), dq=wiring(arm.dq), q0=wiring(Q), counter=k, **SPRINGS, **inputs)
        before = arm.q
        arm.step(out.torque, LOAD if k > 50 else None)
        if np.abs(arm.q).max() > 1e3:
            break
        work += float(out.torque @ (arm.q - before))
        peak, half = max(peak, work), work if k == samples // 2 else half
    return peak, work - half, out


WIRINGS = {f"flip {k}": flip(k) for k in (1, 2, 3, 5)} | {f"swap {k}": swap(k) for k in (0, 1, 3)}


@pytest.mark.slow
@pytest.mark.parametrize("fields", [{}, {"velocity_noise": 0.02}], ids=["", "noise"])
@pytest.mark.parametrize("name", WIRINGS)
def test_an_arm_that_damping_drives_gets_no_torque(robot: ModuleType, name: str, fields: dict[str, Any]) -> None:
    """Flip the sign of a joint, so that damping drives it: no torque. Before: full effort, 5534 J (joint 2)."""
    peak, late, out = hang_on(robot, WIRINGS[name], fields=fields)
    assert out.fault == robot.Fault.DISSIPATION
    assert peak < 30.0 and late == 0.0
    assert not out.torque.any() and out.mode == robot.Mode.LIMP
    assert "sign and order" in out.text


def test_the_torque_of_the_caller_ends_too(robot: ModuleType) -> None:
    """A law that is passed as torque_offset (the FRI client's --law paper) may be what drives the arm."""
    offset = np.array([0.0, 5, 0, 0, 0, 0, 0])
    _, late, out = hang_on(robot, flip(1), torque_offset=offset)
    assert out.fault == robot.Fault.DISSIPATION
    assert late == 0.0 and not out.torque.any()


@pytest.mark.parametrize(
    ("joint", "share", "rise", "found"),
    [(4, 1.2, 40, False), (4, 1.45, 40, False), (4, 1.7, 40, True), (4, 1.3, 80, False), (5, 1.3, 80, True)],
)
def test_a_bump_is_braked(robot: ModuleType, joint: int, share: float, rise: int, found: bool) -> None:
    """A joint is pushed to a share of its velocity limit in `rise` ms, and rests as long after.

    A push beyond 1.5 limits is no bump, nor one against 70 % of the effort limit: A6 is braked with 28 N m at 1.3, A5
    with 38 of 110 N m.
    """
    controller, q = robot.Impedance(**STATED, position_quantum=2e-6), Q.copy()
    for k in range(300):
        speed = share * np.clip(min(k - 50, 50 + 2.5 * rise - k) / rise, 0, 1) * robot.VELOCITY[joint]  # [rad/s]
        dq = speed * np.eye(7)[joint]
        q = q + 1e-3 * dq
        out = controller.step(
            q=q, dq=dq, q0=Q, counter=k, translation_stiffness=np.eye(3), rotation_stiffness=np.eye(3)
        )
        if out.fault:
            break
    assert out.reason == (robot.Reason.DISSIPATION if found else robot.Reason.NONE), out.text
    assert not found or out.fault_joint == joint


def test_a_reset_ends_the_fault(robot: ModuleType) -> None:
    """Reset once the arm rests and its signs are right: springs and torque come back."""
    controller, q = robot.Impedance(**STATED, position_quantum=2e-6), Q.copy()
    for k in range(400):
        dq = 1.8 * np.clip(min(k - 50, 150 - k) / 40, 0, 1) * robot.VELOCITY * np.eye(7)[4]
        q = q + 1e-3 * dq
        out = controller.step(q=q, dq=dq, q0=q, counter=k, **SPRINGS)
    assert out.reason == robot.Reason.DISSIPATION and not out.torque.any()
    controller.reset()
    for k in range(400, 405):
        out = controller.step(q=q, dq=np.zeros(7), q0=q, counter=k, **SPRINGS)
    assert out.reason == robot.Reason.NONE and out.scale > 0.0
