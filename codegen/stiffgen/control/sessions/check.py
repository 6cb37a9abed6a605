# SPDX-License-Identifier: MIT
"""Compare the compiled controller, step by step, with its law (:mod:`~stiffgen.control.sessions.law`).

Steps that reach the limits (torque, rate, velocity of the reference) and the faults show that these hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from stiffgen.control.page import pairs_of
from stiffgen.control.sessions.law import (
    PERIOD,
    Timing,
    coriolis,
    damping_torque,
    differences,
    elastic_torque,
    energy_of_all,
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
_STATED = {"sample_time": PERIOD, "delay_samples": 0, "motor_inertia": 0.5, "heaviest_wrench": (1e4, 1e4)}
"""Configuration fields without a default."""


class _Bench:
    """Robot's controller with samples around one configuration, close to which all limits lie.

    ``reach`` is the distance [rad or m] that each joint moves from ``q`` in these sessions. ``spring`` has the
    stiffnesses, ``tools`` the tools of a robot that takes them.
    """

    def __init__(self, robot: GeneratedRobot, seed: int) -> None:
        """Draw a configuration within the limits, tools and springs [N/m, N m/rad] of all tips and pairs."""
        self.robot, chain = robot, robot.chain
        self.random = np.random.default_rng(seed)
        lower, upper = self._bounds()
        span = upper - lower
        self.q = lower + span * self.random.uniform(0.35, 0.65, len(span))  # the middle third of each range
        self.reach = float(min(0.1, 0.2 * np.abs(span).min()))
        tips, self.pairs = len(chain.tips), [(each.first, each.second) for each in pairs_of(chain, robot.springs.pairs)]
        self.tools = np.broadcast_to(np.eye(4), (tips, 4, 4)).copy()
        # [m] off all axes, different for each tip
        self.tools[:, :3, 3] = np.array([0.02, -0.03, 0.1]) + np.arange(tips)[:, None] * (0.05, 0.0, 0.0)
        roots = self.random.normal(size=(2, tips + 2 * len(self.pairs), 3, 3))
        # Positive definite, of the size 300 N/m and 20 N m/rad.
        Kt, Ko = (roots @ np.swapaxes(roots, 2, 3) / 3 + 0.3 * np.eye(3)) * np.array([300.0, 20.0])[:, None, None, None]
        if tips == 1:
            self.tools, Kt, Ko = self.tools[0], Kt[0], Ko[0]
        self.spring = {"translation_stiffness": Kt, "rotation_stiffness": Ko}
        self.count = 0

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the motors' positions; with closed loops they are near a closed configuration."""
        chain = self.robot.chain
        limits = np.array([c.range_within(1.5) for c in chain.motor_coordinates])
        if chain.loops:
            middle = np.array(chain.start)[list(chain.actuated)]
            return middle - 0.15, middle + 0.15
        return limits[:, 0], limits[:, 1]

    def joints(self, q: FloatArray) -> FloatArray:
        """Return the positions of all joints at the motors' positions q."""
        chain = self.robot.chain
        return np.asarray(self.robot.kernels["close"](q, np.array(chain.start))) if chain.loops else q

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return the motors' mass matrix: G^T M G with closed loops, G = d joints/dq by differences."""
        M = np.asarray(self.robot.kernels["mass_matrix"](self.joints(q)))
        if not self.robot.chain.loops:
            return M
        G = differences(self.joints, q).T
        return np.asarray(G.T @ M @ G)

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the poses of all tips, from the kernels."""
        chain, kernels = self.robot.chain, self.robot.kernels
        joints = self.joints(q)
        names = [""] if len(chain.tips) == 1 else [f"{tip.name}_" for tip in chain.tips]
        tools = np.reshape(self.tools, (-1, 4, 4))
        arguments = [(joints, tool) if chain.runtime_tool else (joints,) for tool in tools]
        rows = [kernels[f"{name}forward_kinematics"](*each) for name, each in zip(names, arguments, strict=True)]
        return np.array(rows)

    def controller(self, *, rests: int = 5, **config: Any) -> Any:
        """Return a controller engaged at rest at q, with limits beyond reach.

        The positions are coarse: an arm that stays where it is to the last bit is no frozen encoder.
        """
        room = {
            **_STATED, "lower_limit": self.q - 4 * self.reach, "upper_limit": self.q + 4 * self.reach,
            "velocity_limit": 10.0, "effort_limit": 1e4, "torque_rate_limit": 1e8, "tip_velocity_limit": 100.0,
            "tank_initial": 1e4, "position_quantum": 1e-5,
            **({"tool_pose": self.tools} if self.robot.chain.runtime_tool else {}),
        }  # fmt: skip
        self.count = 0
        controller = self.robot.module.Impedance(**{**room, **config}, errors="ignore")
        for _ in range(rests):
            self.rest(controller)
        return controller

    def step(self, controller: Any, **given: Any) -> Any:
        """Step once, at the next sample time."""
        self.count += 1
        return controller.step(counter=self.count, **{**self.spring, **given})

    def rest(self, controller: Any, **changed: Any) -> Any:
        """Step once at q, at rest."""
        return self.step(controller, **{"q": self.q, "dq": np.zeros(len(self.q)), "q0": self.q, **changed})

    @property
    def where(self) -> tuple[Any, ...]:
        """Axes and centre of the tips' springs, and the pairs."""
        return self.robot.springs.placement, self.pairs

    def energy(self, tip: int, here: FloatArray, equilibria: FloatArray, pose: FloatArray) -> float:
        """Return the springs' energy with one tip at another pose."""
        poses = np.where(np.arange(len(here))[:, None, None] == tip, pose, here)
        return energy_of_all(poses, equilibria, *self.spring.values(), *self.where)

    def status(self, out: Any, *names: str) -> bool:
        """Return whether any of the bits is set."""
        return any(out.status & self.robot.module.Status[name] for name in names)


def check_controller(robot: GeneratedRobot, seed: int) -> list[Check]:
    """Step the compiled controller through a motion, its limits and its faults.

    Returns nothing for a robot without a controller.
    """
    if not hasattr(robot.module, "Impedance"):
        return []
    bench = _Bench(robot, seed)
    return [
        *_law(bench),
        faultless("controller: limits", "bounds of the configuration", _limits(bench)),
        faultless("controller: governor", "bounds of the configuration", _governor(bench)),
        faultless("controller: faults", "reaction to bad samples", _faults(bench)),
    ]


def _law(bench: _Bench) -> list[Check]:
    """Check a slow motion of arm and reference into the limit zones: every term of the torque, and their sum."""
    errors: dict[str, float] = {}  # the largest one of each quantity, in all steps
    for delay, coriolis_on in ((0, "off"), (5, "on")):
        _Movement(bench, errors, delay, coriolis_on).run()
    return [Check(f"controller: {name}", "differentiated energy, law", error, _BOUND) for name, error in errors.items()]


class _Movement:
    """Motion of an arm in 0.4 s, in its first half followed by the command with feed-forward, and what is compared."""

    def __init__(self, bench: _Bench, errors: dict[str, float], delay: int, coriolis_on: str) -> None:
        """Plan the motion of arm and command, and start a controller with room for them around q."""
        self.bench, self.errors, self.timing, self.coriolis = bench, errors, Timing(delay), coriolis_on == "on"
        q, n, reach = bench.q, len(bench.q), bench.reach
        # the arm moves from q to q + way in 0.4 s, the command to q + aim / 2 in the first half of this
        self.way, self.aim = (bench.random.choice([-1.0, 1.0], n) * reach for _ in range(2))
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
        bench, q, last = self.bench, self.bench.q, self.bench.q
        shape = (-1,) if len(self.wrench) == 1 else self.wrench.shape
        for step in range(401):
            phase = np.pi * step / 400
            # half a cosine in 0.4 s: rate = d(at)/dt
            at, rate = q + self.way * (0.5 - 0.5 * np.cos(phase)), self.way * np.pi / 0.8 * np.sin(phase)
            out = bench.step(
                self.controller, q=at, dq=rate, q0=q + 0.5 * self.aim * min(1.0, step / 200), shaped=True,
                posture_stiffness=self.posture, wrench_command=np.reshape(self.wrench, shape),
                acceleration=self.acceleration,
            )  # fmt: skip
            if step:
                self.hold("reference velocity", out.reference_velocity, (out.reference - last) / PERIOD)
            last = np.array(out.reference)
            self.trend = self.trend + PERIOD / 0.01 * (out.reference_velocity - self.trend)  # low-pass filter of 10 ms
            if step % 40 == 0:  # a comparison takes much longer than a step
                self._compare(out, at, rate)
            if step % 100 == 0 and step:  # the wrench has faded in
                self._compare_feedforward(out, at, rate)
        for _ in range(3000):  # the tip of a long arm is slower than its joints
            if np.abs(out.reference - q - 0.5 * self.aim).max() <= 1e-9:
                break
            out = bench.step(self.controller, q=at, dq=np.zeros(len(q)), q0=q + 0.5 * self.aim)
        self.hold("reference arrives", out.reference, q + 0.5 * self.aim)

    def _compare(self, out: Any, at: FloatArray, rate: FloatArray) -> None:
        """Compare springs, zones and damping with the law."""
        bench, zones = self.bench, self.zones
        Kt, Ko = bench.spring["translation_stiffness"], bench.spring["rotation_stiffness"]
        # equilibrium is the tip at the reference, which the controller may hold back from q0
        spring = (bench.poses(out.reference), out.reference, Kt, Ko, self.posture, *bench.where)
        # what is left of the torque is that of the springs
        pull = out.own_torque - out.damping_torque - out.limit_torque - out.feedforward_torque
        self.hold("elastic torque", pull, out.scale * elastic_torque(bench.poses, at, *spring))
        self.hold("stored", out.stored, out.scale * potential(bench.poses, at, *spring) + zones.energy(at))
        self.hold("limit torque", out.limit_torque, zones.torque(at))
        self.hold("torque", out.torque, out.own_torque)
        self.hold("no fault", float(out.fault), 0.0)
        # stiffness of springs and touched zones (n, n) [N m/rad]
        tangent = joint_hessian(bench.poses, at, *spring) + np.diag(np.where(zones.depth(at) != 0, zones.stiffness, 0))
        config, slip = self.controller.config, out.reference_velocity - rate
        # speed beyond the share 0.72 of the limit, which the reference keeps
        excess = rate - np.clip(rate, -0.72 * config.velocity_limit, 0.72 * config.velocity_limit)
        damping, share = damping_torque(tangent, self._mass_matrix(at), self.timing, slip, excess, 0.7)
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


def _limits(bench: _Bench) -> list[str]:
    """Check torque, torque rate, and work against energy_supplied, with a motion and a command that demand more."""
    faults, n = [], len(bench.q)
    effort, rate = np.linspace(0.02, 0.05, n), np.linspace(1.0, 3.0, n)  # so little that both bind
    controller = bench.controller(effort_limit=effort, torque_rate_limit=rate)
    # torque of the step before [N m]; bits of the status that must occur
    last, seen, position = np.zeros(n), dict.fromkeys(("RATE_LIMITED", "SATURATED"), False), bench.q.copy()
    work, supplied = 0.0, 0.0  # [J] done by the torques; said by the controller in the step before
    for step in range(200):
        # 40 steps at a constant speed, 10 at rest, and back
        speed = bench.reach * (2.0 if step // 50 % 2 else -2.0) * (step % 50 < 40)
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
        seen = {name: found or bench.status(out, name) for name, found in seen.items()}
    return faults + [f"never {name}" for name, found in seen.items() if not found]


def _governor(bench: _Bench) -> list[str]:
    """Check a jump of the command with a held arm: velocity of the reference and of the tips, and the springs' wrench.

    In each row another limit binds: the joints' velocity, the wrench, the tips' velocity.
    """
    faults, n = [], len(bench.q)
    here = np.reshape(bench.poses(bench.q), (-1, 4, 4))
    limits: tuple[tuple[Any, tuple[float, float], tuple[float, float]], ...] = (
        (np.linspace(0.2, 0.5, n) * bench.reach, (1e4, 1e4), (100.0, 100.0)),
        (np.full(n, 5.0), (2.0, 0.2), (100.0, 100.0)),
        (np.full(n, 5.0), (1e4, 1e4), (0.2 * bench.reach, 0.4 * bench.reach)),
    )
    for speed, heaviest, tip_speed in limits:
        controller = bench.controller(
            velocity_limit=speed, heaviest_wrench=heaviest, tip_velocity_limit=tip_speed, ramp_time=1e-3
        )
        last, tips = bench.q, here
        for step in range(300):
            out = bench.rest(controller, q0=bench.q + bench.reach)
            if not (np.abs(out.reference - last) <= 0.72 * speed * PERIOD * (1 + 1e-9)).all():
                faults.append(f"step {step}: the reference is faster than the velocity limit allows")
            moved = np.reshape(bench.poses(out.reference), (-1, 4, 4))
            # 2 sin(angle / 2): the angle, up to 1e-8 of it here; the matrices differ by sqrt(2) times as much
            turned = np.linalg.norm(moved[:, :3, :3] - tips[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
            way = np.linalg.norm(moved[:, :3, 3] - tips[:, :3, 3], axis=1)
            if not ((way <= tip_speed[0] * PERIOD) & (turned <= tip_speed[1] * PERIOD)).all():
                faults.append(f"step {step}: the reference is faster than the tip's limits")
            last, tips = np.array(out.reference), moved
        for tip, pose in enumerate(here):
            pushed = wrench(partial(bench.energy, tip, here, tips), pose)
            load = [np.linalg.norm(part) / most for part, most in zip(pushed.reshape(2, 3), heaviest, strict=True)]
            if not np.linalg.norm(load) <= 1 + 1e-6:
                faults.append("the springs exert more than heaviest_wrench")
        if (last == bench.q).any():
            faults.append("a joint of the reference does not move")
    return faults


def _faults(bench: _Bench) -> list[str]:
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


def _sensor_faults(bench: _Bench, title: str, changed: Mapping[str, Any]) -> list[str]:
    """Pass a bad sample once, then twice; then reset."""
    faults, sensor = [], bench.robot.module.Fault.SENSOR
    # [N m], [N m/s]: 0.5 N m per sample of 1 ms
    controller = bench.controller(effort_limit=50.0, torque_rate_limit=500.0)
    goal = bench.q + 0.1 * bench.reach
    last = np.array([bench.rest(controller, q0=goal) for _ in range(55)][-1].torque)

    def stepped(**given: Any) -> Any:
        out = bench.rest(controller, q0=goal, **given)
        bounded = (np.abs(out.torque) <= 50.0).all() and (np.abs(out.torque - last) <= 0.5 * (1 + 1e-9)).all()
        if not bounded:
            faults.append(f"{title}: torque beyond its limits")
        last[:] = out.torque
        return out

    out = stepped(**changed)
    if out.fault or not bench.status(out, "BAD_SAMPLE"):
        faults.append(f"{title}: one sample is not just a bad one")
    if stepped(**changed).fault != sensor:
        faults.append(f"{title}: twice is no sensor fault")
    rows = [stepped() for _ in range(200)]
    if not all(out.fault == sensor and bench.status(out, "FAULT") for out in rows):
        faults.append(f"{title}: the fault does not stay")
    if rows[-1].torque.any():
        faults.append(f"{title}: a torque stays in a fault")
    controller.reset()
    if [stepped() for _ in range(20)][-1].fault:
        faults.append(f"{title}: reset does not clear the fault")
    return faults


def _release_faults(bench: _Bench) -> list[str]:
    """Move faster than the velocity limit until that is a fault; the springs then let go with their energy known."""
    faults, n, q, speed = [], len(bench.q), bench.q, 2.4 * bench.reach
    # the second joint's limit is the tighter one, where there are several
    limit = np.where(np.arange(n) == min(1, n - 1), 2.0, 8.0) * bench.reach
    controller = bench.controller(velocity_limit=limit, effort_limit=50.0, torque_rate_limit=50.0)
    spring = (*bench.spring.values(), 1.0, *bench.where)
    steps = 0
    while steps < 300:
        steps += 1
        q = q + speed * PERIOD
        out = bench.step(controller, q=q, dq=np.full(n, speed), q0=bench.q)
        if out.fault:
            break
    if out.reason != bench.robot.module.Reason.OVERSPEED or steps != 201 or out.fault_joint != min(1, n - 1):
        faults.append("overspeed is no fault after 0.2 s")
    scales = []
    for _ in range(2000):
        out = bench.step(controller, q=q, dq=np.zeros(n), q0=bench.q)
        whole = potential(bench.poses, q, bench.poses(out.reference), out.reference, *spring)
        if not abs(out.stored - out.scale * whole) <= _BOUND * max(1.0, whole):
            faults.append("springs that are let go store another energy")
            break
        scales.append(float(out.scale))
        if out.scale == 0.0:
            break
    if not any(0.0 < scale < 1.0 for scale in scales) or scales[-1] != 0.0:
        faults.append("the springs are not let go in a fault")
    return faults


def _other_faults(bench: _Bench) -> list[str]:
    """Check faults of communication and position, and that a command with NaN is refused without a fault."""
    module, q, faults = bench.robot.module, bench.q, []
    controller = bench.controller()
    kinds = [int(controller.missed(counter=bench.count + 1 + k).fault) for k in range(10)]
    if kinds != [0] * 9 + [int(module.Fault.COMMUNICATION)]:
        faults.append("missed samples")
    for name, sign in (("upper_limit", 1.0), ("lower_limit", -1.0)):
        # The fault begins 0.1 rad beyond a limit.
        for beyond, expected in ((0.099, module.Reason.NONE), (0.101, module.Reason.POSITION)):
            bounds = {"lower_limit": q - 1.0, "upper_limit": q + 1.0, name: q - sign * beyond}
            if bench.rest(bench.controller(rests=0, **bounds)).reason != expected:
                faults.append(f"{beyond} beyond {name} is {'no' if expected else 'a'} fault")
    for name in ("q0", "translation_stiffness", "rotation_stiffness"):
        controller = bench.controller()
        wrong = np.array(q if name == "q0" else bench.spring[name])
        wrong.flat[0] = np.nan
        out = bench.rest(controller, **{name: wrong})
        refused = out.refusal is not None and out.refusal.reason == module.Refused.NOT_FINITE
        if not refused or not bench.status(out, "COMMAND_REFUSED") or not np.isfinite(out.torque).all() or out.fault:
            faults.append(f"NaN in {name} is not refused")
    return faults
