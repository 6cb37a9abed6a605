# SPDX-License-Identifier: MIT
"""Table of the controller's status bits, modes, faults, reasons, refusals and errors: the only list of them."""

from __future__ import annotations

from stiffgen.core.symbolic.measured import REMEDY

STATUS: tuple[tuple[str, str], ...] = (
    ("fault", "a fault is latched: see fault, reason and fault_time"),
    ("missed", "no sample, or no time: the counter or the clock stands still"),
    ("bad_sample", "the sample was not believed: two of three are a fault"),
    ("command_refused", "the command is refused: refusal says why; reference and stiffness stay"),
    ("command_limited", "q0 is in a limit zone or beyond: it is followed to the zone (limited_joint)"),
    ("moving", "the reference is on its way to q0"),
    ("governor", "the reference is held back: the tank cannot pay, or the springs exert heaviest_wrench"),
    ("tank_limited", "a rise of stiffness or scale is held back: the tank cannot pay"),
    ("tank_deficit", "more was put out than tank and springs had: an assumption of the theorem does not hold"),
    ("reserve", "the torque is reduced: tank and stored energy do not cover more (tank_initial)"),
    ("joint_limit", "a position is in the limit zone or beyond"),
    ("saturated", "the torque would exceed its effort limit: the scale falls, or the torque was cut"),
    ("rate_limited", "a torque was cut to its rate limit"),
    ("stiffness_capped", "springs are softened: sample time and delay do not allow more (stiffness_share)"),
    ("mass_matrix", "the mass matrix is not positive definite: every joint is damped alike"),
    ("overspeed", "a joint is beyond its velocity limit and is braked: a fault after 0.2 s"),
    ("offset_limited", "torque_offset is held back by the effort or the rate limit"),
    ("feedforward_limited", "wrench_command or acceleration is held back by tank, effort, speed, or its limit"),
)
"""Status bits in their order, NAME_STATUS_<NAME>, with their meaning."""

MODES: tuple[tuple[str, str], ...] = (
    ("start", "no sample with a command seen yet"),
    ("active", "the arm is under control"),
    ("release", "a fault is latched: the springs' energy is scaled to zero"),
    ("follow", "a fault is latched: damping and limit zones, the reference follows the arm"),
    ("hold", "a communication fault is latched: the springs hold the arm, the reference stands still"),
    ("limp", "a fault is latched: the torque is zero or on its way there"),
)
"""Modes of a step, NAME_MODE_<NAME>, with their meaning."""

FAULTS: tuple[tuple[str, str], ...] = (
    ("none", "no fault"),
    ("sensor", "two of the last three samples were not believed: the torque goes to zero"),
    ("communication", "samples or calls are missing"),
    ("limit", "the arm is beyond a limit"),
    ("energy", "tank and stored energy do not cover the torque"),
    ("memory", "the state was overwritten: the torque goes to zero, and only init helps"),
    ("dissipation", "braking makes the arm faster: all torque goes to zero, damping and torque_offset, too"),
    ("shaking", "a joint swings to and fro without decay: all torque goes to zero, damping and torque_offset, too"),
)
"""Classes of faults, NAME_FAULT_<NAME>, from 0 on."""

REASONS: tuple[tuple[str, str, str], ...] = (
    ("none", "none", "no fault"),
    ("not_finite", "sensor", "q or dq is NaN, infinite, or absurdly large"),
    ("jump", "sensor", "q moved by more than ten times what the velocity limit allows (velocity_limit)"),
    ("mismatch", "sensor", "dq does not agree with the change of q (velocity_noise, position_quantum)"),
    (
        "frozen",
        "sensor",
        "q or dq stands still while the other moves, or q to the last bit while the torque changes (position_quantum)",
    ),
    ("loops", "sensor", "the closed loops do not close at q, or the passive joints have changed their branch"),
    ("missed", "communication", "ten samples are missing in a row"),
    ("skipped", "communication", "the clock shows that calls are missing (call_gap_limit, missed_limit)"),
    ("clock", "communication", "counter or time stands still, or is not given"),
    ("position", "limit", "a position is beyond its limit by more than 0.1 (lower_limit, upper_limit)"),
    ("overspeed", "limit", "a velocity is beyond its limit for 0.2 s (velocity_limit, velocity_noise)"),
    ("reserve", "energy", "the tank is almost empty and no torque is covered (tank_initial, torque_rate_limit)"),
    ("state", "memory", "the state's checksum is wrong: its memory was overwritten, or never initialised"),
    (
        "dissipation",
        "dissipation",
        "a velocity beyond its limit rises on although it is braked: look at sign and order of the joints in q, dq and "
        "torque (velocity_limit)",
    ),
    (
        "shaking",
        "shaking",
        "a velocity swings to and fro without decay: the torque acts later than declared, or the joints are elastic "
        "(delay_samples, velocity_noise)",
    ),
)
"""Reasons for faults, NAME_REASON_<NAME> from 0 on: class, meaning, and in brackets the fields to look at."""

SEEN: dict[str, str] = {
    "jump": "change of q [rad or m]",
    "mismatch": "dq less the change of q per second [rad/s or m/s]",
    "frozen": "motion that only the other signal shows [rad or m], or range of the torque [N m or N]",
    "missed": "samples missing [samples]",
    "skipped": "sample times since the last call [samples]",
    "position": "q [rad or m]",
    "overspeed": "speed [rad/s or m/s]",
    "reserve": "reserve of the torque [J]",
    "dissipation": "speed [rad/s or m/s]",
    "shaking": "swing of the velocity [rad/s or m/s]",
}
"""Meaning and unit of fault_seen and fault_limit for each reason with numbers."""

REFUSALS: tuple[tuple[str, str], ...] = (
    ("none", "not refused"),
    ("clock", "neither counter nor time is given, or time is not finite: pass one of them at every call"),
    ("not_finite", "a number is not finite, or absurdly large"),
    ("position", "beyond the joint's limit by more than 0.1; positions are in radians and metres"),
    ("loops", "the closed loops do not close at q0"),
    ("stiffness_limit", "negative, or larger than a stiffness may be"),
    ("asymmetric", f"the stiffness is not symmetric ({REMEDY}): difference of two entries"),
    ("indefinite", "the stiffness is not positive semidefinite: its smallest eigenvalue"),
    ("wrench", "larger than heaviest_wrench: force or moment"),
    ("acceleration", "larger than the acceleration of the reference"),
)
"""Reasons for refusing a command, NAME_REFUSAL_<NAME> from 0 on: what was seen is the number in words."""

COMMANDS: tuple[str, ...] = (
    "none", "clock", "q0", "translation_stiffness", "rotation_stiffness", "posture_stiffness", "wrench_command",
    "acceleration",
)  # fmt: skip
"""Arguments that a refusal can be about, NAME_COMMAND_<NAME> from 0 on."""

ERRORS: tuple[tuple[str, str], ...] = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state is not initialised or overwritten: call NAME_impedance_init"),
    ("torque", "the initial torque is not finite or beyond the effort limit"),
    ("position_limits", "lower_limit, upper_limit: lower must be below upper"),
    ("tool_pose", "tool_pose: no pose; its rotation must be orthonormal, and its last row 0 0 0 1"),
    ("spring_limits", "spring_limit: state both force and moment, or neither"),
)
"""Errors that are not those of single configuration fields, NAME_E_<NAME>, from -1 down."""
