# SPDX-License-Identifier: MIT
"""Times of the tip's compliance and its relatives beside the hybrid joint stiffness of the iiwa 14, in one process.

    python -m benchmarks.compliance

Prints the table of docs/compliance.md (contenders/compliance.c). Bars: a single call of tip_compliance takes at most
1.6 times as long as one of joint_stiffness, a batch at most 1.8 times.
"""

import shutil
import tempfile
from pathlib import Path

import stiffgen
from benchmarks.tools import AVX2, HERE, NATIVE, PLAIN, URDF, pinned, run

ROUNDS = 301


def measured(folder: Path, program: Path, compiler: str, flags: str) -> dict[str, list[float]]:
    """Return per function the least ns of a single call and of a configuration of a batch."""
    sources = [f'-DSOURCE="{folder / folder.name}.c"', f'-DBATCHES="{folder / folder.name}_batch.c"', f"-I{folder}"]
    contender = str(HERE / "contenders" / "compliance.c")
    run([compiler, *flags.split(), "-w", contender, *sources, "-o", str(program), "-lm"])
    rows = (line.split() for line in run(pinned([str(program), str(ROUNDS)])).splitlines())
    return {name: [float(each) for each in times] for name, *times in rows}


def main() -> None:
    """Measure and print."""
    print("| function over joint stiffness | single | batch | ns: single, batch |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = stiffgen.generate(URDF, output=name, kernels="all,compliance", build=False)
        for compiler in filter(shutil.which, ("gcc", "clang")):
            for flags in (NATIVE, AVX2, PLAIN):
                times = measured(folder, Path(name) / "compliance", compiler, flags)
                plain = times.pop("joint_stiffness")
                print(f"| {compiler} {flags}: joint stiffness | | | {plain[0]:.0f}, {plain[1]:.0f} |")
                for function, (single, batch) in times.items():
                    ratios = f"{single / plain[0]:.2f} | {batch / plain[1]:.2f}"
                    print(f"| {function} | {ratios} | {single:.0f}, {batch:.0f} |")


if __name__ == "__main__":
    main()
