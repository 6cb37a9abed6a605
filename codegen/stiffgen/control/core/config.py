# SPDX-License-Identifier: MIT
"""Table of the controller's configuration: the only list of its fields.

``init`` copies the configuration; nothing of it changes while the controller runs. A field has a default with a
reason, or it must be stated: no value fits every robot, and a wrong one breaks the energy theorem or the damping.
"""

from __future__ import annotations

import math

from stiffgen.control.core.field import POSE, SCALAR, Field, N

STATED: tuple[Field, ...] = (
    Field(
        "sample_time",
        SCALAR,
        "s",
        "time T from one call of step to the next",
        least=1e-5,
        most=0.1,
        reason="speeds, rates and the account are computed from it",
    ),
    Field(
        "delay_samples",
        SCALAR,
        "samples",
        "delay from the sample that a torque is computed from to the sample at which it acts; 0 if it acts at once",
        least=0,
        most=5,
        type="int",
        reason="an undeclared delay makes stiff springs shake, and its work is not accounted for",
    ),
    Field(
        "motor_inertia",
        N,
        "kg m^2 or kg",
        "inertia of the motors' rotors at the joints",
        least=0.0,
        most=1e4,
        reason="a URDF has none, and without it light joints are damped wrongly",
    ),
    Field(
        "heaviest_wrench",
        (2,),
        "N, N m",
        "heaviest force and moment that the springs are to exert at a tip; a move of the reference stops there",
        least=1e-3,
        most=1e5,
        reason="it sizes tank and supply, and only the task knows it",
    ),
)
"""Fields without a default."""

LIMITS: tuple[Field, ...] = (
    Field(
        "lower_limit",
        N,
        "rad or m",
        "lower limit of the position; may be -infinity",
        "{name}_lower[{i}]",
        -math.inf,
        math.inf,
        reason="the robot's file states it",
    ),
    Field(
        "upper_limit",
        N,
        "rad or m",
        "upper limit of the position; may be infinity",
        "{name}_upper[{i}]",
        -math.inf,
        math.inf,
        reason="the robot's file states it",
    ),
    Field(
        "velocity_limit",
        N,
        "rad/s or m/s",
        "velocity limit of the arm; the reference uses 0.72 of it, and exceeding it for 0.2 s is a fault",
        "{name}_velocity[{i}]",
        1e-6,
        1e3,
        reason="the robot's file states it",
    ),
    Field(
        "effort_limit",
        N,
        "N m or N",
        "largest torque",
        "{name}_effort[{i}]",
        1e-6,
        1e5,
        reason="the robot's file states it",
    ),
    Field(
        "torque_rate_limit",
        N,
        "N m/s or N/s",
        "largest change of the torque per second",
        "{name}_torque_rate[i]",
        1e-6,
        1e8,
        reason="the maker states it, or effort_limit in 0.1 s",
    ),
    Field(
        "tip_velocity_limit",
        (2,),
        "m/s, rad/s",
        "velocity limit of a tip's equilibrium, translation and rotation; it uses 0.8 of it",
        "1.0, 2.5",
        1e-6,
        100.0,
        reason="ISO 10218 collaborative robots stay near 1 m/s",
    ),
)

TIMING: tuple[Field, ...] = (
    Field(
        "call_gap_limit",
        SCALAR,
        "samples",
        "most sample times from one call to the next, with a sample or without; 1 if no call is ever left out, which "
        "lets the tank cover larger torques; no larger than missed_limit counts",
        "3",
        1,
        100,
        "int",
        reason="a loop of a computer without real-time priority leaves out two calls at times",
    ),
    Field(
        "missed_limit",
        SCALAR,
        "calls",
        "number of calls without a believed sample for which the torque is held; from then on it falls at the rate "
        "limit until a sample comes",
        "3",
        1,
        100,
        "int",
        reason="lost datagrams come in short bursts",
    ),
    Field(
        "communication_reaction",
        SCALAR,
        "",
        "reaction to a communication fault, once samples are back: release the springs; hold: the springs keep the arm "
        "where the reference stands until the reset; or resume: hold, and reset after 0.1 s of good samples",
        "release",
        1,
        3,
        "int",
        ("release", "hold", "resume"),
        reason="an arm that moves again by itself must be asked for",
    ),
)

SENSORS: tuple[Field, ...] = (
    Field(
        "position_quantum",
        SCALAR,
        "rad or m",
        "resolution of the positions",
        "0.0",
        0.0,
        0.1,
        reason="encoders of arms are finer than what the checks of samples look at",
    ),
    Field(
        "velocity_noise",
        SCALAR,
        "rad/s or m/s",
        "standard deviation or resolution of dq, the larger one; what the checks of samples and speed allow for",
        "0.0",
        0.0,
        10.0,
        reason="the checks are sharpest without noise, and say what they saw",
    ),
)

LAW: tuple[Field, ...] = (
    Field(
        "damping_ratio",
        SCALAR,
        "",
        "damping ratio of every mode",
        "0.7",
        0.0,
        2.0,
        reason="a step response overshoots by 5 %",
    ),
    Field(
        "ramp_time",
        SCALAR,
        "s",
        "time in which the reference reaches its largest velocity",
        "0.2",
        1e-4,
        10.0,
        reason="the arm then overshoots a step of 10 cm by at most 3 mm (iiwa 14)",
    ),
    Field(
        "tank_initial",
        SCALAR,
        "J",
        "tank energy at the start; with the stored energy it covers the torques, so it bounds what the arm can hold; "
        "0: what heaviest_wrench needs, computed by init",
        "0.0",
        0.0,
        1e5,
        reason="heaviest_wrench says it in the task's terms",
    ),
    Field(
        "coriolis",
        SCALAR,
        "",
        "whether the torque compensates Coriolis and centrifugal forces; on: C(q, dq) dq is added, paid from the tank",
        "off",
        1,
        2,
        "int",
        ("off", "on"),
        reason="many robots do so themselves",
    ),
    Field(
        "coulomb_friction",
        N,
        "N m or N",
        "sliding friction of the joints, of which nine tenths are best stated; fed forward with the sign of the "
        "reference's velocity (in full from 0.02 rad/s on), paid from the tank",
        "0.0",
        0.0,
        1e4,
        reason="it varies with temperature and load; stated too large, the arm runs ahead of its reference",
    ),
    Field(
        "spring_limit",
        (2,),
        "N, N m",
        "largest force and moment of each tip's bounded spring, whose energy grows linearly far away; infinite: the "
        "trace spring, without limits",
        "HUGE_VAL, HUGE_VAL",
        1e-3,
        math.inf,
        when="bounded",
        reason="springs pull harder the farther away the arm is",
    ),
    Field(
        "tool_pose",
        POSE,
        "m",
        "pose of the tool in the tip's frame; another tool is a new init with the torque in force",
        "identity",
        -1e3,
        1e3,
        when="tool",
        reason="the tip itself",
    ),
)

CONFIG_SECTIONS = (
    ("State these: they have no default.", STATED),
    ("Limits: of the robot, and of the equilibrium.", LIMITS),
    ("Timing: calls and samples that may be missing.", TIMING),
    ("Sensors: what the measurement can resolve.", SENSORS),
    ("Law: damping, ramp, tank.", LAW),
)
CONFIG = tuple(field for _, fields in CONFIG_SECTIONS for field in fields)
