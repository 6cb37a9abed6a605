# SPDX-License-Identifier: MIT
"""Time of the parts of a batch (contenders/batch_parts.c): hybrid joint stiffness of the iiwa 14, parts left out.

Prints a table: ns per configuration, the least of all rounds, on one core, with so few configurations that they stay
in a cache, and with so many that they stream through memory.
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np

import stiffgen
from benchmarks.tools import AVX2, NATIVE, URDF, pinned, run
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples

ROBOT = URDF.parent.parent / "generated" / "iiwa14"
SOURCE = Path(__file__).resolve().parent / "contenders" / "batch_parts.c"
COUNTS = {4096: 101, 1_000_000: 15}
"""Configurations, and rounds."""


def main() -> None:
    """Measure and print."""
    samples = Samples(stiffgen.load_chain(URDF), max(COUNTS), seed=1)
    columns: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        program, inputs = Path(name) / "parts", Path(name) / "inputs"
        for compiler in filter(shutil.which, ("gcc", "clang")):
            for flags in (NATIVE, AVX2):
                run([compiler, *flags.split(), "-w", f"-I{ROBOT}", str(SOURCE), "-o", str(program), "-lm"])
                for count, rounds in COUNTS.items():
                    given = samples[Q][:count], samples[WRENCH][:count], samples[TASK_STIFFNESS][0]
                    inputs.write_bytes(b"".join(np.ascontiguousarray(each).tobytes() for each in given))
                    lines = run(pinned([str(program), str(count), str(rounds), str(inputs)])).splitlines()
                    measured = dict(line.split("\t") for line in lines)
                    columns[f"{compiler} {flags}, {count}"] = {part: float(ns) for part, ns in measured.items()}
    print(f"| ns a configuration | {' | '.join(columns)} |")
    print("|---" * (len(columns) + 1) + "|")
    for part in next(iter(columns.values())):
        print(f"| {part} | {' | '.join(f'{each[part]:.1f}' for each in columns.values())} |")
    print(f"| the batch to seven libm sincos | {' | '.join(ratio(each) for each in columns.values())} |")


def ratio(column: dict[str, float]) -> str:
    """Return the bar: 0.22 with AVX-512."""
    return f"{column['the batch'] / column['seven libm sincos']:.3f}"


if __name__ == "__main__":
    main()
