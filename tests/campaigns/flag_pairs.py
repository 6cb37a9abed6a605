# SPDX-License-Identifier: MIT
"""Single flags and pairs of every compiler at hand: refused, found by a self-check, or without effect on any result.

    python tests/campaigns/flag_pairs.py [--compilers gcc clang ...] [--pairs 91] [--seed 1]

The program steps the controller of a small arm and calls its kernels, with good numbers and with NaN and infinity in
every argument. Results of a build with flags are compared with those of the same compiler without: NaN at the same
places, and numbers up to rounding.
"""

from __future__ import annotations

import argparse
import itertools
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

import stiffgen
from support.chains import ARM

FLAGS = {
    "gcc": ("-ffinite-math-only", "-fno-signed-zeros", "-fassociative-math", "-freciprocal-math", "-fno-trapping-math",
            "-funsafe-math-optimizations", "-frounding-math", "-fno-math-errno", "-ffp-contract=fast", "-ffast-math",
            "-fexcess-precision=fast", "-fcx-limited-range", "-Ofast", "-fsingle-precision-constant"),
    "clang": ("-fno-honor-nans", "-fno-honor-infinities", "-fno-signed-zeros", "-fassociative-math", "-fapprox-func",
              "-freciprocal-math", "-fno-trapping-math", "-funsafe-math-optimizations", "-frounding-math",
              "-ffp-contract=fast", "-ffast-math", "-ffinite-math-only", "-Ofast",
              "-fdenormal-fp-math=positive-zero"),
}  # fmt: skip
COMPILERS = [name for base in FLAGS for name in (base, *(f"{base}-{k}" for k in range(11, 22))) if shutil.which(name)]
PROGRAM = """
#include "arm_impedance.h"
#include "arm_paper.h"
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

static void show(int n, const double *x)
{
    for (int k = 0; k < n; ++k) { /* the bits: no flag changes what is printed */
        uint64_t bits;
        memcpy(&bits, x + k, sizeof bits);
        printf("%016llx ", (unsigned long long)bits);
    }
}

static void show_kernels(const double *q, const double *wrench, const double *stiffness)
{
    double result[36];
    arm_forward_kinematics(q, result);
    show(16, result);
    arm_hybrid_joint_stiffness(q, wrench, stiffness, result);
    show(4, result);
    arm_mass_matrix(q, result);
    show(4, result);
}

/* Step the law of the paper with a bad number in each of its arguments: the torque is a number all the same. */
static void show_paper(const double *q, const double *stiffness, const double *bad)
{
    for (int k = 0; k < 30; ++k) {
        arm_paper_config c;
        arm_paper_input in;
        arm_paper_output out;
        arm_paper_state state = {{0.1, -0.1}};
        double *const at[] = {in.q, in.dq, in.q0, in.wrench, in.task_stiffness, state.torque, &c.sample_time,
                              &c.damping_ratio, &c.joint_damping, &c.posture_stiffness, c.motor_inertia,
                              c.effort_limit, c.torque_rate_limit, in.task_stiffness + 1, in.q0 + 1};
        memset(&in, 0, sizeof in);
        arm_paper_default_config(&c);
        memcpy(in.q, q, sizeof in.q);
        memcpy(in.task_stiffness, stiffness, sizeof in.task_stiffness);
        *at[k / 2] = bad[k % 2];
        printf("%d ", arm_paper_step(&c, &state, &in, &out));
        show(2, out.torque);
    }
}

int main(int count, char **words)
{
    const uint64_t patterns[2] = {0x7ff8000000000000u, 0x7ff0000000000000u};
    double q[2] = {0.3, -0.4}, wrench[6] = {1, 2, 3, 4, 5, 6}, stiffness[36] = {0}, bad[2];
    static arm_impedance_state state;
    arm_impedance_config config;
    arm_impedance_input in;
    arm_impedance_output out;
    (void)words;
    memcpy(bad, patterns, sizeof bad);
    for (int k = 0; k < 6; ++k) { stiffness[7 * k] = 300.0; }
    printf("%d\\n", arm_self_check() | arm_impedance_self_check());
    show_kernels(q, wrench, stiffness);
    for (int k = 0; k < 2 * (2 + 6 + 36); ++k) {
        double *const at = k / 2 < 2 ? q + k / 2 : k / 2 < 8 ? wrench + k / 2 - 2 : stiffness + k / 2 - 8;
        const double kept = *at;
        *at = bad[k % 2];
        show_kernels(q, wrench, stiffness);
        *at = kept;
    }
    show_paper(q, stiffness, bad);
    arm_impedance_default_config(&config);
    config.sample_time = 1e-3;
    config.delay_samples = 0;
    for (int i = 0; i < 2; ++i) { config.motor_inertia[i] = 0.1; config.heaviest_wrench[i] = 50.0; }
    printf("%d ", arm_impedance_init(&config, &state, NULL));
    for (int k = 0; k < 400; ++k) {
        double *const fields[] = {in.q, in.dq, in.q0, in.translation_stiffness, in.rotation_stiffness,
                                  in.posture_stiffness, in.torque_offset, in.wrench_command, in.acceleration, &in.time};
        memset(&in, 0, sizeof in);
        in.sample_valid = 1;
        in.clock = k < 200 ? ARM_CLOCK_TIME : ARM_CLOCK_COUNTER;
        in.counter = (uint32_t)k;
        in.time = 1e-3 * k;
        for (int i = 0; i < 2; ++i) {
            in.q[i] = q[i] + 1e-4 * k;
            in.dq[i] = 0.1;
            in.q0[i] = q[i] + 0.1;
        }
        for (int i = 0; i < 9; i += 4) { in.translation_stiffness[i] = 300.0; in.rotation_stiffness[i] = 20.0; }
        if (k % 20 == 10) { fields[k / 20 % 10][k / 20 % 10 == 9 ? 0 : k / 200] = bad[count % 2]; }
        printf("%d ", arm_impedance_step(&state, &in, &out));
        if (k % 5 == 0) { printf("%d ", arm_impedance_reset(&state)); }
        show(2, out.torque);
        show(2, out.damping_torque);
        printf("%x ", (unsigned)out.status & (ARM_STATUS_FAULT | ARM_STATUS_BAD_SAMPLE | ARM_STATUS_COMMAND_REFUSED));
    }
    return 0;
}
"""


def write_sources(folder: Path) -> Path:
    """Generate a small arm beside the program; return its folder."""
    (folder / "arm.urdf").write_text(ARM)
    stiffgen.generate(folder / "arm.urdf", tip="hand", output=folder, build=False)
    (folder / "arm" / "main.c").write_text(PROGRAM)
    return folder / "arm"


def numbers(words: list[str]) -> np.ndarray:
    """Return the doubles among the words; others are returned as they are, as small numbers."""
    return np.array([int(word, 16) for word in words], dtype=np.uint64).view(float)


def judge(compiler: str, flags: tuple[str, ...], sources: Path, work: Path) -> tuple[str, list[str]]:
    """Build and run with the flags. Return "refused", "found" or "ran", and the words that it printed."""
    program = work / "program"
    files = [str(sources / name) for name in ("arm.c", "arm_impedance.c", "arm_paper.c", "main.c")]
    command = [compiler, "-std=gnu99", "-O1", *flags, "-w", f"-I{sources}", *files, "-lm", "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        assert "compile without" in done.stderr or "constants_must_be_doubles" in done.stderr, done.stderr
        return "refused", []
    check, _, words = subprocess.run([program], capture_output=True, text=True, check=True).stdout.partition("\n")
    return ("ran", words.split()) if check == "0" else ("found", [])


def assert_unchanged(plain: list[str], changed: list[str], flags: tuple[str, ...]) -> None:
    """NaN where it was, and the same numbers up to rounding; codes and bits of the status are equal."""
    assert len(plain) == len(changed), flags
    short = [(a, b) for a, b in zip(plain, changed, strict=True) if len(a) < 16]
    assert all(a == b for a, b in short), flags
    before, after = (numbers([word for word in words if len(word) == 16]) for words in (plain, changed))
    np.testing.assert_array_equal(np.isnan(before), np.isnan(after), err_msg=str(flags))
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-9, err_msg=str(flags))


def sweep(compiler: str, combinations: list[tuple[str, ...]], sources: Path, work: Path) -> dict[tuple[str, ...], str]:
    """Return the verdict of each combination of compiler flags; a combination that runs must print the plain values."""
    verdict, plain = judge(compiler, (), sources, work)
    assert verdict == "ran"
    found = {}
    for flags in combinations:
        found[flags], words = judge(compiler, flags, sources, work)
        if found[flags] == "ran":
            assert_unchanged(plain, words, flags)
    return found


def main() -> int:
    """Judge all flags and pairs of flags of the chosen compilers; return 1 if none was refused, as the sweep is idle
    then.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compilers", nargs="*", choices=COMPILERS, default=COMPILERS)
    parser.add_argument("--pairs", type=int, help="pairs drawn for each compiler; default: all")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        sources = write_sources(Path(folder))
        for compiler in options.compilers:
            flags = FLAGS[compiler.partition("-")[0]]
            pairs = list(itertools.combinations(flags, 2))
            if options.pairs is not None:
                pairs = random.Random(options.seed).sample(pairs, min(options.pairs, len(pairs)))
            verdicts = Counter(sweep(compiler, [*((flag,) for flag in flags), *pairs], sources, Path(folder)).values())
            print(
                f"{compiler}: {len(flags)} flags and {len(pairs)} pairs: {dict(sorted(verdicts.items()))}", flush=True
            )
            failed |= verdicts["refused"] == 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
