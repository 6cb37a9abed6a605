# SPDX-License-Identifier: MIT
"""Table of the controller's inputs and outputs: the only list of them."""

from __future__ import annotations

from stiffgen.control.core.field import SCALAR, SPRINGS, WRENCHES, Field, N

INPUT: tuple[Field, ...] = (
    Field(
        "sample_valid",
        SCALAR,
        "",
        "1: the other fields are a new sample and a command; 0: the sample was missed, and only the clock is read",
        type="int",
    ),
    Field(
        "clock",
        SCALAR,
        "",
        "source of the time, at every call: counter, or time; a call without either holds the torque, then lets it "
        "fall, since no one knows how long it acts",
        "",
        1,
        2,
        "int",
        ("counter", "time"),
    ),
    Field("counter", SCALAR, "samples", "number of the sample time; clock counter", type="uint32_t"),
    Field("time", SCALAR, "s", "time of the sample on a clock that never goes back; clock time"),
    Field("q", N, "rad or m", "measured joint positions"),
    Field("dq", N, "rad/s or m/s", "measured, differenced or filtered joint velocities"),
    Field("q0", N, "rad or m", "wanted joint positions; the reference moves there within its limits"),
    Field(
        "shaped",
        SCALAR,
        "",
        "1: q0 is a point of a motion that has ramps already (a pose follower, a plan), and is followed with 4 times "
        "the acceleration; 0: the reference makes the ramp",
        type="int",
    ),
    Field(
        "translation_stiffness",
        SPRINGS,
        "N/m",
        "wanted stiffness Kt, in the axes of the spring kernels (default: base); symmetric, positive semidefinite, at "
        "most 5000",
    ),
    Field(
        "rotation_stiffness",
        SPRINGS,
        "N m/rad",
        "wanted stiffness Ko, in the axes of the spring kernels (default: equilibrium's); symmetric, positive "
        "semidefinite, at most 500",
    ),
    Field("posture_stiffness", N, "N m/rad", "stiffness k of the posture spring k (q - r)^2 / 2, 0 to 10000"),
    Field(
        "wrench_command",
        WRENCHES,
        "N, N m",
        "(force, moment) that the TIP IS TO EXERT on the environment, hybrid axes, beside the springs; at most "
        "heaviest_wrench; it fades out from half of the tip's velocity limits on, and below 3/4 of tank_initial, since "
        "the tank pays for its work",
    ),
    Field(
        "acceleration",
        N,
        "rad/s^2 or m/s^2",
        "acceleration of a planned q0, shaped only: the torque M acceleration carries the arm, paid from the tank; at "
        "most 4 times the reference's own",
    ),
    Field(
        "torque_offset",
        N,
        "N m or N",
        "torque that the caller adds (gravity), inside the effort and rate limits; its work is the caller's, outside "
        "the energy account",
    ),
)

_TORQUE: tuple[Field, ...] = (
    Field("torque", N, "N m or N", "command: own_torque and the caller's torque_offset, within all limits"),
    Field("own_torque", N, "N m or N", "the controller's part, which the account is about"),
)
_STATUS: tuple[Field, ...] = (
    Field("status", SCALAR, "", "status bits, NAME_STATUS_...", type="uint32_t"),
    Field("mode", SCALAR, "", "mode of the step, NAME_MODE_...", type="int"),
    Field("fault", SCALAR, "", "class of the latched fault, NAME_FAULT_...", type="int"),
    Field("reason", SCALAR, "", "reason for the fault, NAME_REASON_...", type="int", memory="fault.reason"),
    Field(
        "fault_joint", SCALAR, "", "index of the joint that the fault is about, or -1", type="int", memory="fault.joint"
    ),
    Field("refusal", SCALAR, "", "why the command is refused, NAME_REFUSAL_...", type="int"),
    Field("refusal_command", SCALAR, "", "argument that the refusal is about, NAME_COMMAND_...", type="int"),
    Field("refusal_entry", SCALAR, "", "joint or row-major index of the entry in this argument, or -1", type="int"),
    Field("limited_joint", SCALAR, "", "first joint whose q0 is followed to its limit's zone only, or -1", type="int"),
    Field(
        "hold",
        SCALAR,
        "calls",
        "calls without a sample for which the torque would be held: missed_limit, or 1 where the tank covers no more",
        type="int",
        memory="account.hold",
    ),
    Field("fault_seen", SCALAR, "", "number that was seen; fault_text says of what", memory="fault.seen"),
    Field("fault_limit", SCALAR, "", "what fault_seen may be", memory="fault.limit"),
    Field("fault_time", SCALAR, "s", "time since the fault was latched", memory="fault.time"),
    Field("refusal_seen", SCALAR, "", "number that was seen"),
    Field("refusal_limit", SCALAR, "", "what refusal_seen may be"),
)
_ENERGIES: tuple[Field, ...] = (
    Field(
        "energy_supplied",
        SCALAR,
        "J",
        "upper bound on all work that has left the robot's port since init, never falling: kept at every sample and "
        "until the next call",
        memory="account.supplied",
    ),
    Field("tank", SCALAR, "J", "energy in the tank", memory="account.tank"),
    Field("stored", SCALAR, "J", "energy of springs and limit zones"),
    Field("reserve", SCALAR, "J", "most work of the torques under way; tank and stored energy cover it"),
    Field("tank_initial", SCALAR, "J", "tank_initial in force", memory="config.tank_initial"),
)
_DIAGNOSTICS: tuple[Field, ...] = (
    Field("position", N, "rad or m", "last believed q; turns of continuous joints are counted", memory="watch.q"),
    Field(
        "reference",
        N,
        "rad or m",
        "reference r: the springs of the tips are at rest at its poses",
        memory="reference.r",
    ),
    Field(
        "reference_velocity",
        N,
        "rad/s or m/s",
        "velocity dr of the reference; the damping acts on dr - dq",
        memory="reference.dr",
    ),
    Field(
        "scale",
        SCALAR,
        "",
        "scale l of the springs' energy: 1 in normal operation, 0 after a fault",
        memory="reference.scale",
    ),
    Field("stiffness_share", SCALAR, "", "share of the springs' stiffness that sample time and delay allow"),
    Field("damping_torque", N, "N m or N", "B (dr - dq), and the brake of joints beyond 0.72 of velocity_limit"),
    Field("limit_torque", N, "N m or N", "torque of the limit zones"),
    Field("feedforward_torque", N, "N m or N", "torque of wrench_command, acceleration, friction and Coriolis forces"),
)

OUTPUT_SECTIONS = (
    ("Torque: what the motors are sent.", _TORQUE),
    ("Status: what happened, and why.", _STATUS),
    ("Energies: the account.", _ENERGIES),
    ("Diagnostics: what is in force, for a log.", _DIAGNOSTICS),
)
OUTPUT = tuple(field for _, fields in OUTPUT_SECTIONS for field in fields)
