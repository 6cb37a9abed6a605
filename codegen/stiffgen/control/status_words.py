# SPDX-License-Identifier: MIT
"""Table of the controller's status bits, modes, faults, reasons and errors: the only list of them (fields.py)."""

from __future__ import annotations

from stiffgen.core.symbolic.measured import REMEDY

STATUS: tuple[tuple[str, str], ...] = (
    ("fault", "a fault is latched: see fault, reason and fault_time"),
    ("missed", "no sample, or one whose counter did not advance by one"),
    ("bad_sample", "the sample was not believed: two of three are a fault"),
    (
        "command_refused",
        "the command is refused (refusal says why, or the sample is not believed): equilibrium and stiffness stay",
    ),
    ("wrench_refused", "the measured wrench is not finite or too large, and is not used"),
    ("moving", "the equilibrium is on its way to the wanted one"),
    ("governor", "the equilibrium is held back by the energy or the engagement limit"),
    ("stiffness_changing", "the applied stiffness is on its way to the wanted one"),
    ("tank_limited", "stiffness or scale is held back: the tank cannot pay, or the springs exert heaviest_wrench"),
    ("tank_deficit", "more was put out than tank and springs had: an assumption of the theorem does not hold"),
    ("reserve", "damping or scale is reduced: tank and stored energy do not cover more torque (tank_initial)"),
    ("joint_limit", "a position is in the limit zone or beyond"),
    ("saturated", "the torque would exceed its effort limit: the scale falls, or the torque was cut"),
    ("rate_limited", "a torque was cut to its rate limit"),
    ("damping_capped", "the damping is capped: M^-1 B T would be too large for the sample time"),
    ("stiffness_capped", "springs are softened: M^-1 K T^2 would be too large for the sample time (stiffness_share)"),
    (
        "indefinite",
        "the tangent has a negative eigenvalue: its mode is unstable, and is damped as if it were stable",
    ),
    ("mass_matrix", "the mass matrix is not positive definite: damping is joint_damping only"),
    (
        "limits_kept",
        "a changed limit waits: limit avoidance that would cost more energy than the tank can pay, or a raised "
        "velocity_limit, missed_limit or call_gap_limit that tank and stored energy do not cover",
    ),
    ("config", "the configuration is refused or the state is not initialised; the return value says why"),
    ("repeated", "the sample repeats the last state, as state_period allows: the torque is held"),
    ("overspeed", "a joint is beyond its velocity limit and is braked: a fault after overspeed_time"),
    ("offset_limited", "torque_offset is held back by the effort or the rate limit"),
    (
        "feedforward_refused",
        "wrench_command, or velocity and acceleration, are not used: not finite, or too large",
    ),
    (
        "feedforward_limited",
        "wrench_command is held back by tank, reserve, effort or speed; or velocity and acceleration are left out: the "
        "equilibrium stands still, or does not keep up with the plan",
    ),
    (
        "unreachable",
        "the commanded pose is out of reach from here: the posture is at its end, or the arm rests in another one; "
        "find_posture searches a posture to be commanded as q0",
    ),
    (
        "command_limited",
        "q0 is beyond a joint limit by up to position_tolerance: it is followed to the limit's zone (limited_joint)",
    ),
)
"""Status bits in their order, NAME_STATUS_<NAME>, with their meaning."""

MODES: tuple[tuple[str, str], ...] = (
    ("start", "no sample with a command seen yet"),
    ("active", "the arm is under control"),
    ("release", "a fault is latched: the elastic energy is scaled to zero"),
    ("follow", "a fault is latched: damping and limit avoidance, the equilibrium follows the arm"),
    ("hold", "a communication fault is latched: the springs hold the arm, the equilibrium stands still"),
)
"""Modes of a step, NAME_MODE_<NAME>, with their meaning."""

FAULTS: tuple[tuple[str, str], ...] = (
    ("none", "no fault"),
    ("sensor", "two of the last three samples were not believed"),
    ("communication", "samples or calls are missing"),
    ("limit", "the arm is beyond a limit"),
    ("energy", "tank and stored energy do not cover the torque"),
    ("configuration", "configuration, spring or state changed in a way that needs a reset"),
    ("dissipation", "braking makes the arm faster: all torque goes to zero, damping and torque_offset, too"),
)
"""Classes of faults, NAME_FAULT_<NAME>, from 0 on."""

REASONS: tuple[tuple[str, str, str], ...] = (
    ("none", "none", "no fault"),
    ("not_finite", "sensor", "q or dq is NaN, infinite, or absurdly large"),
    (
        "jump",
        "sensor",
        "q moved by more than twice the velocity limit allows (velocity_limit, position_quantum, state_period)",
    ),
    (
        "mismatch",
        "sensor",
        "dq does not agree with the change of q (velocity_noise, position_quantum, state_period, velocity_limit)",
    ),
    (
        "frozen",
        "sensor",
        "q or dq stands still while the other moves, or q under a torque that must move it (velocity_noise, "
        "position_quantum, frozen_window, velocity_source)",
    ),
    ("stale", "sensor", "the sample counter does not advance"),
    (
        "missed",
        "communication",
        "too many samples are missing in a row, or more than one of three for long (loss_limit)",
    ),
    ("skipped", "communication", "the sample counter shows that calls are missing (missed_limit)"),
    (
        "position",
        "limit",
        "a position is beyond its limit and tolerance (lower_limit, upper_limit, position_tolerance)",
    ),
    ("overspeed", "limit", "a velocity is beyond its limit for long (velocity_limit, overspeed_time, velocity_noise)"),
    (
        "reserve",
        "energy",
        "the tank is almost empty and the springs' torque is not covered (tank_initial, torque_rate_limit)",
    ),
    ("config", "configuration", "the configuration was refused (the return value names the field)"),
    ("changed", "configuration", "the kind of spring changed while engaged (spring)"),
    ("state", "configuration", "the state's checksum is wrong: its memory was overwritten"),
    ("loops", "sensor", "the closed loops do not close at q, or the passive joints have changed their branch"),
    (
        "dissipation",
        "dissipation",
        "a velocity beyond its limit rises on although it is braked: look at sign and order of the joints in q, dq and "
        "torque (velocity_limit)",
    ),
)
"""Reasons for faults, NAME_REASON_<NAME> from 0 on: class, meaning, and in brackets the fields to look at."""

SEEN: dict[str, str] = {
    "jump": "change of q [rad or m]",
    "mismatch": "dq less the change of q per second [rad/s or m/s]",
    "frozen": "motion that only the other signal, or the torque, shows [rad or m], or range of the torque [N m or N]",
    "stale": "advance of the counter [samples]",
    "missed": "samples missing, less half of the good ones since [samples]",
    "skipped": "calls left out [samples]",
    "position": "q [rad or m]",
    "overspeed": "speed [rad/s or m/s]",
    "dissipation": "speed [rad/s or m/s]",
    "reserve": "reserve of the torque [J]",
}
"""Meaning and unit of fault_seen and fault_limit for each reason with numbers."""

REFUSALS: tuple[tuple[str, str], ...] = (
    ("none", "not refused"),
    ("command", "the command is neither a position nor an equilibrium"),
    ("not_finite", "a number is not finite, or absurdly large"),
    ("position", "beyond the joint's limit by more than position_tolerance; positions are in radians and metres"),
    ("loops", "the closed loops do not close at q0"),
    ("last_row", "the last row of the pose is not 0 0 0 1; matrices are row-major"),
    ("rotation", "the rotation is not orthonormal: sum of |R^T R - I|"),
    ("left_handed", "the rotation is left-handed: determinant"),
    ("reach", "the pose is farther away than the arm can be long, and a metre; positions are in metres"),
    ("stiffness_limit", "above its limit in the configuration (translation_stiffness_limit, rotation_stiffness_limit)"),
    ("asymmetric", f"the stiffness is not symmetric ({REMEDY}): difference of two entries"),
    ("indefinite", "the stiffness is not positive semidefinite: its smallest eigenvalue"),
    ("coupling", "the springs do not couple translation and rotation"),
    ("wrench", "larger than heaviest_wrench: force or moment"),
    ("engaged", "another tool while the springs are in force: init or restart, with the torque in force, takes it"),
)
"""Reasons for refusing a command, NAME_REFUSAL_<NAME> from 0 on: what was seen is the number in words."""

ARGUMENTS: tuple[str, ...] = (
    "none", "q0", "equilibrium", "translation_stiffness", "rotation_stiffness", "tool_pose", "stiffness",
    "wrench_command",
)  # fmt: skip
"""Arguments that a refusal can be about, NAME_ARGUMENT_<NAME> from 0 on."""

ERRORS: tuple[tuple[str, str], ...] = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state is not initialised: call NAME_impedance_init first"),
    ("torque", "the initial torque is not finite or beyond the effort limit"),
    ("position_limits", "lower_limit, upper_limit: lower must be below upper by more than two limit zones"),
    ("state_period", "state_period: must not be above missed_limit times sample_time"),
    ("bounded_spring", "spring: the folder has no bounded spring; generate it with --spring bounded"),
    (
        "stiffness",
        "translation_stiffness_limit, rotation_stiffness_limit: sample_time, delay_samples and motor_inertia allow "
        "less than half of this stiffness; lower the limits, correct motor_inertia, or set stiffness_cap to accept",
    ),
    ("actuation", "actuation: gains need delay_samples 0"),
    ("gains", "joint_gains: a number is not finite, or the limit of a gain is below 0"),
    ("policy", "policy_start: a pose is no pose, or now is not finite"),
    ("pose", "find_posture: a pose is no pose, or start is not finite"),
    ("no_posture", "find_posture: no posture of the poses was found outside the limit zones; one may exist"),
)
"""Errors that are not those of single configuration fields, NAME_E_<NAME>, from -1 down."""
