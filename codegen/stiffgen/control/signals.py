# SPDX-License-Identifier: MIT
"""Table of the controller's inputs and outputs: the only list of them (fields.py)."""

from __future__ import annotations

from stiffgen.control.fields import NN, POSE, SCALAR, SPRING, WRENCH, Field, N, choice_field

INPUT: tuple[Field, ...] = (
    Field(
        "sample_valid",
        SCALAR,
        "",
        "1: the other fields are a new sample; 0: the sample was missed, and they are not read",
        type="int",
    ),
    choice_field(
        "command", "meaning of q0; equilibrium is read by the command of that name", ("position", "equilibrium"), ""
    ),
    Field(
        "wrench_valid",
        SCALAR,
        "",
        "1: wrench is measured; 0: wrench is not read",
        type="int",
    ),
    Field(
        "counter",
        SCALAR,
        "",
        "sample counter; advances by one per sample time, also for missed samples",
        type="uint32_t",
    ),
    Field("q", N, "rad or m", "measured joint positions"),
    Field("dq", N, "rad/s or m/s", "measured, differenced or filtered joint velocities"),
    Field(
        "q0",
        N,
        "rad or m",
        "command position: the wanted joint positions, with equilibrium forward_kinematics(q0) and posture q0; command "
        "equilibrium: the wanted posture",
    ),
    Field(
        "equilibrium",
        POSE,
        "m",
        "pose [R p; 0 1] of the tip where its spring is to be at rest; command equilibrium only",
    ),
    Field(
        "torque_offset",
        N,
        "N m or N",
        "torque that the caller adds (gravity, Coriolis, feed-forward), inside the effort and rate limits; its work is "
        "the caller's, outside the energy account",
    ),
    Field(
        "velocity",
        N,
        "rad/s or m/s",
        "velocity of a planned q0, or with an equilibrium the joint velocity that follows it; 0 without a plan; at "
        "most reference_velocity_limit; left out while the equilibrium stands still",
    ),
    Field(
        "acceleration",
        N,
        "rad/s^2 or m/s^2",
        "derivative of velocity: the torque M acceleration carries the arm; at most reference_velocity_limit / "
        "ramp_time",
    ),
    Field(
        "wrench_command",
        WRENCH,
        "N, N m",
        "(force, moment) that the TIP IS TO EXERT on the environment, hybrid axes, beside the springs; at most "
        "heaviest_wrench; it fades out from half of the tip's velocity limits on, and below 3/4 of tank_initial, since "
        "the tank pays for its work",
    ),
    Field(
        "tool_pose",
        POSE,
        "m",
        "pose of the tool in the tip's frame; refused if it changes while the springs are in force",
        when="tool",
    ),
    Field(
        "translation_stiffness",
        SPRING,
        "N/m",
        "wanted stiffness Kt, in the axes of the spring kernels (default: base); symmetric, positive semidefinite",
    ),
    Field(
        "rotation_stiffness",
        SPRING,
        "N m/rad",
        "wanted stiffness Ko, in the axes of the spring kernels (default: equilibrium's); symmetric, positive "
        "semidefinite",
    ),
    Field(
        "wrench",
        WRENCH,
        "N, N m",
        "(force, moment) that the ENVIRONMENT APPLIES TO THE ROBOT at the tip, hybrid axes; negate the reading of a "
        "sensor that reports the robot's wrench",
    ),
    Field(
        "external_valid",
        SCALAR,
        "",
        "1: external_torque is known, and explains why a joint stands still (velocity_source differenced); 0: it is "
        "not read",
        type="int",
    ),
    Field(
        "external_torque",
        N,
        "N m or N",
        "torque that the ENVIRONMENT APPLIES to each joint, from a source that does not read q, such as torque sensors",
    ),
)

_TORQUE: tuple[Field, ...] = (
    Field(
        "torque",
        N,
        "N m or N",
        "command: elastic + damping + limit + feed-forward torque, and the caller's torque_offset, within all limits",
    ),
    Field(
        "tau_ff",
        N,
        "N m or N",
        "feed-forward torque for motors that apply tau_ff + kp (q_des - q) + kd (dq_des - dq); torque is what they "
        "apply at the last believed q and dq",
    ),
    Field("kp", N, "N m/rad", "gain kp of the motors; 0 with actuation torque", memory="="),
    Field("kd", N, "N m s/rad", "gain kd of the motors; 0 with actuation torque", memory="="),
    Field(
        "q_des",
        N,
        "rad or m",
        "position q_des of the motors, the last believed q as it was measured; where a position begins its turn again, "
        "the motor takes q_des - q modulo a turn",
        memory="measured_q",
    ),
    Field("dq_des", N, "rad/s or m/s", "velocity dq_des of the motors, 0"),
)

_STATUS: tuple[Field, ...] = (  # whole numbers first, an even number: no gaps
    Field("status", SCALAR, "", "bits NAME_STATUS_...", type="uint32_t"),
    Field("mode", SCALAR, "", "mode of the step, NAME_MODE_...", type="int"),
    Field("fault", SCALAR, "", "class of the latched fault, NAME_FAULT_...", type="int", memory="="),
    Field("reason", SCALAR, "", "reason for the fault, NAME_REASON_...", type="int", memory="="),
    Field("fault_joint", SCALAR, "", "index of the joint that the fault is about, or -1", type="int", memory="="),
    Field("missed", SCALAR, "samples", "samples missed since the last believed one", type="int", memory="="),
    Field(
        "hold",
        SCALAR,
        "samples",
        "calls without a sample for which the torque would be held: missed_limit, or 1 where the tank covers no more",
        type="int",
        memory="=",
    ),
    Field("unaccounted", SCALAR, "", "number of times that the energy account began anew", type="uint32_t", memory="="),
    Field("refusal", SCALAR, "", "why the command, or its wrench_command, is refused, NAME_REFUSAL_...", type="int"),
    Field("refusal_argument", SCALAR, "", "argument that the refusal is about, NAME_ARGUMENT_...", type="int"),
    Field("refusal_entry", SCALAR, "", "joint or row-major index of the entry in this argument, or -1", type="int"),
    Field("limited_joint", SCALAR, "", "first joint whose q0 is followed to its limit's zone, or -1", type="int"),
    Field("fault_seen", SCALAR, "", "number that was seen, NAME_impedance_reason_seen says of what", memory="="),
    Field("fault_limit", SCALAR, "", "what fault_seen may be", memory="="),
    Field("fault_time", SCALAR, "s", "time since the fault was latched", memory="="),
    Field("refusal_seen", SCALAR, "", "number that was seen"),
    Field("refusal_limit", SCALAR, "", "what refusal_seen may be"),
)

_ENERGIES: tuple[Field, ...] = (
    Field(
        "energy_supplied",
        SCALAR,
        "J",
        "upper bound on all work that has left the port since init, never falling: port_total is at most this, at "
        "every sample and until the next call",
        memory="=",
    ),
    Field("port_total", SCALAR, "J", "work put out at the robot's port, the sum of torque . change of q", memory="="),
    Field(
        "sampling_total",
        SCALAR,
        "J",
        "energy s put in by holding and cutting the torque; damping counts against it",
        memory="=",
    ),
    Field("reference_total", SCALAR, "J", "energy p put in by moves of the equilibrium", memory="="),
    Field("stiffness_total", SCALAR, "J", "energy v put in by changes of stiffness or scale", memory="="),
    Field("start_total", SCALAR, "J", "energy of the limit avoidance where the account began", memory="="),
    Field("elastic_energy", SCALAR, "J", "energy l U of the springs", memory="="),
    Field("limit_energy", SCALAR, "J", "energy of the joint limit avoidance", memory="="),
    Field("tank_energy", SCALAR, "J", "energy in the tank, which pays for sampling and stiffness", memory="tank"),
    Field(
        "tank_reserve",
        SCALAR,
        "J",
        "worst-case work of the torques in transit; tank and stored energy cover it",
        memory="reserve",
    ),
    Field("engagement", SCALAR, "J", "work left for moves of the equilibrium", memory="="),
    Field(
        "late_work",
        SCALAR,
        "J",
        "most work that the motors put out until the next step, or as many steps as torques are held for, comes",
    ),
)

_DIAGNOSTICS: tuple[Field, ...] = (
    Field("position", N, "rad or m", "last believed q; turns of continuous joints are counted", memory="q"),
    Field(
        "velocity",
        N,
        "rad/s or m/s",
        "velocity that the damping used: dq, its mean, or the credible part of it; 0 without a sample",
    ),
    Field(
        "velocity_samples",
        SCALAR,
        "samples",
        "number of samples in the mean of velocity, 1 to 8, in a fault as without one; 0 without a sample",
    ),
    Field("reference", N, "rad or m", "posture r that the springs pull to", memory="posture"),
    Field("reference_velocity", N, "rad/s or m/s", "velocity dr of the reference; the damping acts on dr - velocity"),
    Field("reference_acceleration", N, "rad/s^2 or m/s^2", "acceleration ddr of a plan in force; 0 without"),
    Field("equilibrium", POSE, "m", "pose where the spring is at rest now", memory="="),
    Field("translation_stiffness", SPRING, "N/m", "stiffness Kt in force, with its caps, before the scale", memory="="),
    Field(
        "rotation_stiffness", SPRING, "N m/rad", "stiffness Ko in force, with its caps, before the scale", memory="="
    ),
    Field(
        "stiffness_share",
        SCALAR,
        "1",
        "share of the wanted stiffness that is in force, in the direction of the smallest share: caps and scale",
    ),
    Field(
        "scale",
        SCALAR,
        "1",
        "scale l of the elastic energy: 1 in normal operation, 0 after a fault",
        memory="=",
    ),
    Field("elastic_torque", N, "N m or N", "torque of the springs, -l dU/dq"),
    Field(
        "damping_torque",
        N,
        "N m or N",
        "B (dr - velocity), and the brake of joints beyond 0.9 of reference_velocity_limit",
    ),
    Field("offset_torque", N, "N m or N", "torque_offset in force"),
    Field("limit_torque", N, "N m or N", "torque of the joint limit avoidance"),
    Field("feedforward_torque", N, "N m or N", "torque of wrench_command, M ddr of a plan, Coriolis forces"),
    Field("wrench_command", WRENCH, "N, N m", "wrench_command in force"),
    Field("spring_wrench", WRENCH, "N, N m", "wrench l dU that the environment applies at rest, hybrid axes"),
    Field("wrench", WRENCH, "N, N m", "measured wrench that was believed; 0 without"),
    Field(
        "joint_stiffness", NN, "N m/rad", "tangent that the damping is designed from: d2U/dq2 with posture and limits"
    ),
    Field("damping", NN, "N m s/rad", "damping matrix B, symmetric positive semidefinite"),
    Field("mass_matrix", NN, "kg m^2", "mass matrix M(q) + motor inertia"),
    Field("eigenvalues", N, "1/s^2", "eigenvalues of the tangent with respect to the mass matrix, ascending"),
    Field(
        "velocity_limit",
        N,
        "rad/s or m/s",
        "velocity_limit in force: a raised one waits until it is covered",
        memory="=",
    ),
    Field("missed_limit", SCALAR, "samples", "missed_limit in force, as velocity_limit", type="int", memory="calls"),
    Field(
        "call_gap_limit", SCALAR, "samples", "call_gap_limit in force, as velocity_limit", type="int", memory="call_gap"
    ),
    Field("tank_initial", SCALAR, "J", "tank_initial in force"),
    Field("engagement_limit", SCALAR, "J", "engagement_limit in force"),
    Field("energy_limit", SCALAR, "J", "energy_limit in force, at the present stiffness and deflection"),
    Field(
        "force_available",
        SCALAR,
        "N",
        "force that effort limits, tank and stored energy cover at the tip now, in the direction of the least force",
    ),
)

OUTPUT_SECTIONS = (
    ("Torque: what the motors are sent.", _TORQUE),
    ("Status: what happened, and why.", _STATUS),
    ("Energies: the account.", _ENERGIES),
    ("Diagnostics: what is in force, for a log.", _DIAGNOSTICS),
)
OUTPUT = tuple(field for _, fields in OUTPUT_SECTIONS for field in fields)
