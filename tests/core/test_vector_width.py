# SPDX-License-Identifier: MIT
"""Vector widths of single calls and batches, as the preprocessor and clang see them."""

from __future__ import annotations

import platform
import re
import subprocess
from pathlib import Path

import pytest

from support.project import require_compiler

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="the widths are those of x86-64")


def output(*command: str | Path) -> str:
    return subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize(
    ("flags", "single", "batch"),
    [(["-mavx512f"], 32, 64), (["-mavx2", "-mno-avx512f"], 32, 32), (["-msse2", "-mno-avx"], 16, 16)],
)
def test_bytes_of_a_vector(compiler: str, flags: list[str], single: int, batch: int, robot_folder: Path) -> None:
    """Preprocess for three instruction sets: single calls and batches use vectors of the expected bytes."""
    for file, expected in (("iiwa14.c", single), ("iiwa14_batch.c", batch)):
        macros = output(require_compiler(compiler), *flags, "-E", "-dM", robot_folder / file)
        assert re.findall(r"^#define LANE_BYTES (\d+)$", macros, re.MULTILINE) == [str(expected)]


def test_clang_does_not_compute_in_halves(robot_folder: Path) -> None:
    """Its tuning for Intel prefers 256 bits."""
    flags = ["-std=gnu99", "-O2", "-march=sapphirerapids"]
    text = output(require_compiler("clang"), *flags, "-S", "-o", "-", robot_folder / "iiwa14_batch.c")
    arithmetic = re.findall(r"^\s+v(?:mul|fn?m(?:add|sub)\d+)pd\s.*", text, re.MULTILINE)
    assert len([line for line in arithmetic if "%zmm" in line]) > 1000
    assert not [line for line in arithmetic if "%ymm" in line]
