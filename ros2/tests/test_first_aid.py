# SPDX-License-Identifier: MIT
"""The example controller with stubs of ROS 2: the torque that it starts from and leaves behind, and NaN."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DISTROS = {"humble": 16, "jazzy": 28, "rolling": 30}
STRICT = ("-Wall", "-Wextra", "-Werror")


@pytest.mark.parametrize("distro", DISTROS)
def test_torque_at_start_and_end(distro: str, robot_objects: list[Path], robot_folder: Path, tmp_path: Path) -> None:
    include = [f"-I{path}" for path in (ROOT / "ros2" / "stubs", ROOT / "examples" / "ros2", robot_folder)]
    source = Path(__file__).parent / "first_aid.cpp"
    program = tmp_path / "scenarios"
    command = ["g++", "-std=c++17", "-O0", *STRICT, f"-DSTUB_DISTRO={DISTROS[distro]}", *include, source]
    subprocess.run([*command, *robot_objects, "-o", program, "-lm"], check=True)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("", 0)
