# SPDX-License-Identifier: MIT
"""Tables of the paper's law: structs of NAME_paper.h, in C and in Python, with the bounds that its validate checks."""

from __future__ import annotations

from stiffgen.control.core.field import NN, SCALAR, Field, N

_MOTORS = "as the controller's"
_MOST, _LARGEST = 1e6, 1e9
"""Largest setting, and largest torque [N m] or rate [N m/s]."""
PAPER_STATE: tuple[Field, ...] = (
    Field(
        "torque", N, "N m", "torque of the last call; before the first call the torque in force, within effort_limit"
    ),
    Field("opposite", N, "N m", "the same with the other sign: memory that was overwritten does not agree with it"),
    Field("change", N, "N m", "largest change of the torque per call, of the last valid configuration"),
)
PAPER_CONFIG: tuple[Field, ...] = (
    Field(
        "conventional",
        SCALAR,
        "",
        "0: corrected, symmetric Kq; 1: conventional, without the connection's correction",
        "0",
        0,
        1,
        "int",
    ),
    Field("sample_time", SCALAR, "s", "time from one call to the next", "0.001", 1e-6, _MOST),
    Field("damping_ratio", SCALAR, "", "damping ratio of every mode", "0.7", 0.0, _MOST),
    Field("joint_damping", SCALAR, "N m s/rad", "added to B as a multiple of the unit matrix", "0.1", 0.0, _MOST),
    Field(
        "posture_stiffness",
        SCALAR,
        "N m/rad",
        "added to the diagonal of Kq: it holds the self-motion",
        "1",
        0.0,
        _MOST,
    ),
    Field("motor_inertia", N, "kg m^2", "inertia of the rotors at the joints, added to M", _MOTORS, 0.0, _MOST),
    Field("effort_limit", N, "N m", "largest torque", "NAME_effort", 0.0, _LARGEST),
    Field("torque_rate_limit", N, "N m/s", "largest rate of the torque", _MOTORS, 0.0, _LARGEST),
)
PAPER_INPUT: tuple[Field, ...] = (
    Field("q", N, "rad", "measured joint positions"),
    Field("dq", N, "rad/s", "joint velocities"),
    Field("q0", N, "rad", "zero-force joint positions"),
    Field("tool_pose", (4, 4), "m", "pose of the tool in the tip's frame", when="tool"),
    Field("wrench", (6,), "N, N m", "wrench of the ENVIRONMENT ON THE ROBOT at the tip, hybrid axes"),
    Field("task_stiffness", (6, 6), "N/m, N, N m", "hybrid axes; symmetric, positive semidefinite"),
)
PAPER_OUTPUT: tuple[Field, ...] = (
    Field("torque", N, "N m", "command: elastic and damping torque, within the limits"),
    Field("elastic_torque", N, "N m", "Kq (q0 - q)"),
    Field("damping_torque", N, "N m", "-B dq"),
    Field("joint_stiffness", NN, "N m/rad", "Kq, with posture_stiffness"),
    Field("damping", NN, "N m s/rad", "B"),
    Field("saturated", SCALAR, "", "1: the torque is cut to effort_limit", type="int"),
    Field("rate_limited", SCALAR, "", "1: the torque is cut to torque_rate_limit", type="int"),
)
PAPER_STRUCTS = (
    ("paper_state", "Memory between calls. Start with zeros, or with zeros and the torque in force.", PAPER_STATE),
    ("paper_config", "Configuration of the paper's law; start from the defaults.", PAPER_CONFIG),
    ("paper_input", "One sample.", PAPER_INPUT),
    ("paper_output", "Result of a step.", PAPER_OUTPUT),
)
