# SPDX-License-Identifier: MIT
"""No result depends on memory that nothing has written: random robots under clang's memory sanitizer.

The calls are those of ``stiffgen prove``'s part "widths", which runs one robot's folder.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from stiffgen import open_robot
from stiffgen.core.emit.build import kernel_sources
from stiffgen.lab.prove.harness import widths
from support.project import require_compiler
from support.warnings import sources_of_varied_robot

WIDTHS = {"native": ("-march=native",), "no vectors": ("-DSTIFFGEN_NO_VECTORS",)}
COUNT = 3
"""Most configurations of a batch."""


def check(seed: int, width: str, folder: Path) -> None:
    """Compile a varied robot with clang's memory sanitizer for one width, and run all its functions."""
    clang = require_compiler("clang")
    sources_of_varied_robot(seed, 4, folder)
    robot = open_robot(folder)
    (folder / "main.c").write_text(widths(robot, robot.table, COUNT))
    flags = ["-std=c99", "-O0", "-w", "-fsanitize=memory", "-fno-sanitize-recover=all", *WIDTHS[width]]
    command = [
        clang,
        *flags,
        *map(str, kernel_sources(folder, robot.name)),
        str(folder / "main.c"),
        "-o",
        str(folder / "program"),
        "-lm",
    ]
    subprocess.run(command, check=True)
    done = subprocess.run([str(folder / "program")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_joint_without_a_force_that_shares_its_coordinate(tmp_path: Path) -> None:
    """Its force, which is always zero, is summed with its partner's."""
    check(11, "no vectors", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "width"),
    [
        pytest.param(9, "native", marks=pytest.mark.wide),
        (11, "native"),
        pytest.param(13, "no vectors", marks=pytest.mark.wide),
        pytest.param(16, "native", marks=pytest.mark.wide),
        pytest.param(23, "no vectors", marks=pytest.mark.wide),
    ],
)
def test_random_robots(seed: int, width: str, tmp_path: Path) -> None:
    """Check random robots of each kind with the memory sanitizer."""
    check(seed, width, tmp_path)
