# SPDX-License-Identifier: MIT
"""Tables of Settle: structs of NAME_settle.h in C and in Python, the bits of its status, and its errors."""

from __future__ import annotations

from stiffgen.control.core.field import POSE, SCALAR, SPRING, WRENCH, Field

SETTLE_CONFIG: tuple[Field, ...] = (
    Field(
        "settle_force",
        (2,),
        "N, N m",
        "largest force and moment that the offset lets the springs exert: the payload or friction that is not known. "
        "Where springs pull by 1.25 times as much in all, something blocks the tip: the offset grows no more. 0: none, "
        "the pose stays as it is",
        "0.0, 0.0",
        0.0,
        1e4,
    ),
    Field(
        "settle_band",
        (2,),
        "m, rad",
        "error that is left: below (static less sliding friction) / stiffness the arm would hunt",
        "0.001, 0.003",
        1e-6,
        1.0,
    ),
    Field(
        "contact_wrench",
        (2,),
        "N, N m",
        "measured force and moment from which on the tip is in contact, and the offset is held",
        "5.0, 1.0",
        0.0,
        1e5,
    ),
)
SETTLE_STATE: tuple[Field, ...] = (
    Field("offset", (6,), "m, rad", "translation and rotation vector from the commanded pose, in base axes"),
    Field("pose", POSE, "m", "last commanded pose"),
    Field("here", POSE, "m", "last measured pose"),
    Field("velocity", (6,), "m/s, rad/s", "measured twist of the tip, smoothed"),
    Field("rest", SCALAR, "s", "time for which the command has been at rest"),
    Field("known", SCALAR, "", "1: the poses are known", type="int"),
    Field("ready", SCALAR, "", "mark that init wrote the state", type="int"),
)
SETTLE_INPUT: tuple[Field, ...] = (
    Field("pose", POSE, "m", "pose wanted of the tip, in the base"),
    Field("translation_stiffness", SPRING, "N/m", "stiffness Kt that the controller is given"),
    Field("rotation_stiffness", SPRING, "N m/rad", "stiffness Ko that the controller is given"),
    Field("wrench", WRENCH, "N, N m", "measured wrench of the environment ON the robot, without the payload's"),
    Field("hold", SCALAR, "", "1: the offset is held, whatever is measured", type="int"),
)
SETTLE_OUTPUT: tuple[Field, ...] = (
    Field("pose", POSE, "m", "moved pose, for Follow"),
    Field("offset", (6,), "m, rad", "translation and rotation vector of the move, in base axes"),
    Field("error", (2,), "m, rad", "distance and angle of the measured tip from the wanted pose"),
    Field("status", SCALAR, "", "bits; NAME_SETTLE_MOVING and others", type="uint32_t"),
)
SETTLE_STRUCTS = (
    ("settle_config", "Configuration of Settle; start from the defaults, and state settle_force.", SETTLE_CONFIG),
    ("settle_input", "Command of a call.", SETTLE_INPUT),
    ("settle_output", "Result of a call.", SETTLE_OUTPUT),
)
SETTLE_STATUS = (
    ("moving", "the offset moves"),
    ("settled", "the measured tip is within settle_band of the wanted pose"),
    ("held", "the offset is held: the command or the tip moves, something touches the tip, or the torque is limited"),
    ("limited", "the offset is as large as settle_force allows"),
)
"""Bits of the status from 1 on, with their meanings."""
SETTLE_ERRORS = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state was not initialised; call NAME_settle_init"),
    ("controller", "the controller's configuration: sample_time, delay_samples, damping_ratio, motor_inertia"),
    ("number", "a number of the input is not finite"),
)
"""Errors besides those of the configuration's fields, from -1 down."""
