# SPDX-License-Identifier: MIT
"""The controller in the loop with a simulated arm, compiled once for all workers."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.plant.loop import Loop
from support.project import Once


@pytest.fixture(scope="session")
def loop(robot_folder: Path, once: Once) -> Loop:
    flags = ("-O2", "-march=native")  # -O3 takes longer to compile than it saves
    return Loop(once("loop", lambda folder: Loop(folder, robot_folder, flags=flags)), robot_folder)
