# SPDX-License-Identifier: MIT
"""Tools that the benchmarks share: programs on one core, times of calls, flags of the compilers."""

from __future__ import annotations

import contextlib
import os
import platform
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parent
COUNT = 4096
URDF = HERE.parent / "urdf" / "iiwa14.urdf"
NATIVE, AVX2, PLAIN = "-O3 -march=native", "-O3 -mavx2 -mfma", "-O2"
Row = tuple[str, float, float, float]
"""Name, median, lower and upper quartile."""


def run(command: list[str], cwd: Path | None = None) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=cwd).stdout


def processor() -> str:
    """Return architecture, model, number of cores and widest vectors of the processor."""
    cpu = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    model = next((line.split(":")[1].strip() for line in cpu.splitlines() if line.startswith("model name")), "unknown")
    widths = [name for flag, name in ((" avx512f", "AVX-512"), (" avx2", "AVX2")) if flag in cpu]
    return f"{platform.machine()}, {model}, {os.cpu_count()} cores, {', '.join(widths)}"


def machine() -> str:
    return f"{processor()}; virtual and shared"


def pinned(command: list[str]) -> list[str]:
    """Return the command on one core, before all other processes of the machine where the system allows it."""
    core = max(os.sched_getaffinity(0))
    first = ["chrt", "--fifo", "50"]
    if not shutil.which("chrt") or subprocess.run([*first, "true"], capture_output=True, check=False).returncode:
        first = []
    return [*first, "taskset", "-c", str(core), *command] if shutil.which("taskset") else command


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Run this thread before all other processes of the machine where the system allows it."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    except (AttributeError, PermissionError):
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def quartiles(values: list[float]) -> tuple[float, float, float]:
    lower, median, upper = statistics.quantiles(values, n=4)
    return median, lower, upper


def in_turn(calls: dict[str, Callable[[], object]], repeat: int = 31, target: float = 0.004) -> list[Row]:
    """Time calls in turn, every other round backwards: a row for each, in microseconds a call."""
    numbers, times = {}, {name: [] for name in calls}  # type: dict[str, int], dict[str, list[float]]
    for name, call in calls.items():
        call()  # compiles
        start = time.perf_counter()
        call()
        numbers[name] = max(1, int(target / max(time.perf_counter() - start, 1e-7)))
    with undisturbed():
        for k in range(repeat):
            for name in list(calls)[:: -1 if k % 2 else 1]:
                call = calls[name]
                start = time.perf_counter()
                for _ in range(numbers[name]):
                    call()
                times[name].append((time.perf_counter() - start) / numbers[name] * 1e6)
    return [(name, *quartiles(values)) for name, values in times.items()]


def least(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the least seconds of each call, in turn."""
    best = dict.fromkeys(calls, float("inf"))
    for call in calls.values():
        call()  # compiles
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def timed(call: Callable[[], object], repeat: int = 15, target: float = 0.02) -> tuple[float, float, float]:
    """Microseconds a call: median and quartiles of batches of calls."""
    start = time.perf_counter()
    call()
    number = max(1, int(target / max(time.perf_counter() - start, 1e-7)))
    values = []
    with undisturbed():
        for _ in range(repeat):
            start = time.perf_counter()
            for _ in range(number):
                call()
            values.append((time.perf_counter() - start) / number * 1e6)
    return quartiles(values)
