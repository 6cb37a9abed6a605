# SPDX-License-Identifier: MIT
"""The fields of a robot's impedance controller, its status bits, faults and reasons: the only list of them.

The C structs and enumerations, the error codes and texts, the check of every configuration field, their
documentation, and the layout that Python reads are made from it. What the controller does with the fields is C:
``runtime/``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_DOF = 40
"""Robots with more coordinates get kernels and no controller."""

Extent = int | str
"""A fixed extent, "n", the number of coordinates, or "tips", the number of tips (left out where there is one)."""


@dataclass(frozen=True)
class Field:
    """A member of a controller's struct.

    ``shape`` is row-major; () is a scalar. ``choices`` are the words that Python takes for an int, each a C constant
    NAME_<FIELD>_<CHOICE>. Configuration only: ``default`` is a C expression ("{name}" is the robot's prefix and i the
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
    """Present only in controllers that have it: "tool", a tool given at run time."""
    memory: str = ""
    """Output only: the member of the state's memory that is reported; "=" if it has the same name."""

    @property
    def rule(self) -> str:
        """What every entry must be."""
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
    Field("sample_time", _SCALAR, "s", "T, between two calls of the step", "0.001", 1e-5, 0.1),
    Field(
        "delay_samples",
        _SCALAR,
        "samples",
        "between the sample that a torque is computed from and the one from which on it acts; 0 if it acts at once",
        "0",
        0,
        2,
        "int",
    ),
    _choice(
        "law",
        "potential: the torque is the gradient of a spring's energy; paper: Kq(q, wrench) (q0 - q), for reproducing "
        "the paper, within bounds",
        ("potential", "paper"),
        "potential",
    ),
    _choice(
        "stiffness_formula",
        "paper's law only: corrected (symmetric) or conventional (without the connection's correction)",
        ("corrected", "conventional"),
        "corrected",
    ),
    Field("posture_stiffness", _N, "N m/rad", "k of the joint-space potential k (q - posture)^2 / 2", "1.0", 0.0, 1e4),
    Field("translation_stiffness_limit", _SCALAR, "N/m", "largest entry accepted (absolute)", "5e3", 1.0, 1e6),
    Field("rotation_stiffness_limit", _SCALAR, "N m/rad", "largest entry accepted (absolute)", "500.0", 0.1, 1e5),
    Field("stiffness_time", _SCALAR, "s", "time constant of a change of stiffness", "0.05", 1e-4, 100.0),
    _choice(
        "damping_design",
        "modal (double diagonalisation of tangent and mass matrix) or task, J^T task_damping J; to each "
        "joint_damping I is added",
        ("modal", "task"),
        "modal",
    ),
    Field("damping_ratio", _N, "1", "modal: of the modes, softest first", "0.7", 0.0, 100.0),
    Field(
        "task_damping",
        (6, 6),
        "N s/m, N s, N m s",
        "task: on twists of every tip, hybrid axes; symmetric, positive semidefinite",
        "0.0",
        -1e5,
        1e5,
    ),
    Field("joint_damping", _SCALAR, "N m s/rad", "d, added as d I", "0.1", 0.0, 1e4),
    Field(
        "motor_inertia",
        _N,
        "kg m^2",
        "of the rotors, seen at the joints; a URDF has none, and the damping of light joints is wrong without",
        "0.0",
        0.0,
        1e4,
    ),
    Field("lower_limit", _N, "rad or m", "of the position; may be -infinity", "{name}_lower[i]", -math.inf, math.inf),
    Field("upper_limit", _N, "rad or m", "of the position; may be infinity", "{name}_upper[i]", -math.inf, math.inf),
    Field(
        "position_tolerance",
        _SCALAR,
        "rad or m",
        "how far beyond its limit a position is still no fault",
        "0.1",
        0.0,
        10.0,
    ),
    Field("limit_zone", _SCALAR, "rad or m", "width of the zone inside each limit that pushes back", "0.1", 1e-6, 10.0),
    Field(
        "limit_stiffness",
        _N,
        "N m/rad",
        "slope of the limit avoidance torque over the depth in the zone, up to the effort limit; softened to what "
        "torque rate and sample time can follow; 0 turns it off",
        "{name}_effort[i]",
        0.0,
        1e6,
    ),
    Field("velocity_limit", _N, "rad/s or m/s", "of the arm; beyond it a limit fault", "{name}_velocity[i]", 1e-6, 1e3),
    Field(
        "reference_velocity_limit",
        _N,
        "rad/s or m/s",
        "of the posture that the springs pull to, which uses 0.8 of it; from 0.9 on the arm's own joint is braked",
        "0.5 * {name}_velocity[i]",
        1e-6,
        1e3,
    ),
    Field("tip_velocity_limit", _SCALAR, "m/s", "of an equilibrium's translation", "0.5", 1e-6, 100.0),
    Field("tip_rotation_limit", _SCALAR, "rad/s", "of an equilibrium's rotation", "1.5", 1e-6, 100.0),
    Field("ramp_time", _SCALAR, "s", "in which the equilibrium reaches its largest velocity", "0.2", 1e-4, 100.0),
    Field("energy_limit", _SCALAR, "J", "elastic energy that moving the equilibrium may store", "5.0", 1e-6, 1e4),
    Field(
        "engagement_limit",
        _SCALAR,
        "J",
        "work that moving the equilibrium may cost after a start or a reset, and per second of a command's travel at "
        "the governor's velocity limits",
        "20.0",
        1e-6,
        1e5,
    ),
    Field("effort_limit", _N, "N m or N", "of the torque", "{name}_effort[i]", 1e-6, 1e5),
    Field("torque_rate_limit", _N, "N m/s or N/s", "of the torque", "10.0 * {name}_effort[i]", 1e-6, 1e8),
    Field("force_limit", _SCALAR, "N", "largest given force (norm) that is believed", "500.0", 1e-3, 1e6),
    Field("moment_limit", _SCALAR, "N m", "largest given moment (norm) that is believed", "100.0", 1e-3, 1e6),
    Field(
        "missed_limit",
        _SCALAR,
        "samples",
        "missed, skipped or bad samples that are a fault; each good one takes half of one back",
        "3",
        1,
        1000,
        "int",
    ),
    Field(
        "position_quantum",
        _SCALAR,
        "rad or m",
        "resolution of the positions that velocities are differenced from; with it, the damping's velocity is the mean "
        "of as many samples (up to 8) as the torque's rate limit needs",
        "0.0",
        0.0,
        0.1,
    ),
    Field(
        "frozen_window",
        _SCALAR,
        "samples",
        "after which a value that stands still while the other signal moves is a bad sample",
        "20",
        2,
        1000000,
        "int",
    ),
    Field(
        "automatic_reset_time",
        _SCALAR,
        "s",
        "of good samples after which a fault resets itself; 0: never",
        "0.0",
        0.0,
        1e4,
    ),
    Field(
        "tank_initial",
        _SCALAR,
        "J",
        "tank energy at the start: with what is stored it covers the torques, so it bounds what the arm can hold "
        "(status RESERVE; table in docs/controller.md)",
        "10.0",
        0.0,
        1e4,
    ),
    Field(
        "tank_maximum",
        _SCALAR,
        "J",
        "tank energy above which income goes to the engagement, or is lost, unless torques on their way need it",
        "10.0",
        0.0,
        1e4,
    ),
)

INPUT: tuple[Field, ...] = (
    Field(
        "sample_valid",
        _SCALAR,
        "",
        "1: the other fields are a new sample; 0: the sample was missed, they are not read",
        type="int",
    ),
    _choice("command", "what q0 means, and whether equilibrium is read", ("position", "equilibrium"), ""),
    Field(
        "wrench_valid", _SCALAR, "", "1: wrench is measured (the paper's law needs it); 0: it is not read", type="int"
    ),
    Field("counter", _SCALAR, "", "of the samples; advances by one a sample time, missed ones too", type="uint32_t"),
    Field("q", _N, "rad or m", "measured joint positions"),
    Field("dq", _N, "rad/s or m/s", "measured, differenced or filtered joint velocities"),
    Field(
        "q0",
        _N,
        "rad or m",
        "command position: zero-force positions, the equilibrium is forward_kinematics(q0) and the posture q0; command "
        "equilibrium: the posture",
    ),
    Field("equilibrium", _POSE, "m", "command equilibrium: pose [R p; 0 1] of the tip where its spring is at rest"),
    Field("tool_pose", _POSE, "m", "pose of the tool in the tip's frame; constant while engaged", when="tool"),
    Field(
        "translation_stiffness",
        _SPRING,
        "N/m",
        "Kt of the spring kernels, in their axes (the base's by default); symmetric, positive semidefinite",
    ),
    Field(
        "rotation_stiffness",
        _SPRING,
        "N m/rad",
        "Ko of the spring kernels, in their axes (the equilibrium's by default); symmetric, positive semidefinite",
    ),
    Field(
        "wrench",
        _WRENCH,
        "N, N m",
        "(force, moment) that the ENVIRONMENT APPLIES TO THE ROBOT at the tip, hybrid axes; negate the reading of a "
        "sensor that reports what the robot applies",
    ),
    Field("task_stiffness", _TASK, "N/m, N, N m", "paper's law only: symmetric, positive semidefinite, hybrid axes"),
)

OUTPUT: tuple[Field, ...] = (
    Field("torque", _N, "N m or N", "command, without gravity: elastic + damping + limit torque, within all limits"),
    Field("status", _SCALAR, "", "NAME_STATUS_ bits", type="uint32_t"),
    Field("mode", _SCALAR, "", "NAME_MODE_ of the step", type="int"),
    Field("fault", _SCALAR, "", "NAME_FAULT_, the class of the latched fault", type="int", memory="="),
    Field("reason", _SCALAR, "", "NAME_REASON_ for it", type="int", memory="="),
    Field("missed", _SCALAR, "samples", "since the last believed one", type="int", memory="="),
    Field("unaccounted", _SCALAR, "", "times the energy account had to begin anew", type="uint32_t", memory="="),
    Field("fault_time", _SCALAR, "s", "since the fault was latched", memory="="),
    Field("position", _N, "rad or m", "last believed q", memory="q"),
    Field(
        "velocity",
        _N,
        "rad/s or m/s",
        "that the damping used: dq, its mean, or what is credible of it; 0 without a sample",
    ),
    Field("reference", _N, "rad or m", "posture that the springs pull to, the governor's r", memory="posture"),
    Field("reference_velocity", _N, "rad/s or m/s", "dr, that the damping is relative to"),
    Field("equilibrium", _POSE, "m", "pose where the spring is at rest", memory="="),
    Field("translation_stiffness", _SPRING, "N/m", "as applied, before the scale", memory="="),
    Field("rotation_stiffness", _SPRING, "N m/rad", "as applied, before the scale", memory="="),
    Field(
        "scale",
        _SCALAR,
        "1",
        "l, that multiplies the elastic energy: 1 in normal operation, 0 after a fault",
        memory="=",
    ),
    Field("elastic_torque", _N, "N m or N", "- l dU/dq; paper: l Kq (r - q)"),
    Field(
        "damping_torque",
        _N,
        "N m or N",
        "B (dr - velocity), and what brakes joints beyond 0.9 of reference_velocity_limit",
    ),
    Field("limit_torque", _N, "N m or N", "joint limit avoidance"),
    Field("spring_wrench", _WRENCH, "N, N m", "l dU: what the environment applies in equilibrium, hybrid axes"),
    Field("wrench", _WRENCH, "N, N m", "the given one; 0 without"),
    Field("joint_stiffness", _NN, "N m/rad", "tangent that designed the damping, d2U/dq2 with posture and limits"),
    Field("damping", _NN, "N m s/rad", "B, symmetric positive semidefinite"),
    Field("mass_matrix", _NN, "kg m^2", "M(q) + motor inertia"),
    Field("eigenvalues", _N, "1/s^2", "of the tangent against the mass matrix, ascending"),
    Field("elastic_energy", _SCALAR, "J", "l U", memory="="),
    Field("limit_energy", _SCALAR, "J", "of the joint limit avoidance", memory="="),
    Field("tank_energy", _SCALAR, "J", "left for sampling and stiffness", memory="tank"),
    Field(
        "tank_reserve",
        _SCALAR,
        "J",
        "what the torques on their way can put out; tank and stored energy cover it",
        memory="reserve",
    ),
    Field("engagement", _SCALAR, "J", "reference work left to this engagement", memory="="),
    Field("port_total", _SCALAR, "J", "work put out at the robot's port, the sum of torque . change of q", memory="="),
    Field(
        "sampling_total",
        _SCALAR,
        "J",
        "s: put in by holding and cutting the torque; damping counts against it",
        memory="=",
    ),
    Field("reference_total", _SCALAR, "J", "p: put in by moving the equilibrium", memory="="),
    Field("stiffness_total", _SCALAR, "J", "v: put in by changing stiffness or scale", memory="="),
    Field("start_total", _SCALAR, "J", "energy of the limit avoidance where the account began", memory="="),
)

STATUS: tuple[tuple[str, str], ...] = (
    ("fault", "a fault is latched: fault, reason and fault_time tell which"),
    ("missed", "no sample, or none that advances the counter by one"),
    ("bad_sample", "the sample was not believed: two of three are a fault"),
    ("command_refused", "wanted equilibrium or stiffness is refused: both stay where they are"),
    ("wrench_refused", "the given wrench is not finite or too large, and is left out"),
    ("moving", "the equilibrium is on its way to the wanted one"),
    ("governor", "the equilibrium is held back by the energy or the engagement limit"),
    ("stiffness_changing", "the applied stiffness is on its way to the wanted one"),
    ("tank_limited", "the stiffness or the scale is held back because the tank cannot pay"),
    ("tank_deficit", "more was put out than tank and springs held: the account does not know why"),
    ("reserve", "damping or scale is lowered: tank and stored energy do not cover more torque"),
    ("joint_limit", "a position is in the limit zone or beyond"),
    ("saturated", "the torque would pass its effort limit: the scale falls, or it was cut"),
    ("rate_limited", "a torque was cut to its rate limit"),
    ("damping_capped", "the damping is capped: M^-1 B T would be too large for the sample time"),
    ("stiffness_capped", "the scale is lowered: M^-1 L T^2 would be too large for the sample time"),
    (
        "indefinite",
        "the tangent has a negative eigenvalue: in its mode the posture is unstable, and damped as if it were not",
    ),
    ("mass_matrix", "the mass matrix is not positive definite: damping is joint_damping only"),
    (
        "limits_kept",
        "a changed limit avoidance waits: it would store more energy at the present position than the tank can pay",
    ),
    ("config", "the configuration is refused or the state is not initialised; the return value says why"),
)
"""Bits of the status in their order: NAME_STATUS_<NAME> and their meaning."""

MODES: tuple[tuple[str, str], ...] = (
    ("start", "no sample with a command seen yet"),
    ("active", "control"),
    ("release", "a fault is latched: the elastic energy is scaled to zero"),
    ("follow", "a fault is latched: damping and limit avoidance, the equilibrium follows the arm"),
)
"""Modes of a step, NAME_MODE_<NAME>, and their meaning."""

FAULTS: tuple[tuple[str, str], ...] = (
    ("none", "no fault"),
    ("sensor", "two of the last three samples were not believed"),
    ("communication", "samples or calls are missing"),
    ("limit", "the arm is beyond a limit"),
    ("energy", "tank and stored energy do not cover the torque"),
    ("configuration", "configuration, law, tool or state changed in a way that needs a reset"),
)
"""Classes of faults, NAME_FAULT_<NAME>, from 0 on."""

REASONS: tuple[tuple[str, str, str], ...] = (
    ("none", "none", "no fault"),
    ("not_finite", "sensor", "q or dq is NaN or infinite, or beyond all measure"),
    ("jump", "sensor", "q moved by more than twice the velocity limit allows"),
    ("mismatch", "sensor", "dq does not agree with the change of q"),
    ("frozen", "sensor", "q or dq stands still while the other moves"),
    ("stale", "sensor", "the sample counter does not advance"),
    ("wrench", "sensor", "paper's law: no wrench, or one that is not believed"),
    ("missed", "communication", "missed_limit samples were missed, or more than one of three for long"),
    ("skipped", "communication", "the sample counter says that calls are missing"),
    ("position", "limit", "a position is beyond its limit and tolerance"),
    ("overspeed", "limit", "a velocity is beyond its limit"),
    ("paper_bound", "limit", "paper's law: load or deflection beyond the bound where it is a spring"),
    ("reserve", "energy", "the tank is almost empty and the springs' torque is not covered"),
    ("config", "configuration", "the configuration was refused"),
    ("changed", "configuration", "law or tool pose changed while engaged"),
    ("state", "configuration", "the state's checksum does not fit: memory was overwritten"),
)
"""Reasons for faults, NAME_REASON_<NAME> from 0 on, with the fault's class."""

ERRORS: tuple[tuple[str, str], ...] = (
    ("null", "a pointer is NULL"),
    ("not_initialised", "the state is not initialised: call NAME_impedance_init first"),
    ("torque", "the initial torque is not finite or beyond the effort limit"),
    ("task_damping_sign", "task_damping: must be symmetric and positive semidefinite"),
    ("position_limits", "lower_limit, upper_limit: lower must be below upper by more than two limit zones"),
    ("tank", "tank_initial: must not be above tank_maximum"),
    ("paper_tips", "law: the paper's law is made for one tip"),
)
"""Errors beside those of single configuration fields, NAME_E_<NAME>, from -1 down."""
