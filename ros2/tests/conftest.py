# SPDX-License-Identifier: MIT
"""Fixtures of the ROS 2 package: the robot's objects and the scenarios' programs, made once for all workers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from support.fixtures import kept_objects, once
from support.project import Once

from .building import PACKAGE, ROS2, compile_robot, compile_scenarios

__all__ = ["kept_objects", "once"]


@pytest.fixture(scope="session")
def robot_folder() -> Path:
    """Return the folder of the committed robot."""
    return ROS2.parent / "generated" / "iiwa14"


@pytest.fixture(scope="session")
def robot_objects(once: Once, robot_folder: Path) -> Path:
    """Return the folder of the robot's objects."""
    return once("ros2_robot", lambda folder: compile_robot(folder, robot_folder))


@pytest.fixture(scope="session")
def scenarios(once: Once, robot_folder: Path, robot_objects: Path) -> Callable[[str], Path]:
    """Return a function of the distribution: the program that runs one scenario by name."""

    def program(distro: str) -> Path:
        made = once(
            f"ros2_{distro}", lambda folder: compile_scenarios(folder, PACKAGE, robot_folder, robot_objects, distro)
        )
        return made / "scenarios"

    return program
