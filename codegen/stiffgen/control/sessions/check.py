# SPDX-License-Identifier: MIT
"""Compare the compiled controller, step by step, with its law computed anew from the equations.

The energy of the springs uses the angle of the error rotation and is differentiated with respect to q along the tips'
poses; the controller has closed forms of gradient and tangent. Damping comes from a bisection of the damping ratio's
definition instead of its solved form. Steps that reach the limits (torque, rate, velocity of the equilibrium) and the
faults show that these hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.placement import Placement
from stiffgen.core.verify.result import Check, faultless

Poses = Callable[[FloatArray], Any]
"""Poses of the tips at q, (4, 4) or (tips, 4, 4)."""

DEFAULT = Placement()
PERIOD = 1e-3
_BOUND = 1e-8
"""Tolerance for finite-difference comparisons, which lose some digits."""


def _largest_damping(delay: int) -> float:
    """Return the largest eigenvalue of M^-1 B that a delay allows [1/s]."""
    return min(0.25, 0.75 / (1 + delay)) / PERIOD


def energy(pose: Any, equilibrium: Any, Kt: Any, Ko: Any, placement: Placement = DEFAULT) -> float:
    """Return U = e^T Kt e / 2 + (1 - cos a) u^T Ko u [J] of one tip.

    e is the displacement of the centre of stiffness, u and a are the axis and angle of R0^T R; e and u are seen in the
    placement's axes.
    """
    centre = np.array(placement.centre)
    axes = {"base": np.eye(3), "tip": pose[:3, :3], "equilibrium": equilibrium[:3, :3]}
    e = (pose[:3, 3] + pose[:3, :3] @ centre) - (equilibrium[:3, 3] + equilibrium[:3, :3] @ centre)
    e = axes[placement.translation_axes or "base"].T @ e
    R = equilibrium[:3, :3].T @ pose[:3, :3]
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    w = axes[placement.rotation_axes].T @ equilibrium[:3, :3] @ w
    cosine = (np.trace(R) - 1) / 2
    # (1 - cos a) u^T Ko u = w^T Ko w / (1 + cos a), without dividing by a small sine
    return float(e @ Kt @ e / 2 + w @ Ko @ w / (1 + cosine))


def wrench(pose: Any, equilibrium: Any, Kt: Any, Ko: Any) -> FloatArray:
    """Return the gradient of U of one tip in hybrid axes [N, N m], by differences along the six unit twists."""
    h, result = 1e-3, np.empty(6)
    for k in range(6):
        values = []
        for step in (h, -h, 2 * h, -2 * h):
            moved = np.array(pose, dtype=float)
            if k < 3:
                moved[k, 3] += step
            else:
                i, j = [(1, 2), (2, 0), (0, 1)][k - 3]  # axes that turn about axis k - 3
                turn = np.eye(3)
                turn[i, i] = turn[j, j] = np.cos(step)
                turn[j, i], turn[i, j] = np.sin(step), -np.sin(step)
                moved[:3, :3] = turn @ moved[:3, :3]
            values.append(energy(moved, equilibrium, Kt, Ko))
        result[k] = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * h)
    return result


def potential(
    poses: Poses,
    q: FloatArray,
    equilibrium: Any,
    posture: Any,
    Kt: Any,
    Ko: Any,
    k: Any,
    placement: Placement = DEFAULT,
) -> float:
    """Return the energy [J] of the springs of all tips and of the posture potential k (q - posture)^2 / 2."""
    tips = (np.reshape(poses(q), (-1, 4, 4)), np.reshape(equilibrium, (-1, 4, 4)))
    stiffness = (np.reshape(Kt, (-1, 3, 3)), np.reshape(Ko, (-1, 3, 3)))
    springs = sum(energy(*each, placement) for each in zip(*tips, *stiffness, strict=True))
    return springs + float(np.sum(k * (q - posture) ** 2) / 2)


def elastic_torque(poses: Poses, q: FloatArray, *spring: Any) -> FloatArray:
    """Return -dU/dq [N m], (n), of :func:`potential` by differences; ``spring`` are its arguments after q."""
    h = 1e-3
    rows = []
    for step in h * np.eye(len(q)):
        near, far = (potential(poses, q + s * step, *spring) - potential(poses, q - s * step, *spring) for s in (1, 2))
        rows.append(-(8 * near - far) / (12 * h))
    return np.array(rows)


def joint_hessian(poses: Poses, q: FloatArray, *spring: Any) -> FloatArray:
    """Return d2U/dq2 [N m/rad], (n, n), by differences of the torque."""
    h = 1e-3
    columns = []
    for step in h * np.eye(len(q)):
        near, far = (
            elastic_torque(poses, q - s * step, *spring) - elastic_torque(poses, q + s * step, *spring) for s in (1, 2)
        )
        columns.append((8 * near - far) / (12 * h))
    return np.array(columns).T


def modal_damping(K: FloatArray, M: FloatArray, ratio: Any, late: float, most: float, d: float) -> FloatArray:
    """Return damping (n, n) that gives every mode its ratio, with stiffness and damping ``late`` [s], capped.

    Args:
        K: tangent (n, n), symmetric.
        M: mass matrix (n, n).
        ratio: of the modes, softest first.
        late: delay [s].
        most: largest eigenvalue [1/s] of M^-1 B.
        d: damping [N m s/rad] added to every joint.

    """
    root = np.linalg.inv(np.linalg.cholesky(M))
    values, vectors = np.linalg.eigh(root @ K @ root.T)
    V = root.T @ vectors  # V^T M V = I
    b = np.empty(len(values))
    for k, (value, zeta) in enumerate(zip(np.abs(values), np.broadcast_to(ratio, len(values)), strict=True)):
        # zeta = (b - l h) / (2 sqrt(l (1 - b h))) with l: value, h: late, solved for b by bisection
        low, high = value * late, min(1 / late, 1e9) if late else 2 * zeta * np.sqrt(value) + 1e-12
        for _ in range(200):
            middle = (low + high) / 2
            excess = (middle - value * late) - 2 * zeta * np.sqrt(value * max(1 - middle * late, 0))
            low, high = (middle, high) if excess < 0 else (low, middle)
        # d leaves so much of it: no eigenvalue of M^-1 d is above d times the trace of M^-1
        b[k] = min(low, most - d * np.trace(np.linalg.inv(M)))
    return np.asarray(M @ V @ np.diag(b) @ V.T @ M + d * np.eye(len(M)))


def limit_torque(q: FloatArray, lower: Any, upper: Any, zone: float, k: Any, effort: Any) -> FloatArray:
    """Return the torque of joint limit avoidance (n) [N m]: slope k times depth in the zone, capped, inwards."""
    depth = np.maximum(q - (upper - zone), 0) - np.maximum(lower + zone - q, 0)
    return np.asarray(-np.clip(k * depth, -effort, effort))


class _Bench:
    """Robot's controller with samples around one configuration, close to which all limits lie.

    ``reach`` is the distance [rad or m] that each joint moves from ``q`` in these sessions. ``given`` are the arguments
    of ``step`` that stay: stiffnesses and, where the robot takes them, tools.
    """

    def __init__(self, robot: GeneratedRobot, seed: int) -> None:
        self.robot, chain = robot, robot.chain
        self.random = np.random.default_rng(seed)
        lower, upper = self._bounds()
        span = upper - lower
        self.q = lower + span * self.random.uniform(0.35, 0.65, len(span))
        self.reach = float(min(0.1, 0.2 * np.abs(span).min()))
        tips = len(chain.tips)
        self.tools = np.broadcast_to(np.eye(4), (tips, 4, 4)).copy()
        self.tools[:, :3, 3] = (0.02, -0.03, 0.1)
        roots = self.random.normal(size=(2, tips, 3, 3))
        Kt, Ko = (roots @ np.swapaxes(roots, 2, 3) / 3 + 0.3 * np.eye(3)) * np.array([300.0, 20.0])[:, None, None, None]
        if tips == 1:
            self.tools, Kt, Ko = self.tools[0], Kt[0], Ko[0]
        self.spring = {"translation_stiffness": Kt, "rotation_stiffness": Ko}
        self.given = {**self.spring, **({"tool_pose": self.tools} if chain.runtime_tool else {})}

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
        M, h = np.asarray(self.robot.kernels["mass_matrix"](self.joints(q))), 1e-3
        if not self.robot.chain.loops:
            return M
        columns = []
        for step in h * np.eye(len(q)):
            near, far = (self.joints(q + s * step) - self.joints(q - s * step) for s in (1, 2))
            columns.append((8 * near - far) / (12 * h))
        G = np.array(columns).T
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

    def controller(self, **config: Any) -> Any:
        """Return a controller engaged at rest at q, with limits just beyond reach and slack for all other options."""
        room = {
            "motor_inertia": 0.5, "frozen_window": 1000000, "limit_stiffness": 0.0, "limit_zone": self.reach,
            "lower_limit": self.q - 4 * self.reach, "upper_limit": self.q + 4 * self.reach,
            "velocity_limit": 10.0, "reference_velocity_limit": 5.0, "effort_limit": 1e4, "torque_rate_limit": 1e8,
            "tank_initial": 1e4, "energy_limit": 1e4, "engagement_limit": 1e5,
            "translation_stiffness_limit": 1e5, "rotation_stiffness_limit": 1e4, "stiffness_cap": "accept",
        }  # fmt: skip
        controller = self.robot.module.Impedance({**room, **config}, errors="ignore")
        for _ in range(5):
            self.rest(controller)
        return controller

    def rest(self, controller: Any, **changed: Any) -> Any:
        """Step once at q, at rest."""
        still = {"q": self.q, "dq": np.zeros(len(self.q)), "q0": self.q, **self.given}
        return controller.step(**{**still, **changed})

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
    """Check a slow motion of arm and equilibrium into the limit zones: every term of the torque, and their sum."""
    errors: dict[str, float] = {}  # the largest one of each quantity, in all steps

    def hold(name: str, value: Any, reference: Any) -> None:
        # relative to the largest entry, or to 1 of its unit if all are smaller
        scale = max(1.0, float(np.abs(reference).max()))
        error = float(np.abs(np.ravel(value) - np.ravel(reference)).max()) / scale
        errors[name] = max(errors.get(name, 0.0), error if np.isfinite(error) else np.inf)

    q, n, reach = bench.q, len(bench.q), bench.reach
    # the arm moves from q to q + way in 0.4 s, the command to q + aim / 2 in the first half of this
    way, aim = (bench.random.choice([-1.0, 1.0], n) * reach for _ in range(2))
    stiff, k, placement = np.linspace(20.0, 200.0, n), 2.5, bench.robot.springs.placement
    for delay in (0, 5):
        controller = bench.controller(
            limit_stiffness=stiff, lower_limit=q - 1.5 * reach, upper_limit=q + 1.5 * reach, effort_limit=1e4,
            posture_stiffness=k, delay_samples=delay, joint_damping=0.05,
        )  # fmt: skip
        config = controller.config
        for step in range(401):
            phase = np.pi * step / 400
            at, rate = q + way * (0.5 - 0.5 * np.cos(phase)), way * np.pi / 0.8 * np.sin(phase)
            out = controller.step(q=at, dq=rate, q0=q + 0.5 * aim * min(1.0, step / 200), **bench.given)
            if step % 40:  # a comparison takes much longer than a step
                continue
            spring = (out.equilibrium, out.reference, out.translation_stiffness, out.rotation_stiffness, k, placement)
            pushed = limit_torque(
                at, config.lower_limit, config.upper_limit, config.limit_zone, stiff, config.effort_limit
            )
            capped = bench.status(out, "STIFFNESS_CAPPED")
            for kind in ("translation_stiffness", "rotation_stiffness"):
                hold("stiffness", getattr(out, kind), getattr(out, kind) if capped else bench.spring[kind])
            hold("equilibrium", out.equilibrium, bench.poses(out.reference))
            hold("elastic torque", out.elastic_torque, out.scale * elastic_torque(bench.poses, at, *spring))
            hold("energy", out.elastic_energy, out.scale * potential(bench.poses, at, *spring))
            hold("limit torque", out.limit_torque, pushed)
            hold("velocity", out.velocity, rate)
            hold("damping torque", out.damping_torque, out.damping @ (out.reference_velocity - rate))
            hold("torque", out.torque, out.elastic_torque + out.damping_torque + out.limit_torque)
            hold("scale", out.scale, 1.0 if not capped else out.scale)
            hold("no fault", float(out.fault), 0.0)
            if step % 200:  # differences of differences take longer still
                continue
            slope = np.where(pushed != 0, stiff, 0.0)
            hold("tangent", out.joint_stiffness, joint_hessian(bench.poses, at, *spring) + np.diag(slope))
            M = bench.mass_matrix(at) + 0.5 * np.eye(n)
            hold("mass matrix", out.mass_matrix, M)
            expected = modal_damping(
                out.scale * out.joint_stiffness, M, 0.7, (delay + 0.5) * PERIOD, _largest_damping(delay), 0.05
            )
            hold("damping", out.damping, expected)
        for _ in range(3000):  # the tip of a long arm is slower than its joints
            if np.abs(out.reference - q - 0.5 * aim).max() <= 1e-9:
                break
            out = controller.step(q=at, dq=np.zeros(n), q0=q + 0.5 * aim, **bench.given)
        hold("equilibrium arrives", out.reference, q + 0.5 * aim)
    return [Check(f"controller: {name}", "differentiated energy, law", error, _BOUND) for name, error in errors.items()]


def _limits(bench: _Bench) -> list[str]:
    """Check torque, torque rate, and work against energy_supplied, with a motion and a command that demand more."""
    faults, n = [], len(bench.q)
    effort, rate = np.linspace(0.02, 0.05, n), np.linspace(1.0, 3.0, n)  # so little that both bind
    controller = bench.controller(effort_limit=effort, torque_rate_limit=rate, reference_velocity_limit=5.0)
    last, seen, position = np.zeros(n), dict.fromkeys(("RATE_LIMITED", "SATURATED"), False), bench.q.copy()
    work, supplied = 0.0, 0.0
    for step in range(200):
        # 40 steps at a constant speed, 10 at rest, and back
        speed = bench.reach * (2.0 if step // 50 % 2 else -2.0) * (step % 50 < 40)
        position = position + PERIOD * speed
        out = controller.step(q=position, dq=np.full(n, speed), q0=bench.q + bench.reach, **bench.given)
        if not (np.abs(out.torque) <= effort * (1 + 1e-12)).all():
            faults.append(f"step {step}: torque beyond the effort limit")
        if not (np.abs(out.torque - last) <= rate * PERIOD * (1 + 1e-9)).all():
            faults.append(f"step {step}: torque beyond its rate limit")
        work += float(np.sum(last) * PERIOD * speed) if step else 0.0  # all joints have the same speed
        # what is in springs and tank can still leave
        if not supplied <= out.energy_supplied >= work + out.elastic_energy + out.limit_energy + out.tank_energy - 1e-6:
            faults.append(f"step {step}: work beyond energy_supplied, or less supplied than before")
        last, supplied = np.array(out.torque), float(out.energy_supplied)
        seen = {name: found or bench.status(out, name) for name, found in seen.items()}
    return faults + [f"never {name}" for name, found in seen.items() if not found]


def _governor(bench: _Bench) -> list[str]:
    """Check a jump of the command with a held arm: the equilibrium's velocity and energy."""
    faults, n, T = [], len(bench.q), PERIOD
    goal = bench.q + bench.reach
    limits = (
        (np.linspace(0.2, 0.5, n) * bench.reach, 1e4, 100.0, 100.0),  # the joints' alone binds
        (np.full(n, 5.0), 0.02, 100.0, 100.0),  # the energy's
        (np.full(n, 5.0), 1e4, 0.2 * bench.reach, 0.4 * bench.reach),  # the tips'
    )
    for joint_speed, energy, tip_speed, tip_turn_rate in limits:
        controller = bench.controller(
            reference_velocity_limit=joint_speed, energy_limit=energy, tip_velocity_limit=tip_speed,
            tip_rotation_limit=tip_turn_rate, ramp_time=1e-3,
        )  # fmt: skip
        last, tips = bench.q, bench.poses(bench.q)
        for step in range(300):
            out = bench.rest(controller, q0=goal)
            if not (np.abs(out.reference - last) <= joint_speed * T * (1 + 1e-9)).all():
                faults.append(f"step {step}: the equilibrium is faster than reference_velocity_limit")
            # elastic_energy has the posture's spring, too; both are scaled alike
            of_posture = 0.5 * np.sum(controller.config.posture_stiffness * (bench.q - out.reference) ** 2)
            if not out.elastic_energy - out.scale * of_posture <= energy * (1 + 1e-9):
                faults.append(f"step {step}: more energy in the tips' springs than energy_limit")
            moved = np.reshape(out.equilibrium, (-1, 4, 4))
            # 2 sin(angle / 2): the angle, up to 1e-8 of it here; the matrices differ by sqrt(2) times as much
            turned = np.linalg.norm(moved[:, :3, :3] - tips[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
            way = np.linalg.norm(moved[:, :3, 3] - tips[:, :3, 3], axis=1)
            if not (way <= tip_speed * T * (1 + 1e-6)).all() or not (turned <= tip_turn_rate * T * (1 + 1e-6)).all():
                faults.append(f"step {step}: the equilibrium is faster than the tip's limits")
            last, tips = np.array(out.reference), np.array(moved)
        if (last == bench.q).any():
            faults.append("a joint of the equilibrium does not move")
    return faults


def _faults(bench: _Bench) -> list[str]:
    """Check that one bad sample is no fault, and that two of three, or a value beyond a limit, latch a fault.

    In a fault the torque keeps its limits, the springs' scale falls to 0, and a reset ends the fault.
    """
    module, n, q = bench.robot.module, len(bench.q), bench.q
    faults: list[str] = []
    first = np.arange(n) == 0
    spoilt: dict[str, Mapping[str, Any]] = {
        "NaN in q": {"q": np.where(first, np.nan, q)},
        "infinity in q": {"q": np.where(first, np.inf, q)},
        "NaN in dq": {"dq": np.where(first, np.nan, 0.0)},
        "a jump of q": {"q": q + 3.0 * first},
        "dq without a change of q": {"dq": 6.0 * first},
    }
    for title, changed in spoilt.items():
        controller = bench.controller(effort_limit=50.0, torque_rate_limit=500.0)
        for _ in range(50):
            bench.rest(controller, q0=q + 0.1 * bench.reach)
        good = [bench.rest(controller, q0=q + 0.1 * bench.reach) for _ in range(5)][-1]
        last = np.array(good.torque)

        # defaults bind the loop's variables; ``last`` is changed in place, from step to step
        def stepped(last: FloatArray = last, title: str = title, controller: Any = controller, **given: Any) -> Any:
            out = bench.rest(controller, q0=q + 0.1 * bench.reach, **given)
            bounded = (np.abs(out.torque) <= 50.0).all() and (np.abs(out.torque - last) <= 0.5 * (1 + 1e-9)).all()
            if not bounded:
                faults.append(f"{title}: torque beyond its limits")
            last[:] = out.torque
            return out

        out = stepped(**changed)
        if out.fault or not bench.status(out, "BAD_SAMPLE"):
            faults.append(f"{title}: one sample is not just a bad one")
        out = stepped(**changed)
        if out.fault != module.Fault.SENSOR:
            faults.append(f"{title}: twice is no sensor fault")
        for _ in range(200):
            out = stepped()
            if out.fault != module.Fault.SENSOR or not bench.status(out, "FAULT"):
                faults.append(f"{title}: the fault does not stay")
                break
            if 0.0 < out.scale < 1.0:
                spring = (out.equilibrium, out.reference, out.translation_stiffness, out.rotation_stiffness)
                whole = potential(
                    bench.poses, q, *spring, controller.config.posture_stiffness, bench.robot.springs.placement
                )
                if not abs(out.elastic_energy - out.scale * whole) <= _BOUND * max(1.0, whole):
                    faults.append(f"{title}: springs that are let go store another energy")
        if out.scale != 0.0:
            faults.append(f"{title}: the springs stay on in a fault")
        controller.reset()
        if [stepped() for _ in range(20)][-1].fault:
            faults.append(f"{title}: reset does not clear the fault")
    return faults + _other_faults(bench)


def _other_faults(bench: _Bench) -> list[str]:
    """Check faults of communication, speed and position, and that a command with NaN is refused without a fault."""
    module, n, q, faults = bench.robot.module, len(bench.q), bench.q, []
    controller = bench.controller(missed_limit=4, loss_limit=4)
    kinds = [int(controller.missed().fault) for _ in range(4)]
    if kinds != [0, 0, 0, int(module.Fault.COMMUNICATION)]:
        faults.append("missed samples")
    controller = bench.controller(velocity_limit=2.0, upper_limit=q + 1e3, overspeed_time=0.0)
    # one sample time at 2.4 rad/s from rest: q and dq agree
    out = controller.step(q=q + 2.4 * PERIOD, dq=np.full(n, 2.4), q0=q, **bench.given)
    if out.reason != module.Reason.OVERSPEED:
        faults.append("overspeed is no fault")
    for limit, sign in (("upper_limit", 1.0), ("lower_limit", -1.0)):
        controller = bench.controller(position_tolerance=0.5 * bench.reach)
        bench.rest(controller)
        controller.config.update({limit: q - sign * 0.6 * bench.reach})  # q is beyond by more than the tolerance
        if bench.rest(controller).reason != module.Reason.POSITION:
            faults.append(f"beyond {limit} is no fault")
    for name in ("q0", "translation_stiffness", "rotation_stiffness"):
        controller = bench.controller()
        wrong = np.array(q if name == "q0" else bench.spring[name])
        wrong.flat[0] = np.nan
        out = bench.rest(controller, **{name: wrong})
        told = bench.status(out, "COMMAND_REFUSED") and out.refusal == module.Refusal.NOT_FINITE
        if not told or not np.isfinite(out.torque).all() or out.fault:
            faults.append(f"NaN in {name} is not refused")
    return faults
