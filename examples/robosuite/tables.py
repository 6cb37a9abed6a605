# SPDX-License-Identifier: MIT
"""Tables of docs/robosuite.md, made of docs/robosuite.csv: a record per robot, task and controller."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

NAMES = ("stiffgen", "OSC_POSE", "JOINT_POSITION")
COLUMNS = ("robot", "task", "controller", "success", "force_N", "error_mm", "torque_change_Nm", "orbit_work_mJ")
ORBIT = "closed orbit"
Record = dict[str, str]


def episode_table(records: Sequence[Record]) -> list[str]:
    """Return the table of tasks and controllers: means over the robots, of the force the largest."""
    lines = [
        "| task | controller | success | largest force [N] | error of the tip [mm] | torque change [N m] |",
        "|---|---|---|---|---|---|",
    ]
    for task in dict.fromkeys(each["task"] for each in records if each["task"] != ORBIT):
        for k, name in enumerate(NAMES):
            rows = [each for each in records if (each["task"], each["controller"]) == (task, name)]
            success, force, error, change = ([float(row[column]) for row in rows] for column in COLUMNS[3:7])
            cells = f"{np.mean(success):.2f} | {max(force):.0f} | {np.mean(error):.1f} | {np.mean(change):.2f}"
            lines.append(f"| {'' if k else task} | {name} | {cells} |")
    return lines


def orbit_table(records: Sequence[Record]) -> list[str]:
    """Return the table of closed orbits."""
    lines = ["| robot | " + " | ".join(NAMES) + " |", "|---" * (1 + len(NAMES)) + "|"]
    for robot in dict.fromkeys(each["robot"] for each in records):
        work = [each["orbit_work_mJ"] for each in records if each["robot"] == robot and each["task"] == ORBIT]
        lines.append(f"| {robot} | " + " | ".join(work) + " |")
    return lines


def tables(records: Sequence[Record]) -> str:
    """Return the page's tables, made of the records."""
    lines = [*episode_table(records), "", "Work that the springs put out on a closed orbit [mJ]:", ""]
    return "\n".join([*lines, *orbit_table(records)]) + "\n"


def csv_text(records: Sequence[Record]) -> str:
    """Return the records as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()
