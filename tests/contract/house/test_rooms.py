# SPDX-License-Identifier: MIT
"""Each room that can be taken out is deleted in a copy: the rest generates, loads, verifies and passes its tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stiffgen.cli import COMMANDS
from stiffgen.rooms import OPTIONAL
from support.project import ROOT

AROUND = ("fri", "ros2")
"""Folders beside the package that can be taken out as well."""
KERNELS = ("--kernels", "hybrid.joint_stiffness,hybrid.jacobian", "--no-batches", "--no-masses")
"""A small folder, whose verification takes seconds."""
TESTS = (
    "tests/unit/lower",
    "tests/unit/emit",
    "tests/unit/robot/test_chain.py",
    "tests/oracle/symbolic/test_golden.py",
    "tests/oracle/symbolic/test_connection.py",
)
"""Unit tests and oracles of the kernels that need no room."""


def copy_without(room: str, target: Path) -> None:
    """Copy what git tracks, but for a room."""
    gone = f"codegen/stiffgen/{room}/" if room in OPTIONAL else f"{room}/"
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"],
        capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    assert any(file.startswith(gone) for file in listed), gone
    for file in listed:
        if not file.startswith(gone) and (ROOT / file).exists():
            (target / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / file, target / file)


@pytest.mark.slow
@pytest.mark.parametrize("room", [*OPTIONAL, *AROUND])
def test_the_others_go_on_without_a_room(room: str, tmp_path: Path) -> None:
    copy_without(room, tmp_path)
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    environment = kept | {"PYTHONPATH": str(tmp_path / "codegen"), "CFLAGS": "-O0", "XDG_CACHE_HOME": str(tmp_path)}

    def run(*words: str) -> str:
        command = [sys.executable, "-m", *words]
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    listed = {line.split()[0] for line in run("stiffgen", "--help").splitlines() if line.startswith("    ")}
    assert listed & COMMANDS.keys() == {
        name for name, (module, _) in COMMANDS.items() if not module.startswith(f"{room}.")
    }
    folder = run("stiffgen", "generate", "urdf/iiwa14.urdf", "--name", "small", *KERNELS).strip()
    run("stiffgen", "verify", folder, "--samples", "20")
    code = (
        "import stiffgen; assert stiffgen.load('urdf/iiwa14.urdf', kernels='limits', controller=False).chain.dof == 7"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True)
    assert " passed" in run("pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *TESTS)
