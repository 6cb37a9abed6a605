# SPDX-License-Identifier: MIT
"""The LBRClient of docs/fri.md: compiled with the stand-in's headers, and led through a session by its callbacks."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from support.pages import blocks
from support.project import ROOT, require_compiler

STANDIN = ROOT / "fri" / "support" / "native" / "standin"
SESSION = (ROOT / "fri" / "support" / "native" / "own_client.cpp").read_text()


@pytest.fixture(scope="module")
def client() -> str:
    [block] = [block for block in blocks(ROOT / "docs" / "fri.md") if block.language == "cpp"]
    assert block.code.count("\n") <= 60
    return block.code


@pytest.mark.parametrize("version", ["115", "205", "207"])
def test_the_pages_client(client: str, version: str, robot_folder: Path, tmp_path: Path) -> None:
    """It waits with torque and position, holds the arm against a push, follows it, and sends no NaN."""
    source = tmp_path / "client.cpp"
    source.write_text(client + SESSION)
    objects = []
    for name in ("iiwa14", "iiwa14_impedance"):
        objects.append(tmp_path / f"{name}.o")
        subprocess.run(["cc", "-std=c99", "-O0", "-c", robot_folder / f"{name}.c", "-o", objects[-1]], check=True)
    command = [require_compiler("g++"), "-std=c++17", "-O0", "-Wall", "-Wextra", "-Werror", f"-I{robot_folder}"]
    command += ["-isystem", str(STANDIN), f"-DSTANDIN_VERSION={version}"]
    subprocess.run([*command, str(source), *objects, "-o", tmp_path / "client", "-lm"], check=True)
    done = subprocess.run([tmp_path / "client"], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("", 0)
