# SPDX-License-Identifier: MIT
"""Delete each room that can be taken out, in a copy: the rest generates, loads, verifies and passes the kernels' tests.

``tests/contract/house/test_rooms.py`` deletes all rooms at once, and each alone without the kernels' tests.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection
from pathlib import Path

from stiffgen.cli import COMMANDS
from stiffgen.rooms import OPTIONAL
from support.project import ROOT

ROOMS = (*OPTIONAL, "fri", "ros2")
"""The package's optional rooms, and the folders beside the package that can be taken out as well."""
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
LOAD = "import stiffgen; assert stiffgen.load('urdf/iiwa14.urdf', kernels='limits', controller=False).chain.dof == 7"


class House:
    """A copy of what git tracks, without some rooms."""

    def __init__(self, rooms: Collection[str], folder: Path) -> None:
        self.rooms, self.folder = rooms, folder
        gone = tuple(f"codegen/stiffgen/{room}/" if room in OPTIONAL else f"{room}/" for room in rooms)
        listed = subprocess.run(
            ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"],
            capture_output=True, text=True, check=True,
        ).stdout.splitlines()  # fmt: skip
        for start in gone:
            assert any(file.startswith(start) for file in listed), start
        for file in listed:
            if not file.startswith(gone) and (ROOT / file).exists():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / file, folder / file)

    def run(self, *words: str) -> str:
        """Run Python in the copy and return what it prints."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
        source = str(self.folder / "codegen")
        environment = kept | {"PYTHONPATH": source, "CFLAGS": "-O0", "XDG_CACHE_HOME": str(self.folder)}
        done = subprocess.run(
            [sys.executable, *words],
            cwd=self.folder, env=environment, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def generate_and_verify(self) -> None:
        """Check the list of commands, generate and verify a small folder, and load a robot."""
        printed = self.run("-m", "stiffgen", "--help").splitlines()
        listed = {line.split()[0] for line in printed if line.startswith("    ")}
        present = {name for name, (module, _) in COMMANDS.items() if module.split(".")[0] not in self.rooms}
        assert listed & COMMANDS.keys() == present
        folder = self.run("-m", "stiffgen", "generate", "urdf/iiwa14.urdf", "--name", "small", *KERNELS).strip()
        self.run("-m", "stiffgen", "verify", folder, "--samples", "20")
        self.run("-c", LOAD)

    def test_kernels(self) -> None:
        """Run the unit tests and oracles of the kernels."""
        assert " passed" in self.run("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *TESTS)


def main() -> None:
    """Delete each room alone."""
    for room in ROOMS:
        with tempfile.TemporaryDirectory() as folder:
            house = House((room,), Path(folder))
            house.generate_and_verify()
            house.test_kernels()
        print(f"without {room}: generates, verifies, loads, passes the kernels' tests", flush=True)


if __name__ == "__main__":
    main()
