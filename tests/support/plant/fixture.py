# SPDX-License-Identifier: MIT
"""Fixture: the controller in the loop with a simulated arm."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.plant.loop import Loop
from support.project import Once


@pytest.fixture(scope="session")
def loop(robot_folder: Path, once: Once) -> Loop:
    """Return the controller in the loop with a simulated arm, compiled once for all workers."""
    return Loop(once("loop", lambda folder: Loop(folder, robot_folder)), robot_folder)
