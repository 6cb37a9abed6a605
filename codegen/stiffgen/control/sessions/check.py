# SPDX-License-Identifier: MIT
"""Compare the compiled controller, step by step, with its law (:mod:`~stiffgen.control.sessions.law`).

Steps that reach the limits (torque, rate, velocity of the reference) and the faults show that these hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from stiffgen.control.page import REFERENCE_SHARE
from stiffgen.control.sessions.bench import ControllerBench
from stiffgen.control.sessions.law import (
    PERIOD,
    TREND_TIME,
    SpringArguments,
    Timing,
    coriolis,
    damping_torque,
    elastic_torque,
    friction_side,
    joint_hessian,
    place_zones,
    potential,
    wrench,
    wrench_torque,
)
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.result import Check, faultless

_BOUND = 1e-8
"""Tolerance for finite-difference comparisons, which lose some digits."""
_MOVE_STEPS = 400
"""Steps of the arm's motion; the command's takes half of them."""
_SLOWEST = 3000
"""Steps in which the reference must arrive after the motion: the tip of a long arm is slower than its joints."""


def check_controller(robot: GeneratedRobot, seed: int) -> list[Check]:
    """Step the compiled controller through a motion, its limits and its faults.

    Returns nothing for a robot without a controller.
    """
    if not hasattr(robot.module, "Impedance"):
        return []
    bench = ControllerBench(robot, seed)
    return [
        *_law(bench),
        faultless("controller: limits", "bounds of the configuration", _limits(bench)),
        faultless("controller: governor", "bounds of the configuration", _governor(bench)),
        faultless("controller: faults", "reaction to bad samples", _faults(bench)),
    ]


def _law(bench: ControllerBench) -> list[Check]:
    """Check a slow motion of arm and reference into the limit zones: every term of the torque, and their sum."""
    errors: dict[str, float] = {}  # the largest one of each quantity, in all steps
    for delay, coriolis_on in ((0, "off"), (5, "on")):
        _Movement(bench, errors, delay, coriolis_on).run()
    return [Check(f"controller: {name}", "differentiated energy, law", error, _BOUND) for name, error in errors.items()]


class _Movement:
    """Motion of an arm in 0.4 s, in its first half followed by the command with feed-forward, and what is compared."""

    def __init__(self, bench: ControllerBench, errors: dict[str, float], delay: int, coriolis_on: str) -> None:
        """Plan the motion of arm and command, and start a controller with room for them around q."""
        self.bench, self.errors, self.timing, self.coriolis = bench, errors, Timing(delay), coriolis_on == "on"
        q, n, reach = bench.q, len(bench.q), bench.reach
        # [rad or m] the arm moves from q to q + way, the command to goal = q + half a reach to either side
        self.way = bench.random.choice([-1.0, 1.0], n) * reach
        self.aim = 0.5 * (bench.random.choice([-1.0, 1.0], n) * reach)
        self.goal = q + self.aim
        # joint springs [N m/rad]; all values differ from joint to joint, so that a mix-up shows
        self.posture = np.linspace(1.0, 3.0, n)
        # [N], [N m] commanded at each tip and pair
        self.wrench = np.tile([5.0, -3.0, 4.0, 0.5, 0.3, -0.2], (len(bench.robot.chain.tips) + len(bench.pairs), 1))
        self.acceleration = np.linspace(-10.0, 10.0, n) * reach
        self.friction, self.trend = np.linspace(0.5, 2.0, n), np.zeros(n)
        self.controller = bench.controller(
            rests=0, lower_limit=q - 1.1 * reach, upper_limit=q + 1.1 * reach, delay_samples=delay,
            velocity_limit=np.linspace(4.5, 10.0, n) * reach, effort_limit=np.linspace(400.0, 500.0, n),
            torque_rate_limit=1e5, coriolis=coriolis_on, coulomb_friction=self.friction,
        )  # fmt: skip
        self.inertia = 0.5 * np.eye(n)
        self.zones = place_zones(self.controller.config, self._mass_matrix(q), self.timing)

    def _mass_matrix(self, q: FloatArray) -> FloatArray:
        return np.asarray(self.bench.mass_matrix(q) + self.inertia)

    def hold(self, name: str, value: Any, reference: Any) -> None:
        """Note an error, relative to the largest entry, or to 1 of its unit if all are smaller."""
        scale = max(1.0, float(np.abs(reference).max()))
        error = float(np.abs(np.ravel(value) - np.ravel(reference)).max()) / scale
        self.errors[name] = max(self.errors.get(name, 0.0), error if np.isfinite(error) else np.inf)

    def run(self) -> None:
        """Step through the motion, then until the reference arrives."""
        last = self.bench.q  # reference of the step before
        for step in range(_MOVE_STEPS + 1):
            at, rate = self._arm(step)
            out = self._step(step, at, rate)
            if step:
                self.hold("reference velocity", out.reference_velocity, (out.reference - last) / PERIOD)
            last = np.array(out.reference)
            self.trend = self.trend + PERIOD / TREND_TIME * (out.reference_velocity - self.trend)
            if step % 40 == 0:  # a comparison takes much longer than a step
                self._compare_springs(out, at)
                self._compare_damping(out, at, rate)
            if step % 100 == 0 and step:  # the wrench has faded in
                self._compare_feedforward(out, at, rate)
        self._arrive(out, at)

    def _arm(self, step: int) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (n) of the arm at a step: half a cosine from q to q + way."""
        phase = np.pi * step / _MOVE_STEPS
        position = self.bench.q + self.way * (0.5 - 0.5 * np.cos(phase))
        velocity = self.way * 0.5 * np.pi / (_MOVE_STEPS * PERIOD) * np.sin(phase)
        return position, velocity

    def _step(self, step: int, at: FloatArray, rate: FloatArray) -> Any:
        """Step with the arm at a position and velocity, and the command on its straight way to the goal."""
        share = min(1.0, step / (_MOVE_STEPS // 2))
        return self.bench.step(
            self.controller, q=at, dq=rate, q0=self.bench.q + self.aim * share, shaped=True,
            posture_stiffness=self.posture, wrench_command=self.wrench[0] if len(self.wrench) == 1 else self.wrench,
            acceleration=self.acceleration,
        )  # fmt: skip

    def _arrive(self, out: Any, at: FloatArray) -> None:
        """Step with the arm at rest at the end of its way until the reference reaches the goal."""
        for _ in range(_SLOWEST):
            if np.abs(out.reference - self.bench.q - self.aim).max() <= 1e-9:
                break
            out = self.bench.step(self.controller, q=at, dq=np.zeros(len(at)), q0=self.goal)
        self.hold("reference arrives", out.reference, self.goal)

    def _springs(self, out: Any) -> SpringArguments:
        """Return the springs of a step: at rest at the reference, which the controller may hold back from q0."""
        return self.bench.springs_of(self.bench.poses(out.reference), out.reference, self.posture)

    def _compare_springs(self, out: Any, at: FloatArray) -> None:
        """Compare torque and energy of springs and zones with the law."""
        poses, spring, zones = self.bench.poses, self._springs(out), self.zones
        # what is left of the torque is that of the springs
        pull = out.own_torque - out.damping_torque - out.limit_torque - out.feedforward_torque
        self.hold("elastic torque", pull, out.scale * elastic_torque(poses, at, *spring))
        self.hold("stored", out.stored, out.scale * potential(poses, at, *spring) + zones.energy(at))
        self.hold("limit torque", out.limit_torque, zones.torque(at))
        self.hold("torque", out.torque, out.own_torque)
        self.hold("no fault", float(out.fault), 0.0)

    def _compare_damping(self, out: Any, at: FloatArray, rate: FloatArray) -> None:
        """Compare damping torque and stiffness share with those that the law designs for the springs' stiffness."""
        zones, limit = self.zones, self.controller.config.velocity_limit
        # stiffness of springs and touched zones (n, n) [N m/rad]
        touched = np.where(zones.depth(at) != 0, zones.stiffness, 0)
        tangent = joint_hessian(self.bench.poses, at, *self._springs(out)) + np.diag(touched)
        excess = rate - np.clip(rate, -REFERENCE_SHARE * limit, REFERENCE_SHARE * limit)
        damping, share = damping_torque(
            tangent, self._mass_matrix(at), self.timing, slip=out.reference_velocity - rate, excess=excess, ratio=0.7
        )
        self.hold("damping torque", out.damping_torque, damping)
        self.hold("stiffness share", out.stiffness_share, share)

    def _compare_feedforward(self, out: Any, at: FloatArray, rate: FloatArray) -> None:
        """Compare the torque of wrench, acceleration, friction and Coriolis forces."""
        expected = wrench_torque(self.bench.poses, at, self.wrench, self.bench.pairs)
        expected = expected + self.friction * friction_side(out.reference_velocity, self.trend)
        if np.any(out.reference_velocity):
            expected = expected + self._mass_matrix(at) @ self.acceleration
        if self.coriolis:
            expected = expected + coriolis(self.bench.mass_matrix, at, rate)
        self.hold("feed-forward torque", out.feedforward_torque, expected)


def _limits(bench: ControllerBench) -> list[str]:
    """Check torque, torque rate, and work against energy_supplied, with a motion and a command that demand more."""
    faults, n = [], len(bench.q)
    effort, rate = np.linspace(0.02, 0.05, n), np.linspace(1.0, 3.0, n)  # so little that both bind
    controller = bench.controller(effort_limit=effort, torque_rate_limit=rate)
    position = bench.q.copy()
    last = np.zeros(n)  # torque of the step before [N m]
    work, supplied = 0.0, 0.0  # [J] done by the torques; said by the controller in the step before
    never = {"RATE_LIMITED", "SATURATED"}  # bits of the status that must occur, and have not yet
    for step in range(200):
        speed = _stop_and_go(step, 2.0 * bench.reach)
        position = position + PERIOD * speed
        out = bench.step(controller, q=position, dq=np.full(n, speed), q0=bench.q + bench.reach)
        if not (np.abs(out.torque) <= effort * (1 + 1e-12)).all():
            faults.append(f"step {step}: torque beyond the effort limit")
        if not (np.abs(out.torque - last) <= rate * PERIOD * (1 + 1e-9)).all():
            faults.append(f"step {step}: torque beyond its rate limit")
        work += float(np.sum(last) * PERIOD * speed) if step else 0.0  # all joints have the same speed
        # what is in springs and tank can still leave
        if not supplied <= out.energy_supplied >= work + out.stored + out.tank - 1e-6:
            faults.append(f"step {step}: work beyond energy_supplied, or less supplied than before")
        last, supplied = np.array(out.torque), float(out.energy_supplied)
        never -= {name for name in never if bench.status(out, name)}
    return faults + [f"never {name}" for name in sorted(never)]


def _stop_and_go(step: int, speed: float) -> float:
    """Return the speed of a motion there and back: 40 steps at one speed, 10 at rest, and the same the other way."""
    if step % 50 >= 40:
        return 0.0
    return speed if step // 50 % 2 else -speed


def _governor(bench: ControllerBench) -> list[str]:
    """Check a jump of the command with a held arm: velocity of the reference and of the tips, and the springs' wrench.

    Each time another limit binds: the joints' velocity, the wrench, the tips' velocity.
    """
    n, reach = len(bench.q), bench.reach
    wide: dict[str, Any] = {
        "velocity_limit": np.full(n, 5.0), "heaviest_wrench": (1e4, 1e4), "tip_velocity_limit": (100.0, 100.0)
    }  # fmt: skip
    binding: tuple[dict[str, Any], ...] = (
        {"velocity_limit": np.linspace(0.2, 0.5, n) * reach},
        {"heaviest_wrench": (2.0, 0.2)},
        {"tip_velocity_limit": (0.2 * reach, 0.4 * reach)},
    )
    return [fault for limit in binding for fault in _jump_faults(bench, **wide | limit)]


def _jump_faults(
    bench: ControllerBench,
    velocity_limit: FloatArray,
    heaviest_wrench: tuple[float, float],
    tip_velocity_limit: tuple[float, float],
) -> list[str]:
    """Command a jump of all joints by ``reach`` for 0.3 s, and check the reference's motion against the limits."""
    faults = []
    controller = bench.controller(
        velocity_limit=velocity_limit, heaviest_wrench=heaviest_wrench, tip_velocity_limit=tip_velocity_limit,
        ramp_time=1e-3,
    )  # fmt: skip
    here = np.reshape(bench.poses(bench.q), (-1, 4, 4))
    last, tips = bench.q, here  # reference of the step before, and the tips' poses there
    for step in range(300):
        out = bench.rest(controller, q0=bench.q + bench.reach)
        if not (np.abs(out.reference - last) <= REFERENCE_SHARE * velocity_limit * PERIOD * (1 + 1e-9)).all():
            faults.append(f"step {step}: the reference is faster than the velocity limit allows")
        moved = np.reshape(bench.poses(out.reference), (-1, 4, 4))
        # |R' - R| = 2 sqrt(2) sin(angle / 2): sqrt(2) times the angle, up to 1e-8 of it here
        turned = np.linalg.norm(moved[:, :3, :3] - tips[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
        way = np.linalg.norm(moved[:, :3, 3] - tips[:, :3, 3], axis=1)
        if not ((way <= tip_velocity_limit[0] * PERIOD) & (turned <= tip_velocity_limit[1] * PERIOD)).all():
            faults.append(f"step {step}: the reference is faster than the tip's limits")
        last, tips = np.array(out.reference), moved
    for tip, pose in enumerate(here):
        pushed = wrench(partial(bench.energy, tip, here, tips), pose)
        force, moment = (np.linalg.norm(part) for part in pushed.reshape(2, 3))
        # an ellipse: of the heaviest force alone, of the heaviest moment alone, or less of both
        if not np.linalg.norm([force / heaviest_wrench[0], moment / heaviest_wrench[1]]) <= 1 + 1e-6:
            faults.append("the springs exert more than heaviest_wrench")
    if (last == bench.q).any():
        faults.append("a joint of the reference does not move")
    return faults


def _faults(bench: ControllerBench) -> list[str]:
    """Check that one bad sample is no fault, and that two of three, or a value beyond a limit, latch a fault.

    In a fault the torque keeps its limits, the springs' scale falls to 0, and a reset ends the fault.
    """
    q = bench.q
    first = np.arange(len(q)) == 0
    spoilt: dict[str, Mapping[str, Any]] = {
        "NaN in q": {"q": np.where(first, np.nan, q)},
        "infinity in q": {"q": np.where(first, np.inf, q)},
        "NaN in dq": {"dq": np.where(first, np.nan, 0.0)},
        "a jump of q": {"q": q + 3.0 * first},
        "dq without a change of q": {"dq": 6.0 * first},
    }
    faults = [fault for title, changed in spoilt.items() for fault in _sensor_faults(bench, title, changed)]
    return [*faults, *_release_faults(bench), *_other_faults(bench)]


def _sensor_faults(bench: ControllerBench, title: str, changed: Mapping[str, Any]) -> list[str]:
    """Pass a bad sample once, then twice; then reset. The torque keeps its limits all the time."""
    faults, sensor = [], bench.robot.module.Fault.SENSOR
    effort, rate = 50.0, 500.0  # [N m], [N m/s]
    controller = bench.controller(effort_limit=effort, torque_rate_limit=rate)
    goal = bench.q + 0.1 * bench.reach
    last = np.array([bench.rest(controller, q0=goal) for _ in range(55)][-1].torque)

    def stepped(**given: Any) -> Any:
        """Step once, compare the torque with its limits, and return the output."""
        out = bench.rest(controller, q0=goal, **given)
        largest, change = np.abs(out.torque).max(), np.abs(out.torque - last).max()
        if not (largest <= effort and change <= rate * PERIOD * (1 + 1e-9)):
            faults.append(f"{title}: torque beyond its limits")
        last[:] = out.torque
        return out

    once = stepped(**changed)
    if once.fault or not bench.status(once, "BAD_SAMPLE"):
        faults.append(f"{title}: one sample is not just a bad one")
    if stepped(**changed).fault != sensor:
        faults.append(f"{title}: twice is no sensor fault")
    rows = [stepped() for _ in range(200)]  # twice the 0.1 s in which 50 N m fall to 0 at 500 N m/s
    if not all(out.fault == sensor and bench.status(out, "FAULT") for out in rows):
        faults.append(f"{title}: the fault does not stay")
    if rows[-1].torque.any():
        faults.append(f"{title}: a torque stays in a fault")
    controller.reset()
    if [stepped() for _ in range(20)][-1].fault:
        faults.append(f"{title}: reset does not clear the fault")
    return faults


def _release_faults(bench: ControllerBench) -> list[str]:
    """Move faster than the velocity limit until that is a fault; the springs then let go with their energy known."""
    n, speed = len(bench.q), 2.4 * bench.reach
    # the second joint's limit is the tighter one, where there are several
    tightest = min(1, n - 1)
    limit = np.where(np.arange(n) == tightest, 2.0, 8.0) * bench.reach
    controller = bench.controller(velocity_limit=limit, effort_limit=50.0, torque_rate_limit=50.0)
    q, faults, steps = bench.q, [], 0
    while steps < 300:
        steps += 1
        q = q + speed * PERIOD
        out = bench.step(controller, q=q, dq=np.full(n, speed), q0=bench.q)
        if out.fault:
            break
    if out.reason != bench.robot.module.Reason.OVERSPEED or steps != 201 or out.fault_joint != tightest:
        faults.append("overspeed is no fault after 0.2 s")
    return [*faults, *_scale_faults(bench, controller, q)]


def _scale_faults(bench: ControllerBench, controller: Any, q: FloatArray) -> list[str]:
    """Step with the arm at rest at q, in a fault, until the springs' scale is 0; ``stored`` is the scaled energy."""
    faults, scales = [], []
    for _ in range(2000):
        out = bench.step(controller, q=q, dq=np.zeros(len(q)), q0=bench.q)
        spring = bench.springs_of(bench.poses(out.reference), out.reference, 1.0)
        whole = potential(bench.poses, q, *spring)
        if not abs(out.stored - out.scale * whole) <= _BOUND * max(1.0, whole):
            faults.append("springs that are let go store another energy")
            break
        scales.append(float(out.scale))
        if out.scale == 0.0:
            break
    if not any(0.0 < scale < 1.0 for scale in scales) or scales[-1] != 0.0:
        faults.append("the springs are not let go in a fault")
    return faults


def _other_faults(bench: ControllerBench) -> list[str]:
    """Check faults of communication and position, and that a command with NaN is refused without a fault."""
    return [*_missed_faults(bench), *_position_faults(bench), *_refusal_faults(bench)]


def _missed_faults(bench: ControllerBench) -> list[str]:
    """Leave out samples: the tenth in a row is a fault of communication, none before it."""
    controller = bench.controller()
    kinds = [int(controller.missed(counter=bench.count + 1 + k).fault) for k in range(10)]
    return [] if kinds == [0] * 9 + [int(bench.robot.module.Fault.COMMUNICATION)] else ["missed samples"]


def _position_faults(bench: ControllerBench) -> list[str]:
    """Place the arm on both sides of where the fault begins: 0.1 rad or m beyond a limit."""
    q, reasons, faults = bench.q, bench.robot.module.Reason, []
    for name, outwards in (("upper_limit", 1.0), ("lower_limit", -1.0)):
        for beyond, expected in ((0.099, reasons.NONE), (0.101, reasons.POSITION)):
            bounds = {"lower_limit": q - 1.0, "upper_limit": q + 1.0, name: q - outwards * beyond}
            if bench.rest(bench.controller(rests=0, **bounds)).reason != expected:
                faults.append(f"{beyond} beyond {name} is {'no' if expected else 'a'} fault")
    return faults


def _refusal_faults(bench: ControllerBench) -> list[str]:
    """Command NaN in the first entry of each argument: the command is refused, and nothing else happens."""
    reasons, faults = bench.robot.module.Refused, []
    for name in ("q0", "translation_stiffness", "rotation_stiffness"):
        controller = bench.controller()
        wrong = np.array(bench.q if name == "q0" else bench.spring[name])
        wrong.flat[0] = np.nan
        out = bench.rest(controller, **{name: wrong})
        is_refused = out.refusal is not None and out.refusal.reason == reasons.NOT_FINITE
        if not is_refused or not bench.status(out, "COMMAND_REFUSED") or not np.isfinite(out.torque).all() or out.fault:
            faults.append(f"NaN in {name} is not refused")
    return faults
