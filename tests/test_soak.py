"""A few thousand hostile steps through sanitizers, valgrind, threads and an allocator that aborts (tests/soak.py)."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from soak import BUILDS, soak


@pytest.mark.parametrize("name", BUILDS)
def test_soak(name: str, robot_folder: Path, tmp_path: Path) -> None:
    compiler, _, before, share = BUILDS[name]
    for tool in (compiler, *before[:1]):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    done = soak(name, tmp_path, robot_folder, 12000 if share > 0.1 else 200000)
    assert done.returncode == 0, done.stderr
    assert "recoveries" in done.stdout
    refused, missed, recoveries = (int(part.split()[0]) for part in done.stdout.splitlines()[0].split(", ")[1:])
    assert min(refused, missed, recoveries) > 5
