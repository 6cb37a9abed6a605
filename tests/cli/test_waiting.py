# SPDX-License-Identifier: MIT
"""Silence at a terminal: a command says what it does before it reads, and pipes get nothing of it."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.project import ROOT

STIFFGEN = [sys.executable, "-m", "stiffgen"]
FILE = "robots/arm.urdf"
COMMANDS = {"inspect": ["inspect", FILE], "new": ["new", FILE, "--tip", "nowhere"]}
"""The second ends behind the file, before it generates and says so."""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """Return a folder with a robot's file."""
    (tmp_path / "robots").mkdir()
    shutil.copy(ROOT / "tests" / "data" / "scara.urdf", tmp_path / FILE)
    return tmp_path


def at_a_terminal(command: list[str], folder: Path) -> str:
    """Return all that a command writes to a terminal; its questions get no answer."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs)
    os.close(theirs)
    written = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        written += part
    os.close(ours)
    process.wait()
    return written.decode(errors="replace")


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_terminal_is_told_before_packages_are_loaded_and_the_file_is_read(name: str, here: Path) -> None:
    text = at_a_terminal([*STIFFGEN, *COMMANDS[name]], here)
    assert text.startswith(f"stiffgen {name}: loading packages ...")
    assert f"reading {FILE}" in text


def test_a_pipe_gets_the_result_alone(here: Path) -> None:
    command = [*STIFFGEN, *COMMANDS["inspect"]]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("robot ") and done.stderr == ""
