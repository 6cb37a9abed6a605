# SPDX-License-Identifier: MIT
"""A few thousand hostile steps through sanitizers, valgrind, threads and an allocator that aborts."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from campaigns.soak import BUILDS, soak
from support.project import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILDS)
def test_soak(name: str, robot_folder: Path, tmp_path: Path) -> None:
    compiler, _, before, _ = BUILDS[name]
    for tool in (compiler, *before[:1]):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    done = soak(name, tmp_path, robot_folder, 2000 if name == "valgrind" else 12000)
    assert done.returncode == 0, done.stderr
    assert "recoveries" in done.stdout
    refused, missed, recoveries = (int(part.split()[0]) for part in done.stdout.splitlines()[0].split(", ")[1:])
    assert min(refused, missed, recoveries) > 5


@pytest.mark.slow
def test_benchmark_of_a_step_runs() -> None:
    script = ROOT / "benchmarks" / "impedance_step.py"
    core = min(os.sched_getaffinity(0))
    command = [sys.executable, str(script), "--steps", "2000", "--core", str(core)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("ratio of the medians") == 3
