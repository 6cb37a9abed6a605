# SPDX-License-Identifier: MIT
"""Tables of Press: structs of NAME_press.h in C and in Python, its stages and errors."""

from __future__ import annotations

from stiffgen.control.core.field import POSE, SCALAR, SPRING, WRENCH, Field

PRESS_CONFIG: tuple[Field, ...] = (
    Field("approach_speed", SCALAR, "m/s", "speed at which contact is looked for", "0.03", 1e-4, 1.0),
    Field(
        "disagreement_limit",
        SCALAR,
        "N",
        "most that the springs may press beyond the measured force, but for 0.2 s: friction and payload that are not "
        "known; a sensor that is frozen or reads too little is found by it. Below it an approach ends that presses, "
        "from 3 cm before the tip on, while the tip goes less than 1 mm in 5 s: friction of a UR5 lets it creep by 1.5",
        "50.0",
        0.0,
        1e4,
    ),
    Field("offset_limit", SCALAR, "m", "farthest that the pose is moved from the commanded one", "0.3", 0.0, 10.0),
)
PRESS_STATE: tuple[Field, ...] = (
    Field("offset", (3,), "m", "move of the commanded pose, in base axes"),
    Field("pose", POSE, "m", "last commanded pose"),
    Field("here", POSE, "m", "last measured pose"),
    Field("force", SCALAR, "N", "force of wrench_command along the axis"),
    Field("speed", SCALAR, "m/s", "measured speed of the tip along the axis, smoothed"),
    Field("doubt", SCALAR, "s", "time for which the springs have pressed beyond disagreement_limit"),
    Field("stalled", SCALAR, "s", "time for which an approach has pressed while the tip stood"),
    Field("gone", SCALAR, "m", "way of the tip along the axis in that time"),
    Field("low", SCALAR, "s", "time for which the force has been low in contact"),
    Field("touched", SCALAR, "samples", "samples with a force before contact", type="int"),
    Field("stage", SCALAR, "", "NAME_PRESS_STAGE_...", type="int"),
    Field("known", SCALAR, "", "1: the pose is known", type="int"),
    Field("ready", SCALAR, "", "mark that init wrote the state", type="int"),
)
PRESS_INPUT: tuple[Field, ...] = (
    Field("pose", POSE, "m", "pose wanted of the tip, in the base; along the axis the force moves it"),
    Field("translation_stiffness", SPRING, "N/m", "stiffness Kt that the controller is given"),
    Field("rotation_stiffness", SPRING, "N m/rad", "stiffness Ko that the controller is given"),
    Field("wrench", WRENCH, "N, N m", "measured wrench of the environment ON the robot at the tip, in base axes"),
    Field("axis", (3,), "", "direction in which the tip presses, in base axes; a unit vector, which may turn"),
    Field("force", SCALAR, "N", "force to exert along the axis; 0 ends pressing: the pose goes back to the wanted one"),
    Field("search", SCALAR, "", "1: look for contact again after a loss; 0: stop there", type="int"),
)
PRESS_OUTPUT: tuple[Field, ...] = (
    Field("pose", POSE, "m", "moved pose, for Follow"),
    Field("wrench_command", WRENCH, "N, N m", "wrench_command for the controller's step"),
    Field("error", SCALAR, "N", "force less the measured one along the axis"),
    Field(
        "pressing", SCALAR, "N", "force that springs and wrench_command exert along the axis, by the measured position"
    ),
    Field("gain", SCALAR, "1/s", "gain of the integral: half of the tip's decay along the axis"),
    Field("stage", SCALAR, "", "NAME_PRESS_STAGE_...", type="int"),
)
PRESS_STRUCTS = (
    ("press_config", "Configuration of Press; start from the defaults.", PRESS_CONFIG),
    ("press_input", "Command of a call.", PRESS_INPUT),
    ("press_output", "Result of a call.", PRESS_OUTPUT),
)
PRESS_STAGES = (
    ("off", "no force is wanted"),
    ("approach", "the pose moves along the axis until something is touched"),
    ("contact", "the force is held"),
    ("lost", "contact was lost, or the controller has a fault: the tip stops until search is set, or force was 0"),
    (
        "doubted",
        "the springs press beyond the measured force by disagreement_limit, or an approach presses for 5 s and the tip "
        "goes less than 1 mm: the pose goes back until force was 0",
    ),
)
"""Stages from 0 on, with their meanings."""
PRESS_ERRORS = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state was not initialised; call NAME_press_init"),
    ("controller", "the controller's configuration: sample_time, delay_samples, damping_ratio, motor_inertia"),
    ("number", "a number of the input is not finite"),
    ("axis", "axis: must be a unit vector, up to 1e-3"),
    ("force", "force: must be at least 0, and at most half of the controller's heaviest_wrench"),
)
"""Errors besides those of the configuration's fields, from -1 down."""
