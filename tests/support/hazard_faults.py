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


HAZARD_FAULTS = (
    HazardFault(
        "a load carries the arm away",
        "test_the_torque_is_that_of_springs_and_damping",
        "w->pull[i] += k * away;",
        "w->pull[i] -= k * away;",
        "static void pull(",
    ),
    HazardFault(
        "moment grows at a clamped tip",
        "test_the_tip_is_clamped",
        "m->reference.scale * w->pull[i]",
        "1.9 * m->reference.scale * w->pull[i]",
        "static void guard(",
    ),
    HazardFault(
        "arm too fast at a start, a jump of q0, a planner's gap",
        "test_far_from_the_wanted_posture",
        "speed <= 1.0 && may_rise(m, g)",
        "may_rise(m, g)",
        "static void govern(",
    ),
    HazardFault(
        "a wrong first position drives the arm",
        "test_an_absurd_first_position_is_not_believed",
        "note(m, &s->limit);",
        "(void)note;",
        "static int may_use(",
    ),
    HazardFault(
        "arm pushed beyond its speed",
        "test_a_fast_arm_is_braked",
        "brake * excess[i] / fast",
        "0.0 * brake",
        "static void add_joint_damping(",
    ),
    HazardFault(
        "pull by a wrong encoder",
        "test_encoder_jump",
        "moved = s->q[i] - m->watch.q[i];",
        "moved = dq * elapsed;",
        "static finding_t check_joint(",
    ),
    HazardFault(
        "torque from stale data",
        "test_calls_left_out",
        "s->periods > calls",
        "s->periods > LONGEST",
        "static finding_t judge_losses(",
    ),
    HazardFault(
        "motion after a fault",
        "test_fault_cycle",
        "(m->fault.reset || resumes)",
        "(m->watch.known || resumes)",
        "static void end_fault(",
    ),
    HazardFault(
        "energy out of nowhere",
        "test_energy_of_schedules",
        "a->tank += lack;",
        "a->tank += lack + 50.0;",
        "static void account_engage(",
    ),
    HazardFault(
        "tip runs away",
        "test_a_wrench_is_exerted_and_paid_from_the_tank",
        "account_pay(a, m, -work - rise);",
        "account_pay(a, m, -0.0 * work - rise);",
        "static void account_interval(",
    ),
    HazardFault(
        "motion of a planner that died",
        "test_an_acceleration_carries_a_shaped_plan",
        "k->planned && k->accepted && k->shaped;",
        "k->planned && k->accepted;",
        "static void accept_command(",
    ),
    HazardFault(
        "oscillation",
        "test_designed_damping_ratio",
        "y[k] *= b;",
        "y[k] *= 0.5 * b;",
        "static void damp_modes(",
    ),
    HazardFault(
        "joint runs into its stop",
        "test_beyond_a_joint_limit",
        "+ w->zone[i] +",
        "+",
        "static void guard(",
    ),
    HazardFault(
        "torque beyond limits, NaN",
        "test_absurd_commands_leave_torque_and_reference_within_their_limits",
        "clamp(aim[i] + wanted, last[i] - rate, last[i] + rate)",
        "aim[i] + wanted",
        "static uint32_t add_offset(",
    ),
    HazardFault(
        "memory overwritten",
        "test_every_torque_is_within_its_limits_whatever_the_memory_holds",
        " && fits_memory(m) && state->checksum == compute_checksum(state)",
        "",
        "static int is_believable(",
    ),
    HazardFault(
        "limp arm under a load",
        "test_an_arm_under_a_load_sinks_slowly_in_a_fault",
        "fault_of_reason(reason) >= IIWA14_FAULT_DISSIPATION",
        "reason != IIWA14_REASON_NONE",
        "static int has_no_torque(",
    ),
    HazardFault(
        "wrong robot, frame, unit",
        "test_what_has_no_default_is_named",
        "if (!doubles_within(c->heaviest_wrench,",
        "if (0 && !doubles_within(c->heaviest_wrench,",
        "static int check_fields(",
    ),
    HazardFault(
        "damping that drives the arm",
        "test_an_arm_that_damping_drives_gets_no_torque",
        "w->rises >= RISES &&",
        "w->rises > LONGEST &&",
        "static void watch_limits(",
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
