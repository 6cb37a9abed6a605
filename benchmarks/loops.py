# SPDX-License-Identifier: MIT
"""Functions in motor coordinates of an ankle with two loops, beside the functions of its open tree.

Each ratio is of one run: instructions of a call (callgrind, AVX2 with FMA) and its time (best of many, -march=native).
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path

import stiffgen
from benchmarks.tools import HERE, NATIVE, pinned, run

sys.path.insert(0, str(HERE.parent))

from examples.closed_loops import ANKLE, ANKLE_LOOPS

ENDS = [("left_end", "left_rod", "0 0 -0.3", ""), ("left_heel", "roll", "-0.05 0.05 0", "")]
ENDS += [("right_end", "right_rod", "0 0 -0.23", ""), ("right_heel", "roll", "-0.05 -0.05 0", "")]
# valgrind 3.19 lacks an instruction that gcc 12 uses
COUNTED = ("clang", "-O2", "-mavx2", "-mfma", "-fno-optimize-sibling-calls")
TIPS = ["sole", *(end[0] for end in ENDS)]
INERTIAL = (
    '<inertial><origin xyz="0.01 0.02 -0.05" rpy="0.1 0.2 0.3"/><mass value="0.4"/>'
    '<inertia ixx="1e-3" ixy="0" ixz="0" iyy="2e-3" iyz="0" izz="1.5e-3"/></inertial>'
)
CALLS = {
    "one": "tree_sole_hybrid_joint_stiffness(q, F, K, out)",
    "sum": "; ".join(
        f"tree_{tip}_hybrid_joint_stiffness(q, F + {6 * k}, K + {36 * k}, out)" for k, tip in enumerate(TIPS)
    ),
    "total": "tree_hybrid_joint_stiffness_total(q, F, K, out)",
    "motors": "ankle_motors_joint_stiffness(q, F, K, out)",
    "spring": "tree_sole_spring_joint_stiffness(q, H, Kt, Kt, out)",
    "motors_spring": "ankle_motors_spring_joint_stiffness(q, H, Kt, Kt, out)",
    "bias": "tree_bias_forces(q, dq, g, out)",
    "motors_bias": "ankle_motors_bias_forces(q, da, g, out)",
    "mass": "tree_mass_matrix(q, out)",
    "motors_mass": "ankle_motors_mass_matrix(q, out)",
}
ROWS = (
    ("`joint_stiffness`, one tip", "motors", "one"),
    ("`joint_stiffness`, five tips one by one", "motors", "sum"),
    ("`joint_stiffness_total` of five tips", "motors", "total"),
    ("`spring_joint_stiffness`, one tip", "motors_spring", "spring"),
    ("`mass_matrix`", "motors_mass", "mass"),
    ("`bias_forces`", "motors_bias", "bias"),
)
PROGRAM = """
#include "ankle.h"
#include "tree.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
static double q[8], dq[8] = {.1, .2, .3, .1, -.2, .1, .3, .2}, da[2] = {.3, -.2}, g[3] = {0, 0, -9.81}, out[64];
static double H[16] = {1, 0, 0, .04, 0, 1, 0, .01, 0, 0, 1, -.4, 0, 0, 0, 1};
static double Kt[9] = {300, 0, 0, 0, 200, 0, 0, 0, 100}, F[30], K[180];
@CALLS@
static void (*const calls[])(void) = {@NAMES@};
int main(int argc, char **argv)
{
    const double a[2] = {0.3, -0.2}, start[8] = {@START@};
    ankle_close(a, start, q);
    for (int k = 0; k < 6; ++k) {
        K[7 * k] = 40;
        for (int tip = 0; tip < 5; ++tip) { F[6 * tip + k] = tip == 0 || k < 3 ? k + 1 : 0; }
    }
    if (argc > 1) { calls[atoi(argv[1])](); return 0; }
    double best[sizeof calls / sizeof *calls];
    for (unsigned i = 0; i < sizeof calls / sizeof *calls; ++i) { best[i] = 1e30; }
    for (int round = 0; round < 300; ++round) {
        for (unsigned i = 0; i < sizeof calls / sizeof *calls; ++i) {
            struct timespec a, b;
            clock_gettime(CLOCK_MONOTONIC, &a);
            for (int k = 0; k < 500; ++k) { calls[i](); }
            clock_gettime(CLOCK_MONOTONIC, &b);
            const double t = (1e9 * (double)(b.tv_sec - a.tv_sec) + (double)(b.tv_nsec - a.tv_nsec)) / 500;
            best[i] = t < best[i] ? t : best[i];
        }
    }
    for (unsigned i = 0; i < sizeof calls / sizeof *calls; ++i) { printf("%.2f\\n", best[i]); }
    return 0;
}
"""


COMPARED = """
Motors: one call of the function in motor coordinates at a closed q, without close.
Open tree: the function of the same name of the same tree at the same q, of
- one tip: the sole alone, whose branch has 2 of the 8 joints;
- five tips: the sole and the four ends of the loops, which bear the loops' forces;
- mass_matrix and bias_forces: all 8 joints."""


def urdf(folder: Path, name: str, *, ends: bool) -> Path:
    """Write the ankle, with links at the ends of the loops if the tree is open."""
    text = "".join(
        f'<link name="{link}">{INERTIAL * bool(axis)}</link>'
        f'<joint name="{link}" type="{"continuous" if axis else "fixed"}"><parent link="{parent}"/>'
        f'<child link="{link}"/><origin xyz="{xyz}"/><axis xyz="{axis or "0 0 1"}"/></joint>'
        for link, parent, xyz, axis in (*ANKLE, *(ENDS if ends else ()))
    )
    file = folder / f"{name}.urdf"
    file.write_text(f'<robot name="{name}"><link name="shank"/>{text}</robot>')
    return file


def build(folder: Path) -> tuple[Path, list[str]]:
    """Generate both robots, and return the program's source and the C files to compile."""
    generate = partial(stiffgen.generate, output=folder, build=False, controller=False)
    motors = ["left", "right"]
    ankle = generate(urdf(folder, "ankle", ends=False), tip="sole", loop=ANKLE_LOOPS, actuated=motors)
    tree = generate(urdf(folder, "tree", ends=True), tip=TIPS)
    start = stiffgen.open_robot(ankle).chain.start
    names = list(CALLS)
    text = PROGRAM.replace("@START@", ", ".join(map(repr, start)))
    text = text.replace("@CALLS@", "\n".join(f"static void call_{name}(void) {{ {CALLS[name]}; }}" for name in names))
    source = folder / "main.c"
    source.write_text(text.replace("@NAMES@", ", ".join(f"call_{name}" for name in names)))
    includes = [f"-I{each}" for each in (ankle, tree)]
    return source, [*includes, str(ankle / "ankle.c"), str(tree / "tree.c")]


def instructions(source: Path, files: list[str]) -> dict[str, int]:
    """Return the instructions of each call."""
    program = source.with_name("counted")
    run([*COUNTED, str(source), *files, "-o", str(program), "-lm"])
    counts = {}
    for number, name in enumerate(CALLS):
        out = source.with_name("callgrind")
        command = ["valgrind", "-q", "--tool=callgrind", f"--callgrind-out-file={out}", "--collect-atstart=no"]
        run([*command, f"--toggle-collect=call_{name}", str(program), str(number)])
        summary = next(line for line in out.read_text().splitlines() if line.startswith("summary:"))
        counts[name] = int(summary.split()[1])
    return counts


def times(source: Path, files: list[str]) -> dict[str, float]:
    """Return the time of each call [ns]."""
    program = source.with_name("timed")
    run(["gcc", *NATIVE.split(), str(source), *files, "-o", str(program), "-lm"])
    return dict(zip(CALLS, map(float, run(pinned([str(program)])).split()), strict=True))


def main() -> None:
    with tempfile.TemporaryDirectory() as work:
        source, files = build(Path(work))
        time = times(source, files)
        count = instructions(source, files) if shutil.which("valgrind") else dict.fromkeys(CALLS, 1)
    cpu = [line for line in run(["lscpu"]).splitlines() if line.startswith("Model name")]
    print(*cpu, run(["gcc", "--version"]).splitlines()[0], "", sep="\n")
    print("| motors / open tree | instructions | ratio | ns | ratio |\n|---|---|---|---|---|")
    for title, a, b in ROWS:
        counted = f"{count[a]} / {count[b]} | {count[a] / count[b]:.2f}"
        print(f"| {title} | {counted} | {time[a]:.0f} / {time[b]:.0f} | {time[a] / time[b]:.2f} |")
    print(COMPARED)


if __name__ == "__main__":
    main()
