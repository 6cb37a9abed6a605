# SPDX-License-Identifier: MIT
"""Inject faults of connection and robot, described by a short text, with a seed.

A specification is a list of faults separated by commas::

    [robot.|client.]KIND[=PROBABILITY][@TIME|@START-END][:ARGUMENT]

``robot.`` means what the robot sends, ``client.`` what the client sends; without either both. Times are seconds of the
robot's clock since the session began. With a probability each datagram (in the interval, if one is given) is hit at
random; with an interval alone every datagram in it; with a time alone the first datagram from then on.

=============  =========================================================================================
drop           lost
delay:CYCLES   arrives so many cycles later (default 3)
reorder        arrives after the next one that arrives
duplicate      arrives twice
garbage        random bytes instead
empty          an empty datagram instead
identifier     wrong message identifier
missing:FIELD  a field left out (default: the header's sequence counter, which is required)
six            all joint values six instead of seven
nan            all joint values NaN
crc            wrong CRC (2.7 alone)
truncate:FIELD cut before a field of the message: robotInfo, monitorData, connectionInfo (default), ipoData
version:V      the message as a robot of another version sends it
burst          held back, all arrive when the interval ends (by the wall clock: at once); takes an interval
silence        nothing arrives; takes an interval
state:STATE    the robot goes to this session state; takes a time
=============  =========================================================================================

One datagram suffers one fault: the first of the list that hits it. Of the robot itself, each in an interval:

===============  =======================================================================================
quality:VALUE    it reports at most this quality
jitter:SHARE     its time stamps are off by a share of a period, to and fro (default 0.3)
resolution:MS    its time stamps are cut to so many milliseconds (default 1)
clock:SECONDS    its clock is set by so much, forward or back
standing:WHAT    its clock, or its counter, stands still (default clock)
safety:STATE     it reports this safety state (default SAFETY_STOP_LEVEL_1)
drives:STATE     it reports this state of its drives (default OFF)
operation:MODE   it reports this operation mode (default T1)
period:MS        it reports this send period, 0: none
held             the arm is held, and gives way by 1e-6 rad per N m, whatever is commanded
still:JOINTS     the measured positions of joints stand still: A6, A2+A4, or all
stuck:JOINTS_Q   they are Q [rad], such as A6_0.3
toggling:JOINTS_BIT  they stand still but for a bit (0 to 51) that toggles, such as A6_32
late:JOINTS_CYCLES   they are those of so many cycles ago, such as all_20
sensor:WHAT      the force-torque sensor is silent, or its reading is frozen (default silent)
===============  =======================================================================================
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import encoders
from .messages import (
    JOINTS,
    MOST_BYTES,
    VERSIONS,
    DriveState,
    OperationMode,
    Protocol,
    Quality,
    SafetyState,
    SessionState,
)

DIRECTIONS = ("robot", "client")
KINDS = ("drop", "delay", "reorder", "duplicate", "garbage", "empty", "identifier", "missing", "six", "nan", "crc",
         "silence", "state", "quality", "truncate", "version", "burst", "jitter", "resolution", "clock", "standing",
         "safety", "drives", "operation", "period", "held", "sensor", *encoders.KINDS)  # fmt: skip
_CONDITIONS: dict[str, tuple[Any, str | None]] = {
    "quality": (Quality, None),
    "safety": (SafetyState, "SAFETY_STOP_LEVEL_1"),
    "drives": (DriveState, "OFF"),
    "operation": (OperationMode, "T1"),
    "standing": (("clock", "counter"), "clock"),
    "jitter": ((-10.0, 10.0), "0.3"),
    "resolution": ((1.0, 1000.0), "1"),
    "clock": ((-1e9, 1e9), None),
    "period": ((0.0, 100.0), None),
    "held": (None, ""),
    "sensor": (("silent", "frozen"), "silent"),
    **dict.fromkeys(encoders.KINDS, ("joints", None)),
}
"""Arguments of the robot's own faults: valid names or bounds, and default."""
_CUTS = ("robotInfo", "monitorData", "connectionInfo", "ipoData")
_FIELDS = {
    "robot": ("header.sequenceCounter", "robotInfo", "monitorData", "connectionInfo", "ipoData",
              "ipoData.jointPosition", "monitorData.measuredJointPosition", "monitorData.externalTorque",
              "monitorData.timestamp", "connectionInfo.sendPeriod"),
    "client": ("header.sequenceCounter", "commandData", "commandData.jointPosition", "commandData.jointTorque"),
}  # fmt: skip
_ITEM = re.compile(
    r"(?:(?P<direction>robot|client)\.)?(?P<kind>[a-z]+)"
    r"(?:=(?P<probability>[0-9.eE+-]+?))?"
    r"(?:@(?P<start>[0-9.]+)(?:-(?P<end>[0-9.]+))?)?"
    r"(?::(?P<argument>[\w.+-]+))?"
)


class FaultError(ValueError):
    """Error in a fault specification; the text says what is wrong and what is valid."""


@dataclass(frozen=True)
class Fault:
    """One fault of a specification.

    Attributes
    ----------
    kind : str
        One of :data:`KINDS`.
    probability : float or None
        For each datagram; None: every datagram in the interval, or one.
    start, end : float or None
        Interval of the robot's clock [s]; ``end`` None: one datagram, or, with a probability, no end.
    argument : str
        As the table of kinds has it.

    """

    kind: str
    probability: float | None
    start: float | None
    end: float | None
    argument: str

    @property
    def once(self) -> bool:
        """Whether the fault hits only one datagram."""
        return self.probability is None and self.end is None

    def covers(self, time: float) -> bool:
        """Return whether a time [s] is in the interval."""
        return (self.start is None or time >= self.start - 1e-9) and (self.end is None or time < self.end - 1e-9)


@dataclass(frozen=True)
class FaultPlan:
    """Faults of a session: for datagrams by direction, changes of state, and conditions of the robot itself."""

    datagrams: dict[str, tuple[Fault, ...]]
    states: tuple[Fault, ...]
    conditions: tuple[Fault, ...]

    def condition(self, kind: str, time: float) -> str | None:
        """Return the argument of a condition that holds at a time [s], or None."""
        for fault in self.conditions:
            if fault.kind == kind and fault.covers(time):
                return fault.argument
        return None

    def quality_at(self, time: float) -> Quality:
        """Return the best quality that the robot may report at a time [s]."""
        said = self.condition("quality", time)
        return Quality.EXCELLENT if said is None else Quality[said]


def parse_faults(specification: str, version: str) -> FaultPlan:
    """Parse a fault specification for an FRI version.

    Raises
    ------
    FaultError
        It cannot be read; the text names the item.

    """
    plan: dict[str, list[Fault]] = {direction: [] for direction in DIRECTIONS}
    states, conditions = [], []
    for item in filter(None, (part.strip() for part in specification.split(","))):
        match = _ITEM.fullmatch(item)
        if not match:
            raise FaultError(
                f"fault '{item}': not of the form [robot.|client.]KIND[=PROBABILITY][@START[-END]][:ARGUMENT]"
            )
        fault = _checked(item, match, version)
        if fault.kind == "state":
            states.append(fault)
        elif fault.kind in _CONDITIONS:
            conditions.append(fault)
        else:
            for direction in _directions(item, match["direction"], fault):
                plan[direction].append(fault)
    return FaultPlan({key: tuple(value) for key, value in plan.items()}, tuple(states), tuple(conditions))


def _directions(item: str, named: str | None, fault: Fault) -> list[str]:
    """Return whose datagrams a fault hits: those of the side that the item names, else of both that can have it."""
    if fault.kind in ("truncate", "version"):
        return ["robot"]
    sides = list(DIRECTIONS) if named is None else [named]
    if fault.kind != "missing":
        return sides
    having = [side for side in sides if fault.argument in _FIELDS[side]]
    if not having:
        raise FaultError(f"fault '{item}': takes one of {', '.join(_FIELDS[sides[0]])}")
    return having


def _checked(item: str, match: re.Match[str], version: str) -> Fault:
    """Return the fault that an item of --faults describes; raise FaultError where its parts do not fit its kind."""
    kind = match["kind"]
    if kind not in KINDS:
        raise FaultError(f"fault '{item}': no kind '{kind}'; there are {', '.join(KINDS)}")
    try:
        probability, start, end = (
            None if match[name] is None else float(match[name]) for name in ("probability", "start", "end")
        )
    except ValueError as error:
        raise FaultError(f"fault '{item}': {error}") from error
    _check_times(item, kind, probability, start, end)
    if kind in ("state", "truncate", "version", *_CONDITIONS) and match["direction"] == "client":
        raise FaultError(f"fault '{item}': the robot alone decides this")
    if kind == "crc" and version != "2.7":
        raise FaultError(f"fault '{item}': FRI {version} has no CRC in its datagrams; 2.7 has")
    return Fault(kind, probability, start, end, _argument(item, kind, match["argument"] or ""))


def _check_times(item: str, kind: str, probability: float | None, start: float | None, end: float | None) -> None:
    """Refuse a probability or times [s] that a kind of fault does not take."""
    if probability is not None and not 0 <= probability <= 1:
        raise FaultError(f"fault '{item}': a probability is from 0 to 1")
    if start is not None and end is not None and end <= start:
        raise FaultError(f"fault '{item}': the interval ends before it begins")
    if probability is None and start is None:
        raise FaultError(f"fault '{item}': give a probability (=0.01) or a time (@2.5)")
    if kind in ("silence", "burst", *_CONDITIONS) and (end is None or probability is not None):
        raise FaultError(f"fault '{item}': takes an interval, such as @2-2.2")
    if kind == "state" and (end is not None or probability is not None):
        raise FaultError(f"fault '{item}': takes a time, such as @2.5")


def _argument(item: str, kind: str, argument: str) -> str:
    """Check the argument of a fault, and return it, or its default; FaultError for one that the kind does not take."""
    if kind == "delay":
        cycles = argument or "3"
        if not cycles.isdecimal() or not 1 <= int(cycles) <= 1000:
            raise FaultError(f"fault '{item}': takes a number of cycles from 1 to 1000")
        return cycles
    if kind == "missing":
        return argument or "header.sequenceCounter"
    if kind == "state":
        return _among(item, argument.upper(), SessionState.__members__)
    if kind == "truncate":
        return _among(item, argument or "connectionInfo", _CUTS)
    if kind == "version":
        return _among(item, argument, VERSIONS)
    if kind in _CONDITIONS:
        return _condition(item, kind, argument)
    if argument:
        raise FaultError(f"fault '{item}': '{kind}' takes no argument")
    return ""


def _among(item: str, word: str, words: Iterable[str]) -> str:
    if word not in words:
        raise FaultError(f"fault '{item}': takes one of {', '.join(words)}")
    return word


def _condition(item: str, kind: str, argument: str) -> str:
    """Check the argument of a condition, such as a safety state, and return it."""
    allowed, default = _CONDITIONS[kind]
    argument = argument or default or ""
    if allowed == "joints":
        try:
            encoders.parse_joints(kind, argument)
        except ValueError as error:
            raise FaultError(f"fault '{item}': {error}") from error
        return argument
    if allowed is None:
        if argument:
            raise FaultError(f"fault '{item}': '{kind}' takes no argument")
        return ""
    if isinstance(allowed, tuple) and isinstance(allowed[0], float):
        least, most = float(allowed[0]), float(allowed[1])
        try:
            good = least <= float(argument) <= most
        except ValueError:
            good = False
        if not good:
            raise FaultError(f"fault '{item}': takes a number from {least:g} to {most:g}")
        return argument
    if isinstance(allowed, tuple):
        return _among(item, argument, [str(word) for word in allowed])
    return _among(item, argument.upper(), allowed.__members__)


@dataclass(frozen=True)
class Delivery:
    """Datagram to deliver, with the cycle in which it was sent. ``intact``: unchanged, in time, once."""

    datagram: bytes
    cycle: int
    intact: bool


class FaultInjector:
    """Does to the datagrams of one direction what the plan says.

    Parameters
    ----------
    protocol : Protocol
        To take messages apart.
    direction : str
        "robot" or "client".
    faults : tuple of Fault
        Those of this direction.
    seed : int
        Of the random numbers; each datagram uses the same number of them, so that equal sessions meet equal faults.
    period : float
        Of a cycle [s].

    Attributes
    ----------
    counts : Counter
        Datagrams hit, by kind.

    """

    def __init__(
        self, protocol: Protocol, direction: str, faults: tuple[Fault, ...], seed: int, period: float = 0.005
    ) -> None:
        """Prepare the faults of one direction, with random numbers of its own, so that runs repeat."""
        self._protocol = protocol
        self._period = period
        self._class = protocol.monitoring_class if direction == "robot" else protocol.command_class
        self._faults = faults
        self._done: set[int] = set()
        self._random = np.random.default_rng([seed, DIRECTIONS.index(direction)])
        self._held: list[tuple[int | None, Delivery]] = []  # with the cycle to arrive in; None: after the next one
        self._latest = -1  # cycle of the newest datagram that arrived
        self.counts: Counter[str] = Counter()
        self.last: str | None = None
        """Kind of the fault that hit the last datagram, or None."""

    def _hit(self, time: float) -> Fault | None:
        """Return the fault that hits a datagram at a time [s], the first one listed.

        Every fault with a probability draws its number for every datagram, so that equal sessions meet equal faults.
        """
        found = None
        for k, fault in enumerate(self._faults):
            is_drawn = fault.probability is None or self._random.random() < fault.probability
            if found is None and is_drawn and k not in self._done and fault.covers(time):
                found = fault
                if fault.once:
                    self._done.add(k)
        return found

    def send(self, datagram: bytes, time: float, cycle: int) -> list[Delivery]:
        """Return the deliveries that arrive now for a datagram sent at a time [s] in a cycle."""
        fault = self._hit(time)
        self.last = fault.kind if fault else None
        if fault is None:
            self._latest = cycle
            return [Delivery(datagram, cycle, intact=True)]
        self.counts[fault.kind] += 1
        if fault.kind in ("drop", "silence"):
            return []
        if fault.kind in ("delay", "reorder", "burst"):
            self._held.append((self._arrival(fault, time, cycle), Delivery(datagram, cycle, intact=False)))
            return []
        self._latest = cycle
        if fault.kind == "duplicate":
            return [Delivery(datagram, cycle, intact=True), Delivery(datagram, cycle, intact=False)]
        return [Delivery(self._changed(fault, datagram), cycle, intact=False)]

    def _arrival(self, fault: Fault, time: float, cycle: int) -> int | None:
        """Return the cycle in which a held datagram arrives; None: after the next one that arrives."""
        if fault.kind == "delay":
            return cycle + int(fault.argument)
        if fault.kind == "burst":  # in the cycle that ends the interval
            left = (fault.end or time) - time  # [s]
            return cycle + int(np.ceil(left / self._period - 1e-9))
        return None

    def release(self, cycle: int) -> list[Delivery]:
        """Return delayed datagrams that arrive in a cycle, after that cycle's own."""
        due: list[Delivery] = []
        later: list[tuple[int | None, Delivery]] = []
        for at, delivery in self._held:
            is_due = self._latest > delivery.cycle if at is None else at <= cycle
            if is_due:
                due.append(delivery)
            else:
                later.append((at, delivery))
        self._held = later
        return due

    def _changed(self, fault: Fault, datagram: bytes) -> bytes:
        """Return the datagram with the fault: other bytes, or a message with changed fields."""
        if fault.kind == "garbage":
            return self._random.bytes(int(self._random.integers(1, MOST_BYTES + 1)))
        if fault.kind == "empty":
            return b""
        if fault.kind == "crc":
            return datagram[:-1] + bytes([datagram[-1] ^ 0xFF])
        try:
            message = self._class.FromString(self._protocol.unframe(datagram))
        except ValueError:
            return datagram  # what the client sent was no message to begin with
        if fault.kind == "truncate":
            return self._cut(datagram, message, fault.argument)
        if fault.kind == "version":
            return _in_version(message, fault.argument)
        if fault.kind == "identifier":
            message.header.messageIdentifier ^= 1
        elif fault.kind == "missing":
            _clear_field(message, fault.argument)
        else:
            _spoil_joint_values(message, fault.kind)
        return self._protocol.frame(message.SerializePartialToString())

    def _cut(self, datagram: bytes, message: Any, field: str) -> bytes:
        """Return the datagram up to a field of the message; fields are sent in the order of their numbers."""
        number = message.DESCRIPTOR.fields_by_name[field].number
        for descriptor, _ in message.ListFields():
            if descriptor.number >= number:
                message.ClearField(descriptor.name)
        front = len(self._protocol.frame(b"")) // 2
        return datagram[: front + len(message.SerializePartialToString())]


def _in_version(message: Any, version: str) -> bytes:
    """Return a monitoring message as a robot of another FRI version sends it."""
    other = Protocol(version)
    told = other.monitoring_class.FromString(message.SerializePartialToString())
    told.DiscardUnknownFields()
    return other.frame(told.SerializePartialToString())


def _clear_field(message: Any, path: str) -> None:
    """Leave out a field of a message, named by the messages that it lies in: monitorData.timestamp."""
    *parts, name = path.split(".")
    for part in parts:
        message = getattr(message, part)
    message.ClearField(name)


def _spoil_joint_values(message: Any, kind: str) -> None:
    """Make all arrays of joints in a message, and in those inside of it, too short ("six"), or NaN ("nan")."""
    for field, child in message.ListFields():
        if not field.message_type or field.is_repeated:
            continue
        if child.DESCRIPTOR.name != "JointValues":
            _spoil_joint_values(child, kind)
        elif kind == "six":
            del child.value[JOINTS - 1 :]
        else:
            child.value[:] = [float("nan")] * len(child.value)
