# SPDX-License-Identifier: MIT
"""Tables of Follow: structs of NAME_follow.h in C and in Python, its errors, and the bits of its status."""

from __future__ import annotations

import math

from stiffgen.control.core.field import POSE, SCALAR, Field, N

ROWS = ("tips", 6)
"""Shape of the twists of all tips."""
FOLLOW_CONFIG: tuple[Field, ...] = (
    Field("sample_time", SCALAR, "s", "time from one call of step to the next; it has no default", "0.0", 1e-5, 0.1),
    Field(
        "lower_limit",
        N,
        "rad or m",
        "lower limit of the position; may be -infinity",
        "{name}_lower[i]",
        -math.inf,
        math.inf,
    ),
    Field(
        "upper_limit",
        N,
        "rad or m",
        "upper limit of the position; may be infinity",
        "{name}_upper[i]",
        -math.inf,
        math.inf,
    ),
    Field(
        "limit_distance",
        N,
        "rad or m",
        "distance that q0 keeps from both limits; the default is at most a tenth of the range",
        "fmin(0.1, 0.1 * ({name}_upper[i] - {name}_lower[i]))",
        0.0,
        1e3,
    ),
    Field(
        "velocity_limit",
        N,
        "rad/s or m/s",
        "largest velocity of q0; the arm overshoots, so less than its own limit",
        "0.7 * {name}_velocity[i]",
        1e-6,
        1e3,
    ),
    Field("tip_velocity_limit", SCALAR, "m/s", "largest velocity of each tip's translation", "0.75", 1e-6, 100.0),
    Field("tip_rotation_limit", SCALAR, "rad/s", "largest velocity of each tip's rotation", "1.9", 1e-6, 100.0),
    Field(
        "ramp_time",
        SCALAR,
        "s",
        "time from rest to full speed to a pose; along a coarse stream it is half as long again, and a joint may "
        "reach its velocity limit in a quarter of it",
        "0.2",
        1e-3,
        100.0,
    ),
    Field(
        "smoothing",
        SCALAR,
        "1",
        "time constant of coarse streams, over the time from one pose to the next; 0: poses are followed as they come",
        "1.0",
        0.0,
        100.0,
    ),
)
FOLLOW_STATE: tuple[Field, ...] = (
    Field("q", N, "rad or m", "joint positions of the last command"),
    Field("dq", N, "rad/s or m/s", "their velocities"),
    Field("posture", N, "rad or m", "last accepted posture, within the limits"),
    Field("pose", POSE, "m", "last accepted poses"),
    Field("tool", POSE, "m", "last accepted poses of tools", when="tool"),
    Field("twist", ROWS, "m/s", "velocities of the tips that the ramp asks for; rotations times 0.2 m, here and below"),
    Field("stream", ROWS, "m/s", "velocities of the commanded poses"),
    Field("weakest", ("short",), "1", "direction in which the tips move least"),
    Field("way", SCALAR, "s", "time to the poses at full speed"),
    Field("asked", SCALAR, "s", "mean way that a call asks for"),
    Field("got", SCALAR, "s", "mean way that a call gains"),
    Field("push", SCALAR, "1", "share of full speed"),
    Field("least", SCALAR, "s", "least way, which the tips must undercut"),
    Field("interval", SCALAR, "s", "time from pose to pose of a coarse stream; 0: none"),
    Field("age", SCALAR, "calls", "age of the poses", type="int"),
    Field("period", SCALAR, "calls", "from pose to pose of a fine stream; 0: none", type="int"),
    Field("stuck", SCALAR, "calls", "without progress", type="int"),
    Field("idle", SCALAR, "calls", "for which the tips came no nearer", type="int"),
    Field("by_joints", SCALAR, "", "1: on the way to the posture", type="int"),
    Field("ready", SCALAR, "", "mark that init wrote the state", type="int"),
    Field("grasp", POSE, "m", "last accepted grasps", when="several"),
    Field("object", (4, 4), "m", "pose of the object, on its way", when="several"),
    Field("goal", (4, 4), "m", "last accepted pose of the object", when="several"),
    Field("carried", (6,), "m/s, rad/s", "velocity of the object", when="several"),
    Field("waits", SCALAR, "calls", "for which the object has waited for a tip", type="int", when="several"),
    Field("held", SCALAR, "", "1: the last call had an object", type="int", when="several"),
)
FOLLOW_INPUT: tuple[Field, ...] = (
    Field("pose", POSE, "m", "pose wanted of the tip, in the base"),
    Field("posture", N, "rad or m", "posture: where joints go that the poses leave free, and on which branch"),
    Field("tool_pose", POSE, "m", "pose of the tool in the tip's frame", when="tool"),
    Field(
        "object_pose",
        (4, 4),
        "m",
        "pose wanted of an object that all tips hold: it goes there on one straight way, and they keep their places in "
        "it; pose does not count then. All 0: none",
        when="several",
    ),
    Field("grasp", POSE, "m", "poses of the tips in the object", when="several"),
)
FOLLOW_OUTPUT: tuple[Field, ...] = (
    Field("q0", N, "rad or m", "command"),
    Field("dq0", N, "rad/s or m/s", "its velocity"),
    Field("error", ("tips", 2), "m, rad", "distance and angle of the tip from its pose, with the last q0"),
    Field("status", SCALAR, "", "bits; NAME_FOLLOW_MOVING and others", type="uint32_t"),
)
FOLLOW_STRUCTS = (
    ("follow_config", "Configuration of Follow; start from the defaults, and state sample_time.", FOLLOW_CONFIG),
    ("follow_input", "Command of a call.", FOLLOW_INPUT),
    ("follow_output", "Result of a call.", FOLLOW_OUTPUT),
)
FOLLOW_STATUS = (
    ("moving", "q0 moves"),
    ("smoothed", "the poses are a coarse stream, which is smoothed"),
    ("by_joints", "the straight line was blocked; q0 goes to the posture, which has the tips at their poses"),
    ("unreachable", "q0 is as near to the poses as it comes from here, and waits for others"),
    ("refused", "the pose or posture of this call is refused; the last accepted one counts"),
)
"""Bits of the status from 1 on, with their meanings."""
FOLLOW_ERRORS = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state was not initialised; call NAME_follow_init"),
    ("start", "q: every position at the start must be finite"),
    ("pose", "pose: entries must be finite, and the last row 0 0 0 1"),
    ("rotation", "pose: the upper left (3, 3) is no rotation matrix; R^T R may differ from 1 by 1e-3"),
    ("posture", "posture: every position must be finite"),
    ("tool", "tool_pose: no pose, as for pose"),
    ("limits", "lower_limit: must be below upper_limit by twice limit_distance"),
)
"""Errors besides those of the configuration's fields, from -1 down."""
