# SPDX-License-Identifier: MIT
"""Session of two controllers with random configurations and events: gaps, jumps, faults, resets, overwritten states."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from stiffgen.control.core.field import Field
from stiffgen.control.sessions.library import ControllerLibrary, fill, is_same, set_field
from stiffgen.control.sessions.spoilers import SPOILERS
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray

_CHOSEN_APART = ("sample_time", "delay_samples", "motor_inertia", "lower_limit", "upper_limit", "tool_pose")
"""Fields of the configuration that a session chooses by rules of their own."""
_RANGES = {
    "position_quantum": (-7.0, -3.0), "velocity_noise": (-4.0, -1.0), "spring_limit": (0.0, 2.0),
    "coulomb_friction": (-1.0, 2.0),
}  # fmt: skip
"""Powers of ten between which fields lie whose default is 0 or infinite."""
_TANK = (-3.0, 1.5)
"""Powers of ten [J] of a tank that is stated."""
Random = np.random.Generator


class HostileSession:
    """Session with a configuration, an arm that moves with the reference's torque, and random events.

    A seed names a session: a draw more, or in another place, makes other sessions of all seeds. ``config``, ``input``
    and ``output`` are the reference's; the library has copies of the first two.
    """

    steps = 400
    """Number of steps."""

    def __init__(self, reference: ControllerLibrary, library: ControllerLibrary, chain: Chain, random: Random) -> None:
        """Draw a session: calm or wild, its configuration, and where the arm starts within its limits."""
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
        self._start()

    def _configure(self) -> None:
        """Take the defaults, and change fields at random."""
        random, config = self.random, self.config
        self.both[0].take_defaults()
        config.sample_time = float(random.choice([1e-3, 1e-3, 2e-3, 5e-3, 0.02]))
        config.delay_samples = int(random.integers(0, 6))
        fill(config.motor_inertia, random.uniform(0.1, 0.6, self.n))  # [kg m^2]
        self.inertia = np.array(config.motor_inertia) + random.uniform(0.2, 2.0, self.n)
        for field in self.both[0].fields:
            if field.name not in _CHOSEN_APART and random.random() < (0.15 if self.calm else 0.35):
                self._vary(field)
        if random.random() < 0.5:
            config.tank_initial = 10.0 ** random.uniform(*_TANK)
        if self.chain.runtime_tool:
            fill(config.tool_pose, np.stack([_pose(random, 0.1) for _ in self.chain.tips]))

    def _vary(self, field: Field) -> None:
        """Change a field of the configuration within its own rule; rules about several fields may refuse the result.

        A field over joints gets one value and a share of it per joint.
        """
        random = self.random
        if field.choices:
            value: float = int(random.integers(1, len(field.choices) + 1))
        elif field.name in _RANGES:
            value = 10.0 ** random.uniform(*_RANGES[field.name])
        else:
            present = getattr(self.config, field.name)
            typical = float(np.max(np.abs(present))) if field.shape else float(present)
            value = typical * 10.0 ** random.uniform(-1.5, 0.7)
        value = min(max(value, field.least), field.most)
        set_field(self.config, field, round(value) if field.type == "int" else value, -1)
        if field.shape == ("n",):
            fill(getattr(self.config, field.name), value * self.random.uniform(0.5, 1.0, self.n))

    def _start(self) -> None:
        """Initialise both controllers, with the arm inside its limits, sometimes with a torque in force."""
        random = self.random
        self.q = np.clip(self.q, np.array(self.config.lower_limit), np.array(self.config.upper_limit))
        torque = None
        if random.random() < 0.3:
            values = random.uniform(-0.2, 0.2, self.n) * np.array(self.config.effort_limit)
            torque = (ctypes.c_double * self.n)(*values)
        for each in self.both:
            ctypes.memset(each.state, 0, ctypes.sizeof(each.state))
            ctypes.memset(ctypes.byref(each.output), 0, ctypes.sizeof(each.output))
            ctypes.memset(ctypes.byref(each.input), 0, ctypes.sizeof(each.input))
        self._initialise(torque)
        self.ticks = int(random.integers(0, 2**32))
        self.goal = self.q + 0.0
        self.absent = self.held = self.stuck = 0
        self.pressed = np.zeros(len(self.input.wrench_command))
        share = random.choice([0.0, 0.2])  # a torque in force at the start is the caller's as far as it is offset
        self.offset = random.normal(size=self.n) * np.array(self.config.effort_limit) * share
        self.rate, self.stated = np.zeros(self.n), np.zeros(self.n)
        self.stuck_field, self.shaped = "q", 0
        self.clock = 2 if random.random() < 0.3 else 1
        self._choose_stiffness()

    def _initialise(self, torque: Any) -> int:
        """Initialise both controllers with the reference's configuration and a torque in force; return the error."""
        _copy(self.config, self.both[1].config)
        errors = [each.call("init", each.config, each.state, torque) for each in self.both]
        return errors[0]

    def _choose_stiffness(self) -> None:
        """Choose translational and rotational stiffness of the springs, (2, springs, 3, 3), and of the posture.

        One in ten is not positive.
        """
        random = self.random
        roots = random.normal(size=(2, len(self.input.rotation_stiffness) // 9, 3, 3))
        scale = np.array([500.0, 20.0]) * 10.0 ** random.uniform(-1.5, 0.5)  # [N/m], [N m/rad]
        self.stiffness = (roots @ np.swapaxes(roots, 2, 3) / 3) * scale[:, None, None, None]
        self.posture = random.uniform(0.0, 1.0, self.n) * 10.0 ** random.uniform(-1.0, 2.0) * random.integers(0, 2)
        if random.random() < 0.1:
            self.stiffness[:, :, 0, 0] *= -1.0

    def _choose_plan(self) -> None:
        """Choose the rate of the goal, and the acceleration that the plan states: some, or none."""
        random, limit = self.random, np.nan_to_num(np.array(self.config.velocity_limit))
        self.rate = random.uniform(-0.3, 0.3, self.n) * limit * random.integers(0, 2)
        self.shaped = int(random.integers(0, 2))
        share = random.choice([0.0, 0.01, 0.3, 1.0], p=[0.4, 0.3, 0.2, 0.1])
        self.stated = share * random.uniform(-3.0, 3.0, self.n) * limit / max(self.config.ramp_time, 1e-4)

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
        results = [each.call("step", each.state, each.input, each.output) for each in self.both]
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
        """Change goal, stiffness, wrench, torque offset or plan, each with a probability of 1 or 2 % per sample."""
        random = self.random
        if number == 5 or random.random() < 0.01:
            self.goal = self.q + random.normal(size=self.n) * 10.0 ** random.uniform(-3, -0.5 if self.calm else 0)
        if random.random() < 0.02:
            self.goal = self.goal + random.normal(size=self.n) * 1e-3
        if random.random() < 0.01:
            self._choose_stiffness()
        if random.random() < 0.02:
            size = np.repeat(self.config.heaviest_wrench, 3) * random.choice([0.0, 0.1, 0.7])
            self.pressed = (random.uniform(-1.0, 1.0, (len(self.pressed) // 6, 6)) * size).ravel()
        if random.random() < 0.01:
            share = random.choice([0.0, 0.01, 0.2, 0.9])
            self.offset = random.normal(size=self.n) * np.array(self.config.effort_limit) * share
        if random.random() < 0.02:
            self._choose_plan()

    def _choose_troubles(self) -> None:
        """Let a load, a reset, another configuration, an obstacle or a clock's restart happen, each rarely."""
        random, rate = self.random, 0.15 if self.calm else 1.0
        if random.random() < 0.03 * rate:
            share = 0.02 if self.calm else random.choice([0, 0.3])
            self.load = random.normal(size=self.n) * np.array(self.config.effort_limit) * share
        if random.random() < (0.08 if self.output.fault else 0.01):
            for each in self.both:
                each.call("reset", each.state)
        if random.random() < (0.003 if self.calm else 0.006):
            self._change_config()
        if random.random() < 0.004 * rate:
            self.clock = 3 - self.clock
        if random.random() < 0.004:  # an obstacle holds the arm, perhaps far from the goal
            self.held = int(random.integers(5, 80))
            self.goal = self.goal + random.normal(size=self.n) * random.choice([0.0, 1.0])
        if random.random() < 0.003 * rate:  # the robot's clock starts again
            self.ticks -= int(random.integers(2, 2000))
        if random.random() < (0.05 if self.output.fault else 0.001 * rate):
            self.dq = 0.1 * self.dq
            self._start()

    def _change_config(self) -> None:
        """Begin anew with the torque in force and one field changed, now and then to a value that is refused.

        Of the refused ones one in five stays: the state is then none, until another start.
        """
        random, before, fields = self.random, bytes(self.config), self.both[0].fields
        field = fields[int(random.integers(len(fields)))]
        if field.name in ("lower_limit", "upper_limit"):
            outwards = -1.0 if field.name == "lower_limit" else 1.0
            fill(getattr(self.config, field.name), self.q + outwards * random.uniform(-0.2, 0.6, self.n))
        elif field.name == "tool_pose":
            self.config.tool_pose[3] += 0.01 if random.random() < 0.8 else math.nan
        elif random.random() < 0.2:
            set_field(self.config, field, math.nan if field.type == "double" else -1, int(random.integers(self.n)))
        else:
            self._vary(field)
        torque = (ctypes.c_double * self.n)(*self.output.torque)
        if self._initialise(torque) != 0 and random.random() < 0.8:
            ctypes.memmove(ctypes.byref(self.config), before, len(before))
            self._initialise(torque)

    def _write_input(self) -> None:
        """Write a good sample and a command into the reference's input; now and then the command is refused."""
        random, given, n = self.random, self.input, self.n
        self.ticks += 1
        given.sample_valid, given.clock = 1, self.clock
        self.write_clock()
        measured = np.round(self.q / self.quantum) * self.quantum if self.quantum else self.q
        fill(given.q, measured)
        fill(given.dq, self.dq + (0.0 if self.calm else 1e-4) * random.normal(size=n))
        # [rad] outside the limits: clipped by the controller, or refused
        beyond = 0.05 if random.random() < 0.99 else 100.0
        low, high = np.array(self.config.lower_limit), np.array(self.config.upper_limit)
        fill(given.q0, np.clip(self.goal, low - beyond, high + beyond))
        given.shaped = self.shaped
        # rounded, and so not quite symmetric
        stiffness = self.stiffness.astype(np.float32) if random.random() < 0.05 else self.stiffness
        for field in ("translation_stiffness", "rotation_stiffness"):
            fill(getattr(given, field), stiffness[int(field.startswith("rotation"))])
        fill(given.posture_stiffness, self.posture)
        fill(given.wrench_command, self.pressed)
        fill(given.torque_offset, self.offset)
        fill(given.acceleration, self.stated)

    def write_clock(self) -> None:
        """Write both clocks; the one in seconds is up to a third of a sample time early or late."""
        given, ticks = self.input, self.ticks % 2**32
        given.counter, given.time = ticks, (ticks + self.random.uniform(-0.3, 0.3)) * float(self.config.sample_time)

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
            self.ticks += int(random.integers(1, 6))
            self.write_clock()
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
        self.dq = self.dq + time * (torque + self.load - 2.0 * self.dq) / self.inertia
        self.dq = finite(self.dq).clip(-20.0, 20.0)
        self.q = self.q + time * self.dq


def finite(values: FloatArray) -> FloatArray:
    """Return numbers with NaN as 0 and infinity as the largest one; np.nan_to_num alone is slow."""
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def _copy(source: Any, target: Any) -> None:
    ctypes.memmove(ctypes.byref(target), ctypes.byref(source), ctypes.sizeof(source))


def _pose(random: Random, reach: float) -> FloatArray:
    """Return a pose near the identity."""
    angle, pose = random.normal() * 0.3, np.eye(4)
    pose[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    pose[:3, 3] = random.normal(size=3) * reach
    return pose
