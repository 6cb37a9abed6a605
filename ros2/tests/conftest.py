# SPDX-License-Identifier: MIT
"""Fixtures of the ROS 2 package: the robot's objects, compiled once for all workers."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

ROOT = Path(__file__).parents[2]


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
    return ROOT / "generated" / "iiwa14"


@pytest.fixture(scope="session")
def robot_objects(made_once: Callable[..., Path], robot_folder: Path) -> list[Path]:
    """Return the objects of the robot's functions and controller."""
    names = (robot_folder.name, f"{robot_folder.name}_impedance")

    def make(folder: Path) -> None:
        for name in names:
            command = ["cc", "-std=c99", "-O1", "-c", robot_folder / f"{name}.c", "-o", folder / f"{name}.o"]
            subprocess.run(command, check=True)

    folder = made_once("robot", make)
    return [folder / f"{name}.o" for name in names]
