# SPDX-License-Identifier: MIT
"""The LBRClient of docs/fri.md: led through a session by its callbacks, and in a program of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from fri.support.python_client import free_port
from fri.support.session import require_tools, run_cmake
from support.pages import blocks, commands
from support.project import ROOT, Once, require_compiler

STANDIN = ROOT / "fri" / "support" / "native" / "standin"
BLOCKS = blocks(ROOT / "docs" / "fri.md")
SESSION = (ROOT / "fri" / "support" / "native" / "own_client.cpp").read_text()


@pytest.fixture(scope="module")
def client() -> str:
    block, _ = (block for block in BLOCKS if block.language == "cpp")
    assert block.code.count("\n") <= 60
    return block.code


@pytest.fixture(scope="module")
def objects(once: Once, robot_folder: Path) -> list[Path]:
    """Return the objects of the robot and its controller, without optimisation."""

    def make(folder: Path) -> None:
        sources = [robot_folder / f"{name}.c" for name in ("iiwa14", "iiwa14_impedance")]
        subprocess.run(["cc", "-std=c99", "-O0", "-c", *sources], cwd=folder, check=True)

    return sorted(once("own-client", make).glob("*.o"))


@pytest.mark.slow
@pytest.mark.parametrize("version", ["115", "205", "207"])
def test_the_pages_client(client: str, version: str, robot_folder: Path, objects: list[Path], tmp_path: Path) -> None:
    """Compile and run the page's client: it waits with torque and position, yields to a push, and sends no NaN."""
    source = tmp_path / "client.cpp"
    source.write_text(client + SESSION)
    command = [require_compiler("g++"), "-std=c++17", "-O0", "-Wall", "-Wextra", "-Werror", f"-I{robot_folder}"]
    command += ["-isystem", str(STANDIN), f"-DSTANDIN_VERSION={version}"]
    command += ["-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    subprocess.run([*command, str(source), *objects, "-o", tmp_path / "client", "-lm"], check=True)
    done = subprocess.run([tmp_path / "client"], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("", 0)


@pytest.mark.slow
def test_the_pages_program_meets_the_simulated_robot(robot_folder: Path, plate_folder: Path, tmp_path: Path) -> None:
    """Client and connection with the open library, built by the page's commands; the session ends as planned."""
    if missing := require_tools():
        pytest.skip(missing)
    (tmp_path / "fri").symlink_to(ROOT / "fri")
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    port = free_port()
    program = "".join(block.code for block in BLOCKS if block.language == "cpp")
    (tmp_path / "own.cpp").write_text(program.replace("connect(30200)", f"connect({port})"))
    run_cmake(
        ["-S", ROOT / "fri" / "client", "-B", tmp_path / "build" / "fri", f"-DROBOT_DIR={robot_folder}"],
        ["--build", tmp_path / "build" / "fri", "--target", "open_fri"],
    )
    (lines,) = (commands(block) for block in BLOCKS if block.code.startswith("cc -std=c99"))
    for line in lines:
        subprocess.run(line.replace("-O2", "-O0"), shell=True, cwd=tmp_path, check=True)
    client = subprocess.Popen([tmp_path / "a.out"])
    robot = [sys.executable, "-m", "fri.robot", "--protocol", "2.7", "--lockstep", "--duration", "2"]
    robot += ["--port", str(port), "--robot", str(plate_folder)]
    done = subprocess.run(robot, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, client.wait(60)) == (0, 0), done.stdout + done.stderr
    assert re.search(r"COMMANDING_ACTIVE", done.stdout), done.stdout
