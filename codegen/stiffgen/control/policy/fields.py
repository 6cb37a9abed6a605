# SPDX-License-Identifier: MIT
"""Tables of the policy port: structs of NAME_policy.h in C and in Python, parts, refusals, stages and errors."""

from __future__ import annotations

import math

from stiffgen.control.core.field import POSE, SCALAR, SPRING, WRENCH, Field

_PARTS = (4,)
_LONGEST = 10.0
"""Longest time of a setting [s]."""

POLICY_CONFIG: tuple[Field, ...] = (
    Field("hold_time", SCALAR, "s", "age up to which a part is held; three periods of 10 Hz", "0.3", 0.0, _LONGEST),
    Field("fade_time", SCALAR, "s", "time in which a stale part then fades", "0.5", 0.0, _LONGEST),
    Field("stale_share", SCALAR, "1", "share of the stiffness that is left at the end of a fade", "0.1", 0.0, 1.0),
    Field(
        "longest_interval",
        SCALAR,
        "s",
        "longest interpolation of stiffness and wrench; the period of 10 Hz",
        "0.1",
        0.0,
        1.0,
    ),
    Field("clock_tolerance", SCALAR, "s", "how far a time stamp may lie in the future", "0.005", 0.0, _LONGEST),
    Field(
        "reach",
        SCALAR,
        "m",
        "largest distance of a pose from the base's origin; by default a little more than all links in one line",
        "{reach}",
        0.0,
        math.inf,
    ),
    Field("translation_stiffness_limit", SCALAR, "N/m", "largest entry of a stiffness", "5000.0", 0.0, 1e9),
    Field("rotation_stiffness_limit", SCALAR, "N m/rad", "largest entry of a stiffness", "500.0", 0.0, 1e9),
    Field(
        "heaviest_wrench",
        (2,),
        "N, N m",
        "largest force and moment of wrench_command; state the controller's, which refuses larger ones in any case",
        "HUGE_VAL, HUGE_VAL",
        0.0,
        math.inf,
    ),
)
POLICY_PROPOSAL: tuple[Field, ...] = (
    Field("valid", _PARTS, "", "per part, NAME_POLICY_PART_..., 1: proposed; 0: not read", type="int"),
    Field("time", _PARTS, "s", "time stamp of each part, on the clock of now"),
    Field("pose", POSE, "m", "pose wanted of the tip, in the base"),
    Field("translation_stiffness", SPRING, "N/m", "stiffness Kt, in the axes that the controller takes it in"),
    Field("rotation_stiffness", SPRING, "N m/rad", "stiffness Ko; one part with translation_stiffness"),
    Field("wrench_command", WRENCH, "N, N m", "(force, moment) that the TIP IS TO EXERT on the environment"),
    Field("gripper", SCALAR, "", "number that the port passes through without reading it"),
)
POLICY_OUTPUT: tuple[Field, ...] = (
    Field("pose", POSE, "m", "newest accepted pose, for Follow"),
    Field("translation_stiffness", SPRING, "N/m", "stiffness Kt for the controller's step"),
    Field("rotation_stiffness", SPRING, "N m/rad", "stiffness Ko for the controller's step"),
    Field("wrench_command", WRENCH, "N, N m", "wrench_command for the controller's step"),
    Field("gripper", SCALAR, "", "newest accepted number; 0 before the first"),
    Field("stage", _PARTS, "", "NAME_POLICY_STAGE_... of each part", type="int"),
)
POLICY_STATE: tuple[Field, ...] = (
    Field("now", SCALAR, "s", "latest time seen; the port's time never goes back"),
    Field("time", _PARTS, "s", "time stamp of the accepted part"),
    Field("begin", _PARTS, "s", "time at which the interpolation to the accepted part began"),
    Field("interval", _PARTS, "s", "duration of this interpolation"),
    Field("refused_seen", _PARTS, "", "number that was refused"),
    Field("refused_limit", _PARTS, "", "limit of this number"),
    Field("from_translation", SPRING, "N/m", "Kt at which the interpolation began"),
    Field("from_rotation", SPRING, "N m/rad", "Ko at which the interpolation began"),
    Field("from_wrench", WRENCH, "N, N m", "wrench_command at which the interpolation began"),
    Field("to_translation", SPRING, "N/m", "accepted Kt, symmetric"),
    Field("to_rotation", SPRING, "N m/rad", "accepted Ko, symmetric"),
    Field("to_wrench", WRENCH, "N, N m", "accepted wrench_command"),
    Field("refused", _PARTS, "", "why the newest proposal of a part was refused, NAME_POLICY_REFUSED_...", type="int"),
    Field(
        "refused_entry",
        _PARTS,
        "",
        "row-major index of the refused entry, or -1; of a stiffness, rotation_stiffness behind translation_stiffness",
        type="int",
    ),
    Field("ready", SCALAR, "", "mark that start wrote the state", type="int"),
)
POLICY_STRUCTS = (
    ("policy_config", "Configuration of the port; start from the defaults.", POLICY_CONFIG),
    ("policy_proposal", "Proposal of a commander.", POLICY_PROPOSAL),
    ("policy_output", "Command of the port.", POLICY_OUTPUT),
)
POLICY_WORDS = (
    (
        "policy_part",
        (
            ("pose", "pose"),
            ("stiffness", "translation_stiffness and rotation_stiffness"),
            ("wrench", "wrench_command"),
            ("gripper", "gripper"),
        ),
    ),
    (
        "policy_refused",
        (
            ("none", "accepted, or not proposed"),
            ("time", "the time stamp, or now, is not finite"),
            ("future", "the time stamp lies in the future by more than clock_tolerance"),
            ("order", "the time stamp is not later than the accepted one"),
            ("stale", "older than hold_time and fade_time together"),
            ("not_finite", "a number is not finite"),
            ("pose", "no pose: no rotation, or the last row is not 0 0 0 1"),
            ("reach", "the pose is farther away than reach"),
            ("stiffness", "an entry is larger than translation_stiffness_limit or rotation_stiffness_limit"),
            ("asymmetric", "the stiffness is not symmetric: difference of two entries"),
            ("indefinite", "the stiffness is not positive semidefinite: its smallest eigenvalue"),
            ("wrench", "force or moment is larger than heaviest_wrench"),
        ),
    ),
    (
        "policy_stage",
        (
            ("waiting", "nothing accepted yet"),
            ("moving", "accepted within the last interval, in which stiffness and wrench are interpolated"),
            ("holding", "at the accepted part, which is held"),
            ("fading", "stale: fades; with a stale pose the stiffness fades"),
            ("faded", "stale: at the safe end"),
        ),
    ),
)
"""Enumerations from 0 on, with their meanings."""
POLICY_ERRORS = (
    ("null", "a pointer is NULL"),
    ("not_started", "the state was not started; call NAME_policy_start"),
    ("time", "now: the time at the start must be finite"),
    ("pose", "pose: no pose at the start: rotation matrix, last row 0 0 0 1, within reach"),
)
"""Errors besides those of the configuration's fields, from -1 down."""
