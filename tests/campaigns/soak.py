# SPDX-License-Identifier: MIT
"""Run the controller and the eigensolver for long: ``make campaign NAME=soak``.

Options: --steps N, --matrices N, --builds NAMES. Hostile input (1 % NaN, infinity, 1e308, denormals, limits exceeded,
1 % missed samples) through builds with the address and undefined-behaviour sanitizers of gcc and clang, the thread
sanitizer (a quarter of the steps in each of four threads), an allocator that aborts, valgrind; then random matrices.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from support.project import ROOT

PROGRAM = ROOT / "tests" / "campaigns" / "impedance_soak.c"
SOURCES = ("iiwa14.c", "iiwa14_impedance.c")
MEMORY = ("-g1", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
BUILDS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...], float]] = {
    # name: compiler, flags, command before the program, share of the steps
    "plain": ("gcc", ("-O2",), (), 1.0),
    "address and undefined behaviour, gcc": ("gcc", MEMORY, (), 1.0),
    "address and undefined behaviour, clang": ("clang", MEMORY, (), 1.0),
    "threads": ("gcc", ("-g1", "-O1", "-fsanitize=thread"), (), 0.25),
    "allocator that aborts": ("gcc", ("-O2", "-DABORTING_ALLOCATOR"), (), 1.0),
    "valgrind": ("gcc", ("-g", "-O1"), ("valgrind", "-q", "--error-exitcode=9"), 1.0),
}


def soak(name: str, folder: Path, robot: Path, steps: int, seed: int = 1) -> subprocess.CompletedProcess[str]:
    """Build the soak program one way and run it."""
    compiler, flags, before, share = BUILDS[name]
    program = folder / "soak"
    sources = [PROGRAM, *(robot / source for source in SOURCES)]
    command = [compiler, "-std=gnu99", *flags, f"-I{robot}", *map(str, sources), "-lm", "-lpthread", "-o", str(program)]
    subprocess.run(command, check=True)
    threads = "4" if name == "threads" else "1"
    return subprocess.run(
        [*before, str(program), str(max(int(steps * share), 600)), str(seed), threads],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def was_eventful(said: str) -> bool:
    """Return whether the run had refused samples, missed samples and recoveries."""
    return all(int(part.split()[0]) > 5 for part in said.splitlines()[0].split(", ")[1:])


def worst_residual(count: int, folder: Path) -> float:
    """Return the largest |A V - V l| / |A| of the C eigensolver, over `count` matrices of seven joints."""
    from support.controller_library import Matrices, residual, spectra

    matrices, worst = Matrices(folder, 7), 0.0
    for A in spectra(np.random.default_rng(2025), 7, count):
        worst = float(np.maximum(worst, residual(A, *matrices.find_modes(A))))
    return worst


def results(builds: Sequence[str], steps: int, count: int) -> Iterator[tuple[str, bool, str]]:
    """Yield name, whether it passed, and output of each long run of the controller, then of the eigensolver."""
    for name in builds:
        with tempfile.TemporaryDirectory() as folder:
            done = soak(name, Path(folder), ROOT / "generated" / "iiwa14", steps)
            yield name, done.returncode == 0 and was_eventful(done.stdout), (done.stdout + done.stderr).strip()
    with tempfile.TemporaryDirectory() as folder:
        worst = worst_residual(count, Path(folder))
        yield "eigensolver", worst <= 1e-12, f"worst relative residual of {count} matrices {worst:.1e}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the soak of all builds; return 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--matrices", type=int, default=100_000)
    parser.add_argument("--builds", nargs="+", choices=BUILDS, default=list(BUILDS), metavar="NAME")
    options = parser.parse_args(arguments)
    good, start = True, time.monotonic()
    for name, passed, text in results(options.builds, options.steps, options.matrices):
        good = good and passed
        print(f"{'ok    ' if passed else 'FAILED'} {name} ({time.monotonic() - start:.0f} s)\n{text}", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
