# SPDX-License-Identifier: MIT
"""Table of the controller's fields, status bits, faults and reasons: the only list of them.

C structs and enumerations, error codes and texts, the check of every configuration field, documentation and the
layout that Python reads are made from this table. The C in ``runtime/`` uses the fields.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_DOF = 40
"""Most coordinates of a robot with a controller."""

Extent = int | str
"""Extent of a field: a number, "n" for the coordinates, or "tips" for the tips (left out if there is one)."""


@dataclass(frozen=True)
class Field:
    """Member of a controller's struct.

    ``shape`` is row-major; () is a scalar. ``choices`` are the words that Python accepts for an int, each a C constant
    NAME_<FIELD>_<CHOICE>. Configuration only: ``default`` is a C expression ("{name}" is the robot's prefix, i the
    index), and every entry must lie between ``least`` and ``most`` (both allowed).
    """

    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    default: str = ""
    least: float = math.nan
    most: float = math.nan
    type: str = "double"
    choices: tuple[str, ...] = ()
    when: str = ""
    """Condition for the field: "tool", a tool pose at run time."""
    memory: str = ""
    """Member of the state's memory that an output reports; "=" for the same name."""

    @property
    def rule(self) -> str:
        """Condition on every entry, in words."""
        if self.choices:
            words = [*self.choices[:-2], " or ".join(self.choices[-2:])]
            return "must be " + ", ".join(words)
        if math.isinf(self.most):
            return "must be a number, or infinite"
        each = "every entry must" if self.shape else "must"
        return f"{each} lie between {self.least:g} and {self.most:g}"


_N, _NN = ("n",), ("n", "n")
_SCALAR: tuple[Extent, ...] = ()
_POSE, _WRENCH, _TASK, _SPRING = ("tips", 4, 4), ("tips", 6), ("tips", 6, 6), ("tips", 3, 3)


def _choice(name: str, meaning: str, choices: tuple[str, ...], default: str) -> Field:
    return Field(name, _SCALAR, "", meaning, default, 1, len(choices), "int", choices)


CONFIG: tuple[Field, ...] = (
    Field("sample_time", _SCALAR, "s", "time T from one call of step to the next", "0.001", 1e-5, 0.1),
    Field(
        "delay_samples",
        _SCALAR,
        "samples",
        "delay from the sample that a torque is computed from to the sample at which it acts; 0 if it acts at once",
        "0",
        0,
        2,
        "int",
    ),
    _choice(
        "law",
        "control law; potential: the torque is the negative gradient of a spring's energy; paper: Kq(q, wrench) "
        "(q0 - q), to reproduce the paper, within bounds",
        ("potential", "paper"),
        "potential",
    ),
    _choice(
        "stiffness_formula",
        "formula of Kq in the paper's law: corrected (symmetric) or conventional (without the connection's correction)",
        ("corrected", "conventional"),
        "corrected",
    ),
    Field(
        "posture_stiffness", _N, "N m/rad", "stiffness k of the posture spring k (q - posture)^2 / 2", "1.0", 0.0, 1e4
    ),
    Field("translation_stiffness_limit", _SCALAR, "N/m", "largest accepted entry (absolute value)", "5e3", 1.0, 1e6),
    Field("rotation_stiffness_limit", _SCALAR, "N m/rad", "largest accepted entry (absolute value)", "500.0", 0.1, 1e5),
    _choice(
        "spring",
        "spring at the tips: trace (kernels of the group spring) or bounded (spring_bounded, needs a folder generated "
        "with --spring bounded), whose energy grows linearly far away",
        ("trace", "bounded"),
        "trace",
    ),
    Field("spring_force_limit", _SCALAR, "N", "largest force of each bounded spring", "40.0", 1e-3, 1e6),
    Field("spring_moment_limit", _SCALAR, "N m", "largest moment of each bounded spring", "10.0", 1e-3, 1e5),
    _choice(
        "stiffness_cap",
        "what init does if the sample time allows less than half of the stiffness limits in some posture: refuse the "
        "configuration, or accept it; the springs are then softened where they must be (output stiffness_share)",
        ("refuse", "accept"),
        "refuse",
    ),
    Field("stiffness_time", _SCALAR, "s", "time constant of a change of stiffness", "0.002", 1e-4, 100.0),
    _choice(
        "damping_design",
        "design of the damping: modal (tangent and mass matrix diagonalised together) or task (J^T task_damping J); "
        "joint_damping I is added to both",
        ("modal", "task"),
        "modal",
    ),
    Field("damping_ratio", _N, "1", "damping ratio of each mode, softest first; modal design only", "0.7", 0.0, 100.0),
    Field(
        "task_damping",
        (6, 6),
        "N s/m, N s, N m s",
        "damping of every tip's twist in hybrid axes; symmetric, positive semidefinite; task design only",
        "0.0",
        -1e5,
        1e5,
    ),
    Field("joint_damping", _SCALAR, "N m s/rad", "damping d of every joint, added as d I", "0.1", 0.0, 1e4),
    _choice(
        "coriolis",
        "whether the torque compensates Coriolis and centrifugal forces; on: C(q, dq) dq is added, paid from the tank; "
        "off where the robot does so itself",
        ("off", "on"),
        "off",
    ),
    Field(
        "motor_inertia",
        _N,
        "kg m^2",
        "inertia of the motors' rotors at the joints; a URDF has none, and without it light joints are damped wrongly",
        "{name}_motor_inertia[i]",
        0.0,
        1e4,
    ),
    Field(
        "lower_limit",
        _N,
        "rad or m",
        "lower limit of the position; may be -infinity",
        "{name}_lower[i]",
        -math.inf,
        math.inf,
    ),
    Field(
        "upper_limit",
        _N,
        "rad or m",
        "upper limit of the position; may be infinity",
        "{name}_upper[i]",
        -math.inf,
        math.inf,
    ),
    Field(
        "position_tolerance",
        _SCALAR,
        "rad or m",
        "distance beyond a position limit up to which there is no fault",
        "0.1",
        0.0,
        10.0,
    ),
    Field(
        "limit_zone",
        _SCALAR,
        "rad or m",
        "width of the zone inside each limit where the limit avoidance acts",
        "0.1",
        1e-6,
        10.0,
    ),
    Field(
        "limit_stiffness",
        _N,
        "N m/rad",
        "stiffness of the limit avoidance in the zone, up to the effort limit; softened to what torque rate and sample "
        "time can follow; 0 turns it off",
        "{name}_effort[i]",
        0.0,
        1e6,
    ),
    Field(
        "velocity_limit",
        _N,
        "rad/s or m/s",
        "velocity limit of the arm; exceeding it for overspeed_time is a limit fault",
        "{name}_velocity[i]",
        1e-6,
        1e3,
    ),
    Field(
        "reference_velocity_limit",
        _N,
        "rad/s or m/s",
        "velocity limit of the equilibrium, which uses 0.8 of it; from 0.9 of it on the arm's joint is braked",
        "0.9 * {name}_velocity[i]",
        1e-6,
        1e3,
    ),
    Field("tip_velocity_limit", _SCALAR, "m/s", "velocity limit of the equilibrium's translation", "1.0", 1e-6, 100.0),
    Field("tip_rotation_limit", _SCALAR, "rad/s", "velocity limit of the equilibrium's rotation", "2.5", 1e-6, 100.0),
    Field("ramp_time", _SCALAR, "s", "time in which the equilibrium reaches its largest velocity", "0.05", 1e-4, 100.0),
    Field(
        "heaviest_wrench",
        (2,),
        "N, N m",
        "heaviest force and moment that the springs are to exert at a tip; energy_limit, engagement_limit and the tank "
        "follow from it where they are 0",
        "100.0, 20.0",
        1e-3,
        1e5,
    ),
    Field(
        "energy_limit",
        _SCALAR,
        "J",
        "largest energy that a move of the equilibrium may store in the springs of the tips; 0: the energy at which "
        "they exert heaviest_wrench",
        "0.0",
        0.0,
        1e4,
    ),
    Field(
        "engagement_limit",
        _SCALAR,
        "J",
        "work that moves of the equilibrium may cost after a start or a reset, and per second of a command's travel at "
        "the governor's velocity limits; 0: work against heaviest_wrench in a second at the tip's velocity limits",
        "0.0",
        0.0,
        1e5,
    ),
    Field("effort_limit", _N, "N m or N", "largest torque", "{name}_effort[i]", 1e-6, 1e5),
    Field(
        "torque_rate_limit",
        _N,
        "N m/s or N/s",
        "largest change of the torque per second",
        "{name}_torque_rate[i]",
        1e-6,
        1e8,
    ),
    _choice(
        "actuation",
        "what the motors are sent: torque, held from one step to the next; or gains: tau_ff, kp and kd for a "
        "controller inside each motor, which follows q and dq between the steps; gains need the potential law and "
        "delay_samples 0",
        ("torque", "gains"),
        "torque",
    ),
    Field("kp_limit", _N, "N m/rad", "largest kp that a motor takes; actuation gains only", "500.0", 0.0, 1e6),
    Field("kd_limit", _N, "N m s/rad", "largest kd that a motor takes; actuation gains only", "5.0", 0.0, 1e5),
    Field("force_limit", _SCALAR, "N", "largest measured force (norm) that is believed", "500.0", 1e-3, 1e6),
    Field("moment_limit", _SCALAR, "N m", "largest measured moment (norm) that is believed", "100.0", 1e-3, 1e6),
    Field(
        "missed_limit",
        _SCALAR,
        "samples",
        "number of calls without a believed sample for which the torque is held; from then on it moves to zero at the "
        "rate limit until a sample comes; as many calls left out in a row are a fault",
        "3",
        1,
        1000,
        "int",
    ),
    Field(
        "loss_limit",
        _SCALAR,
        "samples",
        "number of missing or bad samples in a row that is a fault, at least missed_limit; each good sample takes half "
        "of one back, so random loss of 5 % is none",
        "10",
        1,
        1000000,
        "int",
    ),
    Field(
        "state_period",
        _SCALAR,
        "s",
        "time from one new state of the robot to the next; within it a sample that repeats the last one is no new "
        "sample, and none that is missing; at most missed_limit sample times; 0: each sample is new",
        "0.0",
        0.0,
        1.0,
    ),
    Field(
        "call_gap_limit",
        _SCALAR,
        "samples",
        "most sample times from one call to the next, with a sample or without; 1 if no call is ever left out, which "
        "lets the tank cover larger torques; no larger than missed_limit counts",
        "3",
        1,
        1000,
        "int",
    ),
    Field(
        "position_quantum",
        _SCALAR,
        "rad or m",
        "resolution of the positions that velocities are computed from; the damping then uses the mean velocity of as "
        "many samples (up to 8) as the torque's rate limit needs",
        "0.0",
        0.0,
        0.1,
    ),
    Field(
        "velocity_noise",
        _SCALAR,
        "rad/s or m/s",
        "standard deviation or resolution of dq, the larger one; what the checks of samples and speed allow for",
        "0.0",
        0.0,
        100.0,
    ),
    Field(
        "velocity_filter_time",
        _SCALAR,
        "s",
        "time constant of a low pass on the velocity that the damping uses, for noisy velocities; the damping is "
        "designed for its delay",
        "0.0",
        0.0,
        0.1,
    ),
    Field(
        "frozen_window",
        _SCALAR,
        "samples",
        "number of samples for which a value may stand still while the other signal moves, before it is judged",
        "20",
        2,
        1000000,
        "int",
    ),
    Field(
        "overspeed_time",
        _SCALAR,
        "s",
        "time for which a joint may be beyond velocity_limit, as after a bump; it is braked from the first sample on",
        "0.2",
        0.0,
        10.0,
    ),
    Field(
        "automatic_reset_time",
        _SCALAR,
        "s",
        "time of good samples after which a fault resets itself; 0: never",
        "0.0",
        0.0,
        1e4,
    ),
    Field(
        "communication_reset_time",
        _SCALAR,
        "s",
        "time of good samples after which a communication fault resets itself; 0: as automatic_reset_time",
        "0.0",
        0.0,
        1e4,
    ),
    _choice(
        "communication_reaction",
        "reaction to a communication fault, once samples are back: release the springs, or hold: the springs keep the "
        "arm where the equilibrium stands until the reset",
        ("release", "hold"),
        "release",
    ),
    Field(
        "tank_initial",
        _SCALAR,
        "J",
        "tank energy at the start; with the stored energy it covers the torques, so it bounds what the arm can hold "
        "(status RESERVE; table in docs/controller.md); 0: what heaviest_wrench needs, computed by init",
        "0.0",
        0.0,
        1e4,
    ),
    Field(
        "tank_maximum",
        _SCALAR,
        "J",
        "tank energy above which income goes to the engagement or is lost, unless the reserve is larger; 0: as "
        "tank_initial",
        "0.0",
        0.0,
        1e4,
    ),
)

INPUT: tuple[Field, ...] = (
    Field(
        "sample_valid",
        _SCALAR,
        "",
        "1: the other fields are a new sample; 0: the sample was missed, and they are not read",
        type="int",
    ),
    _choice(
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

STATUS: tuple[tuple[str, str], ...] = (
    ("fault", "a fault is latched: see fault, reason and fault_time"),
    ("missed", "no sample, or one whose counter did not advance by one"),
    ("bad_sample", "the sample was not believed: two of three are a fault"),
    ("command_refused", "the command is refused: equilibrium and stiffness stay where they are"),
    ("wrench_refused", "the measured wrench is not finite or too large, and is not used"),
    ("moving", "the equilibrium is on its way to the wanted one"),
    ("governor", "the equilibrium is held back by the energy or the engagement limit"),
    ("stiffness_changing", "the applied stiffness is on its way to the wanted one"),
    ("tank_limited", "the stiffness or the scale is held back because the tank cannot pay"),
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
        "a changed limit avoidance waits: at the present position it would cost more energy than the tank can pay",
    ),
    ("config", "the configuration is refused or the state is not initialised; the return value says why"),
    ("repeated", "the sample repeats the last state, as state_period allows: the torque is held"),
    ("overspeed", "a joint is beyond its velocity limit and is braked: a fault after overspeed_time"),
    ("offset_limited", "torque_offset is held back by the effort or the rate limit"),
    (
        "feedforward_refused",
        "wrench_command, or velocity and acceleration, are not used: not finite, too large, with the paper's law, or a "
        "velocity that does not agree with the motion of the command",
    ),
    (
        "feedforward_limited",
        "wrench_command is held back by tank, reserve, effort or speed, or the governor does not keep up with the plan",
    ),
    ("unreachable", "the commanded pose is out of reach from here: the equilibrium ends at the nearest point"),
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
    ("configuration", "configuration, law or state changed in a way that needs a reset"),
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
        "q or dq stands still while the other moves (velocity_noise, position_quantum, frozen_window)",
    ),
    ("stale", "sensor", "the sample counter does not advance"),
    ("wrench", "sensor", "paper's law: no wrench, or one that is not believed (force_limit, moment_limit)"),
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
    ("paper_bound", "limit", "paper's law: load or deflection beyond the bound where the law is a spring (law)"),
    (
        "reserve",
        "energy",
        "the tank is almost empty and the springs' torque is not covered (tank_initial, torque_rate_limit)",
    ),
    ("config", "configuration", "the configuration was refused (the return value names the field)"),
    ("changed", "configuration", "law or spring changed while engaged (law, spring)"),
    ("state", "configuration", "the state's checksum is wrong: its memory was overwritten"),
)
"""Reasons for faults, NAME_REASON_<NAME> from 0 on: class, meaning, and in brackets the fields to look at."""

SEEN: dict[str, str] = {
    "jump": "change of q [rad or m]",
    "mismatch": "dq less the change of q per second [rad/s or m/s]",
    "frozen": "motion that only the other signal shows [rad or m]",
    "stale": "advance of the counter [samples]",
    "missed": "samples missing, less half of the good ones since [samples]",
    "skipped": "calls left out [samples]",
    "position": "q [rad or m]",
    "overspeed": "speed [rad/s or m/s]",
    "paper_bound": "deflection [rad]",
    "reserve": "reserve of the torque [J]",
}
"""Meaning and unit of fault_seen and fault_limit for each reason with numbers."""

ERRORS: tuple[tuple[str, str], ...] = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state is not initialised: call NAME_impedance_init first"),
    ("torque", "the initial torque is not finite or beyond the effort limit"),
    ("task_damping_sign", "task_damping: must be symmetric and positive semidefinite"),
    ("position_limits", "lower_limit, upper_limit: lower must be below upper by more than two limit zones"),
    ("tank", "tank_initial: must not be above tank_maximum"),
    ("paper_tips", "law: the paper's law needs a robot with one tip"),
    ("state_period", "state_period: must not be above missed_limit times sample_time"),
    ("bounded_spring", "spring: the folder has no bounded spring; generate it with --spring bounded"),
    (
        "stiffness",
        "translation_stiffness_limit, rotation_stiffness_limit: sample_time, delay_samples and motor_inertia allow "
        "less than half of this stiffness; lower the limits, correct motor_inertia, or set stiffness_cap to accept",
    ),
    ("actuation", "actuation: gains need the potential law and delay_samples 0"),
    ("gains", "joint_gains: a number is not finite, or the limit of a gain is below 0"),
    ("policy", "policy_start: a pose is no pose, or now is not finite"),
)
"""Errors that are not those of single configuration fields, NAME_E_<NAME>, from -1 down."""
