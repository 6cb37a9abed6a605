# SPDX-License-Identifier: MIT
"""Time of a full controller step of the iiwa 14 (kernels, mass matrix, damping, safety, account), pinned to one core.

Compiles benchmarks/impedance_step.c with the committed code. The worst time is that of the machine as much as of the
code: run it on an idle, isolated core for a number that means something.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROBOT = ROOT / "generated" / "iiwa14"
SOURCES = ("iiwa14.c", "iiwa14_impedance.c")
OWN = ("impedance_step.c", "contenders/seven_sincos.c")
DESIGNS = ("the reference moves", "reference and stiffness move")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--core", type=int, default=0)
    parser.add_argument("--compiler", default="cc")
    parser.add_argument("--flags", default="-O3")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "impedance_step"
        sources = [*(ROOT / "benchmarks" / source for source in OWN), *(ROBOT / source for source in SOURCES)]
        flags = ["-std=gnu99", *options.flags.split(), f"-I{ROBOT}"]
        subprocess.run([options.compiler, *flags, *map(str, sources), "-lm", "-o", str(program)], check=True)
        for index, design in enumerate(DESIGNS):
            print(design, flush=True)
            subprocess.run([str(program), str(options.steps), str(options.core), str(index)], check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
