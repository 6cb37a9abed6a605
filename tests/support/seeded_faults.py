# SPDX-License-Identifier: MIT
"""Faults in the iiwa 14's C that ``stiffgen prove`` must find.

tests/campaigns/seeded_faults.py shows of each that it does harm, and that it is found.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from support.generated_c import kernel_files
from support.project import ROOT

FOLDER = ROOT / "generated" / "iiwa14"
CONTROLLER = "iiwa14_impedance.c"


class Fault(NamedTuple):
    """Replace ``old`` by ``new`` at its first place behind ``after``, and prove ``only`` a kernel, or a ``part``."""

    title: str
    old: str
    new: str
    after: str = ""
    only: str = ""
    part: str = "memory"


STIFFNESS, BATCH, LANES = (
    "void iiwa14_hybrid_joint_stiffness(",
    "void iiwa14_hybrid_joint_stiffness_batch(",
    "static void hybrid_joint_stiffness_lanes(",
)
FAULTS = (
    Fault("a row too many", "i < N; ++i", "i <= N; ++i", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("rows stored too far", "(i), BLOCKS);", "(i), BLOCKS + 2);", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("a block too short", "lanes u[6][PADDED]", "lanes u[5][PADDED]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("a local array too short", "lanes row[PADDED]", "lanes row[PADDED - 2]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an argument read beyond its end", "F[5]", "F[6]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an argument read before its start", "F[5]", "F[-1]", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an uninitialised row", "u[0][j] = ", "const lanes unused = ", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("uninitialised columns", "hybrid_columns(q, J);", "", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("an uninitialised row of a batch", "u[4][j] = ", "const lanes unused = ", LANES, "hybrid_joint_stiffness"),
    Fault("a row that is not written", "i < N; ++i", "i < N - 1; ++i", STIFFNESS, "hybrid_joint_stiffness"),
    Fault("not mirrored", "mirror_upper(joint_stiffness, N);", "", STIFFNESS, "hybrid_joint_stiffness"),
    Fault(
        "symmetric but for one entry", "mirror_upper(joint_stiffness, N);",
        "mirror_upper(joint_stiffness, N);\n    joint_stiffness[45] = wrench[0];", STIFFNESS, "hybrid_joint_stiffness",
    ),
    Fault(
        "an argument is written", "hybrid_columns(q, J);", "hybrid_columns(q, J);\n    ((double *)wrench)[2] = 0.0;",
        STIFFNESS, "hybrid_joint_stiffness",
    ),
    Fault(
        "the result aliases an argument", "lanes u[6][PADDED];",
        "lanes (*const u)[PADDED] = (lanes (*)[PADDED])task_stiffness;",
        STIFFNESS, "hybrid_joint_stiffness",
    ),
    Fault("the batch reads one too many", "k < whole", "k <= whole", "void load_lanes(", "hybrid_jacobian"),
    Fault("the batch writes one too many", "c < present", "c <= present", "void store_lanes(", "hybrid_jacobian"),
    Fault("the batch never ends", "done += LANES", "done += 0", BATCH, "hybrid_joint_stiffness"),
    Fault("the batch writes beside", "+ 49 * done)", "+ 49 * done + 1)", BATCH, "hybrid_joint_stiffness"),
    Fault("a shift beyond the width", "<< 62)", "<< 64)", "void sine_cosine(", "forward_kinematics"),
    Fault("a rate too many", "i < N; ++i", "i <= N; ++i", "int initialise(", part="services"),
    Fault("an invalid number is taken", "x[i] > most", "x[i] > most + 1", "int integers_within(", part="services"),
    Fault(
        "the configuration is written", "m->config = *c;", "m->config = *c;\n    ((config_t *)c)->coriolis = 2;",
        "int initialise(", part="services",
    ),
    Fault("a delay beyond the memory of torques", "c->delay_samples * N;", "6 * N;", "account_time(", part="step"),
    Fault("a turn too many", "k < count; ++k", "k <= count; ++k", "void to_modes(", part="step"),
    Fault("a mode too many", "last < N - 1", "last < N", "void find_modes(", part="step"),
    Fault("a counter without a bound", "sum < LONGEST ? sum : LONGEST", "sum", "int count_up(", part="step"),
)  # fmt: skip


def faulty(fault: Fault, folder: Path) -> Path:
    """Copy the iiwa 14's folder with one fault in its text, and return the copy."""
    target = folder / "iiwa14"
    shutil.copytree(FOLDER, target)
    files = kernel_files(target, "iiwa14") if fault.part == "memory" else [target / CONTROLLER]
    file = next(each for each in files if fault.after in (text := each.read_text()) and fault.old in text)
    text = file.read_text()
    start = 0 if not fault.after else text.index(f"{fault.after}")
    if fault.after:  # ``old`` in a definition, not in the comment or the call before it
        assert "{" in text[start : start + 400], fault.title
    place = text.index(fault.old, start)
    file.write_text(text[:place] + fault.new + text[place + len(fault.old) :])
    return target
