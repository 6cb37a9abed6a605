# SPDX-License-Identifier: MIT
"""Tools that the benchmarks share: programs on one core, times of calls, flags of the compilers."""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
COUNT = 4096
URDF = HERE.parent / "urdf" / "iiwa14.urdf"
NATIVE, AVX2, PLAIN = "-O3 -march=native", "-O3 -mavx2 -mfma", "-O2"
Row = tuple[str, float, float, float]
"""Name, median, lower and upper quartile."""


def run(command: list[str], cwd: Path | None = None) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=cwd).stdout


def machine() -> str:
    cpu = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    model = next((line.split(":")[1].strip() for line in cpu.splitlines() if line.startswith("model name")), "unknown")
    widths = [name for flag, name in ((" avx512f", "AVX-512"), (" avx2", "AVX2")) if flag in cpu]
    return f"{platform.machine()}, {model}, {os.cpu_count()} cores, {', '.join(widths)}; virtual and shared"


def pinned(command: list[str]) -> list[str]:
    core = max(os.sched_getaffinity(0))
    return ["taskset", "-c", str(core), *command] if shutil.which("taskset") else command


def quartiles(values: list[float]) -> tuple[float, float, float]:
    lower, median, upper = statistics.quantiles(values, n=4)
    return median, lower, upper


def timed(call: Callable[[], object], repeat: int = 15, target: float = 0.02) -> tuple[float, float, float]:
    """Microseconds a call: median and quartiles of batches of calls."""
    start = time.perf_counter()
    call()
    number = max(1, int(target / max(time.perf_counter() - start, 1e-7)))
    values = []
    for _ in range(repeat):
        start = time.perf_counter()
        for _ in range(number):
            call()
        values.append((time.perf_counter() - start) / number * 1e6)
    return quartiles(values)
