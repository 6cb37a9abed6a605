# SPDX-License-Identifier: MIT
"""Times of springs beside the hybrid joint stiffness, in one process."""

from __future__ import annotations

import shutil
import statistics
from pathlib import Path

import stiffgen
from benchmarks.tools import COUNT, HERE, NATIVE, Row, pinned, run
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples
from stiffgen.families.springs.springs import TRACE

SPRING_ROUNDS = 1001


def of_springs(chain: stiffgen.Chain, folder: Path, robot: Path) -> dict[str, list[Row]]:
    """Return per compiler the rows (name, fastest, median, ninth decile) [ns] of springs and of the joint stiffness."""
    samples = Samples(chain, COUNT, seed=1)
    shared = (TASK_STIFFNESS, *TRACE.parameters)
    inputs = folder / "spring_inputs"
    inputs.write_bytes(
        samples[Q].tobytes() + samples[WRENCH].tobytes() + b"".join(samples[each][0].tobytes() for each in shared)
    )
    tables = {}
    for compiler in ("gcc", "clang"):
        if not shutil.which(compiler):
            continue
        program = folder / f"springs_{compiler}"
        macros = [f'-DROBOT_C="{robot / robot.name}.c"', f'-DBATCH_C="{robot / robot.name}_batch.c"']
        source = [*macros, f"-I{robot}", str(HERE / "contenders" / "springs.c")]
        run([compiler, *NATIVE.split(), *source, "-o", str(program), "-lm"])
        rows = []
        for line in run(pinned([str(program), str(inputs), str(COUNT), str(SPRING_ROUNDS)])).splitlines():
            name, values = line.split(";")
            times = [float(each) for each in values.split()]
            rows.append((name, min(times), statistics.median(times), statistics.quantiles(times, n=10)[-1]))
        tables[f"{compiler} {NATIVE}"] = rows
    return tables


def springs_section(tables: dict[str, list[Row]]) -> list[str]:
    """Return lines with the ratios to the hybrid joint stiffness of the same run, single calls and batches."""
    lines = [
        "## Springs, ns a configuration",
        "",
        "The trace spring: torque alone, and energy, torque and joint stiffness in one call (linearization), held to",
        f"the plain hybrid joint stiffness in the same process, in turn, {SPRING_ROUNDS} rounds of {COUNT}. The",
        "fastest rounds are compared: others on a shared machine can only add. Bars: 0.9 and 1.6.",
        "",
    ]
    for title, rows in tables.items():
        plain = {name.split()[0]: fastest for name, fastest, *_ in rows if name.endswith("hybrid.joint_stiffness")}
        lines += [
            f"| {title} | fastest, ns | median | ninth decile | to hybrid.joint_stiffness |",
            "|---|---|---|---|---|",
        ]
        for name, fastest, median, late in rows:
            ratio = fastest / plain[name.split()[0]]
            lines.append(f"| {name} | {fastest:.1f} | {median:.1f} | {late:.1f} | {ratio:.2f} |")
        lines.append("")
    return lines
