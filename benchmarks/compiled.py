# SPDX-License-Identifier: MIT
"""Times of compiled contenders in one process, with their instructions and share of what the processor allows."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stiffgen
from benchmarks.instructions import Work, compiled_steps, of_contender
from benchmarks.tools import HERE, Row, pinned, quartiles, run
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.measured import symmetric_part
from stiffgen.core.verify.kernels.references import TASK_STIFFNESS, WRENCH
from stiffgen.core.verify.kernels.samples import Samples

AGREE = 1e-12


@dataclass(frozen=True)
class Timed:
    """Contenders in the order of the table: times [ns], cycles per configuration, and the work of each."""

    rows: list[Row]
    cycles: dict[str, float]
    work: dict[str, Work | None]
    gigahertz: float

    def share(self, name: str) -> float | None:
        """Return the least cycles of a contender over its cycles, if both are known."""
        work = self.work.get(name)
        if work is None or work.least_cycles is None or name not in self.cycles:
            return None
        return work.least_cycles / self.cycles[name]


def motion(chain: stiffgen.Chain, count: int) -> NDArray[np.float64]:
    """Return configurations of a slow motion (count, n) [rad]: each is within some mrad of the one before."""
    ends = np.array([(c.lower, c.upper) for c in chain.coordinates])
    phase = np.arange(count)[:, None] * 1e-3 / np.linspace(1, 2, len(ends)) + np.arange(len(ends))
    q: NDArray[np.float64] = ends.mean(axis=1) + 0.9 * np.diff(ends)[:, 0] / 2 * np.sin(phase)
    return q


def in_c(
    chain: stiffgen.Chain, folder: Path, built: dict[str, Path], count: int, rounds: int, *, along_path: bool = False
) -> Timed:
    """Time the contenders on ``count`` configurations, in turn, forwards and backwards.

    The configurations are drawn at random, or follow one another as in a control loop: where code branches, such as
    the C library's sine, the processor foresees the branches of a path.
    """
    samples = Samples(chain, count, seed=1)
    inputs, driver, steps = folder / "inputs", folder / "driver", compiled_steps(folder)
    q = motion(chain, count) if along_path else samples[Q]
    inputs.write_bytes(q.tobytes() + samples[WRENCH].tobytes() + symmetric_part(samples[TASK_STIFFNESS][0]).tobytes())
    run(["gcc", "-O2", str(HERE / "contenders" / "driver.c"), "-o", str(driver), "-ldl", "-lm"])
    names = {str(path): name for name, path in built.items()}
    clock, *lines = run(pinned([str(driver), str(inputs), str(count), str(rounds), *names])).splitlines()
    of_cycle = [float(ns) for ns in clock.split()]
    rows, cycles, work = [], {}, {}
    for line in lines:
        path, difference, *words = line.split()
        file, plus, _ = path.partition("+")
        name = names[file].replace("stiffgen;", "stiffgen batch;") if plus else names[file]
        if float(difference) > AGREE:
            raise SystemExit(f"{name} disagrees by {difference}")
        times = [float(word) for word in words]
        rows.append((name, *quartiles(times)))
        if all(of_cycle):
            cycles[name] = statistics.median(ns / one for ns, one in zip(times, of_cycle, strict=True))
        work[name] = of_contender(steps, inputs, Path(file), "run_batch" if plus else "run", count)
    return Timed(rows, cycles, work, 1 / statistics.median(of_cycle) if all(of_cycle) else 0.0)


def section(timed: Timed, along_path: Timed) -> list[str]:
    """Return the tables of random configurations, and of a path, and how to read the last columns."""
    return [
        *table(timed),
        "Instructions are counted one by one (`contenders/steps.c`). Cycles are those of a chain of multiplications",
        f"in the same round ({timed.gigahertz:.2f} GHz). The bound is the share of the cycles that the units of the",
        "processor need at least for these instructions, without latencies and caches, and what needs them",
        "(`instructions.py`: Zen 4). A way with fewer instructions has a bound of its own.",
        "",
        "The same along a path, each configuration within some mrad of the one before, as in a control loop: the",
        "processor foresees the branches of the C library's sine there.",
        "",
        *table(along_path),
    ]


def table(timed: Timed) -> list[str]:
    heads = ("contender; compiler and flags", "ns", "quartiles", "to 7 sincos", "instructions", "per cycle", "bound")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    floor = timed.rows[0][1]
    for name, *values in timed.rows:
        figures = [f"{value:.0f}" if value >= 100 else f"{value:.3g}" for value in values]
        work, cycles, share = timed.work.get(name), timed.cycles.get(name), timed.share(name)
        counts = ["-" if work is None else f"{work.instructions:.0f}"]
        counts.append("-" if work is None or not cycles else f"{work.instructions / cycles:.1f}")
        counts.append("-" if share is None or work is None else f"{100 * share:.0f} %, {work.busiest}")
        lines.append(
            f"| {name} | {figures[0]} | {figures[1]} to {figures[2]} | {values[0] / floor:.2f} | {' | '.join(counts)} |"
        )
    return [*lines, ""]
