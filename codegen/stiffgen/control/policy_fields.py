# SPDX-License-Identifier: MIT
"""Table of the policy port's fields, refusals and stages, as fields.py has that of the controller's configuration."""

from __future__ import annotations

from stiffgen.control.fields import POSE, SPRING, TASK, WRENCH, Field

_PARTS = (4,)

PARTS = ("pose", "stiffness", "wrench", "gripper")
"""Parts of a proposal; arrays over parts have this order."""

PROPOSAL: tuple[Field, ...] = (
    Field("valid", _PARTS, "", "per part (pose, stiffness, wrench, gripper) 1: proposed; 0: not read", type="int"),
    Field("time", _PARTS, "s", "time stamp of each part, on the clock of `now`"),
    Field("equilibrium", POSE, "m", "pose [R p; 0 1] of the tip where its spring is to be at rest"),
    Field(
        "stiffness",
        TASK,
        "N/m, N m/rad",
        "blocks Kt and Ko on the diagonal, in the axes of the controller's translation_stiffness and "
        "rotation_stiffness; the controller's springs have no coupling, so the other blocks must be 0",
    ),
    Field("wrench_command", WRENCH, "N, N m", "(force, moment) that the TIP IS TO EXERT on the environment"),
    Field("gripper", (), "", "value that the port passes through without reading it"),
)
POLICY: tuple[Field, ...] = (
    Field("hold_time", (), "s", "setting: age up to which a part is held; 0.3, three periods of 10 Hz"),
    Field("fade_time", (), "s", "setting: time in which a stale part then fades; 0.5"),
    Field("stale_share", (), "", "setting: share of the stiffness that is left at the end of a fade, 0 to 1; 0.1"),
    Field("longest_interval", (), "s", "setting: longest interpolation; 0.1, the period of 10 Hz"),
    Field("clock_tolerance", (), "s", "setting: how far a time stamp may lie in the future; 0.005"),
    Field(
        "smoothing",
        (),
        "",
        "setting: share of a pose's departure from the predicted one that is taken for noise, 0 to 0.9; 0: none, each "
        "pose is reached on a straight line; 0.5 for a policy whose poses scatter",
    ),
    Field("now", (), "s", "latest time seen; the port's time never goes back"),
    Field("time", _PARTS, "s", "time stamp of the accepted part"),
    Field("begin", _PARTS, "s", "time at which the interpolation to the accepted part began"),
    Field("interval", _PARTS, "s", "duration of this interpolation"),
    Field("refused", _PARTS, "", "why the newest proposal of each part was refused, NAME_REFUSED_*", type="int"),
    Field("refusal", _PARTS, "", "what of it was refused, NAME_REFUSAL_*, as in the output of a step", type="int"),
    Field("refusal_argument", _PARTS, "", "argument that it is about, NAME_ARGUMENT_*", type="int"),
    Field("refusal_entry", _PARTS, "", "index of the entry in this argument, or -1", type="int"),
    Field("refusal_seen", _PARTS, "", "number that was seen"),
    Field("refusal_limit", _PARTS, "", "what refusal_seen may be"),
    Field("stage", _PARTS, "", "NAME_STAGE_* of each part", type="int"),
    Field("equilibrium", POSE, "m", "pose that the port commands"),
    Field("translation_stiffness", SPRING, "N/m", "stiffness Kt that the port commands"),
    Field("rotation_stiffness", SPRING, "N m/rad", "stiffness Ko that the port commands"),
    Field("wrench_command", WRENCH, "N, N m", "wrench_command that the port commands"),
    Field("gripper", (), "", "value of the newest accepted gripper part"),
    Field("from_equilibrium", POSE, "m", "pose at which the interpolation began"),
    Field("from_translation", SPRING, "N/m", "Kt at which the interpolation began"),
    Field("from_rotation", SPRING, "N m/rad", "Ko at which the interpolation began"),
    Field("from_wrench", WRENCH, "N, N m", "wrench_command at which the interpolation began"),
    Field("to_equilibrium", POSE, "m", "pose at the end: the accepted one, orthonormal; smoothed, half a period ahead"),
    Field("estimate", POSE, "m", "pose without noise at the time stamp of the accepted one"),
    Field("velocity", WRENCH, "m/s, rad/s", "estimated velocity of the proposed poses, hybrid axes"),
    Field("from_velocity", WRENCH, "m/s, rad/s", "velocity at which the interpolation of the pose began"),
    Field("to_translation", SPRING, "N/m", "accepted Kt, symmetric"),
    Field("to_rotation", SPRING, "N m/rad", "accepted Ko, symmetric"),
    Field("to_wrench", WRENCH, "N, N m", "accepted wrench_command"),
)
REFUSED: tuple[tuple[str, str], ...] = (
    ("none", "accepted, or not proposed"),
    ("time", "the time stamp, or now, is not finite"),
    ("future", "the time stamp lies in the future by more than clock_tolerance"),
    ("order", "the time stamp is not later than the accepted one"),
    ("stale", "older than hold_time and fade_time together"),
    ("pose", "not finite, out of bounds, or no rotation"),
    ("stiffness", "not finite, not symmetric, not positive semidefinite, or above the stiffness limits"),
    ("coupling", "the stiffness couples translation and rotation"),
    ("wrench", "not finite, or larger than heaviest_wrench"),
)
STAGES: tuple[tuple[str, str], ...] = (
    ("waiting", "nothing accepted yet"),
    ("moving", "interpolated to the accepted part"),
    ("holding", "at the accepted part, which is held"),
    ("fading", "stale: fades"),
    ("faded", "stale: at the safe end"),
)
