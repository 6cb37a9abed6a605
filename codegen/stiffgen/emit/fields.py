"""The fields of a robot's impedance controller: the only list of them.

The C structs, their documentation, the layout that Python reads, the stubs and the tables of the docs are made from
it. What the controller does with the fields is C: ``runtime/stiffgen_impedance_step.h``.
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_DOF = 32
"""STIFFGEN_MAX_DOF: robots with more coordinates get kernels and no controller."""

Extent = int | str
"""A fixed extent, "n", the number of coordinates, or a macro of the runtime."""


@dataclass(frozen=True)
class Field:
    """A member of a controller's struct.

    ``shape`` is row-major; () is a scalar. ``choices`` are the words that Python takes for an int, each a C constant
    STIFFGEN_<FIELD>_<CHOICE>. ``default`` (configuration only) is a C expression; "{name}" is the robot's prefix and
    i the index.
    """

    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    default: str = ""
    type: str = "double"
    choices: tuple[str, ...] = ()

    def constant(self, choice: str) -> str:
        """The C name of a choice."""
        return f"STIFFGEN_{self.name.upper()}_{choice.upper()}"


_N, _NN = ("n",), ("n", "n")
_SCALAR: tuple[Extent, ...] = ()
_TASK = (6, 6)


def _choice(name: str, meaning: str, choices: tuple[str, ...], default: str) -> Field:
    return Field(name, _SCALAR, "", meaning, f"STIFFGEN_{name.upper()}_{default.upper()}", "int", choices)


CONFIG: tuple[Field, ...] = (
    Field("sample_time", _SCALAR, "s", "time between two calls of the step", "0.001"),
    _choice(
        "representation",
        "in which the wrench and the task stiffness are given: body (tip axes, tip's origin), spatial (base axes, "
        "base's origin; another connection, hence another stiffness) or hybrid (base axes, tip's origin)",
        ("body", "spatial", "hybrid"),
        "hybrid",
    ),
    _choice(
        "stiffness_formula",
        "corrected (symmetric) or, for comparison only, conventional (without the connection's correction)",
        ("corrected", "conventional"),
        "corrected",
    ),
    _choice(
        "stiffness_sign",
        "as_is, or positive_part: negative eigenvalues against the mass matrix become 0, so that the elastic energy "
        "is bounded below",
        ("as_is", "positive_part"),
        "as_is",
    ),
    Field(
        "stiffness_rate_limit",
        _SCALAR,
        "N m/rad/s",
        "largest Frobenius norm of the applied joint stiffness' rate of change",
        "1e4",
    ),
    _choice(
        "nullspace",
        "off; isotropic, + k I as in the paper; or projected, + N (k I) N^T with the inertia-weighted projector",
        ("off", "isotropic", "projected"),
        "isotropic",
    ),
    Field("nullspace_stiffness", _SCALAR, "N m/rad", "k; 0 exactly if nullspace is off", "1.0"),
    Field(
        "singularity_threshold",
        _SCALAR,
        "1",
        "projected: the inverse is damped where J M^-1 J^T, scaled to a unit diagonal, has smaller eigenvalues",
        "1e-3",
    ),
    _choice(
        "damping_design",
        "modal (double diagonalisation), factorised (its positive part), or task, J^T task_damping J; to each "
        "joint_damping I is added",
        ("modal", "factorised", "task"),
        "modal",
    ),
    Field(
        "damping_ratio",
        _N,
        "1",
        "modal: of the modes, softest first; factorised: of the joints; task: not used",
        "0.7",
    ),
    Field(
        "task_damping",
        _TASK,
        "N s/m, N s, N m s",
        "on twists, in the representation's frame; symmetric, positive semidefinite; 0 unless the design is task",
        "0.0",
    ),
    Field("joint_damping", _SCALAR, "N m s/rad", "d, added as d I", "0.1"),
    _choice(
        "wrench_filter",
        "off, first_order (exact for a held input) or moving_average (over wrench_window raw samples)",
        ("off", "first_order", "moving_average"),
        "first_order",
    ),
    Field("wrench_time_constant", _SCALAR, "s", "of the first-order filter", "0.01"),
    Field("wrench_window", _SCALAR, "samples", "of the moving average, 1 to STIFFGEN_MAX_WINDOW", "3", "int"),
    Field("lower_limit", _N, "rad or m", "of the position; may be -infinity", "{name}_lower[i]"),
    Field("upper_limit", _N, "rad or m", "of the position; may be infinity", "{name}_upper[i]"),
    Field(
        "position_tolerance",
        _SCALAR,
        "rad or m",
        "how far beyond its limit a position q or q0 is still believed",
        "0.1",
    ),
    Field("limit_zone", _SCALAR, "rad or m", "width of the zone inside each limit where the torque grows", "0.1"),
    Field(
        "limit_stiffness",
        _N,
        "N m/rad",
        "slope of the limit avoidance torque over the depth in the zone; 0 turns it off",
        "{name}_effort[i]",
    ),
    Field(
        "velocity_limit",
        _N,
        "rad/s or m/s",
        "largest velocity dq or dq0 that is accepted; in the fallback up to ten times it still brakes",
        "2.0 * {name}_velocity[i]",
    ),
    Field("force_limit", _SCALAR, "N", "largest force (norm) that is believed", "500.0"),
    Field("moment_limit", _SCALAR, "N m", "largest moment (norm) that is believed", "100.0"),
    Field(
        "task_stiffness_limit",
        _SCALAR,
        "N/m, N, N m",
        "largest absolute entry of a task stiffness that is accepted",
        "1e4",
    ),
    Field("effort_limit", _N, "N m or N", "of the torque", "{name}_effort[i]"),
    Field("torque_rate_limit", _N, "N m/s or N/s", "of the torque", "10.0 * {name}_effort[i]"),
    Field(
        "missed_limit",
        _SCALAR,
        "samples",
        "consecutive missed samples from which on the watchdog falls back; before that the torque is held",
        "3",
        "int",
    ),
    Field(
        "velocity_decay_time",
        _SCALAR,
        "s",
        "time constant with which the last believed velocity fades while there is no new one",
        "0.02",
    ),
    Field("return_time", _SCALAR, "s", "of the smooth return from the fallback, and of the start", "0.5"),
    _choice("tank", "off, or on: energy for stiffness variation comes from the tank", ("off", "on"), "on"),
    Field("tank_initial", _SCALAR, "J", "tank energy at the start", "1.0"),
    Field("tank_minimum", _SCALAR, "J", "tank energy that is never drawn", "0.1"),
    Field("tank_maximum", _SCALAR, "J", "tank energy above which income is lost", "5.0"),
    Field("tank_refill", _SCALAR, "1", "share of the dissipated energy that refills the tank", "0.9"),
)

INPUT: tuple[Field, ...] = (
    Field(
        "sample_valid",
        _SCALAR,
        "",
        "1: the other fields are a new sample; 0: the sample was missed, they are not read",
        type="int",
    ),
    Field("q", _N, "rad or m", "measured joint positions"),
    Field("dq", _N, "rad/s or m/s", "measured or filtered joint velocities"),
    Field("q0", _N, "rad or m", "zero-force joint positions"),
    Field("dq0", _N, "rad/s or m/s", "their velocities"),
    Field(
        "wrench",
        (6,),
        "N, N m",
        "(force, moment) that the ENVIRONMENT APPLIES TO THE ROBOT at the tip, in the representation's frame; negate "
        "the reading of a sensor that reports what the robot applies",
    ),
    Field(
        "task_stiffness",
        _TASK,
        "N/m, N, N m",
        "on twists (linear, angular), in the representation's frame; symmetric and positive semidefinite, or refused",
    ),
)

OUTPUT: tuple[Field, ...] = (
    Field(
        "torque",
        _N,
        "N m or N",
        "command, without gravity: elastic + damping + limit torque, saturated, then rate limited",
    ),
    Field("status", _SCALAR, "", "STIFFGEN_STATUS_ bits", type="uint32_t"),
    Field("mode", _SCALAR, "", "STIFFGEN_MODE_ of the step", type="int"),
    Field("missed", _SCALAR, "samples", "consecutive missed samples", type="int"),
    Field(
        "unaccounted",
        _SCALAR,
        "steps",
        "steps across which no position was known: the energy account leaves them out",
        type="uint32_t",
    ),
    Field("position", _N, "rad or m", "last believed q"),
    Field(
        "velocity",
        _N,
        "rad/s or m/s",
        "velocity that the damping used: dq; in the fallback cut to its limit, or the faded last one",
    ),
    Field("reference", _N, "rad or m", "position that the spring pulls to: q0, or on its way there"),
    Field("reference_velocity", _N, "rad/s or m/s", "its velocity"),
    Field("error", _N, "rad or m", "e = reference - position; 0 in the fallback"),
    Field("elastic_torque", _N, "N m or N", "Kq e"),
    Field("damping_torque", _N, "N m or N", "Bq (reference velocity - velocity)"),
    Field("limit_torque", _N, "N m or N", "joint limit avoidance"),
    Field("wrench", (6,), "N, N m", "after the filter"),
    Field("stiffness_target", _NN, "N m/rad", "joint stiffness of this sample, with the nullspace stiffness"),
    Field("stiffness", _NN, "N m/rad", "Kq as applied, after rate limit and tank"),
    Field("damping", _NN, "N m s/rad", "Bq, symmetric positive semidefinite"),
    Field("mass_matrix", _NN, "kg m^2", "M(q)"),
    Field("eigenvalues", _N, "1/s^2", "of the applied stiffness' symmetric part against M, ascending"),
    Field("antisymmetric_norm", _SCALAR, "N m/rad", "Frobenius norm of (Kq - Kq^T)/2 as applied"),
    Field("singularity", _SCALAR, "1", "nullspace projected: smallest scaled eigenvalue of J M^-1 J^T; else 0"),
    Field("stiffness_step", _SCALAR, "1", "share of the way from the last applied to the target stiffness"),
    Field("blend", _SCALAR, "1", "0 in the fallback to 1 in full control"),
    Field("elastic_energy", _SCALAR, "J", "V = 1/2 e^T sym(Kq) e"),
    Field("limit_energy", _SCALAR, "J", "elastic energy of the joint limit avoidance"),
    Field("dissipated_power", _SCALAR, "W", "mean since the last sample"),
    Field("variation_power", _SCALAR, "W", "1/2 e^T dKq/dt e, mean since the last sample"),
    Field("antisymmetric_power", _SCALAR, "W", "put out by the antisymmetric part, mean since the last sample"),
    Field("tank_energy", _SCALAR, "J", "T, never below tank_minimum"),
    Field("tank_deficit", _SCALAR, "J", "energy that went out while the tank could not pay; paid back first"),
    Field("port_total", _SCALAR, "J", "net energy that went out to robot and reference since the start"),
    Field("variation_total", _SCALAR, "J", "put in by stiffness variation"),
    Field("sampling_total", _SCALAR, "J", "put in by holding the torque between samples, 1/2 De^T Kq De each"),
    Field("antisymmetric_total", _SCALAR, "J", "put in by the antisymmetric part"),
    Field("limiting_total", _SCALAR, "J", "put in by saturation and rate limit"),
    Field("dissipated_total", _SCALAR, "J", "taken out by the damping torque"),
    Field("released_total", _SCALAR, "J", "elastic energy dropped on falling back or losing the position"),
    Field(
        "engaged_total",
        _SCALAR,
        "J",
        "elastic energy set up on return (of the spring: 0 with a return time) or start in a limit zone",
    ),
)

STATUS: tuple[tuple[str, str], ...] = (
    ("non_finite", "an input is NaN or infinite"),
    ("out_of_range", "an input lies beyond what is believed: position, velocity, force, moment or task stiffness"),
    ("task_stiffness", "the task stiffness is not symmetric or not positive semidefinite"),
    ("missed", "the sample was missed"),
    ("watchdog", "missed_limit or more consecutive samples were missed"),
    ("fallback", "pure damping: no elastic torque"),
    ("returning", "the reference is on its way back to q0"),
    ("joint_limit", "a position is in the limit zone or beyond"),
    ("saturated", "a torque was cut to its effort limit"),
    ("rate_limited", "a torque was cut to its rate limit"),
    ("stiffness_rate", "the stiffness was held back by its rate limit"),
    ("tank_limited", "the stiffness was held back because the tank could not pay"),
    ("tank_deficit", "more energy went out than the tank could pay"),
    ("indefinite", "the applied stiffness has a negative eigenvalue; its modes are not damped by the modal design"),
    ("mass_matrix", "the mass matrix is not positive definite: last damping (and nullspace stiffness) kept"),
    ("singular", "nullspace projected: the inverse is damped near a singularity"),
    ("config", "the configuration is refused or the state not initialised; the return value says why"),
)
"""Bits of the status in their order: STIFFGEN_STATUS_<NAME> and their meaning."""

MODES: tuple[tuple[str, str], ...] = (
    ("start", "initialised, no sample seen yet"),
    ("return", "control, with the reference on its way to q0"),
    ("active", "control"),
    ("fallback", "pure damping, no elastic torque"),
)
"""Modes of a step, STIFFGEN_MODE_<NAME>, and their meaning."""
