# SPDX-License-Identifier: MIT
"""The controller's energy account: an identity at every step, and the output that bounds the work."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stiffgen.control.sessions.check import energy
from support.controller_inputs import KO, KT, SPRING, Arm, Q, hostile, run_with_resets, walk


def residual(out: Any) -> np.ndarray:
    """port + what is stored - what was put in."""
    put_in = out.start_total + out.sampling_total + out.reference_total + out.stiffness_total
    return np.asarray(out.port_total + out.elastic_energy + out.limit_energy - put_in)


@pytest.mark.parametrize("delay", [0, 1, 2, 5])
def test_the_account_is_the_work_at_the_port(robot: ModuleType, delay: int) -> None:
    """The port's total is the sum of (the torque that acted) . (change of q), taken outside; and nothing is missing."""
    inputs = walk(np.random.default_rng(delay), robot, 1500)
    fields: dict[str, Any] = {"delay_samples": delay, "stiffness_cap": "accept"}
    out = robot.Impedance(limit_zone=0.9, motor_inertia=0.1, **fields).run(**inputs)
    torque = np.vstack([np.zeros((delay, 7)), out.torque])[: len(out.torque)]
    port = np.concatenate([[0.0], np.cumsum(np.sum(torque[:-1] * np.diff(inputs["q"], axis=0), axis=1))])
    np.testing.assert_allclose(out.port_total, port, atol=1e-10)
    assert np.abs(residual(out)).max() < 1e-11
    assert np.ptp(out.reference_total) > 0.01
    assert np.ptp(out.stiffness_total) > 0.01
    assert out.limit_energy.max() > 0.01


def test_elastic_energy_is_the_springs(robot: ModuleType) -> None:
    """The energy is l U of the tip's and the posture's springs, with the stiffnesses that are in force."""
    inputs = walk(np.random.default_rng(4), robot, 400)
    out = robot.Impedance(posture_stiffness=3.0, motor_inertia=0.1).run(**inputs)
    for k in (0, 100, 399):
        pose = robot.forward_kinematics(inputs["q"][k])
        stored = energy(pose, out.equilibrium[k], out.translation_stiffness[k], out.rotation_stiffness[k])
        stored += 1.5 * np.sum((inputs["q"][k] - out.reference[k]) ** 2)
        assert out.elastic_energy[k] == pytest.approx(out.scale[k] * stored, rel=1e-10, abs=1e-12)
        np.testing.assert_allclose(out.equilibrium[k], robot.forward_kinematics(out.reference[k]), atol=1e-12)


def test_the_identity_holds_through_faults_and_gaps(robot: ModuleType) -> None:
    """One row in ten is spoilt; the account has no remainder, in at least three modes."""
    inputs, _ = hostile(np.random.default_rng(5), robot, 4000, 0.1)
    out = run_with_resets(robot.Impedance(motor_inertia=0.1, errors="ignore"), inputs, 50)
    assert np.abs(residual(out)).max() < 1e-9
    assert np.unique(out.mode).size >= 3


def carried_along(controller: Any, torque: np.ndarray, missing: int = 0, samples: int = 1500) -> tuple[float, float]:
    """Move every joint at its velocity limit with the torque that acts, from init on; the first samples are missing.

    Return the work put out [J] over energy_supplied, and the work, each at its peak.
    """
    config, q, worst, most, work = controller.config, Q.copy(), -np.inf, 0.0, 0.0
    acting, dq = [torque] * (int(config.delay_samples) + 1), np.zeros(7)
    for k in range(samples):
        wanted = 0.99 * config.velocity_limit * np.sign(acting[0])
        dq = np.clip(wanted, dq - 0.3 * config.velocity_limit, dq + 0.3 * config.velocity_limit) if k else wanted
        work += 1e-3 * float(acting[0] @ dq)
        q = q + 1e-3 * dq
        out = controller.missed() if k < missing else controller.step(q=q, dq=dq, q0=Q, **SPRING)
        acting = [*acting[1:], out.torque]
        worst, most = max(worst, work - float(out.energy_supplied)), max(most, work)
    return worst, most


@pytest.mark.parametrize("share", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("fields", [{}, {"delay_samples": 3}, {"call_gap_limit": 1}, {"missed_limit": 2}])
@pytest.mark.parametrize("missing", [0, 1, 30])
def test_a_torque_in_force_at_the_start_is_supplied(
    robot: ModuleType, share: float, fields: dict[str, Any], missing: int
) -> None:
    """As another tool is taken. Before: 35, 109 and 213 J beyond energy_supplied at 50, 75 and 100 % of effort."""
    limits = {"lower_limit": -1e3, "upper_limit": 1e3, "stiffness_cap": "accept", "overspeed_time": 10.0}
    torque = share * robot.EFFORT * [1, -1, 1, -1, 1, -1, 1]
    controller = robot.Impedance(torque=torque, motor_inertia=0.1, errors="ignore", **limits, **fields)
    worst, most = carried_along(controller, torque, missing)
    assert worst <= 1e-6
    assert most > 1.0


def left(out: Any) -> np.ndarray:
    """What can still be put out by the output energy_supplied, less what springs and tank hold: never negative."""
    return np.asarray(out.energy_supplied - out.port_total - out.elastic_energy - out.limit_energy - out.tank_energy)


@pytest.mark.parametrize("seed", range(6))
def test_constant_equilibrium_puts_out_no_more_than_it_was_given(robot: ModuleType, seed: int) -> None:
    """q is driven at random; stiffness changes at random; samples are lost and faults are reset."""
    random = np.random.default_rng(seed)
    inputs = walk(random, robot, 3000, q0=Q)
    inputs["q"] = inputs["q"] + 0.02 * np.sin(np.arange(3000)[:, None] * random.uniform(0.01, 0.2, 7))
    inputs["dq"] = np.gradient(inputs["q"], 1e-3, axis=0) * random.choice([1.0, 0.95])
    inputs["sample_valid"][random.integers(0, 3000, 8)] = 0
    controller = robot.Impedance(tank_initial=0.5, engagement_limit=0.5, motor_inertia=0.1)
    out = controller.run(**inputs)
    assert left(out).min() > -1e-12
    assert np.all(np.diff(out.energy_supplied) >= 0)
    assert out.energy_supplied[0] == 0.5 + out.start_total[0]
    assert np.all(out.energy_supplied <= 0.5 + 0.5 + out.start_total)
    assert out.tank_energy.min() > 0
    assert np.all(out.tank_energy <= 0.5)


def test_fault_cycles_put_out_nothing_without_an_end(robot: ModuleType) -> None:
    """A fault, the limp arm displaced by hand, a reset, the way back: the old law put 4.4 J out a lap."""
    controller = robot.Impedance(motor_inertia=0.1, tank_initial=2.0)
    arm, resets, start = Arm(robot, Q), 0, []
    port = 0.0
    for k in range(6 * 2500):
        phase = k % 2500
        q = np.full(7, np.nan) if phase in (500, 501) else arm.q
        if phase == 1000:
            controller.reset()
            resets += 1
        if phase == 499:
            start.append(port)
        out = controller.step(q=q, dq=arm.dq, q0=Q, **SPRING)
        before = arm.q
        arm.step(out.torque, np.array([40.0, 0, 0, 0, 0, 0]) if 510 < phase < 900 else None)
        port += float(out.torque @ (arm.q - before))
        assert (out.fault == robot.Fault.SENSOR) == (501 <= phase < 1000)
    assert abs(residual(out)) < 1e-10
    assert out.unaccounted == 0
    assert np.abs(arm.q - Q).max() < 0.05
    assert np.all(np.diff(start) < 0)  # the hand's work went into damping
    assert left(out) > -1e-12
    assert out.energy_supplied <= 2.0 + (1 + resets) * out.engagement_limit


def test_what_raises_the_energy_supplied(robot: ModuleType) -> None:
    """Moves of the equilibrium do, and a limit zone at the start; damping, stiffness and repeated commands do not.

    The table of docs/energy.md. The arm stands still throughout, so that nothing leaves the port.
    """
    fields: dict[str, Any] = {"motor_inertia": 0.1, "tank_initial": 5.0, "engagement_limit": 2.0}

    def rises(controller: Any, steps: int, **changes: Any) -> np.ndarray:
        given = {"q": Q, "dq": np.zeros(7), "q0": Q, **SPRING, **changes}
        outs = [controller.step(**given) for _ in range(steps)]
        assert all(abs(out.port_total) < 1e-12 for out in outs)
        return np.array([out.energy_supplied for out in outs])

    controller = robot.Impedance(**fields)
    assert np.all(rises(controller, 200) == 5.0)  # at rest where it is commanded
    stiffer = {name: 2 * value for name, value in SPRING.items()}
    assert np.all(rises(controller, 200, **stiffer) == 5.0)
    moved = rises(controller, 500, q0=Q + 0.2)
    assert 5.0 < moved[-1] <= 5.0 + 2.0 + 2.0 * 0.5  # an engagement, and one per second of travel at most
    assert np.all(np.diff(moved) >= 0)
    assert np.all(rises(controller, 500, q0=Q + 0.2) == moved[-1])  # repeated: the first has been paid
    deep = Q.copy()
    deep[1] = robot.UPPER[1] - 0.02
    started = robot.Impedance(**fields).step(q=deep, dq=np.zeros(7), q0=deep, **SPRING)
    assert started.energy_supplied == 5.0 + started.limit_energy > 5.0


def test_stiffness_change_is_split(robot: ModuleType) -> None:
    """Tank empty: softer in three directions and stiffer in one; the softer part is not held back."""
    q = Q + 0.05
    wanted = np.diag([350.0, 1400.0, 400.0])
    tilted = KT * 0.5 + np.array([[0, 60.0, 0], [60.0, 0, 0], [0, 0, 0]])

    def displaced(**fields: float) -> Any:
        controller = robot.Impedance(stiffness_time=0.02, motor_inertia=0.1, **fields)
        for k in range(600):
            phase = np.pi * min(1, k / 500)
            way, rate = 0.5 - 0.5 * np.cos(phase), np.pi * np.sin(phase)
            out = controller.step(q=Q + way * (q - Q), dq=rate * (q - Q), q0=Q, **SPRING)
        assert not out.fault, repr(out)
        assert out.elastic_energy > 0.1
        return controller

    # With energy in the tank, all of it passes; with the tank kept from paying, the release alone.
    rich = displaced(tank_initial=20.0)
    for _ in range(1000):
        out = rich.step(q=q, dq=np.zeros(7), q0=Q, translation_stiffness=wanted, rotation_stiffness=KO)
    np.testing.assert_allclose(out.translation_stiffness, wanted, rtol=1e-8)
    poor = displaced(tank_initial=1.0)
    for _ in range(1000):
        out = poor.step(q=q, dq=np.zeros(7), q0=Q, translation_stiffness=3 * wanted, rotation_stiffness=KO)
    assert out.status & robot.Status.TANK_LIMITED
    assert out.tank_energy > 0
    assert not out.fault
    for _ in range(1000):
        out = poor.step(q=q, dq=np.zeros(7), q0=Q, translation_stiffness=tilted, rotation_stiffness=KO)
    assert np.linalg.eigvalsh(out.translation_stiffness - KT * 0.62).max() < 700  # released where it was wanted softer
    assert out.translation_stiffness[2, 2] == pytest.approx(400, rel=1e-6)


def test_a_reset_that_ends_in_another_fault_brings_in_nothing(robot: ModuleType) -> None:
    """Deep in a limit zone, the torque over 300 missed samples is not covered: each reset ends in its own call.

    Before: each such call filled the engagement.
    """
    controller = robot.Impedance(
        motor_inertia=0.1, tank_initial=0.1, engagement_limit=0.2, limit_zone=0.5, missed_limit=300,
        call_gap_limit=1, limit_stiffness=300.0,
    )  # fmt: skip
    controller.config.tank_initial = 10.0  # an engagement brings in 0.2 J: the tank stays below a tenth of this
    q, wanted, ended, before = Q.copy(), Q.copy(), [], (0.0, 0.0, 0.0, 0.0)
    q[1] = wanted[1] = robot.UPPER[1] - 0.2
    wanted[4] += 0.3
    for k in range(400):
        out = controller.step(q=q, dq=np.zeros(7), q0=wanted if k else q, **SPRING)
        now = (float(out.fault), out.fault_time, out.engagement, out.tank_energy)
        if before[0] and now[0] and now[1] < before[1]:
            ended.append((before[2:], now[2:]))
        before = now
        if k % 50 == 49:
            controller.reset()
    assert len(ended) > 3
    for then, since in ended:
        np.testing.assert_allclose(since, then, atol=1e-12)
        assert since[0] < 0.2 - 1e-6


RAISED: dict[str, Any] = {"motor_inertia": 0.1, "call_gap_limit": 1, "missed_limit": 20, "loss_limit": 1000}


def rest(controller: Any, steps: int, q: np.ndarray, q0: np.ndarray) -> Any:
    """Hold the arm at q; a velocity that toggles is no frozen one."""
    return [controller.step(q=q, dq=np.full(7, 1e-4 * (-1) ** k), q0=q0, **SPRING) for k in range(steps)][-1]


@pytest.mark.parametrize("fault", [False, True])
@pytest.mark.parametrize(("name", "raised"), [
    ("velocity_limit", 10.0), ("missed_limit", 900), ("call_gap_limit", 20),
])  # fmt: skip
def test_a_raised_limit_waits_until_it_is_covered(robot: ModuleType, name: str, raised: float, fault: bool) -> None:
    """An arm that is carried along at the limit in force. Before, ten times the velocity limit set TANK_DEFICIT."""
    controller = robot.Impedance(**RAISED, errors="ignore")
    out = rest(controller, 1500, Q, Q + 0.1)
    before = np.copy(getattr(out, name))
    wanted = raised * robot.VELOCITY if name == "velocity_limit" else int(raised)
    setattr(controller.config, name, wanted)
    q, work, torque = Q.copy(), 0.0, out.torque
    for k in range(30):  # in the direction of the torque
        dq = 0.999 * out.velocity_limit * np.sign(torque) * (k > 0)
        q = q + 1e-3 * dq
        work += 1e-3 * float(torque @ dq)
        shown = np.full(7, np.nan) if fault and k in (2, 3) else q
        out = controller.step(q=shown, dq=dq, q0=Q + 0.1, **SPRING)
        torque = out.torque
        assert work <= out.energy_supplied and not out.status & robot.Status.TANK_DEFICIT
        if k == 0:
            assert np.any(getattr(out, name) == before), "each joint by itself: a load holds back its own"
            assert out.status & robot.Status.LIMITS_KEPT
    out = rest(controller, 1500, q, q)  # at the command, or in a fault, nothing is in transit
    np.testing.assert_array_equal(getattr(out, name), wanted)
    assert bool(out.fault) == fault and not out.status & robot.Status.LIMITS_KEPT


@pytest.mark.parametrize(("rate", "tank"), [(100.0, 0.3), (300.0, 1.0), (300.0, 3.0)])
def test_a_velocity_beyond_its_limit_books_no_more_than_was_reserved(
    robot: ModuleType, rate: float, tank: float
) -> None:
    """The last dq before a gap lies by half of the limit, and is believed. Before, such a gap set TANK_DEFICIT.

    The arm moves at the limit, against the torque at first: springs and damping then use all that the account covers.
    """
    fields = RAISED | {"missed_limit": 2, "tank_initial": tank, "torque_rate_limit": rate}
    controller = robot.Impedance(**fields, errors="ignore")
    out = rest(controller, 1500, Q, Q + 0.1)
    q, torque, work, sides = Q.copy(), out.torque, 0.0, np.sign(out.torque)
    for k in range(341):
        dq = (-0.95 if k < 40 else 0.999) * out.velocity_limit * sides
        q = q + 1e-3 * dq
        work += 1e-3 * float(torque @ dq)
        if 40 <= k < 340:
            out = controller.missed()
        else:
            out = controller.step(q=q, dq=(1.45 if k == 39 else 1.0) * dq, q0=Q + 0.1, **SPRING)
        torque = out.torque
        assert work <= out.energy_supplied and not out.status & robot.Status.TANK_DEFICIT


def test_a_speed_is_judged_by_the_limit_in_force(robot: ModuleType) -> None:
    """A raise that waits is not yet a limit: joint 2, loaded, is too fast for the old one. Joint 7 has no load."""
    controller = robot.Impedance(**RAISED, tank_initial=1.0, overspeed_time=0.0, errors="ignore")
    q0 = Q + 0.1 * np.eye(7)[1]
    rest(controller, 1500, Q, q0)
    controller.config.velocity_limit = 10.0 * robot.VELOCITY
    out = rest(controller, 1, Q, q0)
    assert out.velocity_limit[1] == robot.VELOCITY[1] and out.velocity_limit[6] == 10.0 * robot.VELOCITY[6]
    last = 1.2 * robot.VELOCITY * np.eye(7)[6]
    out = controller.step(q=Q + 1e-3 * last, dq=last, q0=q0, **SPRING)
    assert not out.fault and not out.status & robot.Status.OVERSPEED
    second = 1.2 * robot.VELOCITY * np.eye(7)[1]
    out = controller.step(q=Q + 1e-3 * (last + second), dq=second, q0=q0, **SPRING)
    assert out.reason == robot.Reason.OVERSPEED and out.fault_joint == 1
    assert out.fault_limit == robot.VELOCITY[1]


def test_a_lowered_limit_acts_at_once(robot: ModuleType) -> None:
    """Calls by the next sample; a velocity is judged by it at once, and counted with once the arm is below it.

    A sample is missing before, while torques of the delay are in transit: then a raised limit would wait.
    """
    limits = RAISED | {"call_gap_limit": 3, "delay_samples": 2}
    controller = robot.Impedance(**limits, overspeed_time=0.01, errors="ignore")
    speed = 0.5 * robot.VELOCITY[6] * np.eye(7)[6]
    outs = [controller.step(q=Q + 1e-3 * k * speed, dq=speed, q0=Q, **SPRING) for k in range(5)]
    assert not outs[-1].fault
    controller.config.velocity_limit = 0.4 * robot.VELOCITY
    controller.config.missed_limit, controller.config.call_gap_limit = 7, 2
    controller.missed()
    out = controller.step(q=Q + 6e-3 * speed, dq=speed, q0=Q, **SPRING)
    assert (out.missed_limit, out.call_gap_limit) == (7, 2) and not out.status & robot.Status.LIMITS_KEPT
    assert out.status & robot.Status.OVERSPEED and out.velocity_limit[6] == robot.VELOCITY[6]
    np.testing.assert_array_equal(out.velocity_limit[:6], 0.4 * robot.VELOCITY[:6])
    out = controller.step(q=Q + 6e-3 * speed, dq=np.zeros(7), q0=Q, **SPRING)
    np.testing.assert_array_equal(out.velocity_limit, 0.4 * robot.VELOCITY)


def test_a_sample_that_is_not_believed_lowers_no_limit(robot: ModuleType) -> None:
    """In a fault: dq stands at 0 while the arm moves at 0.8 of its limit, above the lowered one, which has to wait."""
    controller = robot.Impedance(**RAISED, errors="ignore")
    speed = 0.8 * robot.VELOCITY[6] * np.eye(7)[6]
    for k in range(5):
        controller.step(q=Q + 1e-3 * k * speed, dq=speed, q0=Q, **SPRING)
    controller.config.velocity_limit = 0.5 * robot.VELOCITY
    for k in range(5, 9):
        out = controller.step(q=Q + 1e-3 * k * speed, dq=0.0 * speed, q0=Q, **SPRING)
    assert out.reason == robot.Reason.MISMATCH and out.status & robot.Status.BAD_SAMPLE
    assert out.velocity_limit[6] == robot.VELOCITY[6]
    for _ in range(3):
        out = controller.step(q=Q + 8e-3 * speed, dq=0.0 * speed, q0=Q, **SPRING)
    np.testing.assert_array_equal(out.velocity_limit, 0.5 * robot.VELOCITY)


def test_a_raised_number_of_calls_raises_the_gap_that_it_holds_back(robot: ModuleType) -> None:
    """The gap in force is at most missed_limit in force; each of both is adopted by itself."""
    controller = robot.Impedance(**RAISED | {"call_gap_limit": 6, "missed_limit": 4})
    out = rest(controller, 1500, Q, Q + 0.1)
    assert (out.missed_limit, out.call_gap_limit) == (4, 4)
    controller.config.missed_limit = 900
    out = rest(controller, 1, Q, Q + 0.1)
    assert (out.missed_limit, out.call_gap_limit) == (4, 4) and out.status & robot.Status.LIMITS_KEPT
    controller.config.missed_limit = 5
    out = rest(controller, 1, Q, Q)
    assert (out.missed_limit, out.call_gap_limit) == (5, 5) and not out.status & robot.Status.LIMITS_KEPT
