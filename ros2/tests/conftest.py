# SPDX-License-Identifier: MIT
"""Fixtures of the ROS 2 package: the robot's objects and the scenarios' programs, made once for all workers."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

from .building import PACKAGE, ROS2, compile_robot, compile_scenarios


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Callable[..., Path]:
    """Return ``made_once(name, make)``: a folder of that name, filled by ``make`` in the first worker that asks."""
    base = tmp_path_factory.getbasetemp()
    root = (base if worker_id == "master" else base.parent) / "ros2"
    root.mkdir(exist_ok=True)

    def made(name: str, make: Callable[[Path], object]) -> Path:
        folder, done = root / name, root / f"{name}.made"
        with FileLock(f"{folder}.lock"):
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def robot_folder() -> Path:
    """Return the folder of the committed robot."""
    return ROS2.parent / "generated" / "iiwa14"


@pytest.fixture(scope="session")
def robot_objects(made_once: Callable[..., Path], robot_folder: Path) -> Path:
    """Return the folder of the robot's objects."""
    return made_once("robot", lambda folder: compile_robot(folder, robot_folder))


@pytest.fixture(scope="session")
def scenarios(made_once: Callable[..., Path], robot_folder: Path, robot_objects: Path) -> Callable[[str], Path]:
    """Return a function of the distribution: the program that runs one scenario by name."""

    def program(distro: str) -> Path:
        made = made_once(distro, lambda folder: compile_scenarios(folder, PACKAGE, robot_folder, robot_objects, distro))
        return made / "scenarios"

    return program
