# SPDX-License-Identifier: MIT
"""Feed-forward of the controller: wrenches that the tip is to exert."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.plant.loop import Q0, Loop, N

SOFT = {"translation": 100 * np.eye(3), "rotation": 20 * np.eye(3)}
SPRINGS = {"translation_stiffness": 100 * np.eye(3), "rotation_stiffness": 20 * np.eye(3)}
STILL = {"q": Q0, "dq": np.zeros(N), "q0": Q0}


def advance(loop: Loop, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> None:
    """Move the arm for 1 ms in place, with rotors of 0.1 kg m^2."""
    M = loop.mass_matrix(q) + 0.1 * np.eye(N)
    v += 1e-3 * np.linalg.solve(M, torque - loop.bias(q, v))
    q += 1e-3 * v


def shifts(loop: Loop, q: np.ndarray) -> np.ndarray:
    """Return the tip's motion and turn (6, n) per rad of each joint, by differences of the pose."""
    columns = []
    for step in 1e-6 * np.eye(N):
        there, back = loop.pose(q + step), loop.pose(q - step)
        turn = there[:3, :3] @ back[:3, :3].T
        spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        columns.append(np.concatenate([there[:3, 3] - back[:3, 3], spin]) / 2e-6)
    return np.array(columns).T


@pytest.mark.parametrize("wrench", [[0, 0, -80, 0, 0, 0], [30, -50, 20, 0, 0, 0], [20, 10, -40, 4, -8, 6]])
def test_the_torque_holds_the_wrench(robot: ModuleType, loop: Loop, wrench: list[float]) -> None:
    """By virtual work: the torque at each joint is the wrench times the tip's motion per rad."""
    controller, plain = robot.Impedance(), robot.Impedance()
    for _ in range(300):
        out = controller.step(**STILL, **SPRINGS, wrench_command=wrench)
        without = plain.step(**STILL, **SPRINGS)
    np.testing.assert_allclose(out.torque - without.torque, shifts(loop, Q0).T @ wrench, atol=1e-6)
    np.testing.assert_allclose(out.wrench_command, wrench)
    assert not out.status & (robot.Status.FEEDFORWARD_LIMITED | robot.Status.FEEDFORWARD_REFUSED)


@pytest.mark.parametrize("stiffness", [1e4, 1e5])
@pytest.mark.parametrize("force", [10.0, 50.0, 95.0])
def test_a_wall_is_pressed(loop: Loop, force: float, stiffness: float) -> None:
    """The tip begins 1 cm above a wall and presses it: the wall's force and the springs' carry the wrench."""
    step, q, v = loop.stepper(loop.default(motor_inertia=0.1)), Q0.copy(), np.zeros(N)
    start = loop.pose(Q0)[:3, 3]
    for _ in range(4000):
        command = step(q=q, dq=v, wanted=Q0, **SOFT, wrench_command=[0, 0, -force, 0, 0, 0])
        contact = max(0.0, stiffness * (start[2] - 0.01 - loop.pose(q)[2, 3]))
        advance(loop, q, v, np.array(command.torque) + loop.jacobian(q)[2] * contact)
    assert not command.faulted
    spring = 100 * (start[2] - loop.pose(q)[2, 3])
    assert contact + spring == pytest.approx(force, rel=0.01)
    assert np.abs(v).max() < 1e-4


def round_trips(turns: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield q and its velocity on a closed curve of the joints, one turn per second."""
    for k in range(turns * 1000 + 1):
        phase = 2 * np.pi * (1e-3 * k + np.arange(N) / 7)
        rise = min(1.0, k / 300)
        yield Q0 + 0.08 * rise * np.sin(phase), 0.16 * np.pi * rise * np.cos(phase)


def kept(command: Any, work: float, before: float, most: float) -> float:
    """Return tank + energy + work: unchanged since the last sample, but for income that a full tank does not hold."""
    account = float(command.tank + command.energy + work)
    assert account == pytest.approx(before, abs=1e-9) or (account < before and command.tank == pytest.approx(most))
    return account


@pytest.mark.parametrize("wrench", [[0, 0, -40, 0, 0, 0], [30, 20, 10, 3, -4, 5]])
def test_a_closed_orbit_costs_the_tank_what_it_puts_out(loop: Loop, wrench: list[float]) -> None:
    """A force has a potential, a moment has none: what either puts out is missing in the tank, exactly."""
    step, works = loop.stepper(loop.default(motor_inertia=0.1, tank_initial=20.0)), [0.0]
    torque, last, account, full = np.zeros(N), Q0, 20.0, 0
    for k, (q, v) in enumerate(round_trips(6)):
        works.append(works[-1] + float(torque @ (q - last)))
        command = step(q=q, dq=v, wanted=Q0, **SOFT, wrench_command=wrench)
        torque, last = np.array(command.torque), q
        assert not command.faulted, k
        account, full = kept(command, works[-1], account, 20.0), full + (command.tank >= 20.0)
    assert full < 0.5 * len(works)
    turn, swing = works[-1] - works[-1001], np.ptp(works[-1001:])
    assert swing > 1.0
    assert turn < (0.0 if wrench[5] == 0 else 0.2 * swing)  # the damping takes some


@pytest.mark.parametrize("force", [20.0, 95.0])
def test_a_wrench_without_contact_does_not_run_away(loop: Loop, force: float) -> None:
    """Without springs, nothing holds the tip: it keeps its velocity limit, and the tank its half."""
    step, q, v, fastest, work, tank = (
        loop.stepper(loop.default(motor_inertia=0.1)),
        Q0.copy(),
        np.zeros(N),
        0.0,
        0.0,
        0.0,
    )
    for _ in range(1500):
        command = step(q=q, dq=v, wanted=Q0, translation=np.zeros((3, 3)), rotation=20 * np.eye(3),
                       wrench_command=[0, 0, -force, 0, 0, 0])  # fmt: skip
        advance(loop, q, v, np.array(command.torque))
        fastest = max(fastest, float(np.linalg.norm(loop.jacobian(q)[:3] @ v)))
        work, tank = work + 1e-3 * float(np.array(command.torque) @ v), max(tank, command.tank)
        assert not command.faulted
        assert work < 0.5 * tank
    assert 0.3 < fastest < 1.0


def test_a_tip_that_is_led_away_gets_half_the_tank(loop: Loop) -> None:
    """Without springs, the tip is led along a force that turns; half of the tank stays."""
    settings = loop.default(motor_inertia=0.1, posture_stiffness=0.0, damping_ratio=0.0, joint_damping=0.0)
    step, q, work, tank = loop.stepper(settings), Q0.copy(), 0.0, 0.0
    none = {"translation": 1e-9 * np.eye(3), "rotation": 1e-9 * np.eye(3)}
    for k in range(8000):
        J = loop.jacobian(q)[:3]
        force = -60.0 * np.array([np.cos(k / 500), np.sin(k / 500), 0.0])
        v = np.clip(np.linalg.pinv(J) @ (0.2 * force / 60), -1, 1)
        command = step(q=q, dq=v, wanted=Q0, **none, wrench_command=[*force, 0, 0, 0])
        tank = max(tank, command.tank)
        work += float(np.array(command.torque) @ v) * 1e-3
        q = q + 1e-3 * v
        assert not command.faulted, k
        assert work <= 0.5 * tank + 0.1
    assert work > 0.4 * tank


@pytest.mark.parametrize(
    "wrench", [[np.nan, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, np.inf], [0, 0, 101, 0, 0, 0], [0, 0, 0, 0, 21, 0]]
)
def test_a_wrench_that_is_refused_acts_like_none(robot: ModuleType, wrench: list[float]) -> None:
    """The event is named, the position command is followed, and the wrench given before is gone."""
    controller, plain = robot.Impedance(errors="ignore"), robot.Impedance()
    for k in range(1000):
        given = wrench if k >= 200 else [0, 0, -50, 0, 0, 0]
        out = controller.step(q=Q0, dq=np.zeros(N), q0=Q0 + 0.01, **SPRINGS, wrench_command=given)
        without = plain.step(q=Q0, dq=np.zeros(N), q0=Q0 + 0.01, **SPRINGS)
        assert bool(out.status & robot.Status.FEEDFORWARD_REFUSED) == (k >= 200)
        assert not out.fault
    np.testing.assert_array_equal(out.torque, without.torque)
    assert not out.wrench_command.any()


def test_wrenches_keep_the_limits(robot: ModuleType) -> None:
    """Wrenches and torques of the caller that jump, with samples missing: effort and rate limits hold."""
    random, effort = np.random.default_rng(5), 0.2 * robot.EFFORT
    controller = robot.Impedance(effort_limit=effort, heaviest_wrench=[100, 20], motor_inertia=0.1)
    rate, last = 1e-3 * controller.config.torque_rate_limit, np.zeros(N)
    limited = 0
    for k in range(3000):
        if k % 50 == 0:
            wrench = random.normal(size=6) * [50, 50, 50, 8, 8, 8]
            wrench *= min(1.0, *(limit / np.linalg.norm(part) for limit, part in ((100, wrench[:3]), (20, wrench[3:]))))
            offset = random.normal(size=N) * 0.3 * effort
        late = random.random() < 0.05
        out: Any = controller.missed() if late else controller.step(
            **STILL, **SPRINGS, wrench_command=wrench, torque_offset=offset
        )  # fmt: skip
        assert np.all(np.abs(out.torque) <= effort * (1 + 1e-12))
        assert np.all(np.abs(out.torque - last) <= rate * (1 + 1e-9))
        limited += bool(out.status & robot.Status.FEEDFORWARD_LIMITED)
        last = out.torque
    assert limited > 100
    assert not out.fault


# ---- plans


Plan = tuple[np.ndarray, np.ndarray, np.ndarray]


def line(loop: Loop, way: list[float], speed: float = 0.5) -> Plan:
    """Return q, dq, ddq of a plan that moves the tip along 0.3 m without a turn, smooth, up to a speed."""
    start, q, rows = loop.pose(Q0), Q0.copy(), []
    time = np.clip(1e-3 * np.arange(1600) / (1.875 * 0.3 / speed), 0, 1)
    for share in 10 * time**3 - 15 * time**4 + 6 * time**5:
        for _ in range(3):
            here = loop.pose(q)
            turn = start[:3, :3] @ here[:3, :3].T
            spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
            away = start[:3, 3] + 0.3 * share * np.array(way) - here[:3, 3]
            q = q + np.linalg.pinv(loop.jacobian(q)) @ np.concatenate([away, spin])
        rows.append(q)
    velocity = np.gradient(np.array(rows), 1e-3, axis=0)
    rates = velocity, np.gradient(velocity, 1e-3, axis=0)
    velocity, acceleration = (np.where(np.abs(each) < 1e-9, 0.0, each) for each in rates)  # at rest, no rounding
    return np.array(rows), velocity, acceleration


def track(loop: Loop, plan: Plan, stiffness: float, stated: Any = None, **config: Any) -> tuple[float, int]:
    """Follow a plan; ``stated`` makes inputs from k. Return the tip's rms error [m] and all status bits together."""
    step, (wanted, _, _) = loop.stepper(loop.default(motor_inertia=0.1, **config)), plan
    q, v, away, status = wanted[0].copy(), np.zeros(N), [], 0
    springs = {"translation": stiffness * np.eye(3), "rotation": stiffness / 20 * np.eye(3)}
    for k in range(len(wanted)):
        command = step(q=q, dq=v, wanted=wanted[k], posture=wanted[k], **springs, **(stated(k) if stated and k else {}))
        assert not command.faulted, k
        status |= command.status
        advance(loop, q, v, np.array(command.torque))
        away.append(loop.pose(q)[:3, 3] - loop.pose(wanted[min(k + 1, len(wanted) - 1)])[:3, 3])
    return float(np.sqrt(np.mean(np.sum(np.square(away), axis=1)))), status


@pytest.mark.parametrize("pose", [0, 1])
@pytest.mark.parametrize("way", [[0, 1, 0], [0, 0, -1]])
def test_a_line_at_half_a_metre_per_second(robot: ModuleType, loop: Loop, way: list[float], pose: int) -> None:
    """Velocity and acceleration of the plan leave a third of the error, Coriolis forces a tenth of it."""
    plan = line(loop, way)

    def stated(k: int) -> dict[str, Any]:
        return {"velocity": plan[1][k], "acceleration": plan[2][k], "pose": pose}

    before, _ = track(loop, plan, 400.0, lambda k: {"pose": pose})
    after, status = track(loop, plan, 400.0, stated)
    whole, _ = track(loop, plan, 400.0, stated, coriolis=2)
    held = robot.Status.FEEDFORWARD_LIMITED | robot.Status.FEEDFORWARD_REFUSED
    assert before > 0.009 and after < before / 3 and whole < before / 10
    assert not status & held


@pytest.mark.parametrize("engagement", [0.05, 1.0])
def test_the_engagement_pays_for_an_acceleration(loop: Loop, engagement: float) -> None:
    """The arm is led along an acceleration that a slow plan states: what is put out is missing in the engagement."""
    sides, rate, tank = np.array([1, 1, -1, 1, 1, -1, 1.0]), np.full(N, 1e-4), 0.5
    parts: list[dict[str, Any]] = [{"wanted": Q0, "translation": np.eye(3), "rotation": 0.1 * np.eye(3)}]
    for k, start in enumerate(range(300, 3000, 200)):
        sign = (-1.0) ** k
        plan = {"velocity": sign * rate, "acceleration": sign * 0.45 * sides * loop.velocity}
        wanted = {"wanted": Q0 + (0.0 if k % 2 == 0 else 0.2) * rate, "wanted_rate": sign * rate}
        along = {"driven": 1, "driven_by": 1e5, "driven_to": sign * 0.4 * sides * loop.velocity}
        parts.append({"start": start, **wanted, **plan, **along})
    settings = {"tank_initial": tank, "engagement_limit": engagement, "posture_stiffness": 0.01}
    settings |= {"damping_ratio": 0.0, "joint_damping": 0.0}
    summary, outputs = loop.run(3000, loop.segments(*parts), None, loop.config(**settings), outputs=True)
    assert np.any(outputs["reference_acceleration"])
    assert outputs["engagement"].min() >= 0
    assert 0.6 * engagement < summary.port_most <= engagement + 1e-9


@pytest.mark.parametrize("name", ["velocity", "acceleration"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 100.0])
def test_a_plan_that_is_refused_acts_like_none(robot: ModuleType, name: str, value: float) -> None:
    controller, plain = robot.Impedance(), robot.Impedance()
    spoiled = {"velocity": np.full(N, 0.1), "acceleration": np.zeros(N)}
    spoiled[name][3] = value
    for k in range(100):
        moving = {"q": Q0, "dq": np.zeros(N), "q0": Q0 + 1e-4 * k, **SPRINGS}
        out, without = controller.step(**moving, **spoiled), plain.step(**moving)
        assert out.status & robot.Status.FEEDFORWARD_REFUSED
        assert not out.status & robot.Status.COMMAND_REFUSED
        np.testing.assert_array_equal(out.torque, without.torque)


@pytest.mark.parametrize("by_pose", [False, True])
def test_a_plan_that_is_repeated_ends(robot: ModuleType, by_pose: bool) -> None:
    """The planner dies in the middle of a motion, and the loop repeats its last command."""
    controller, rate = robot.Impedance(), 0.3 * np.array([0, 1, 0, 1, 0, 0, 0])
    limited = []
    for k in range(1500):
        q0 = Q0 + 1e-3 * min(k, 500) * rate
        goal = {"equilibrium": robot.forward_kinematics(q0), "posture": q0} if by_pose and k else {"q0": q0}
        plan = {"velocity": rate, "acceleration": 5 * rate}
        out = controller.step(q=q0, dq=rate * (0 < k <= 500), **goal, **SPRINGS, **plan)
        assert not out.fault
        limited.append(bool(out.status & robot.Status.FEEDFORWARD_LIMITED))
        assert out.reference_acceleration.any() != limited[-1]
    assert not any(limited[50:500]) and all(limited[700:])
    assert not out.reference_velocity.any() and not out.feedforward_torque.any()


def test_a_plan_that_the_governor_does_not_follow(robot: ModuleType) -> None:
    """A plan at 1.2 of the governor's velocity: no acceleration is added, and the status says so."""
    controller, first = robot.Impedance(), np.eye(N)[0]
    rate = 1.2 * 0.8 * controller.config.reference_velocity_limit * first
    for k in range(300):
        plan = {"velocity": rate, "acceleration": 0.1 * first}
        out = controller.step(q=Q0, dq=np.zeros(N), q0=Q0 + 1e-3 * k * rate, **SPRINGS, **plan)
    assert out.status & robot.Status.FEEDFORWARD_LIMITED
    assert not out.status & robot.Status.FEEDFORWARD_REFUSED
    assert not out.reference_acceleration.any()


# ---- Coriolis forces


def test_coriolis_forces_are_compensated(robot: ModuleType, loop: Loop) -> None:
    """The torque gains the forces of the plant, which are made from differences of its mass matrix."""
    random = np.random.default_rng(3)
    for _ in range(20):
        q, v = Q0 + random.uniform(-0.3, 0.3, N), random.uniform(-0.4, 0.4, N) * robot.VELOCITY
        on, off = robot.Impedance(coriolis="on"), robot.Impedance()
        for k in range(3):
            given = {"q": q + 1e-3 * k * v, "dq": v, "q0": q, **SPRINGS}
            out, without = on.step(**given), off.step(**given)
        np.testing.assert_allclose(out.feedforward_torque, loop.bias(q + 2e-3 * v, v), atol=1e-6)
        difference = out.torque - without.torque
        free = ~((np.abs(difference - out.feedforward_torque) > 1e-6) & bool(out.status & robot.Status.RATE_LIMITED))
        np.testing.assert_allclose(difference[free], out.feedforward_torque[free], atol=1e-6)
        assert not out.fault


def test_the_tank_pays_for_coriolis_forces(loop: Loop) -> None:
    """Led to and fro between postures of different inertia; all that is put out is missing in the tank."""
    settings = {"coriolis": 2, "tank_initial": 3.0, "damping_ratio": 0.0, "joint_damping": 0.0}
    step, work, torque, last = loop.stepper(loop.default(motor_inertia=0.1, **settings)), 0.0, np.zeros(N), Q0
    account, full = 3.0, 0
    for k in range(6000):
        phase, rise = 2e-3 * np.pi * k, min(1.0, k / 500)
        q = Q0 + rise * np.array([0.2 * np.sin(phase), 0, 0, 0.2 * np.sin(phase + 1.0), 0, 0, 0])
        work += float(torque @ (q - last))
        command = step(q=q, dq=1e3 * (q - last), wanted=Q0, translation=np.eye(3), rotation=np.eye(3))
        torque, last = np.array(command.torque), q
        account, full = kept(command, work, account, 3.0), full + (command.tank >= 3.0)
        assert not command.faulted
    assert command.tank > 1.4 and full < 3600
