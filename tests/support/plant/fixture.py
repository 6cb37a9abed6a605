# SPDX-License-Identifier: MIT
"""The controller in the loop with simulated robots, compiled once for all workers."""

from __future__ import annotations

from pathlib import Path

import pytest

from campaigns import energy
from support.plant.loop import Loop
from support.project import Once


@pytest.fixture(scope="session")
def loop(robot_folder: Path, once: Once) -> Loop:
    """Return the controller in the loop with a simulated arm, compiled once for all workers."""
    return Loop(once("loop", lambda folder: Loop(folder, robot_folder)), robot_folder)


def loop_of(once: Once, name: str) -> Loop:
    """Return the controller in the loop with another robot of the adversary's."""

    def make(folder: Path) -> Loop:
        robot, home = energy.generate_arm(name, folder, build=False)
        return Loop(folder, robot, home=home)

    return make(once(f"energy-{name}", make))
