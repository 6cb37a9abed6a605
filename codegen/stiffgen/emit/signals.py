# SPDX-License-Identifier: MIT
"""Table of the controller's inputs and outputs: the only list of them (fields.py)."""

from __future__ import annotations

from stiffgen.emit.fields import Extent, Field, choice_field

_N, _NN = ("n",), ("n", "n")
_SCALAR: tuple[Extent, ...] = ()
_POSE, _WRENCH, _TASK, _SPRING = ("tips", 4, 4), ("tips", 6), ("tips", 6, 6), ("tips", 3, 3)

INPUT: tuple[Field, ...] = (
    Field(
        "sample_valid",
        _SCALAR,
        "",
        "1: the other fields are a new sample; 0: the sample was missed, and they are not read",
        type="int",
    ),
    choice_field(
        "command", "meaning of q0; equilibrium is read by the command of that name", ("position", "equilibrium"), ""
    ),
    Field(
        "wrench_valid",
        _SCALAR,
        "",
        "1: wrench is measured (the paper's law needs it); 0: wrench is not read",
        type="int",
    ),
    Field(
        "counter",
        _SCALAR,
        "",
        "sample counter; advances by one per sample time, also for missed samples",
        type="uint32_t",
    ),
    Field("q", _N, "rad or m", "measured joint positions"),
    Field("dq", _N, "rad/s or m/s", "measured, differenced or filtered joint velocities"),
    Field(
        "q0",
        _N,
        "rad or m",
        "command position: the wanted joint positions, with equilibrium forward_kinematics(q0) and posture q0; command "
        "equilibrium: the wanted posture",
    ),
    Field(
        "equilibrium",
        _POSE,
        "m",
        "pose [R p; 0 1] of the tip where its spring is to be at rest; command equilibrium only",
    ),
    Field(
        "torque_offset",
        _N,
        "N m or N",
        "torque that the caller adds (gravity, Coriolis, feed-forward), inside the effort and rate limits; its work is "
        "the caller's, outside the energy account",
    ),
    Field(
        "velocity",
        _N,
        "rad/s or m/s",
        "velocity of a planned q0, or with an equilibrium the joint velocity that follows it; 0 without a plan; at "
        "most reference_velocity_limit; refused where it does not agree with the motion of the command",
    ),
    Field(
        "acceleration",
        _N,
        "rad/s^2 or m/s^2",
        "derivative of velocity: the torque M acceleration carries the arm; at most reference_velocity_limit / "
        "ramp_time",
    ),
    Field(
        "wrench_command",
        _WRENCH,
        "N, N m",
        "(force, moment) that the TIP IS TO EXERT on the environment, hybrid axes, beside the springs; at most "
        "heaviest_wrench; it fades out from half of the tip's velocity limits on, and below 3/4 of tank_initial, since "
        "the tank pays for its work",
    ),
    Field(
        "tool_pose",
        _POSE,
        "m",
        "pose of the tool in the tip's frame; a change takes the equilibrium along, as far as the engagement pays",
        when="tool",
    ),
    Field(
        "translation_stiffness",
        _SPRING,
        "N/m",
        "wanted stiffness Kt, in the axes of the spring kernels (default: base); symmetric, positive semidefinite",
    ),
    Field(
        "rotation_stiffness",
        _SPRING,
        "N m/rad",
        "wanted stiffness Ko, in the axes of the spring kernels (default: equilibrium's); symmetric, positive "
        "semidefinite",
    ),
    Field(
        "wrench",
        _WRENCH,
        "N, N m",
        "(force, moment) that the ENVIRONMENT APPLIES TO THE ROBOT at the tip, hybrid axes; negate the reading of a "
        "sensor that reports the robot's wrench",
    ),
    Field(
        "task_stiffness",
        _TASK,
        "N/m, N, N m",
        "task stiffness of the paper's law, hybrid axes; symmetric, positive semidefinite",
    ),
)

OUTPUT: tuple[Field, ...] = (
    Field(
        "torque",
        _N,
        "N m or N",
        "command: elastic + damping + limit + feed-forward torque, and the caller's torque_offset, within all limits",
    ),
    Field(
        "tau_ff",
        _N,
        "N m or N",
        "feed-forward torque for motors that apply tau_ff + kp (q_des - q) + kd (dq_des - dq); torque is what they "
        "apply at the last believed q and dq",
    ),
    Field("kp", _N, "N m/rad", "gain kp of the motors; 0 with actuation torque", memory="="),
    Field("kd", _N, "N m s/rad", "gain kd of the motors; 0 with actuation torque", memory="="),
    Field("q_des", _N, "rad or m", "position q_des of the motors, the last believed q", memory="q"),
    Field("dq_des", _N, "rad/s or m/s", "velocity dq_des of the motors, 0"),
    Field(
        "late_work",
        _SCALAR,
        "J",
        "most work that the motors put out until the next step, or as many steps as torques are held for, comes",
    ),
    Field("status", _SCALAR, "", "bits NAME_STATUS_...", type="uint32_t"),
    Field("mode", _SCALAR, "", "mode of the step, NAME_MODE_...", type="int"),
    Field("fault", _SCALAR, "", "class of the latched fault, NAME_FAULT_...", type="int", memory="="),
    Field("reason", _SCALAR, "", "reason for the fault, NAME_REASON_...", type="int", memory="="),
    Field("missed", _SCALAR, "samples", "samples missed since the last believed one", type="int", memory="="),
    Field(
        "unaccounted", _SCALAR, "", "number of times that the energy account began anew", type="uint32_t", memory="="
    ),
    Field("fault_joint", _SCALAR, "", "index of the joint that the fault is about, or -1", type="int", memory="="),
    Field(
        "hold",
        _SCALAR,
        "samples",
        "calls without a sample for which the torque would be held: missed_limit, or 1 where the tank covers no more",
        type="int",
        memory="=",
    ),
    Field("fault_time", _SCALAR, "s", "time since the fault was latched", memory="="),
    Field("fault_seen", _SCALAR, "", "number that was seen, NAME_impedance_reason_seen says of what", memory="="),
    Field("fault_limit", _SCALAR, "", "what fault_seen may be", memory="="),
    Field("position", _N, "rad or m", "last believed q", memory="q"),
    Field(
        "velocity",
        _N,
        "rad/s or m/s",
        "velocity that the damping used: dq, its mean, or the credible part of it; 0 without a sample",
    ),
    Field("reference", _N, "rad or m", "posture r that the springs pull to", memory="posture"),
    Field("reference_velocity", _N, "rad/s or m/s", "velocity dr of the reference; the damping acts on dr - velocity"),
    Field("reference_acceleration", _N, "rad/s^2 or m/s^2", "acceleration ddr of a plan in force; 0 without"),
    Field("equilibrium", _POSE, "m", "pose where the spring is at rest now", memory="="),
    Field(
        "translation_stiffness", _SPRING, "N/m", "stiffness Kt in force, with its caps, before the scale", memory="="
    ),
    Field(
        "rotation_stiffness", _SPRING, "N m/rad", "stiffness Ko in force, with its caps, before the scale", memory="="
    ),
    Field(
        "stiffness_share",
        _SCALAR,
        "1",
        "share of the wanted stiffness that is in force, in the direction of the smallest share: caps and scale",
    ),
    Field(
        "scale",
        _SCALAR,
        "1",
        "scale l of the elastic energy: 1 in normal operation, 0 after a fault",
        memory="=",
    ),
    Field("elastic_torque", _N, "N m or N", "torque of the springs, -l dU/dq; paper: l Kq (r - q)"),
    Field(
        "damping_torque",
        _N,
        "N m or N",
        "B (dr - velocity), and the brake of joints beyond 0.9 of reference_velocity_limit",
    ),
    Field("offset_torque", _N, "N m or N", "torque_offset in force"),
    Field("limit_torque", _N, "N m or N", "torque of the joint limit avoidance"),
    Field("feedforward_torque", _N, "N m or N", "torque of wrench_command, M ddr of a plan, Coriolis forces"),
    Field("wrench_command", _WRENCH, "N, N m", "wrench_command in force"),
    Field("spring_wrench", _WRENCH, "N, N m", "wrench l dU that the environment applies at rest, hybrid axes"),
    Field("wrench", _WRENCH, "N, N m", "measured wrench that was believed; 0 without"),
    Field(
        "joint_stiffness", _NN, "N m/rad", "tangent that the damping is designed from: d2U/dq2 with posture and limits"
    ),
    Field("damping", _NN, "N m s/rad", "damping matrix B, symmetric positive semidefinite"),
    Field("mass_matrix", _NN, "kg m^2", "mass matrix M(q) + motor inertia"),
    Field("eigenvalues", _N, "1/s^2", "eigenvalues of the tangent with respect to the mass matrix, ascending"),
    Field("elastic_energy", _SCALAR, "J", "energy l U of the springs", memory="="),
    Field("limit_energy", _SCALAR, "J", "energy of the joint limit avoidance", memory="="),
    Field("tank_energy", _SCALAR, "J", "energy in the tank, which pays for sampling and stiffness", memory="tank"),
    Field(
        "tank_reserve",
        _SCALAR,
        "J",
        "worst-case work of the torques in transit; tank and stored energy cover it",
        memory="reserve",
    ),
    Field("engagement", _SCALAR, "J", "work left for moves of the equilibrium", memory="="),
    Field("tank_initial", _SCALAR, "J", "tank_initial in force"),
    Field("engagement_limit", _SCALAR, "J", "engagement_limit in force"),
    Field("energy_limit", _SCALAR, "J", "energy_limit in force, at the present stiffness and deflection"),
    Field(
        "force_available",
        _SCALAR,
        "N",
        "force that effort limits, tank and stored energy cover at the tip now, in the direction of the least force",
    ),
    Field("port_total", _SCALAR, "J", "work put out at the robot's port, the sum of torque . change of q", memory="="),
    Field(
        "sampling_total",
        _SCALAR,
        "J",
        "energy s put in by holding and cutting the torque; damping counts against it",
        memory="=",
    ),
    Field("reference_total", _SCALAR, "J", "energy p put in by moves of the equilibrium", memory="="),
    Field("stiffness_total", _SCALAR, "J", "energy v put in by changes of stiffness or scale", memory="="),
    Field("start_total", _SCALAR, "J", "energy of the limit avoidance where the account began", memory="="),
)
