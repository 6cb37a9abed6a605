# SPDX-License-Identifier: MIT
"""Session of two controllers with random configurations and events: gaps, jumps, faults, resets, overwritten states."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np

from stiffgen.control.core.field import Field
from stiffgen.control.sessions.events import choose_commands, choose_stiffness, choose_troubles, random_torque
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
_COUNTER, _TIME = 1, 2
"""Clocks of a call, NAME_CLOCK_...: numbers of the sample times, or seconds."""
_COPIES = 6
"""Copies, n doubles each, with which a state begins: three of the last torque, then three of its largest change."""
_OVERWRITTEN = 40
"""Doubles per joint from the state's beginning, among which one is overwritten."""
_LARGEST_STEP, _FASTEST = 0.02, 20.0
"""Largest step of the simulated arm [s], and its largest velocity [rad/s or m/s]."""
_BAD = (math.nan, math.inf, -math.inf, 1e7)
"""Values of a sample that is falsified."""
_TEXT_SIZES = (512, 512, 40, 1, 0)
"""Bytes of memory for texts."""
Random = np.random.Generator


class HostileSession:
    """Session with a configuration, an arm that moves with the reference's torque, and random events.

    A seed names a session: a draw more, or in another place, makes other sessions of all seeds. ``config``, ``input``
    and ``output`` are the reference's; the library has copies of the first two.
    """

    steps = 400
    """Number of steps."""
    stiffness: FloatArray
    """Translational and rotational stiffness of the springs, (2, springs, 3, 3)."""
    posture: FloatArray
    """Stiffness of the posture spring (n) [N m/rad]."""

    def __init__(self, reference: ControllerLibrary, library: ControllerLibrary, chain: Chain, random: Random) -> None:
        """Draw a session: calm or wild, its configuration, and where the arm starts within its limits."""
        self.both, self.chain, self.random = (reference, library), chain, random
        self.config, self.input, self.output = reference.config, reference.input, reference.output
        motors, self.n = chain.motor_coordinates, len(chain.motor_coordinates)
        reach = [math.pi if c.type != "prismatic" else 1.0 for c in motors]
        self.lower, self.upper = np.array([c.range_within(r) for c, r in zip(motors, reach, strict=True)]).T
        self.calm = random.random() < 0.6
        self._configure()
        self.q = self.lower + (self.upper - self.lower) * self._drawn_place()
        self.dq, self.load = np.zeros(self.n), np.zeros(self.n)
        self.quantum = float(self.config.position_quantum)
        self.start()

    def _drawn_place(self) -> FloatArray:
        """Return shares (n) of the joints' ranges: all joints in the middle or near a limit, or each anywhere else."""
        if self.random.random() < 0.4:
            return np.full(self.n, self.random.choice([0.5, 0.98, 0.02, 1.0]))
        return self.random.uniform(0.1, 0.9, self.n)

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
                self.vary(field)
        if random.random() < 0.5:
            config.tank_initial = 10.0 ** random.uniform(*_TANK)
        if self.chain.runtime_tool:
            fill(config.tool_pose, np.stack([_pose(random, 0.1) for _ in self.chain.tips]))

    def vary(self, field: Field) -> None:
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

    def start(self) -> None:
        """Initialise both controllers, with the arm inside its limits, sometimes with a torque in force."""
        random = self.random
        effort = np.array(self.config.effort_limit)
        self.q = np.clip(self.q, np.array(self.config.lower_limit), np.array(self.config.upper_limit))
        torque = None
        if random.random() < 0.3:
            torque = (ctypes.c_double * self.n)(*(random.uniform(-0.2, 0.2, self.n) * effort))
        for each in self.both:
            for memory in (each.state, each.output, each.input):
                ctypes.memset(ctypes.byref(memory), 0, ctypes.sizeof(memory))
        self.initialise(torque)
        self.ticks = int(random.integers(0, 2**32))  # number of the sample time; C's counter is that modulo 2^32
        self.absent = 0  # samples that are still to be lost
        self.held = 0  # steps for which an obstacle still holds the arm
        self.stuck, self.stuck_field = 0, "q"  # samples that still repeat old values, of q or dq
        self.goal, self.rate = self.q + 0.0, np.zeros(self.n)  # command, and its velocity [rad/s or m/s]
        self.shaped, self.stated = 0, np.zeros(self.n)  # acceleration that a plan states [rad/s^2 or m/s^2]
        self.pressed = np.zeros(len(self.input.wrench_command))
        # a torque in force at the start is the caller's as far as it is offset
        self.offset = random_torque(self, random.choice([0.0, 0.2]))
        self.clock = _TIME if random.random() < 0.3 else _COUNTER
        choose_stiffness(self)

    def switch_clock(self) -> None:
        """Give the calls the other clock."""
        self.clock = _TIME if self.clock == _COUNTER else _COUNTER

    def initialise(self, torque: Any) -> int:
        """Initialise both controllers with the reference's configuration and a torque in force; return the error."""
        _copy(self.config, self.both[1].config)
        errors = [each.call("init", each.config, each.state, torque) for each in self.both]
        return errors[0]

    def find_difference(self) -> int | None:
        """Run the session; return the number of the first step whose results differ, or None."""
        for number in range(self.steps):
            if not self.step(number):
                return number
        reference, library = self.both
        has_same_memory = bytes(reference.state) == bytes(library.state)  # also behind the state
        return None if has_same_memory else self.steps

    def step(self, number: int) -> bool:
        """Step both controllers once; return whether all their outputs are the same."""
        choose_commands(self, number)
        choose_troubles(self)
        self._write_input()
        self._spoil_sample()
        _copy(self.input, self.both[1].input)
        if self.random.random() < (0.001 if self.calm else 0.006):
            self._overwrite_state()
        errors = [each.call("step", each.state, each.input, each.output) for each in self.both]
        if self.held > 0:  # by an obstacle
            self.held, self.dq = self.held - 1, np.zeros(self.n)
        else:
            self._move()
        has_texts = self.output.fault or self.output.refusal or number == 0
        has_same_texts = not has_texts or self._has_same_texts()
        return errors[0] == errors[1] and has_same_texts and is_same(*self.both)

    def _has_same_texts(self) -> bool:
        """Return whether both put out the same texts of fault and refusal, in memory that may be too short."""
        size = _TEXT_SIZES[self.random.integers(len(_TEXT_SIZES))]
        reference, library = ((each.fault_text(size), each.refusal_text(size)) for each in self.both)
        return reference == library

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
        fill(given.q0, self.goal.clip(low - beyond, high + beyond))
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

        A sample that is not lost has at most one of the single events: each has the probability of its interval of
        ``event``, an eighth of it in a calm session.
        """
        random, given = self.random, self.input
        event, joint = random.random() * (8.0 if self.calm else 1.0), int(random.integers(self.n))
        bad = _BAD[random.integers(len(_BAD))]  # as random.choice, which is slow
        self._begin_gap()
        if self.stuck > 0:
            self.stuck -= 1
            fill(getattr(given, self.stuck_field), self.stuck_values)
        if self.absent > 0:
            self._lose_sample()
            return
        spoil = next((each for end, each in SPOILERS if event < end), None)
        if spoil is not None:
            spoil(self, given, joint, bad)

    def _begin_gap(self) -> None:
        """Sometimes let samples be lost from now on, or let positions or velocities be stuck at those of this one."""
        random = self.random
        if random.random() < 0.004:
            self.absent = int(random.integers(1, 30))
        if random.random() < 0.003:
            self.stuck, self.stuck_field = int(random.integers(5, 80)), str(random.choice(["q", "dq"]))
            self.stuck_values = np.array(getattr(self.input, self.stuck_field))

    def _lose_sample(self) -> None:
        """Take the sample away; sometimes calls are left out, too."""
        self.absent -= 1
        self.input.sample_valid = 0
        if self.random.random() < 0.1:
            self.ticks += int(self.random.integers(1, 6))
            self.write_clock()

    def _overwrite_state(self) -> None:
        """Overwrite the same number of both states, or the same one in two of the last torque's three copies."""
        random, n = self.random, self.n
        is_copy = random.random() < 0.7
        place = int(random.integers(_COPIES * n) if is_copy else random.integers(_COPIES * n, _OVERWRITTEN * n))
        if place < n and random.random() < 0.3:  # the wrong number has the majority
            value = random.choice([math.nan, math.inf, 1e300])
            for each in self.both:
                each.state[place] = each.state[place + n] = value
            return
        for each in self.both:
            each.state[place] = each.state[place] * 1.5 + 0.125

    def _move(self) -> None:
        """Move arm and goal for one sample time: the controller's torque, a load, friction and diagonal inertia."""
        time = min(float(self.config.sample_time), _LARGEST_STEP) if self.config.sample_time > 0 else 1e-3
        self.goal = self.goal + time * self.rate
        torque = finite(np.array(self.output.torque))
        friction = 2.0 * self.dq  # [N m] at 2 N m s/rad
        self.dq = self.dq + time * (torque + self.load - friction) / self.inertia
        self.dq = finite(self.dq).clip(-_FASTEST, _FASTEST)
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
