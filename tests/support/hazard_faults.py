# SPDX-License-Identifier: MIT
"""One fault per row of docs/hazards.csv: the row's sentence becomes false, and its named test must fail.

tests/campaigns/hazards.py runs each test on the iiwa 14's controller with the fault.
"""

from __future__ import annotations

import csv
from typing import NamedTuple

from support.project import ROOT

TABLE = ROOT / "docs" / "hazards.csv"


class HazardFault(NamedTuple):
    """Replace ``old`` by ``new`` in NAME_impedance.c, once, behind ``after``; ``test`` of the row ``hazard`` fails."""

    hazard: str
    test: str
    old: str
    new: str
    after: str


FEED_BACK = """
    for (int k = 0; k < 6 * TIPS; ++k) {
        add_scaled(N, -0.9 * out->wrench[k], find_jacobians(s) + k * N, out->elastic_torque);
    }
    brake_fast_joints(s);
"""
LIMP = """
    brake_fast_joints(s);
    if (m->fault != IIWA14_FAULT_NONE) {
        memset(out->damping_torque, 0, sizeof out->damping_torque);
    }
"""

HAZARD_FAULTS = (
    HazardFault(
        "a load carries the arm away",
        "test_torque_is_the_gradient_of_the_springs_energy",
        "+= m->posture_stiffness[i] * (m->posture[i] - m->q[i]);",
        "-= m->posture_stiffness[i] * (m->posture[i] - m->q[i]);",
        "static double pull_springs(",
    ),
    HazardFault(
        "moment grows at a clamped tip",
        "test_the_tip_is_clamped",
        "\n    brake_fast_joints(s);\n",
        FEED_BACK,
        "static void compute_torque(",
    ),
    HazardFault(
        "arm too fast at a start, a jump of q0, a planner's gap",
        "test_far_from_the_wanted_posture",
        "return ",
        "return 0.2 * ",
        "static double relative_size(",
    ),
    HazardFault(
        "a wrong first position drives the arm",
        "test_an_absurd_first_position_is_not_believed",
        "s->condemned[i] = !m->known &&",
        "s->condemned[i] = 0 &&",
        "static int check_joint(",
    ),
    HazardFault(
        "arm pushed beyond its speed",
        "test_fast_joints_are_braked",
        "s->brake[i] * excess[i] / fast",
        "0.0",
        "static void brake_fast_joints(",
    ),
    HazardFault(
        "pull by a wrong encoder",
        "test_encoder_jump",
        "motion = m->known ? q - m->q[i] : dq * elapsed;",
        "motion = dq * elapsed;",
        "static int check_joint(",
    ),
    HazardFault(
        "torque from stale data",
        "test_calls_left_out",
        "if (ahead > 0) {",
        "if (ahead > 1000000) {",
        "static int check_counter(",
    ),
    HazardFault(
        "motion after a fault",
        "test_a_fault_lasts_until_its_reset",
        "(m->reset || resumes)",
        "(m->known || resumes)",
        "static void end_fault(",
    ),
    HazardFault(
        "energy out of nowhere",
        "test_energy_of_schedules",
        "m->tank += s->lack;",
        "m->tank += s->lack + 50.0;",
        "static void pay_engagement(",
    ),
    HazardFault(
        "tip runs away",
        "test_a_wrench_without_contact_does_not_run_away",
        "smaller(fade_with_tank(s), fade_with_speed(s, J))",
        "1.0",
        "static void press_tips(",
    ),
    HazardFault(
        "motion of a planner that died",
        "test_a_plan_that_is_repeated_ends",
        "(s->status & (uint32_t)IIWA14_STATUS_MOVING) != 0u",
        "1",
        "void follow_plan(",
    ),
    HazardFault(
        "oscillation",
        "test_caps_for_the_sample_time",
        "LARGEST_DAMPING = 0.25",
        "LARGEST_DAMPING = 1.5",
        "",
    ),
    HazardFault(
        "joint runs into its stop",
        "test_beyond_a_joint_limit",
        "out->elastic_torque[i] + out->limit_torque[i] +",
        "out->elastic_torque[i] +",
        "static int try_torque(",
    ),
    HazardFault(
        "torque beyond limits, NaN",
        "test_hostile_input",
        "s->c->torque_rate_limit[i] * s->c->sample_time",
        "2.0 * s->c->torque_rate_limit[i] * s->c->sample_time",
        "static void start_step(",
    ),
    HazardFault(
        "memory overwritten",
        "test_flipped_bits_of_the_state",
        " && fits_memory(m) && state->checksum == compute_checksum(state)",
        "",
        "",
    ),
    HazardFault(
        "limp arm under a load",
        "test_a_joint_beyond_its_velocity_limit_is_believed_and_braked",
        "\n    brake_fast_joints(s);\n",
        LIMP,
        "static void compute_torque(",
    ),
    HazardFault(
        "wrong robot, frame, unit",
        "test_names_and_libraries",
        "static void compute_adjugate(",
        "void compute_adjugate(",
        "",
    ),
)  # fmt: skip


def hazards() -> dict[str, list[str]]:
    """Return the rows of docs/hazards.csv: hazard -> names of its tests."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        return {row["hazard"]: row["tests"].split() for row in csv.DictReader(file)}


def spoilt(text: str, fault: HazardFault) -> str:
    """Return the controller's C with the fault; ValueError if the fault does not apply."""
    start = -1
    while (start := text.find(fault.after, start + 1)) >= 0:
        before_body = text[start:].partition("{")[0]
        if ";" not in before_body or not fault.after.startswith("static"):  # a definition, no declaration
            place = text.find(fault.old, start)
            if place >= 0:
                return text[:place] + fault.new + text[place + len(fault.old) :]
    raise ValueError(f"{fault.hazard}: {fault.old!r} is not behind {fault.after!r}")
