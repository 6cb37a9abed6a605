# SPDX-License-Identifier: MIT
"""Session of two controllers with random configurations and events: gaps, jumps, faults, resets, overwritten states."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from stiffgen.control.fields import CONFIG, Field
from stiffgen.control.sessions.library import ControllerLibrary, fill, is_same, set_field
from stiffgen.control.sessions.spoilers import SPOILERS
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray

_FAVOURED = (
    "lower_limit", "upper_limit", "limit_zone", "limit_stiffness", "velocity_limit", "missed_limit",
    "posture_stiffness",
)  # fmt: skip
"""Fields whose change the controller may postpone (a joint is in its zone, or fast; samples are missing) or fade in."""
_CHOSEN_APART = (
    "sample_time", "delay_samples", "lower_limit", "upper_limit", "spring",
)  # fmt: skip
"""Fields of the configuration that a session chooses by rules of their own."""
_RANGES = {
    "position_quantum": (-6.0, -3.0),
    "velocity_noise": (-4.0, -1.0),
    "velocity_filter_time": (-3.0, -1.5),
}
"""Powers of ten between which fields lie whose default is 0."""
Random = np.random.Generator


class HostileSession:
    """Session with a configuration, an arm that moves with the reference's torque, and random events.

    A seed names a session: a draw more, or in another place, makes other sessions of all seeds. ``config``, ``input``
    and ``output`` are the reference's; the library has copies of the first two.
    """

    steps = 400
    """Number of steps."""

    def __init__(self, reference: ControllerLibrary, library: ControllerLibrary, chain: Chain, random: Random) -> None:
        self.both, self.chain, self.random = (reference, library), chain, random
        self.config, self.input, self.output = reference.config, reference.input, reference.output
        motors, self.n = chain.motor_coordinates, len(chain.motor_coordinates)
        reach = [math.pi if c.type != "prismatic" else 1.0 for c in motors]
        self.lower, self.upper = np.array([c.range_within(r) for c, r in zip(motors, reach, strict=True)]).T
        self.calm = random.random() < 0.6
        self._configure()
        place = random.choice([0.5, 0.98, 0.02, 1.0]) if random.random() < 0.4 else random.uniform(0.1, 0.9, self.n)
        self.q = self.lower + (self.upper - self.lower) * place
        self.dq, self.load = np.zeros(self.n), np.zeros(self.n)
        self.quantum = float(self.config.position_quantum)
        self.reported = self.q, self.dq
        self._start()

    def _configure(self) -> None:
        """Take the defaults, and change fields at random."""
        random, config, both = self.random, self.config, self.both
        both[0].call("default_config", config)
        effort = np.array(config.effort_limit)
        config.sample_time = float(random.choice([1e-3, 1e-3, 2e-3, 5e-3, 0.02]))
        config.delay_samples = int(random.integers(0, 6))
        fill(config.motor_inertia, random.uniform(0.1, 0.6, len(effort)))  # [kg m^2]
        for field in CONFIG:
            if field.name in _CHOSEN_APART:
                continue
            if random.random() < (0.15 if self.calm else 0.35):
                self._vary(field)
        if random.random() < 0.3:
            config.engagement_limit, config.energy_limit = 10.0 ** random.uniform([-4.0, -3.0], 0.5)
        if random.random() < 0.3:
            config.tank_initial = 10.0 ** random.uniform(-3.0, 0.5)
        if random.random() < 0.3:
            config.frozen_window = int(random.integers(2, 40))
        config.stiffness_cap = 1 + int(random.random() < 0.95)  # hardly ever refused
        if random.random() < 0.3:
            config.heaviest_wrench[0], config.heaviest_wrench[1] = 10.0 ** random.uniform([0.0, 0.0], [2.5, 1.7])
        if config.actuation == 2:
            config.delay_samples = 0  # gains go with no delay
        config.spring = 2
        if both[0].call("validate", config) != 0 or random.random() < 0.5:
            config.spring = 1  # the folder has no other, or by chance

    def _vary(self, field: Field) -> None:
        """Change a field of the configuration within its own rule; rules about several fields may refuse the result.

        A field over joints gets one value and a share of it per joint.
        """
        random = self.random
        if field.choices:
            value: float = int(random.integers(1, len(field.choices) + 1))
        elif field.name in _RANGES:
            value = 10.0 ** random.uniform(*_RANGES[field.name])
        elif field.name == "state_period":
            value = self.config.sample_time * random.uniform(1.1, min(4.0, max(1.2, self.config.missed_limit)))
        elif field.name in ("posture_stiffness", "limit_stiffness") and random.random() < 0.3:
            value = 0.0
        else:
            present = getattr(self.config, field.name)
            typical = float(np.max(np.abs(present))) if field.shape else float(present)
            value = typical * 10.0 ** random.uniform(-1.5, 0.7)
        value = min(max(value, field.least), field.most)
        set_field(self.config, field, round(value) if field.type == "int" else value, -1)
        if field.shape == ("n",):
            fill(getattr(self.config, field.name), value * self.random.uniform(0.5, 1.0, self.n))

    def _start(self) -> None:
        """Initialise both controllers, sometimes with a nonzero torque."""
        random = self.random
        self._copy_config()
        torque = None
        if random.random() < 0.3:
            values = random.uniform(-0.2, 0.2, self.n) * np.array(self.config.effort_limit)
            torque = (ctypes.c_double * self.n)(*values)
        for each in self.both:
            ctypes.memset(each.state, 0, ctypes.sizeof(each.state))
            ctypes.memset(ctypes.byref(each.output), 0, ctypes.sizeof(each.output))
            ctypes.memset(ctypes.byref(each.input), 0, ctypes.sizeof(each.input))
            each.call("init", each.config, each.state, torque)
        self.counter = int(random.integers(0, 2**32))
        self.goal = self.q + 0.0
        self.absent = self.held = self.stuck = 0
        self.pressed = np.zeros(6 * len(self.chain.tips))
        share = random.choice([0.0, 0.2])  # a torque in force at the start is the caller's as far as it is offset
        self.offset = random.normal(size=self.n) * np.array(self.config.effort_limit) * share
        self.rate, self.stated = np.zeros(self.n), np.zeros((2, self.n))
        self.stuck_field = "q"
        self.command = 2 if random.random() < 0.3 else 1
        self.tools = np.stack([_pose(random, 0.1) for _ in self.chain.tips])
        self._choose_stiffness()

    def _copy_config(self) -> None:
        """Give the library the reference's configuration."""
        _copy(self.config, self.both[1].config)

    def _choose_stiffness(self) -> None:
        """Choose translational and rotational stiffness of the tips, (2, tips, 3, 3); one in ten is not positive."""
        random, tips = self.random, len(self.chain.tips)
        roots = random.normal(size=(2, tips, 3, 3))
        scale = np.array([500.0, 20.0]) * 10.0 ** random.uniform(-1.5, 0.5)  # [N/m], [N m/rad]
        self.stiffness = (roots @ np.swapaxes(roots, 2, 3) / 3) * scale[:, None, None, None]
        if random.random() < 0.1:
            self.stiffness[:, :, 0, 0] *= -1.0

    def _choose_plan(self) -> None:
        """Choose the rate of the goal, and what the plan states of it: the truth, something else, or nothing."""
        random, limit = self.random, np.nan_to_num(np.array(self.config.velocity_limit))
        self.rate = random.uniform(-0.3, 0.3, self.n) * limit * random.integers(0, 2)
        velocity = self.rate if random.random() < 0.7 else random.uniform(-0.1, 0.1, self.n) * limit
        acceleration = random.uniform(-1.1, 1.1, self.n) * limit / max(self.config.ramp_time, 1e-4)
        share = random.choice([0.0, 0.01, 0.3, 1.0], p=[0.4, 0.3, 0.2, 0.1])
        self.stated = np.stack([velocity, share * acceleration]) * float(random.random() < 0.7)

    def find_difference(self) -> int | None:
        """Run the session; return the number of the first step whose results differ, or None."""
        different = next((number for number in range(self.steps) if not self.step(number)), None)
        if different is None and bytes(self.both[0].state) != bytes(self.both[1].state):  # memory behind the state
            return self.steps
        return different

    def step(self, number: int) -> bool:
        """Step both controllers once; return whether all their outputs are the same."""
        self._choose_events(number)
        self._write_input()
        self._spoil_sample()
        _copy(self.input, self.both[1].input)
        if self.random.random() < (0.001 if self.calm else 0.006):
            self._overwrite_state()
        results = [each.call("step", each.config, each.state, each.input, each.output) for each in self.both]
        if self.held > 0:  # by an obstacle
            self.held, self.dq = self.held - 1, np.zeros(self.n)
        else:
            self._move()
        texts: list[tuple[object, ...]] = [(), ()]
        if self.output.fault or self.output.refusal or number == 0:
            size = int(self.random.choice([512, 512, 40, 1, 0]))
            texts = [(each.fault_text(size), each.refusal_text(size)) for each in self.both]
        return results[0] == results[1] and texts[0] == texts[1] and is_same(*self.both)

    def _choose_events(self, number: int) -> None:
        """Change commands and stiffness; load, reset, reconfigure, hold the arm, start again."""
        self._choose_commands(number)
        self._choose_troubles()

    def _choose_commands(self, number: int) -> None:
        random = self.random
        if number == 5 or random.random() < 0.01:
            self.goal = self.q + random.normal(size=self.n) * 10.0 ** random.uniform(-3, -0.5 if self.calm else 0)
        if random.random() < 0.02:
            self.goal = self.goal + random.normal(size=self.n) * 1e-3
        if random.random() < 0.01:
            self._choose_stiffness()
        if random.random() < 0.02:
            size = np.repeat(self.config.heaviest_wrench, 3) * random.choice([0.0, 0.1, 0.7])
            self.pressed = (random.uniform(-1.0, 1.0, (len(self.chain.tips), 6)) * size).ravel()
        if random.random() < 0.01:
            share = random.choice([0.0, 0.01, 0.2, 0.9])
            self.offset = random.normal(size=self.n) * np.array(self.config.effort_limit) * share
        if random.random() < 0.02:
            self._choose_plan()

    def _choose_troubles(self) -> None:
        random, rate = self.random, 0.15 if self.calm else 1.0
        if random.random() < 0.03 * rate:
            share = 0.02 if self.calm else random.choice([0, 0.3])
            self.load = random.normal(size=self.n) * np.array(self.config.effort_limit) * share
        if random.random() < (0.08 if self.output.fault else 0.01):
            for each in self.both:
                each.call("reset", each.state)
        if random.random() < (0.012 if self.calm else 0.02):
            self._change_config()
        if random.random() < 0.004 * rate:
            self.command = 3 - self.command
        if random.random() < 0.004:  # an obstacle holds the arm, perhaps far from the goal
            self.held = int(random.integers(5, 80))
            self.goal = self.goal + random.normal(size=self.n) * random.choice([0.0, 1.0])
        if random.random() < 0.003 * rate:  # the robot's clock starts again
            self.counter = (self.counter - int(random.integers(2, 2000))) % 2**32
        if random.random() < (0.02 if self.output.fault else 0.001 * rate):
            self.dq = 0.1 * self.dq
            self._start()

    def _change_config(self) -> None:
        """Change one field while the controller runs, also to values that are refused.

        Of the refused ones one in five stays: every step then refuses the configuration, until another change.
        """
        random = self.random
        field = CONFIG[int(random.integers(len(CONFIG)))]
        if random.random() < 0.4:
            name = random.choice(_FAVOURED)
            field = next(each for each in CONFIG if each.name == name)
        before = bytes(self.config)
        if field.name in ("lower_limit", "upper_limit"):
            outwards = -1.0 if field.name == "lower_limit" else 1.0
            fill(getattr(self.config, field.name), self.q + outwards * random.uniform(-0.2, 0.6, self.n))
        elif field.name == "velocity_limit" and random.random() < 0.7:
            fill(self.config.velocity_limit, 0.01 + np.abs(self.dq) * random.uniform(0.5, 2.0, self.n))
        elif field.name == "missed_limit" and random.random() < 0.7:
            self.config.missed_limit = int(random.integers(1, 12))
        elif random.random() < 0.2:
            set_field(self.config, field, math.nan if field.type == "double" else -1, int(random.integers(self.n)))
        else:
            self._vary(field)
        self._copy_config()
        if self.both[0].call("validate", self.config) != 0 and random.random() < 0.8:
            ctypes.memmove(ctypes.byref(self.config), before, len(before))
            self._copy_config()

    def _write_input(self) -> None:
        """Write a good sample and a command into the reference's input; now and then the command is refused."""
        random, given, n = self.random, self.input, self.n
        self.counter = (self.counter + 1) % 2**32
        given.sample_valid, given.command, given.counter = 1, self.command, self.counter
        measured = np.round(self.q / self.quantum) * self.quantum if self.quantum else self.q
        noise = 0.0 if self.calm else 1e-4
        if self.config.state_period == 0.0 or random.random() < 0.4:  # else the robot repeats its last state
            self.reported = measured, self.dq + noise * random.normal(size=n)
        fill(given.q, self.reported[0])
        fill(given.dq, self.reported[1])
        beyond = (0.5 if random.random() < 0.99 else 1e3) * self.config.position_tolerance
        fill(
            given.q0,
            np.clip(self.goal, np.array(self.config.lower_limit) - beyond, np.array(self.config.upper_limit) + beyond),
        )
        stiffness = self.stiffness.astype(np.float32) if random.random() < 0.05 else self.stiffness
        for field in ("translation_stiffness", "rotation_stiffness"):
            fill(getattr(given, field), stiffness[int(field.startswith("rotation"))])
        if self.command == 2:
            fill(given.equilibrium, self._commanded_poses())
        if self.chain.runtime_tool:
            if self.output.fault and random.random() < 0.01:
                self.tools[..., 0, 3] += 0.01
            fill(given.tool_pose, self.tools)
        fill(given.wrench_command, self.pressed)
        fill(given.torque_offset, self.offset)
        fill(given.velocity, self.stated[0])
        fill(given.acceleration, self.stated[1])
        given.wrench_valid = int(random.random() < 0.3)
        given.external_valid = int(random.random() < 0.5)
        fill(given.external_torque, random.normal(size=n) * 10.0 ** random.uniform(-1, 2))
        fill(given.wrench, random.normal(size=6 * len(self.chain.tips)) * 10.0 ** random.uniform(0, 2.3))

    def _commanded_poses(self) -> FloatArray:
        """Return poses (tips, 4, 4) near the equilibrium in force, now and then far from it, rounded or impossible."""
        random = self.random
        poses = np.reshape(np.array(self.output.equilibrium), (-1, 4, 4)).copy()
        if not poses[:, 3, 3].all():  # no step has written the output yet
            poses = np.broadcast_to(np.eye(4), poses.shape).copy()
        poses[:, :3, 3] += 1e-3 * random.normal(size=3)
        if random.random() < 0.05:  # half a turn about an axis
            poses[:, :3, :3] *= np.roll([1.0, -1.0, -1.0], random.integers(3))
        if random.random() < 0.01:
            poses = _impossible(poses, int(random.integers(3)))
        if random.random() < 0.1:  # a command of few digits
            poses = np.round(poses, int(random.integers(3, 7)))
        return poses

    def _spoil_sample(self) -> None:
        """Sometimes omit, repeat, skip or falsify samples and commands.

        At most one of the single events happens: each has the probability of its interval of ``event``, an eighth of
        it in a calm session.
        """
        random, given = self.random, self.input
        event, joint = random.random() * (8.0 if self.calm else 1.0), int(random.integers(self.n))
        bad = float(random.choice([math.nan, math.inf, -math.inf, 1e7]))
        if not self._is_lost():
            spoil = next((each for most, each in SPOILERS if event < most), None)
            if spoil is not None:
                spoil(self, given, joint, bad)

    def _is_lost(self) -> bool:
        """Repeat a sample where values are stuck; return whether the sample is lost."""
        random, given = self.random, self.input
        if random.random() < 0.004:
            self.absent = int(random.integers(1, 30))
        if random.random() < 0.003:
            self.stuck, self.stuck_field = int(random.integers(5, 80)), str(random.choice(["q", "dq"]))
            self.stuck_values = np.array(getattr(given, self.stuck_field))
        if self.stuck > 0:
            self.stuck -= 1
            fill(getattr(given, self.stuck_field), self.stuck_values)
        if self.absent == 0:
            return False
        self.absent -= 1
        given.sample_valid = 0
        if random.random() < 0.1:  # calls are left out, too
            self.counter = (self.counter + int(random.integers(1, 6))) % 2**32
        return True

    def _overwrite_state(self) -> None:
        """Overwrite the same bytes of both states, such as a copy of the last torque, or two of the three.

        A state begins with copies, n doubles each: three of the last torque, then three of its largest change.
        """
        random, n = self.random, self.n
        place = int(random.integers(6 * n)) if random.random() < 0.7 else int(random.integers(6 * n, 40 * n))
        twice = place < n and random.random() < 0.3
        value = random.choice([math.nan, math.inf, 1e300]) if twice else None
        for each in self.both:
            for number in (place, place + n) if twice else (place,):
                each.state[number] = each.state[number] * 1.5 + 0.125 if value is None else value

    def _move(self) -> None:
        """Move arm and goal for one sample time: the controller's torque, a load, friction and diagonal inertia."""
        time = min(float(self.config.sample_time), 0.02) if self.config.sample_time > 0 else 1e-3
        self.goal = self.goal + time * self.rate
        torque = finite(np.array(self.output.torque))
        n = self.n
        inertia = np.maximum(np.diag(np.array(self.output.mass_matrix).reshape(n, n)), 0.3)
        inertia = np.where(np.isfinite(inertia), inertia, 1.0)
        self.dq = self.dq + time * (torque + self.load - 2.0 * self.dq) / inertia
        self.dq = finite(self.dq).clip(-20.0, 20.0)
        self.q = self.q + time * self.dq


def finite(values: FloatArray) -> FloatArray:
    """Return numbers with NaN as 0 and infinity as the largest one; np.nan_to_num alone is slow."""
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def _copy(source: Any, target: Any) -> None:
    ctypes.memmove(ctypes.byref(target), ctypes.byref(source), ctypes.sizeof(source))


def _impossible(poses: FloatArray, kind: int) -> FloatArray:
    """Return poses that are column-major (0), left-handed (1) or in millimetres (2)."""
    if kind == 0:
        return np.swapaxes(poses, 1, 2)
    changed = poses.copy()
    changed[:, :3, 0 if kind == 1 else 3] *= -1.0 if kind == 1 else 1e3
    return changed


def _pose(random: Random, reach: float) -> FloatArray:
    """Return a pose near the identity."""
    angle, pose = random.normal() * 0.3, np.eye(4)
    pose[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    pose[:3, 3] = random.normal(size=3) * reach
    return pose
