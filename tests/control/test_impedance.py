# SPDX-License-Identifier: MIT
"""The controller's interface: what must be stated, what is refused and why, clocks, restarts, records."""

from __future__ import annotations

import copy
import ctypes
import pickle
import re
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stiffgen.control.core.config import CONFIG, CONFIG_SECTIONS, STATED
from stiffgen.control.core.memory import RECORDS
from support.controller_inputs import KO, KT, SPRING, Arm, Q, walk
from support.controller_inputs import STATED as ARM
from support.plant.loop import struct
from support.project import ROOT

HEADER = ROOT / "generated" / "iiwa14" / "iiwa14_impedance.h"
AT_REST: dict[str, Any] = {"q": Q, "dq": np.zeros(7), "q0": Q, **SPRING}


def test_at_most_twenty_fields_and_each_has_a_reason() -> None:
    """Check the configuration: at most 20 fields, each with unit and reason, and the header says them."""
    everywhere = [field for field in CONFIG if not field.when]
    assert len(everywhere) <= 20
    assert all(field.reason for field in CONFIG)
    assert all(field.unit or field.choices or field.name == "damping_ratio" for field in CONFIG)
    assert [field.name for field in CONFIG if not field.default] == [field.name for field in STATED]
    text = " ".join(HEADER.read_text().replace("\n     *", "").split())
    for heading, fields in CONFIG_SECTIONS:
        assert f"---- {heading} ----" in text
        for field in (each for each in fields if not each.when):
            said = "MUST BE STATED" if field in STATED else "Default: "
            assert re.search(rf"{said}[^/]*{re.escape(field.reason)}\. \*/ \w+ {field.name}", text), field.name


@pytest.mark.parametrize("name", [field.name for field in STATED])
def test_what_has_no_default_is_named(robot: ModuleType, name: str) -> None:
    """Python names the missing argument; C's init returns the field's error, whose text says why."""
    given = {field: value for field, value in ARM.items() if field != name}
    with pytest.raises(TypeError, match=f"missing 1 required keyword-only argument: '{name}'"):
        robot.Impedance(**given)
    with pytest.raises(ValueError, match=rf"{name} \[.*\]: state it, since"):
        robot.Impedance(**given, **{name: -1 if name == "delay_samples" else np.nan})


def test_a_field_that_does_not_exist_or_is_out_of_range(robot: ModuleType) -> None:
    """Give unknown fields and values out of range: the error names the field and what it takes."""
    with pytest.raises(TypeError, match="no configuration field 'engagement_limit'; there are: sample_time"):
        robot.Impedance(**ARM, engagement_limit=1.0)
    with pytest.raises(ValueError, match="damping_ratio: must lie between 0 and 2"):
        robot.Impedance(**ARM, damping_ratio=3.0)
    with pytest.raises(ValueError, match="communication_reaction: no value 'stop'; it takes release, hold, resume"):
        robot.Impedance(**ARM, communication_reaction="stop")
    with pytest.raises(ValueError, match="lower must be below upper"):
        robot.Impedance(**ARM, lower_limit=1.0, upper_limit=1.0)


def test_a_configuration_is_kept(robot: ModuleType) -> None:
    """Assign to a configuration in use: refused, and restart() takes the change and keeps the other fields."""
    controller = robot.Impedance(**ARM)
    with pytest.raises(AttributeError, match=r"damping_ratio: a controller keeps its configuration; restart\(torque"):
        controller.config.damping_ratio = 1.0
    controller.restart(damping_ratio=1.0)
    assert controller.config.damping_ratio == 1.0
    assert controller.config.sample_time == ARM["sample_time"]
    assert controller.config.communication_reaction == "release"


OLD = {
    "equilibrium": (np.eye(4), r"equilibrium: .*follow\.step\(pose=equilibrium\)"),
    "posture": (Q, r"posture: .*follow\.step\(pose=pose, posture=posture\)"),
    "tool_pose": (np.eye(4), r"tool_pose: .*iiwa14\.Impedance\(\.\.\., tool_pose=tool_pose\)"),
    "velocity": (Q, "velocity: .*shaped=True"),
    "wrench": (np.zeros(6), "wrench: a step reads no measured wrench"),
    "damping_ratio": (1.0, r"damping_ratio: .*controller\.restart\(torque, damping_ratio="),
    "speed": (1.0, "speed: no such argument; there are: sample_valid"),
}


@pytest.mark.parametrize("name", OLD)
def test_old_arguments_are_told_the_new_line(robot: ModuleType, name: str) -> None:
    """Pass an argument of an older release: the error says the line to write now."""
    value, words = OLD[name]
    controller = robot.Impedance(**ARM)
    with pytest.raises(TypeError, match=words):
        controller.step(**AT_REST, counter=0, **{name: value})
    with pytest.raises(TypeError, match=words):
        controller.run(**AT_REST, counter=[0], **{name: value})


def test_a_step_without_a_clock_is_refused(robot: ModuleType) -> None:
    """Step without a clock: TypeError in Python; C holds the torque and lets it fall. Before: 73 J."""
    controller = robot.Impedance(**ARM)
    for given in ({}, {"counter": 1, "time": 0.1}):
        with pytest.raises(TypeError, match=r"give counter= .* or time="):
            controller.step(**AT_REST, **given)
    with pytest.raises(TypeError, match="give counter="):
        controller.missed()
    with pytest.raises(TypeError, match="give counter="):
        controller.run(**AT_REST)


def held_away(robot: ModuleType, **config: Any) -> tuple[Any, Any]:
    """Return a controller whose springs pull at an arm that stands still, and its last output."""
    controller = robot.Impedance(**ARM, position_quantum=2e-6, **config)
    for k in range(600):
        out = controller.step(**AT_REST | {"q0": Q + 0.1}, counter=k)
    assert np.abs(out.torque).max() > 5 and not out.fault
    return controller, out


def test_a_counter_that_stands_still_ends_the_account(robot: ModuleType) -> None:
    """Stop the counter for 0.6 s: the controller goes limp (CLOCK), and brakes once the counter moves again."""
    controller, last = held_away(robot)
    for k in range(600):
        out = controller.step(**AT_REST | {"q0": Q + 0.1}, counter=599)
        if k < 2:  # at first the torque stays as it was
            np.testing.assert_array_equal(out.torque, last.torque)
    assert out.reason == robot.Reason.CLOCK and out.mode == robot.Mode.LIMP
    assert not out.torque.any()
    moving = np.full(7, 0.1)  # [rad/s]
    for k in range(700, 740):  # the clock goes on: damping brakes, the springs wait for the reset
        out = controller.step(**AT_REST | {"q": Q + moving * 1e-3 * (k - 700), "dq": moving}, counter=k)
    assert out.mode == robot.Mode.FOLLOW and out.torque @ moving < -0.1 and out.stored == 0.0
    controller.reset()
    for k in range(740, 760):
        out = controller.step(**AT_REST, counter=k)
    assert out.mode == robot.Mode.ACTIVE


def test_time_counts_samples(robot: ModuleType) -> None:
    """Calls at the times of a jittering loop are those of a counter; lost calls are seen."""
    random = np.random.default_rng(1)
    by_counter, by_time = robot.Impedance(**ARM), robot.Impedance(**ARM)
    inputs = walk(random, robot, 400)
    for k in range(400):
        if k % 50 in (48, 49):
            continue
        sample = {name: inputs[name][k] for name in ("q", "dq", "q0", "translation_stiffness", "rotation_stiffness")}
        a = by_counter.step(**sample, counter=k)
        b = by_time.step(**sample, time=17.0 + 1e-3 * (k + random.uniform(-0.3, 0.3)))
        np.testing.assert_array_equal(a.torque, b.torque)
        assert a.energy_supplied == b.energy_supplied
    out = by_time.step(**sample, time=17.2)  # a clock that goes back
    assert out.status & robot.Status.MISSED


REFUSED: dict[str, tuple[dict[str, Any], str, int, str]] = {
    "not finite": ({"q0": np.where(np.arange(7) == 3, np.nan, Q)}, "q0", 3, "NOT_FINITE"),
    "position": ({"q0": np.degrees(Q)}, "q0", 0, "POSITION"),
    "stiffness": ({"translation_stiffness": 6e3 * np.eye(3)}, "translation_stiffness", 0, "STIFFNESS_LIMIT"),
    "asymmetric": ({"rotation_stiffness": KO + 5 * np.eye(3)[[1, 2, 0]]}, "rotation_stiffness", 1, "ASYMMETRIC"),
    "indefinite": ({"translation_stiffness": np.diag([100.0, -5, 3])}, "translation_stiffness", 0, "INDEFINITE"),
    "posture": ({"posture_stiffness": -np.eye(7)[2]}, "posture_stiffness", 2, "STIFFNESS_LIMIT"),
    "wrench": ({"wrench_command": [0, 90, 90, 0, 0, 0]}, "wrench_command", 0, "WRENCH"),
    "moment": ({"wrench_command": [0, 0, 0, 0, 0, -21]}, "wrench_command", 5, "WRENCH"),
    "acceleration": ({"acceleration": 99 * np.eye(7)[4], "shaped": True}, "acceleration", 4, "ACCELERATION"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_has_command_entry_seen_and_limit(robot: ModuleType, name: str) -> None:
    """Refuse a command: the reference stays, and the output says what was seen, in numbers and words."""
    changed, command, entry, reason = REFUSED[name]
    controller = robot.Impedance(**ARM, errors="ignore")
    before = controller.step(**AT_REST, counter=0)
    out = controller.step(**AT_REST | changed, counter=1)
    assert out.status & robot.Status.COMMAND_REFUSED and not out.fault
    assert (out.refusal.command, out.refusal.entry, out.refusal.reason.name) == (command, entry, reason)
    np.testing.assert_array_equal(out.reference, before.reference)
    value = np.ravel(changed[command])[entry]
    if reason in ("POSITION", "STIFFNESS_LIMIT", "ACCELERATION") or name == "moment":
        assert out.refusal.seen == value and abs(out.refusal.limit) < abs(value)
    if command == "q0":
        assert f"q0 of A{entry + 1}: " in out.refusal.text
    elif reason != "NOT_FINITE":
        assert f"{command}, entry {entry}: " in out.refusal.text and "limit " in out.refusal.text
    assert controller.step(**AT_REST, counter=2).refusal is None


def test_a_refused_command_warns_once_or_raises(robot: ModuleType) -> None:
    """Command q0 beyond the limits: one warning for three samples, or an exception with errors="raise"."""
    controller = robot.Impedance(**ARM)
    with pytest.warns(robot.CommandWarning, match="beyond the joint's limit") as told:
        for k in range(3):
            controller.step(**AT_REST | {"q0": 10 * Q}, counter=k)
    assert len(told) == 1
    with pytest.raises(ValueError, match="command refused: q0 of A2"):
        robot.Impedance(**ARM, errors="raise").step(**AT_REST | {"q0": 10 * Q}, counter=0)


def test_the_torque_is_that_of_springs_and_damping(robot: ModuleType) -> None:
    """Compare the torque at rest with the spring's kernel at the reference and the posture spring."""
    _, out = held_away(robot, tank_initial=200.0)
    E = robot.forward_kinematics(out.reference)
    expected = robot.spring.torque(Q, E, KT, KO) + 1.0 * (out.reference - Q)
    np.testing.assert_allclose(out.torque, expected, atol=1e-9)
    assert out.stored == pytest.approx(
        float(robot.spring.energy(Q, E, KT, KO)) + 0.5 * float(((out.reference - Q) ** 2).sum()), rel=1e-9
    )
    assert not out.damping_torque.any()


def test_damping_is_that_of_the_modes(robot: ModuleType) -> None:
    """Compute B = L f(C) L^T + d I from NumPy's eigenvectors, with f(l) for the ratio and half a sample of delay."""
    controller = robot.Impedance(**ARM, tank_initial=500.0)
    out = controller.step(**AT_REST, counter=0)
    dq = 0.05 * np.arange(1.0, 8.0)
    q, T, zeta = Q + 1e-3 * dq, 1e-3, 0.7
    out = controller.step(**AT_REST | {"q": q, "dq": dq}, counter=1)
    E = robot.forward_kinematics(out.reference)
    M = robot.mass_matrix(q) + 0.1 * np.eye(7)  # with the rotors' 0.1 kg m^2
    L = np.linalg.cholesky(M)
    K = robot.spring.joint_stiffness(q, E, KT, KO) + np.eye(7)  # with the posture's 1 N m/rad
    values, V = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, K).T))
    # 250 / s is the largest eigenvalue of M^-1 B; the joints' own damping d takes at most half of it.
    softness, late = np.diag(np.linalg.inv(M)).sum(), 0.5 * T
    own = min(0.1, 0.5 * 250 / softness)
    p = np.abs(values) * late * (2 * zeta**2 - 1)
    square = p**2 + 4 * zeta**2 * np.abs(values) - (values * late) ** 2
    b = np.maximum(np.sqrt(np.maximum(square, 0)) - p, np.abs(values) * late)
    B = L @ (V * np.minimum(b, 250 - own * softness)) @ V.T @ L.T + own * np.eye(7)
    np.testing.assert_allclose(out.damping_torque, -B @ dq, rtol=1e-9)


def test_a_q0_in_a_limit_zone_is_followed_to_the_zone(robot: ModuleType) -> None:
    """Command q0 beyond a joint limit: the reference stops 0.1 rad before it, where the limit zone begins."""
    controller, arm = robot.Impedance(**ARM), Arm(robot, Q)
    goal = Q.copy()
    goal[5] = robot.UPPER[5] + 0.05
    for k in range(4000):
        out = controller.step(**AT_REST | {"q": arm.q, "dq": arm.dq, "q0": goal}, counter=k)
        arm.step(out.torque)
    assert out.status & robot.Status.COMMAND_LIMITED and out.limited_joint == 5 and not out.fault
    assert out.reference[5] == pytest.approx(robot.UPPER[5] - 0.1)
    assert arm.q[5] < robot.UPPER[5]


def test_a_restart_with_the_torque_in_force_has_no_jump(robot: ModuleType) -> None:
    """Restart with the last torque: the next one differs by at most the torque rate limit times 1 ms."""
    controller, last = held_away(robot)
    controller.restart(last.torque, damping_ratio=1.0)
    out = controller.step(**AT_REST | {"q0": Q + 0.1}, counter=0)
    assert np.all(np.abs(out.torque - last.torque) <= 1e-3 * controller.config.torque_rate_limit * (1 + 1e-9))
    assert out.energy_supplied > controller.config.tank_initial
    with pytest.raises(ValueError, match="initial torque is not finite or beyond the effort limit"):
        controller.restart(1e3)


def test_samples_that_are_lost_and_come_back(robot: ModuleType) -> None:
    """Miss samples until a fault, then give good ones: each reaction (release, hold, resume) goes on as it says."""
    modes = {}
    for reaction in ("release", "hold", "resume"):
        controller, _ = held_away(robot, communication_reaction=reaction)
        for k in range(600, 615):  # more than the ten that are borne
            out = controller.missed(counter=k)
        assert out.reason == robot.Reason.MISSED
        for k in range(615, 1000):
            out = controller.step(**AT_REST | {"q0": Q + 0.1}, counter=k)
        modes[reaction] = out.mode.name
        controller.reset()
        for k in range(1000, 1010):
            out = controller.step(**AT_REST | {"q0": Q + 0.1}, counter=k)
        assert out.mode.name == "ACTIVE"
    assert modes == {"release": "FOLLOW", "hold": "HOLD", "resume": "ACTIVE"}


def test_a_reset_after_a_lost_sensor_brakes_a_coasting_arm(robot: ModuleType) -> None:
    """Reset after a lost sensor while the arm coasts: springs begin slack where it is, and only brake it."""
    for joint in range(7):
        controller, arm = robot.Impedance(**ARM, position_quantum=2e-6), Arm(robot, Q)
        springs, work, most = {**AT_REST, "translation_stiffness": 2000 * np.eye(3)}, 0.0, 0.0
        for k in range(10):
            springs |= {"q": arm.q * (np.nan if k > 5 else 1.0), "dq": arm.dq}  # the sensor is lost
            out = controller.step(**springs, counter=k)
        assert out.reason == robot.Reason.NOT_FINITE
        arm.dq[joint] = 0.8 * robot.VELOCITY[joint]
        for k in range(10, 1000):
            if k == 60:
                assert not out.torque.any() and out.fault == robot.Fault.SENSOR
                controller.reset()
                springs["q0"] = arm.q
            out, before = controller.step(**springs | {"q": arm.q, "dq": arm.dq}, counter=k), arm.dq
            arm.step(out.torque - robot.bias_forces(arm.q, arm.dq, np.zeros(3)))
            work += 1e-3 * float(out.torque @ (before + arm.dq)) / 2
            most = max(most, float(np.max(np.abs(arm.dq) / robot.VELOCITY)))
            assert work < 1e-6
        assert out.mode == robot.Mode.ACTIVE and not out.fault and most < 1.05  # of the velocity limit
        assert np.max(np.abs(arm.dq) / robot.VELOCITY) < 0.4  # self-motion, which no spring opposes, ends slowly


def test_a_wrench_is_exerted_and_paid_from_the_tank(robot: ModuleType) -> None:
    """Command a wrench: it is J^T F at rest, its share rises from 0, and the tank pays for the work of a tip that
    gives way.
    """
    controller = robot.Impedance(**ARM, tank_initial=100.0, position_quantum=2e-6)
    wrench = np.array([5.0, 0, -20, 0, 1, 0])  # [N], [N m]
    for k in range(200):  # 0.2 s: the share has risen to 1
        out = controller.step(**AT_REST, counter=k, wrench_command=wrench)
    J = np.reshape(robot.hybrid.jacobian(Q), (6, 7))
    np.testing.assert_allclose(out.feedforward_torque, J.T @ wrench, atol=1e-9)
    np.testing.assert_allclose(out.torque, J.T @ wrench, atol=1e-9)
    q, tank, work = Q.copy(), out.tank + out.stored, 0.0
    dq = np.linalg.pinv(J) @ [0, 0, -0.05, 0, 0, 0]  # the tip gives way at 50 mm/s
    for k in range(200, 300):
        work += float(out.torque @ (1e-3 * dq))
        q = q + 1e-3 * dq
        out = controller.step(**AT_REST | {"q": q, "dq": dq}, counter=k, wrench_command=wrench)
    assert out.tank + out.stored == pytest.approx(tank - work, abs=1e-9) and work > 0.05


def test_coriolis_forces_are_compensated(robot: ModuleType) -> None:
    controller, dq = robot.Impedance(**ARM, coriolis="on", tank_initial=500.0), 0.2 * np.ones(7)
    controller.step(**AT_REST, counter=0)
    q = Q + 1e-3 * dq
    out = controller.step(**AT_REST | {"q": q, "dq": dq}, counter=1)
    np.testing.assert_allclose(out.feedforward_torque, robot.bias_forces(q, dq, np.zeros(3)), atol=1e-12)


def test_friction_is_fed_forward_by_the_reference_alone(robot: ModuleType) -> None:
    """Move reference and arm: friction is fed forward by the reference alone, in full from 0.02 rad/s on."""
    friction = np.linspace(0.5, 2.0, 7)
    controller = robot.Impedance(**ARM, tank_initial=500.0, position_quantum=2e-6, coulomb_friction=friction)
    for k in range(400):  # until the reference has stopped braking: friction ends before it
        goal = Q + 1e-3 * k * np.array([0.3, -0.3, 0.01, -0.01, 0.0, 0.1, 0.0])
        out = controller.step(**AT_REST | {"q0": goal}, counter=k, shaped=True)
    np.testing.assert_allclose(out.reference_velocity, [0.3, -0.3, 0.01, -0.01, 0, 0.1, 0], atol=1e-9)
    np.testing.assert_allclose(out.feedforward_torque, friction * [1, -1, 0.5, -0.5, 0, 1, 0], atol=1e-6)
    still = robot.Impedance(**ARM, tank_initial=500.0, coulomb_friction=friction)
    for k in range(5):
        moved = {"q": Q + 1e-3 * k * 0.2, "dq": np.full(7, 0.2)}
        out = still.step(**AT_REST | moved, counter=k)
    assert not out.feedforward_torque.any()


def test_an_acceleration_carries_a_shaped_plan(robot: ModuleType) -> None:
    """M ddr, only with shaped, and only while the reference moves."""
    controller = robot.Impedance(**ARM, tank_initial=500.0, position_quantum=2e-6)
    acceleration = np.array([1.0, 0, 0, -2, 0, 0, 0])
    for k in range(5):
        goal = Q + 0.5 * acceleration * (1e-3 * k) ** 2
        out = controller.step(**AT_REST | {"q0": goal}, counter=k, shaped=True, acceleration=acceleration)
    M = robot.mass_matrix(Q) + 0.1 * np.eye(7)
    np.testing.assert_allclose(out.feedforward_torque, M @ acceleration, atol=1e-9)
    out = controller.step(**AT_REST | {"q0": goal}, counter=5, acceleration=acceleration)
    assert not out.feedforward_torque.any()


def test_copies_and_pickles_share_nothing(robot: ModuleType) -> None:
    controller, _ = held_away(robot)
    others = [copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))]
    out = controller.step(**AT_REST, counter=600)
    for other in others:
        np.testing.assert_array_equal(other.step(**AT_REST, counter=600).torque, out.torque)


def test_a_record_keeps_the_newest_steps(robot: ModuleType) -> None:
    controller = robot.Impedance(**ARM, record=10)
    inputs = walk(np.random.default_rng(0), robot, 25)
    rows = controller.run(**inputs)
    told, outs = controller.trace
    np.testing.assert_array_equal(told.counter, np.arange(15, 25))
    np.testing.assert_array_equal(outs.torque, rows.torque[-10:])


def test_structs_have_no_gaps() -> None:
    """NumPy reads a row of outputs as it is only then, and the checksum sees every byte of a record."""
    for name in ("output", *(record for record, _, _ in RECORDS)):
        made = struct(HEADER, f"iiwa14_impedance_{name}", {}, {})
        assert ctypes.sizeof(made) == sum(getattr(made, field).size for field, *_ in made._fields_), name
