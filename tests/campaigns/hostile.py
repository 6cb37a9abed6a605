# SPDX-License-Identifier: MIT
"""Hostile steps and bit flips of the controller's state, under the sanitizers of gcc and clang; see hostile.c.

    python tests/campaigns/hostile.py [--steps 10000000] [--flips 100000]

Half of the steps with gcc, half with clang. The first run of each has no bit flips: with them the state is set up anew
again and again, and less of what takes long is reached.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from support.project import ROOT

PROGRAM = ROOT / "tests" / "campaigns" / "hostile.c"
SANITIZERS = ("-g1", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def build(folder: Path, robot: Path, compiler: str, flags: tuple[str, ...] = SANITIZERS) -> Path:
    """Build the program; the kernels without optimisation, which takes a tenth of the time."""
    program, objects = folder / f"hostile-{compiler}", []
    for source, more in ((PROGRAM, ()), (robot / "iiwa14.c", ("-O0",)), (robot / "iiwa14_impedance.c", ())):
        objects.append(str(folder / f"{source.stem}-{compiler}.o"))
        command = [compiler, "-std=c99", *flags, *more, f"-I{robot}", "-c", str(source), "-o", objects[-1]]
        subprocess.run(command, check=True)
    subprocess.run([compiler, *flags, *objects, "-lm", "-o", str(program)], check=True)
    return program


def run(program: Path, steps: int, seed: int, flips: float = 0.0) -> subprocess.CompletedProcess[str]:
    """Run the program; ``flips`` are bit flips per million steps."""
    command = [str(program), str(steps), str(seed), str(flips)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def under_control(said: str) -> int:
    """Return the number of steps with the controller active."""
    return int(said.split(", ")[1].split()[0])


def main() -> int:
    """Run the hostile program in 20 parts, the first two without flipped bits; return 1 if one fails or is idle."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--flips", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    parts, failed, start = 20, 0, time.monotonic()
    rate = options.flips / options.steps * 1e6
    with tempfile.TemporaryDirectory() as folder:
        programs = [build(Path(folder), ROOT / "generated" / "iiwa14", name) for name in ("gcc", "clang")]
        for part in range(parts):
            steps = -(-options.steps // parts)
            done = run(programs[part % 2], steps, options.seed + part, 0.0 if part < 2 else rate * parts / (parts - 2))
            failed += done.returncode != 0 or under_control(done.stdout) < steps / 12
            print(f"{(done.stdout + done.stderr).strip()} ({time.monotonic() - start:.0f} s)", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
