# SPDX-License-Identifier: MIT
"""Table of the controller's memory between steps, by phase: the only list of it.

The structs in NAME_impedance.h with their comments, the check of their integers and the invariant of ``stiffgen prove``
are made from this table. Doubles come first, so that no padding lies between the fields.
"""

from __future__ import annotations

from stiffgen.control.core.config import CONFIG
from stiffgen.control.core.field import POSE, SCALAR, SPRINGS, Extent, Field, N
from stiffgen.control.core.words import REASONS

_MOST = 100_000
"""Bound of counters that only tell how long something lasts."""


def _number(name: str, shape: tuple[Extent, ...], unit: str, meaning: str, when: str = "") -> Field:
    return Field(name, shape, unit, meaning, when=when)


def _count(name: str, least: int, most: int, meaning: str, shape: tuple[Extent, ...] = SCALAR) -> Field:
    """Return an integer that lies between the bounds before and after every call."""
    return Field(name, shape, "", meaning, least=least, most=most, type="int")


def _any(name: str, meaning: str, type_: str = "int") -> Field:
    """Return an integer that may have any value."""
    return Field(name, SCALAR, "", meaning, type=type_)


ARM: tuple[Field, ...] = (
    _number("zone", (3, "n"), "", "limit zone per joint: lower edge, upper edge, stiffness [N m/rad]"),
    _number("joints", ("joints",), "rad", "joints of the tree from which the loops are closed", when="loops"),
)
WATCH: tuple[Field, ...] = (
    _number("q", N, "rad", "last believed position; turns of continuous joints are counted"),
    _number("dq", N, "rad/s", "velocity of this sample"),
    _number("moved", N, "rad", "motion that dq shows, less that of q, while one of them stands still"),
    _number("still_least", N, "N m", "least torque while the position is the same to the last bit"),
    _number("still_most", N, "N m", "largest torque in this time"),
    _number("peak", N, "rad/s", "velocity where the swing that goes on is largest"),
    _number("last_peak", N, "rad/s", "velocity where the swing before it ended"),
    _number("swing", N, "rad/s", "size of the swing before it"),
    _number("time", SCALAR, "s", "time of the last call by clock time"),
    _number("lead", SCALAR, "samples", "lead of the clock over the samples that it was counted as"),
    _number("fastest", SCALAR, "", "largest speed over its limit since one is above its limit"),
    _count("q_age", 0, _MOST, "samples since q changed", N),
    _count("dq_age", 0, _MOST, "samples since dq changed", N),
    _count("swings", 0, 32, "swings to and fro without decay, twice; odd: the swing that goes on is downwards", N),
    _count("since", 0, _MOST, "samples since the last one ended", N),
    _any("counter", "number of the last sample time", "uint32_t"),
    _count("known", 0, 1, "a position is believed: the account has begun"),
    _count("seen", 0, 2, "clock of the last call, NAME_CLOCK_...; 0 before the first"),
    _count("bad", 0, 7, "the last three samples, one bit each: 1 was not believed"),
    _count("missed", 0, _MOST, "calls since the last believed sample"),
    _count("good", 0, _MOST, "believed samples in a row"),
    _count("fast", 0, _MOST, "samples in a row beyond a velocity limit"),
    _count("rises", 0, _MOST, "samples since then in which the speed has risen"),
)
FAULT: tuple[Field, ...] = (
    _number("seen", SCALAR, "", "number that the fault is about"),
    _number("limit", SCALAR, "", "limit of this number"),
    _number("time", SCALAR, "s", "time since the fault was latched"),
    _count("reason", 0, len(REASONS) - 1, "its reason, NAME_REASON_...; 0 for no fault"),
    _any("joint", "joint that the fault is about, or -1"),
    _count("reset", 0, 1, "a reset is asked for"),
)
REFERENCE: tuple[Field, ...] = (
    _number("r", N, "rad", "reference: the springs are at rest at its poses"),
    _number("dr", N, "rad/s", "its velocity"),
    _number("trend", N, "rad/s", "its velocity, 10 ms late"),
    _number("wanted", N, "rad", "q0 of the last accepted command"),
    _number("equilibrium", POSE, "m", "poses of the tips at r"),
    _number("scale", SCALAR, "", "scale l of the springs, from 0 to 1"),
    _number("press", SCALAR, "", "share of wrench_command in force"),
    _count("engaged", 0, 1, "the springs are in force"),
    _count("commanded", 0, 1, "a command was accepted since init"),
)
STIFFNESS: tuple[Field, ...] = (
    _number("translation", SPRINGS, "N/m", "stiffness Kt"),
    _number("rotation", SPRINGS, "N m/rad", "stiffness Ko"),
    _number("posture", N, "N m/rad", "stiffness of the posture spring"),
)
ACCOUNT: tuple[Field, ...] = (
    _number("tank", SCALAR, "J", "energy in the tank"),
    _number("supplied", SCALAR, "J", "all that start, restarts and travel have supplied"),
    _number("springs", SCALAR, "J", "energy l U of the springs"),
    _number("zones", SCALAR, "J", "energy of the limit zones"),
    _number("history", (6, "n"), "N m", "own torques of the last sample times, newest first"),
    _number("gap_change", N, "N m", "sum of |change of torque| in a gap, each times the intervals before it"),
    _number("gap_total", N, "N m", "sum of |torque| over the intervals of a gap"),
    _number("gap_torque", N, "N m", "torque that acted in the newest interval of a gap"),
    _count("gap", 0, 2 * _MOST, "sample times since the last believed sample"),
    _count("hold", 0, 100, "calls without a sample for which the last torque is held"),
)
CALLER: tuple[Field, ...] = (_number("offset", N, "N m", "caller's torque_offset in force"),)

RECORDS: tuple[tuple[str, str, tuple[Field, ...]], ...] = (
    ("arm", "What depends on where the arm is: limit zones, and the joints of closed loops.", ARM),
    ("watch", "What samples leave (sample.c, watch.c).", WATCH),
    ("fault", "Latched fault.", FAULT),
    ("reference", "Reference, and what of springs and wrench is in force (reference.c, guard.c).", REFERENCE),
    ("stiffness", "Stiffness of the springs in force (reference.c).", STIFFNESS),
    ("caller", "Torque of the caller.", CALLER),
    ("account", "One purse; the functions account_ alone write it (account.c).", ACCOUNT),
)
"""Records of the memory in their order: name, summary, fields."""
RANGES: tuple[tuple[str, str, int, int, bool], ...] = tuple(
    (record, field.name, int(field.least), int(field.most), bool(field.shape))
    for record, fields in (("config", CONFIG), *((name, fields) for name, _, fields in RECORDS))
    for field in fields
    if field.type == "int" and field.least == field.least
)
"""Integers of the memory with their bounds before and after every call; a memory beyond them is not believed."""
