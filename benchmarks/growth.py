# SPDX-License-Identifier: MIT
"""Time and size of code over the number of joints, on synthetic chains."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import stiffgen
from benchmarks.tools import NATIVE, pinned, run
from stiffgen.core.symbolic.kernels import MAX_BATCH_JOINTS

JOINTS = (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30)
SAME_FUNCTIONS = f"10 to {MAX_BATCH_JOINTS} joints (longer chains have fewer functions)"


def synthetic(n: int) -> str:
    text = '<robot name="chain"><link name="l0"/>'
    for k in range(n):
        text += (
            f'<link name="l{k + 1}"/><joint name="j{k}" type="continuous"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0 0.05 0.3" rpy="{(-1) ** k * math.pi / 2:.15f} 0 0"/><axis xyz="0 0 1"/></joint>'
        )
    return text + "</robot>"


GROWTH = """
#include "chain.c"
#include <stdio.h>
#include <time.h>
static double q[256][N], F[6] = {1, 2, 3, 4, 5, 6}, K[36], out[N * N];
int main(void)
{
    struct timespec a, b;
    double best = 1e30;
    for (int k = 0; k < 256 * N; ++k) { q[0][k] = 0.001 * (k % 3001); }
    for (int k = 0; k < 36; ++k) { K[k] = k % 7 ? 1.0 : 300.0; }
    for (int round = 0; round < 60; ++round) {
        clock_gettime(CLOCK_MONOTONIC, &a);
        for (int k = 0; k < 1024; ++k) { chain_hybrid_joint_stiffness(q[k % 256], F, K, out); }
        clock_gettime(CLOCK_MONOTONIC, &b);
        const double t = (1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec)) / 1024;
        best = t < best ? t : best;
    }
    printf("%.1f", best);
    return 0;
}
"""


def growth(folder: Path) -> list[tuple[int, float, int, int]]:
    """Return (joints, ns per call, bytes of machine code of the whole library, lines of C)."""
    rows = []
    for n in JOINTS:
        urdf = folder / "chain.urdf"
        urdf.write_text(synthetic(n))
        made = stiffgen.generate(urdf, output=folder, name="chain", build=False, force=True)
        main, program, library = folder / "main.c", folder / "program", folder / "chain.o"
        main.write_text(GROWTH)
        run(["gcc", *NATIVE.split(), f"-I{made}", str(main), "-o", str(program), "-lm"])
        run(["gcc", *NATIVE.split(), "-c", str(made / "chain.c"), "-o", str(library)])
        text = int(run(["size", str(library)]).splitlines()[1].split()[0])
        nanoseconds = min(float(run(pinned([str(program)]))) for _ in range(3))
        rows.append((n, nanoseconds, text, len((made / "chain.c").read_text().splitlines())))
    return rows


def exponent(rows: list[tuple[int, float, int, int]], column: int, last: int) -> float:
    """Fit the exponent of a power of the number of joints, from 10 joints to the last."""
    chosen = [(row[0], row[column]) for row in rows if 10 <= row[0] <= last]
    x, y = np.log([c[0] for c in chosen]), np.log([c[1] for c in chosen])
    return float(np.polyfit(x, y, 1)[0])


def growth_section(grown: list[tuple[int, float, int, int]]) -> list[str]:
    return [
        "## Number of joints",
        "",
        f"Synthetic chains, gcc {NATIVE}, hybrid joint stiffness; best of three runs. Machine code of all functions;",
        f"chains of more than {MAX_BATCH_JOINTS} joints have no batch functions.",
        "",
        "| joints | ns | bytes of code | lines of C |",
        "|---|---|---|---|",
        *(f"| {n} | {t:.0f} | {text} | {count} |" for n, t, text, count in grown),
        "",
        f"Fitted exponents: time {exponent(grown, 1, JOINTS[-1]):.2f} from 10 to 30 joints; machine code "
        f"{exponent(grown, 2, MAX_BATCH_JOINTS):.2f} and lines of C {exponent(grown, 3, MAX_BATCH_JOINTS):.2f}, "
        f"{SAME_FUNCTIONS}.",
        "",
    ]
