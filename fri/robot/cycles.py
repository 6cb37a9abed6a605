# SPDX-License-Identifier: MIT
"""Run one cycle of the robot's side: a message out, commands in, one step of the plant."""

from __future__ import annotations

import time as wall
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import encoders
from .faults import DIRECTIONS, KINDS, Delivery, FaultInjector, FaultPlan
from .link import Link
from .messages import (
    Command,
    CommandMode,
    ControlMode,
    DriveState,
    IODirection,
    IOType,
    IOValue,
    MessageError,
    Monitoring,
    OperationMode,
    OverlayType,
    Protocol,
    SafetyState,
    SessionState,
)
from .record import Recorder
from .robot import Robot
from .session import COMMANDING, Policy, QualityMeter, Session

BUTTON = "MediaFlange.UserButton"
LOCKSTEP_EPOCH = 1_700_000_000_000_000_000
"""Unix time [ns] at which the robot's clock starts in lockstep, so that runs are equal."""
OBSERVE = 10
"""Cycles between two observations of the contact without a log: an observation takes too long for a period of 1 ms."""


@dataclass(frozen=True)
class Settings:
    """Settings of a session.

    Attributes
    ----------
    period : int
        Period of the monitoring messages [ms].
    multiplier : int
        The client answers every so many messages.
    mode : CommandMode
    lockstep : bool
    answer_timeout : float
        Wall time that lockstep waits for an answer, and that a session waits for a client to begin [s].
    button : (float, float) or None
        When the user button is pressed and let go, of the robot's clock [s].
    ios : tuple of IOValue
        Outputs that the client may set, with their values at the start.
    sensor_port : int
        Port of this machine that gets the sensor's reading before each message; 0 for none.

    """

    period: int
    multiplier: int
    mode: CommandMode
    lockstep: bool
    answer_timeout: float = 20.0
    button: tuple[float, float] | None = None
    ios: tuple[IOValue, ...] = ()
    sensor_port: int = 0


@dataclass
class Statistics:
    """Figures of a session.

    ``sent`` monitoring messages, ``received`` datagrams, ``accepted`` commands; ``rejected`` datagrams and outputs by
    reason; ``overruns`` cycles that the emulator itself was late with, by ``slip`` seconds in all; ``in_contact``
    cycles of those ``observed`` in COMMANDING_ACTIVE; ``worst_latency`` of an answer [s];
    ``largest_force`` on the tip [N].
    """

    sent: int = 0
    received: int = 0
    accepted: int = 0
    overruns: int = 0
    slip: float = 0.0
    rejected: Counter[str] = field(default_factory=Counter)
    observed: int = 0
    in_contact: int = 0
    worst_latency: float = 0.0
    largest_force: float = 0.0


class Cycles:
    """Cycles of the robot's side of a session, whatever clock they follow.

    Parameters
    ----------
    link : Link
    protocol : Protocol
    robot : Robot
    session : Session
    policy : Policy
    settings : Settings
    faults : FaultPlan
    seed : int
        Seed of the faults.
    recorder : Recorder or None

    """

    def __init__(
        self,
        link: Link,
        protocol: Protocol,
        robot: Robot,
        session: Session,
        policy: Policy,
        settings: Settings,
        faults: FaultPlan,
        seed: int = 0,
        recorder: Recorder | None = None,
    ) -> None:
        """Connect link, protocol, robot and session, and start all counters; periods are in s, settings in ms."""
        self._link = link
        self._protocol = protocol
        self.robot = robot
        self.session = session
        self._settings = settings
        self._faults = faults
        self.injectors = {
            direction: FaultInjector(protocol, direction, faults.datagrams[direction], seed, settings.period / 1000)
            for direction in DIRECTIONS
        }
        self.forced_states = 0
        self._recorder = recorder
        self._period = settings.period / 1000
        grace = 0 if settings.lockstep else int(np.ceil(policy.grace / self._period))
        self.meter = QualityMeter(policy, settings.multiplier, grace)
        self._executed: deque[bool] = deque(maxlen=policy.tracking_window)
        self.tracking = 0.0
        self._encoders = encoders.Encoders()
        self.statistics = Statistics()
        self.wrench = np.zeros(6)
        self._reading = robot.plant.reading
        self.in_contact = robot.plant.in_contact
        self._epoch = LOCKSTEP_EPOCH if settings.lockstep else wall.time_ns()
        self._cycle = 0
        self._forced = sorted(faults.states, key=lambda fault: fault.start or 0.0)
        self._standing_counter = 0
        self._standing_clock = self._epoch
        self._outputs = {io.name: io for io in settings.ios}
        self._last_command = -1
        self._arrived: list[tuple[Command, float]] = []  # accepted in this cycle, with their latency [s]
        self._received = 0  # datagrams in this cycle
        self._sent_at: deque[tuple[int, float]] = deque(maxlen=1000)
        self._fewest = self._most = 0  # messages that the client may have counted since its last answer
        self._interrupted = False
        self.quiet: Callable[[], bool] | None = None
        """Whether the client has sent all its answers, if this can be observed; lockstep then goes on."""

    @property
    def time(self) -> float:
        """Time of the robot's clock since the session began [s]."""
        return self._cycle * self._period

    def interrupt(self) -> None:
        """End the session in order after this cycle (called by a signal handler)."""
        self._interrupted = True

    def _monitoring(self) -> Monitoring:
        """Return the message of this cycle: the robot's state, as far as no fault condition changes it."""
        session, robot = self.session, self.robot
        commanding = session.state in COMMANDING
        stopped = session.failure is not None
        safety = SafetyState.SAFETY_STOP_LEVEL_1 if stopped else SafetyState.NORMAL_OPERATION
        said = {kind: self._faults.condition(kind, self.time) for kind in ("safety", "drives", "operation", "period")}
        return Monitoring(
            state=session.state,
            quality=min(session.quality, self._faults.quality_at(self.time)),
            send_period=self._settings.period if said["period"] is None else int(float(said["period"])),
            receive_multiplier=self._settings.multiplier,
            sequence=self._counter(),
            reflected=max(self._last_command, 0),
            safety=SafetyState[said["safety"]] if said["safety"] else safety,
            drive=DriveState[said["drives"] or "ACTIVE"],
            operation=OperationMode[said["operation"] or "AUT"],
            control=ControlMode.JOINT_IMPEDANCE if commanding else ControlMode.POSITION,
            command_mode=self._settings.mode if commanding else CommandMode.NO_COMMAND_MODE,
            overlay=OverlayType.JOINT if commanding else OverlayType.NO_OVERLAY,
            position=self._encoders.read(robot.q, self._encoder_faults()),
            torque=robot.measured_torque,
            commanded_position=robot.commanded_position,
            commanded_torque=robot.commanded_torque,
            external_torque=robot.external_torque,
            external_force=self.wrench,
            pose=robot.pose() if self._protocol.cartesian else np.full(7, np.nan),
            redundancy=float(robot.q[2]),  # [POLICY] E1 is taken for the position of A3
            ios=[IOValue(BUTTON, IOType.BOOLEAN, IODirection.INPUT, self._pressed()), *self._outputs.values()],
            ipo=robot.set_point if commanding else None,
            tracking=self.tracking,
            sent_at=self._clock(),
        )

    def _encoder_faults(self) -> dict[str, str]:
        """Return the arguments of the encoders' faults of this cycle, by kind."""
        said = {kind: self._faults.condition(kind, self.time) for kind in encoders.KINDS}
        return {kind: argument for kind, argument in said.items() if argument is not None}

    def _counter(self) -> int:
        """Return the sequence counter of this cycle's message; a fault may stop it."""
        if self._faults.condition("standing", self.time) != "counter":
            self._standing_counter = self._cycle
        return self._standing_counter

    def _clock(self) -> int:
        """Return the Unix time [ns] of this cycle as the robot reports it, with the faults of its clock."""
        period = self._settings.period * 1_000_000  # [ns]
        now = self._epoch + self._cycle * period
        now += round(1e9 * self._condition_number("clock"))  # set by so many seconds
        off = round(self._condition_number("jitter") * period)  # a share of the period, to and fro
        now += off if self._cycle % 2 else -off
        now -= now % max(1, round(1e6 * self._condition_number("resolution")))  # cut to so many milliseconds
        if self._faults.condition("standing", self.time) != "clock":
            self._standing_clock = now
        return self._standing_clock

    def _condition_number(self, kind: str) -> float:
        """Return the number of a fault condition that holds in this cycle; 0 without one."""
        return float(self._faults.condition(kind, self.time) or 0)

    def _pressed(self) -> bool:
        span = self._settings.button
        return span is not None and span[0] <= self.time < span[1]

    def _begin(self) -> tuple[Monitoring, list[Delivery]]:
        """Apply state faults; return this cycle's message and the datagrams that arrive at the client."""
        while self._forced and self._forced[0].covers(self.time):
            self.forced_states += 1
            old = self.session.state
            self.session.force(SessionState[self._forced.pop(0).argument])
            self._follow_state(old)
        monitoring = self._monitoring()
        self._send_reading()
        self._arrived.clear()
        self._received = 0
        if self.session.state is SessionState.IDLE:
            return monitoring, []
        datagram = self._protocol.encode_monitoring(monitoring)
        self.statistics.sent += 1
        if self._cycle == 0:  # the client learns the robot's address from it; faults begin later
            return monitoring, [Delivery(datagram, 0, True)]
        injector = self.injectors["robot"]
        return monitoring, injector.send(datagram, self.time, self._cycle) + injector.release(self._cycle)

    def _send_reading(self) -> None:
        """Send the sensor's reading, with the sensor's faults."""
        fault = self._faults.condition("sensor", self.time)
        if fault != "frozen":
            self._reading = self.robot.plant.reading
        if self._settings.sensor_port and fault != "silent":
            self._link.send_reading(self._reading, self._settings.sensor_port)

    def _take(self, datagram: bytes) -> None:
        """Accept a datagram from the client and apply the faults of its direction."""
        self.statistics.received += 1
        self._received += 1
        for delivery in self.injectors["client"].send(datagram, self.time, self._cycle):
            self._decode(delivery.datagram)

    def _decode(self, datagram: bytes) -> None:
        """Read a command; reject it if it is damaged, old, or answers a message that was not sent."""
        statistics = self.statistics
        try:
            command = self._protocol.decode_command(datagram)
        except MessageError as error:
            statistics.rejected[error.kind] += 1
            return
        if command.sequence <= self._last_command:
            statistics.rejected["out of order or twice"] += 1
            return
        if command.reflected > self._cycle:
            statistics.rejected["answers nothing"] += 1
            return
        self._last_command = command.sequence
        statistics.accepted += 1
        latency = self._latency(command.reflected)
        if latency > statistics.worst_latency:
            statistics.worst_latency = latency
        self.meter.answered(command.reflected)
        self._arrived.append((command, latency))

    def _latency(self, sequence: int) -> float:
        """Return the wall time [s] since the message of a number was sent last; NaN if that is too long ago."""
        now = wall.perf_counter()
        return next((now - at for sent, at in reversed(self._sent_at) if sent == sequence), np.nan)

    def _finish(self, monitoring: Monitoring) -> None:
        """End a cycle after its answers: execute commands, advance the session and the plant."""
        for delivery in self.injectors["client"].release(self._cycle):
            self._decode(delivery.datagram)
        session, robot = self.session, self.robot
        old = monitoring.state
        complete = False
        for command, _ in self._arrived:
            self._write_outputs(command)
            if old not in COMMANDING:
                continue
            complete |= robot.complete(command)
            objection = robot.objection(command)
            if objection:
                session.fail(objection)
            elif old is SessionState.COMMANDING_ACTIVE:
                robot.command(command)
        trouble = robot.trouble()
        if trouble:
            session.fail(trouble)
        row = self._record(monitoring)
        quality = min(self.meter.judge(self._cycle), self._faults.quality_at(self.time))
        self._track(old, complete)
        if session.state is old and old is not SessionState.IDLE:
            session.advance(quality, answered=bool(self._arrived), complete=complete)
        self._follow_state(old)
        robot.step(self._period, held=self._faults.condition("held", self.time) is not None)
        if row is not None:
            row["applied_torque"] = robot.applied
        self._observe(old)
        self._cycle += 1
        if self._interrupted:
            session.failure = session.failure or "interrupted"
            session.end("interrupted")

    def _follow_state(self, old: SessionState) -> None:
        """Release the arm when commanding starts, and hold it when commanding ends."""
        new = self.session.state
        if new is old:
            return
        if new is SessionState.COMMANDING_ACTIVE:
            self.robot.release()
        elif old in COMMANDING or new is SessionState.COMMANDING_WAIT:
            self.robot.hold()

    def _track(self, state: SessionState, complete: bool) -> None:
        """Update the tracking performance [POLICY]: share of the last commands that came at once."""
        if state is not SessionState.COMMANDING_ACTIVE:
            self._executed.clear()
            self.tracking = 0.0
            return
        self._executed.append(complete or (self._cycle + 1) % self._settings.multiplier != 0)
        self.tracking = sum(self._executed) / len(self._executed)

    def _observe(self, state: SessionState) -> None:
        """Read external wrench and contact for the next message, the log, the status line and the counts."""
        every = self._recorder is not None or self._cycle % OBSERVE == 0
        if every or self._protocol.framed:
            self.wrench = self.robot.plant.wrench(self.robot.model)
        if every:
            self.in_contact = self.robot.plant.in_contact
        if every and state is SessionState.COMMANDING_ACTIVE:
            statistics = self.statistics
            statistics.observed += 1
            statistics.in_contact += self.in_contact
            statistics.largest_force = max(statistics.largest_force, float(np.linalg.norm(self.wrench[:3])))

    def _write_outputs(self, command: Command) -> None:
        for io in command.ios:
            known = self._outputs.get(io.name)
            if known is None or known.type is not io.type:
                self.statistics.rejected["IO"] += 1
            else:
                known.value = io.value

    def _record(self, sent: Monitoring) -> Any:
        """Fill a row of the recording with what was sent; return None without a recorder."""
        if self._recorder is None:
            return None
        row = self._recorder.new_row()
        row["time"], row["timestamp"] = self.time, sent.sent_at
        row["sequence"], row["reflected"] = sent.sequence, sent.reflected
        row["state"], row["quality"], row["safety"] = sent.state, sent.quality, sent.safety
        row["command_mode"], row["button"], row["tracking"] = sent.command_mode, self._pressed(), sent.tracking
        row["q"], row["dq"], row["torque"] = sent.position, self.robot.dq, sent.torque
        row["external_torque"] = sent.external_torque
        row["sent_position"], row["sent_torque"] = sent.commanded_position, sent.commanded_torque
        row["ipo"] = np.nan if sent.ipo is None else sent.ipo
        row["pose"], row["wrench"] = sent.pose, sent.external_force
        row["in_contact"] = self.in_contact
        for direction in DIRECTIONS:
            last = self.injectors[direction].last
            row[f"{direction}_fault"] = -1 if last is None else KINDS.index(last)
        self.injectors["client"].last = None
        row["received"], row["accepted"] = self._received, len(self._arrived)
        command, latency = self._arrived[-1] if self._arrived else (Command(-1, -1, None, None, ()), np.nan)
        row["command_sequence"], row["command_reflects"] = command.sequence, command.reflected
        row["has_position"], row["has_torque"] = command.position is not None, command.torque is not None
        row["command_position"] = np.nan if command.position is None else command.position
        row["command_torque"] = np.nan if command.torque is None else command.torque
        row["latency"] = latency
        return row
