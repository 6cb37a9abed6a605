# SPDX-License-Identifier: MIT
"""Fixtures of the ROS 2 package: the robot's objects and the scenarios' programs, made once for all workers."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

ROS2 = Path(__file__).parents[1]
PACKAGE, STUBS = ROS2 / "stiffgen_ros2", ROS2 / "stubs"
STRICT = ("-std=c++17", "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
DISTROS = {"humble": 16, "jazzy": 28, "rolling": 30}
"""Major version of rclcpp, which the stubs take their form from."""


def run(command: list[object], folder: Path) -> str:
    """Run a command in a folder; a failure shows what the command printed."""
    done = subprocess.run([str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-6000:]
    return done.stdout


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
def scenarios(made_once: Callable[..., Path], robot_folder: Path) -> Callable[[str], Path]:
    """Return a function of the distribution: the program that runs one scenario by name."""

    def objects(folder: Path) -> None:
        for name in (robot_folder.name, f"{robot_folder.name}_impedance"):
            run(["cc", "-std=c99", "-O1", "-c", robot_folder / f"{name}.c"], folder)

    def program(distro: str) -> Path:
        robot = made_once("robot", objects)
        sources = [*(PACKAGE / "src").glob("*.cpp"), *Path(__file__).parent.glob("*.cpp")]
        sources.remove(PACKAGE / "src" / "mock_system.cpp")  # another plugin, with a program of its own

        def make(folder: Path) -> None:
            configured(folder, robot_folder.name)
            include = [f"-I{path}" for path in (PACKAGE / "src", folder, STUBS, robot_folder)]
            command = ["g++", *STRICT, f"-DSTUB_DISTRO={DISTROS[distro]}", *include]
            for source in sources:
                run([*command, "-c", source], folder)
            run(["g++", *folder.glob("*.o"), *robot.glob("*.o"), "-o", "scenarios", "-lm"], folder)

        return made_once(distro, make) / "scenarios"

    return program


def configured(folder: Path, name: str) -> None:
    """Write robot.hpp as CMake does."""
    text = (PACKAGE / "src" / "robot.hpp.in").read_text()
    (folder / "robot.hpp").write_text(text.replace("@ROBOT_NAME@", name).replace("@ROBOT_MACRO@", name.upper()))
