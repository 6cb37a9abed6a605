# SPDX-License-Identifier: MIT
"""Table of the controller's memory between steps: the only list of it (fields.py has the configuration).

The struct in NAME_impedance.h with its comments, the check of its integers and the invariant of ``stiffgen prove`` are
made from this table. Doubles come first, so that no padding lies between the fields.
"""

from __future__ import annotations

from stiffgen.control.fields import POSE, SCALAR, SPRING, WRENCH, Extent, Field, N
from stiffgen.control.status_words import FAULTS, REASONS

_MOST = 1_000_000
"""Bound of counters that only tell how long something lasts."""
_TWO_PER_TIP = ("tips", 2)


def _number(name: str, shape: tuple[Extent, ...], unit: str, meaning: str, when: str = "") -> Field:
    return Field(name, shape, unit, meaning, when=when)


def _count(name: str, least: int, most: int, meaning: str) -> Field:
    """Return an integer that lies between the bounds before and after every call."""
    return Field(name, SCALAR, "", meaning, least=least, most=most, type="int32_t")


def _any(name: str, meaning: str, type_: str = "int32_t") -> Field:
    """Return an integer that may have any value."""
    return Field(name, SCALAR, "", meaning, type=type_)


_TORQUES: tuple[Field, ...] = (
    _number("older", (5, "n"), "N m", "torques before the last one, newest first, as far as a delay can need them"),
    _number("feed", (6, "n"), "N m", "reference's share B dr + M ddr of the last torques, newest first"),
    _number("gap_torque", N, "N m", "torque that acted in the newest interval of a gap"),
    _number("gap_change", N, "N m", "sum of |change of torque| in a gap, each times the intervals before it"),
    _number("gap_total", N, "N m", "sum of |torque| over the intervals of a gap"),
    _number("gap_transit", N, "N m", "sum of |torque| in the gap and in transit at the last call that told the time"),
    _number("gap_sum", N, "N m", "sum of |torque| of the calls since then"),
    _number("gap_largest", N, "N m", "largest |torque| of these calls"),
    _number("rate", N, "N m", "largest change of the torque per step, of the last valid configuration"),
    _number("velocity_limit", N, "rad/s", "velocity limit that bounds what is believed"),
    _number("avoidance", (4, "n"), "", "limit avoidance per joint: lower edge, upper edge, stiffness, largest torque"),
    _number("inertia", N, "kg m^2", "inertia of each joint beside any motion of the others, for the limit avoidance"),
    _number("offset", N, "N m", "caller's torque_offset in force"),
    _number("filtered", N, "rad/s", "velocity behind the low pass of velocity_filter_time"),
    _number("kp", N, "N m/rad", "gain kp of the motors in force"),
    _number("kd", N, "N m s/rad", "gain kd of the motors in force"),
)
_SAMPLES: tuple[Field, ...] = (
    _number("recent", (8, "n"), "rad/s", "velocities of the last samples, newest first, for their mean"),
    _number("q", N, "rad", "last believed position; turns of continuous joints are counted"),
    _number("measured_q", N, "rad", "the same position as it was measured"),
    _number("dq", N, "rad/s", "velocity that was used with it"),
    _number("still_q", N, "rad", "position of the last sample, believed or not, to see whether q changes"),
    _number("moved_q", N, "rad", "motion that dq shows, less that of q, while q stands still"),
    _number("still_dq", N, "rad/s", "velocity of the last sample, to see whether dq changes"),
    _number("moved_dq", N, "rad", "motion that dq shows, less that of q, while dq stands still"),
    _number("q_age", N, "samples", "samples since q changed"),
    _number("dq_age", N, "samples", "samples since dq changed"),
)
_STANDSTILLS: tuple[Field, ...] = (
    _number("rest_q", N, "rad", "position since a joint stands still (velocity_source differenced)"),
    _number("rest_other", N, "rad", "position before it, between which and rest_q one bit may toggle"),
    _number("rest_torque", N, "N m", "torque that acted when the standstill began"),
    _number("rest_external", N, "N m", "torque of the environment at that time"),
    _number("rest_load", N, "N m", "load that is not measured, at that time"),
    _number("rest_change", N, "N m", "largest change of their sum since then"),
    _number("rest_speed", N, "rad/s", "speed since then that this change and friction predict"),
    _number("rest_travel", N, "rad", "motion that belongs to it, which fades"),
    _number("alone_speed", N, "rad/s", "the same without the environment, while other joints move"),
    _number("alone_travel", N, "rad", "motion that belongs to it"),
    _number("still_value", N, "rad", "position of the last samples, the same to the last bit"),
    _number("still_other", N, "rad", "position before it, between which and still_value one bit may toggle"),
    _number("still_time", N, "s", "time for which the position has been these"),
    _number("still_least", N, "N m", "least torque of the controller in this time"),
    _number("still_most", N, "N m", "largest torque of the controller in this time"),
    _number("held_torque", N, "N m", "largest change of torque under which the joint has stood still, and moved later"),
    _number("friction", N, "N m", "dry friction: |unexplained| in motion, less the part that grows with the speed"),
    _number("mean_torque", N, "N m", "mean of |unexplained| in motion"),
    _number("mean_speed", N, "rad/s", "mean of |dq| in motion"),
    _number("mean_square", N, "rad^2/s^2", "mean of dq^2 in motion"),
    _number("mean_power", N, "W", "mean of |unexplained dq| in motion"),
    _number("moving_time", N, "s", "time of motion that this mean is about"),
    _number("unexplained", N, "N m", "torque that mass matrix and known torques do not explain, behind a low pass"),
    _number("momentum", N, "kg m^2/s", "M dq of the last sample"),
    _number("mass", N, "kg m^2", "diagonal of M at the last sample"),
)
_EQUILIBRIUM: tuple[Field, ...] = (
    _number("posture", N, "rad", "posture of the equilibrium, where the posture spring is at rest"),
    _number("posture_velocity", N, "rad/s", "velocity of this posture"),
    _number("wanted_posture", N, "rad", "posture of the last accepted command"),
    _number("posture_stiffness", N, "N m/rad", "posture stiffness in force"),
    _number("equilibrium", POSE, "m", "poses where the springs of the tips are at rest"),
    _number("equilibrium_velocity", WRENCH, "m/s, rad/s", "twists of these poses while they move by poses"),
    _number("wanted_equilibrium", POSE, "m", "poses of the last accepted command by pose"),
    _number("translation_stiffness", SPRING, "N/m", "stiffness Kt in force"),
    _number("rotation_stiffness", SPRING, "N m/rad", "stiffness Ko in force"),
    _number("tool_pose", POSE, "m", "tools in force; the tips themselves for a folder without tools"),
    _number("spring_limits", _TWO_PER_TIP, "N, N m", "limits of bounded springs in force: forces, then moments"),
    _number("joints", ("joints",), "rad", "joints of the tree from which the loops are closed", when="loops"),
)
_ENERGIES: tuple[Field, ...] = (
    _number("scale", SCALAR, "", "scale l of the springs, from 0 to 1"),
    _number("elastic_energy", SCALAR, "J", "energy l U of the springs at the last position"),
    _number("limit_energy", SCALAR, "J", "energy of the limit avoidance at the last position"),
    _number("tank", SCALAR, "J", "energy in the tank, which pays for sampling and stiffness"),
    _number("reserve", SCALAR, "J", "worst-case work of the torques in transit"),
    _number("engagement", SCALAR, "J", "work left for moves of the equilibrium"),
    _number("travel", SCALAR, "s", "travel of commands that has brought in no engagement yet"),
    _number("sample_time", SCALAR, "s", "sample time of the last valid configuration"),
    _number("stiffness_share", SCALAR, "", "share of the commanded stiffness that the sample time allows"),
    _number("sized_tank", SCALAR, "J", "tank that heaviest_wrench needs, from init"),
    _number("load", SCALAR, "", "wrench of the springs over heaviest_wrench"),
    _number("load_energy", SCALAR, "J", "energy of the tips' springs at this load"),
    _number("press_share", SCALAR, "", "share of wrench_command in force"),
    _number("port_total", SCALAR, "J", "account: work put out at the robot's port"),
    _number("sampling_total", SCALAR, "J", "account: energy s put in by sampling"),
    _number("reference_total", SCALAR, "J", "account: energy p put in by moves of the equilibrium"),
    _number("stiffness_total", SCALAR, "J", "account: energy v put in by changes of stiffness or scale"),
    _number("start_total", SCALAR, "J", "account: energy of the limit avoidance where the account began"),
    _number("supplied", SCALAR, "J", "account: start, first tank, and what engagements have paid less what came back"),
    _number("energy_supplied", SCALAR, "J", "account: the most that was ever supplied"),
    _number("fault_time", SCALAR, "s", "time since the fault was latched"),
    _number("good_time", SCALAR, "s", "time of good samples since"),
    _number("fault_seen", SCALAR, "", "number that the fault is about"),
    _number("fault_limit", SCALAR, "", "limit of this number"),
    _number("fastest", SCALAR, "", "largest speed over its velocity limit since one is above its limit"),
)
_INTEGERS: tuple[Field, ...] = (
    _any("ready", "mark of an initialised memory"),
    _count("spring", 0, 2, "spring in force; 0 before the first sample"),
    _count("known", 0, 1, "a position is believed: the account has begun"),
    _count("doubted", 0, 1, "the first position was beyond a limit, and is not believed: its unit may be wrong"),
    _count("engaged", 0, 1, "the springs are in force"),
    _count("commanded", 0, 1, "a command was accepted since init"),
    _count("joined", 0, 1, "the equilibrium is the pose of its posture"),
    _count("beyond", 0, 1, "the commanded pose is out of reach: the posture leads, the equilibrium follows"),
    _count("fault", 0, len(FAULTS) - 1, "class of the latched fault, NAME_FAULT_..."),
    _count("reason", 0, len(REASONS) - 1, "its reason, NAME_REASON_..."),
    _count("reset", 0, 1, "a reset is asked for"),
    _count("bad", 0, 7, "the last three samples, one bit each: 1 was not believed"),
    _count("missed", 0, _MOST, "calls since the last believed sample"),
    _count("gap", 0, _MOST, "sample times since the last believed sample"),
    _count("recent_count", 0, 8, "velocities in `recent`"),
    _count("averaged", 0, 7, "velocities before the last one in the damping's mean, where there are as many"),
    _count("regular", 0, 3, "calls in a row whose counter advanced by one"),
    _any("counter", "counter of the last believed sample", "uint32_t"),
    _any("unaccounted", "number of times that the account began anew", "uint32_t"),
    _any("seen_counter", "counter of the last sample, believed or not", "uint32_t"),
    _count("absent", 0, 2 * _MOST, "halves of samples that are missing; a good sample takes one back"),
    _count("delay", 0, 5, "delay_samples of the last valid configuration"),
    _count("gap_calls", 0, _MOST, "calls since the last one that told the time"),
    _count("calls", 0, 1000, "missed_limit in force"),
    _count("hold", 0, 1000, "calls without a sample for which the last torque is held"),
    _count("state_age", 0, _MOST, "samples for which the robot's state has repeated itself"),
    _count("fast", 0, _MOST, "samples in a row beyond a velocity limit"),
    _count("rises", 0, 10, "samples since then in which this speed has risen"),
    _any("fault_joint", "joint that the fault is about, or -1"),
    _count("call_gap", 0, 1000, "call_gap_limit in force"),
    _count("capped", 0, 1, "the sample time has not allowed the springs' stiffness"),
    _count("by_pose", 0, 1, "the last accepted command was a pose"),
)
MEMORY = (*_TORQUES, *_SAMPLES, *_STANDSTILLS, *_EQUILIBRIUM, *_ENERGIES, *_INTEGERS)
"""Members of NAME_impedance_memory in their order."""
RANGES: tuple[tuple[str, int, int], ...] = tuple(
    (field.name, int(field.least), int(field.most)) for field in _INTEGERS if field.least == field.least
)
"""Integers of the memory with their bounds before and after every call; a memory beyond them is not believed."""
