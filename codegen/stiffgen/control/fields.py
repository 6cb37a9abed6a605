# SPDX-License-Identifier: MIT
"""Table of the controller's configuration: the only list of its fields; signals.py and status_words.py have the others.

C structs and enumerations, error codes and texts, the check of every configuration field, documentation and the
layout that Python reads are made from these tables. The C in ``library/`` uses the fields.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_DOF = 40
"""Most coordinates of a robot with a controller."""

Extent = int | str
"""Extent of a field: a number, "n" for the coordinates, "tips" for the tips (left out if there is one), or "joints"."""


@dataclass(frozen=True)
class Field:
    """Member of a controller's struct.

    ``shape`` is row-major; () is a scalar. ``choices`` are the words that Python accepts for an int, each a C constant
    NAME_<FIELD>_<CHOICE>. Configuration only: ``default`` is a C expression ("{name}" is the robot's prefix, i the
    index, "{i}" that in q), and every entry must lie between ``least`` and ``most`` (both allowed).
    """

    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    default: str = ""
    least: float = math.nan
    most: float = math.nan
    type: str = "double"
    choices: tuple[str, ...] = ()
    when: str = ""
    """Condition for the field: "tool", a tool pose at run time; "loops", a robot with closed loops."""
    memory: str = ""
    """Member of the state's memory that an output reports; "=" for the same name."""

    @property
    def rule(self) -> str:
        """Condition on every entry, in words."""
        if self.choices:
            words = [*self.choices[:-2], " or ".join(self.choices[-2:])]
            return "must be " + ", ".join(words)
        if math.isinf(self.most):
            return "must be a number, or infinite"
        each = "every entry must" if self.shape else "must"
        return f"{each} lie between {self.least:g} and {self.most:g}"


SCALAR: tuple[Extent, ...] = ()
N, NN = ("n",), ("n", "n")
POSE, WRENCH, TASK, SPRING = ("tips", 4, 4), ("tips", 6), ("tips", 6, 6), ("tips", 3, 3)
"""Shapes of a pose, a wrench, a task stiffness, and the stiffness of a spring's translation or rotation."""


def choice_field(name: str, meaning: str, choices: tuple[str, ...], default: str) -> Field:
    """Return a field whose values are words."""
    return Field(name, SCALAR, "", meaning, default, 1, len(choices), "int", choices)


BASIC: tuple[Field, ...] = (
    Field("sample_time", SCALAR, "s", "time T from one call of step to the next", "0.001", 1e-5, 0.1),
    Field(
        "delay_samples",
        SCALAR,
        "samples",
        "delay from the sample that a torque is computed from to the sample at which it acts; 0 if it acts at once",
        "0",
        0,
        5,
        "int",
    ),
    Field(
        "heaviest_wrench",
        (2,),
        "N, N m",
        "heaviest force and moment that the springs are to exert at a tip, to which a rise of the stiffness is held; "
        "energy_limit, engagement_limit and the tank follow from it where they are 0",
        "100.0, 20.0",
        1e-3,
        1e5,
    ),
    Field(
        "motor_inertia",
        N,
        "kg m^2",
        "inertia of the motors' rotors at the joints; a URDF has none, and without it light joints are damped wrongly",
        "{name}_motor_inertia[i]",
        0.0,
        1e4,
    ),
    Field(
        "lower_limit",
        N,
        "rad or m",
        "lower limit of the position; may be -infinity",
        "{name}_lower[{i}]",
        -math.inf,
        math.inf,
    ),
    Field(
        "upper_limit",
        N,
        "rad or m",
        "upper limit of the position; may be infinity",
        "{name}_upper[{i}]",
        -math.inf,
        math.inf,
    ),
    Field(
        "velocity_limit",
        N,
        "rad/s or m/s",
        "velocity limit of the arm; exceeding it for overspeed_time is a limit fault",
        "{name}_velocity[{i}]",
        1e-6,
        1e3,
    ),
    Field("effort_limit", N, "N m or N", "largest torque", "{name}_effort[{i}]", 1e-6, 1e5),
    Field("tip_velocity_limit", SCALAR, "m/s", "velocity limit of the equilibrium's translation", "1.0", 1e-6, 100.0),
    Field("tip_rotation_limit", SCALAR, "rad/s", "velocity limit of the equilibrium's rotation", "2.5", 1e-6, 100.0),
    Field(
        "position_quantum",
        SCALAR,
        "rad or m",
        "resolution of the positions that velocities are computed from; the damping then uses the mean velocity of as "
        "many samples (up to 8) as the torque's rate limit needs",
        "0.0",
        0.0,
        0.1,
    ),
    Field(
        "velocity_noise",
        SCALAR,
        "rad/s or m/s",
        "standard deviation or resolution of dq, the larger one; what the checks of samples and speed allow for",
        "0.0",
        0.0,
        100.0,
    ),
    Field(
        "call_gap_limit",
        SCALAR,
        "samples",
        "most sample times from one call to the next, with a sample or without; 1 if no call is ever left out, which "
        "lets the tank cover larger torques; no larger than missed_limit counts",
        "3",
        1,
        1000,
        "int",
    ),
    choice_field(
        "communication_reaction",
        "reaction to a communication fault, once samples are back: release the springs; hold: the springs keep the arm "
        "where the equilibrium stands until the reset; or resume: hold, and reset after 0.1 s of good samples",
        ("release", "hold", "resume"),
        "release",
    ),
)
"""What a user states: timing, load, the robot's motors and limits, sensors, and what to do when samples were lost."""

EXPERT: tuple[Field, ...] = (
    Field(
        "posture_stiffness", N, "N m/rad", "stiffness k of the posture spring k (q - posture)^2 / 2", "1.0", 0.0, 1e4
    ),
    Field("translation_stiffness_limit", SCALAR, "N/m", "largest accepted entry (absolute value)", "5e3", 1.0, 1e6),
    Field("rotation_stiffness_limit", SCALAR, "N m/rad", "largest accepted entry (absolute value)", "500.0", 0.1, 1e5),
    choice_field(
        "spring",
        "spring at the tips: trace (kernels of the group spring) or bounded (spring_bounded, needs a folder generated "
        "with --spring bounded), whose energy grows linearly far away",
        ("trace", "bounded"),
        "trace",
    ),
    Field("spring_force_limit", SCALAR, "N", "largest force of each bounded spring", "40.0", 1e-3, 1e6),
    Field("spring_moment_limit", SCALAR, "N m", "largest moment of each bounded spring", "10.0", 1e-3, 1e5),
    choice_field(
        "stiffness_cap",
        "what init does if the sample time allows less than half of the stiffness limits in some posture: refuse the "
        "configuration, or accept it; the springs are then softened where they must be (output stiffness_share)",
        ("refuse", "accept"),
        "refuse",
    ),
    Field("stiffness_time", SCALAR, "s", "time constant of a change of stiffness", "0.002", 1e-4, 100.0),
    Field("damping_ratio", N, "1", "damping ratio of each mode, softest first", "0.7", 0.0, 100.0),
    Field("joint_damping", SCALAR, "N m s/rad", "damping d of every joint, added as d I", "0.1", 0.0, 1e4),
    choice_field(
        "coriolis",
        "whether the torque compensates Coriolis and centrifugal forces; on: C(q, dq) dq is added, paid from the tank; "
        "off where the robot does so itself",
        ("off", "on"),
        "off",
    ),
    choice_field(
        "continuous_joints",
        "positions of joints without limits (URDF type continuous; not with closed loops): wrapped: q and q0 count "
        "modulo a turn, q as the turn nearest to the last believed one, q0 as the turn nearest to the reference; "
        "counted: as they are, so that an encoder that begins its turn again is a jump",
        ("wrapped", "counted"),
        "wrapped",
    ),
    Field(
        "position_tolerance",
        SCALAR,
        "rad or m",
        "distance beyond a position limit up to which there is no fault",
        "0.1",
        0.0,
        10.0,
    ),
    Field(
        "limit_zone",
        SCALAR,
        "rad or m",
        "width of the zone inside each limit where the limit avoidance acts",
        "0.1",
        1e-6,
        10.0,
    ),
    Field(
        "limit_stiffness",
        N,
        "N m/rad",
        "stiffness of the limit avoidance in the zone, up to the effort limit; softened to what torque rate and sample "
        "time can follow; 0 turns it off",
        "{name}_effort[{i}]",
        0.0,
        1e6,
    ),
    Field(
        "reference_velocity_limit",
        N,
        "rad/s or m/s",
        "velocity limit of the equilibrium, which uses 0.8 of it; from 0.9 of it on the arm's joint is braked",
        "0.9 * {name}_velocity[{i}]",
        1e-6,
        1e3,
    ),
    Field(
        "ramp_time",
        SCALAR,
        "s",
        "time in which the equilibrium reaches its largest velocity; one that moves by poses takes twice as long",
        "0.05",
        1e-4,
        100.0,
    ),
    Field(
        "energy_limit",
        SCALAR,
        "J",
        "largest energy that a move of the equilibrium may store in the springs of the tips; 0: the energy at which "
        "they exert heaviest_wrench",
        "0.0",
        0.0,
        1e4,
    ),
    Field(
        "engagement_limit",
        SCALAR,
        "J",
        "work that moves of the equilibrium may cost after a start or a reset, and per second of a command's travel at "
        "the governor's velocity limits; 0: work against heaviest_wrench in a second at the tip's velocity limits",
        "0.0",
        0.0,
        1e5,
    ),
    Field(
        "torque_rate_limit",
        N,
        "N m/s or N/s",
        "largest change of the torque per second",
        "{name}_torque_rate[i]",
        1e-6,
        1e8,
    ),
    choice_field(
        "actuation",
        "what the motors are sent: torque, held from one step to the next; or gains: tau_ff, kp and kd for a "
        "controller inside each motor, which follows q and dq between the steps; gains need delay_samples 0",
        ("torque", "gains"),
        "torque",
    ),
    Field("kp_limit", N, "N m/rad", "largest kp that a motor takes; actuation gains only", "500.0", 0.0, 1e6),
    Field("kd_limit", N, "N m s/rad", "largest kd that a motor takes; actuation gains only", "5.0", 0.0, 1e5),
    Field("force_limit", SCALAR, "N", "largest measured force (norm) that is believed", "500.0", 1e-3, 1e6),
    Field("moment_limit", SCALAR, "N m", "largest measured moment (norm) that is believed", "100.0", 1e-3, 1e6),
    Field(
        "missed_limit",
        SCALAR,
        "samples",
        "number of calls without a believed sample for which the torque is held; from then on it moves to zero at the "
        "rate limit until a sample comes; as many calls left out in a row are a fault",
        "3",
        1,
        1000,
        "int",
    ),
    Field(
        "loss_limit",
        SCALAR,
        "samples",
        "number of missing or bad samples in a row that is a fault, at least missed_limit; each good sample takes half "
        "of one back, so random loss of 5 % is none",
        "10",
        1,
        1000000,
        "int",
    ),
    Field(
        "state_period",
        SCALAR,
        "s",
        "time from one new state of the robot to the next; within it a sample that repeats the last one is no new "
        "sample, and none that is missing; at most missed_limit sample times; 0: each sample is new",
        "0.0",
        0.0,
        1.0,
    ),
    Field(
        "velocity_filter_time",
        SCALAR,
        "s",
        "time constant of a low pass on the velocity that the damping uses, for noisy velocities; the damping is "
        "designed for its delay",
        "0.0",
        0.0,
        0.1,
    ),
    choice_field(
        "velocity_source",
        "source of dq: measured, by a sensor of its own; or differenced: computed from q, filtered or not. A "
        "differenced dq cannot show that q is frozen: with it a joint is FROZEN if it stands still under a change of "
        "torque that must move it (position_quantum)",
        ("measured", "differenced"),
        "measured",
    ),
    Field(
        "frozen_window",
        SCALAR,
        "samples",
        "number of samples for which a value may stand still while the other signal moves, before it is judged",
        "20",
        2,
        1000000,
        "int",
    ),
    Field(
        "overspeed_time",
        SCALAR,
        "s",
        "time for which a joint may be beyond velocity_limit, as after a bump; it is braked from the first sample on",
        "0.2",
        0.0,
        10.0,
    ),
    Field(
        "tank_initial",
        SCALAR,
        "J",
        "tank energy at the start, above which income goes to the engagement or is lost, unless the reserve is larger; "
        "with the stored energy it covers the torques, so it bounds what the arm can hold (status RESERVE; table in "
        "docs/controller.md); 0: what heaviest_wrench needs, computed by init",
        "0.0",
        0.0,
        1e4,
    ),
)
"""Everything else: its defaults fit, or follow from the basic fields."""

CONFIG_SECTIONS = (
    ("Basic: what you state.", BASIC),
    ("Expert: these defaults fit, or follow from the basic fields.", EXPERT),
)
CONFIG = (*BASIC, *EXPERT)
"""Both records in one C struct: C99 has no anonymous members, and config.basic.sample_time says no more to a reader."""
