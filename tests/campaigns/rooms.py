# SPDX-License-Identifier: MIT
"""Delete rooms and families in a copy: what is left generates, loads, verifies and passes the kernels' tests.

``tests/house/test_rooms.py`` deletes all rooms at once, and each alone without the kernels' tests.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from importlib.util import cache_from_source
from pathlib import Path

from stiffgen.cli import COMMANDS
from stiffgen.core.family import FAMILIES
from stiffgen.rooms import OPTIONAL
from support.chains import chain_urdf
from support.project import ROOT
from support.pythons import IN_A_CHILD

OUTSIDE = ("fri", "ros2")
"""Folders beside the package that can be taken out as well."""
ROOMS = (*(room for room in OPTIONAL if room != "cli"), *OUTSIDE)
"""The command line is deleted together with the lab, whose commands it runs."""
WITHOUT_KERNELS = ("cpp", "cuda", "jax", "torch", "rounding")
"""Families without a record: backends (``core/emit/registry.py``), and the bounds that a header states."""
ALL_FAMILIES = (*(name for name in FAMILIES if "." not in name), *WITHOUT_KERNELS)
SMALL = chain_urdf("rpm")
"""Robot of three joints, one sliding and one that mimics."""
KERNELS = ("--kernels", "hybrid.joint_stiffness,hybrid.jacobian", "--no-batches", "--no-masses")
"""A small folder, whose verification takes seconds."""
TESTS = tuple(
    f"tests/core/test_{name}.py" for name in ("graph", "spots", "choices", "libraries", "chain", "golden", "connection")
)
"""Unit tests and oracles of the kernels that need no room."""
OF_THE_CORE = tuple(
    f"tests/core/test_{name}.py" for name in ("choices", "description", "golden", "spots", "connection")
)
"""Tests that need no family either."""
LOAD = "import stiffgen; assert stiffgen.load('small.urdf', kernels='limits', controller=False).chain.dof == 2"
COMMAND_LINE = f"""from stiffgen.cli import main
assert main(["generate", "small.urdf", "--name", "small", *{KERNELS}]) == 0
assert main(["verify", "generated/small", "--samples", "20"]) == 0
"""
GENERATE = "import stiffgen; print(stiffgen.generate('{}.urdf', output='whole', build={}))"
GENERATE_EACH = """
def generate(folder):
    os.chdir(folder)
    sys.path.insert(0, os.path.join(folder, "codegen"))
    import stiffgen
    assert stiffgen.__file__.startswith(folder), stiffgen.__file__
    stiffgen.generate("small.urdf", output="whole", build=False)

for folder in sys.argv[1:]:
    in_a_child(generate, folder)
"""
"""Generate the small robot in each folder by its own package."""
ALONE = """import stiffgen
from stiffgen.core.verify.verify import verify
folder = stiffgen.generate("small.urdf", name="small", kernels="hybrid", batches=False, masses=False)
checks = verify(folder, count=20)
assert len(checks) > 30 and all(check.passed for check in checks), [c for c in checks if not c.passed]
"""
"""Generate and verify without the command line."""
_FUNCTION = re.compile(r"^(?:static )?(?:[\w \*]+ )\*?(\w+)\(([^;{]*)\)\s*\{\n(.*?)^\}\n", re.MULTILINE | re.DOTALL)


class House:
    """A copy of what git tracks, without some rooms (``lab.play``) and families (``families.loops``)."""

    def __init__(self, rooms: Collection[str], folder: Path, within: str = "") -> None:
        """Copy the committed files within a folder of the repository, without those of rooms that are to be absent."""
        self.rooms, self.folder = tuple(rooms), folder
        gone = tuple(
            f"{room}/" if room in OUTSIDE else f"codegen/stiffgen/{room.replace('.', '/')}/" for room in self.rooms
        )
        listed = subprocess.run(
            ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"],
            capture_output=True, text=True, check=True,
        ).stdout.splitlines()  # fmt: skip
        for start in gone:
            assert any(file.startswith(start) for file in listed), start
        for file in listed:
            if file.startswith(within) and not file.startswith(gone) and (ROOT / file).exists():
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / file, folder / file)
                self._copy_compiled(file)
        (folder / "small.urdf").write_text(SMALL)

    def _copy_compiled(self, file: str) -> None:
        """Copy what Python has compiled a module to: it stays valid, since the module's copy keeps its time."""
        if file.startswith("codegen/"):
            compiled = Path(cache_from_source(file))
            if (ROOT / compiled).exists():
                (self.folder / compiled).parent.mkdir(exist_ok=True)
                shutil.copy2(ROOT / compiled, self.folder / compiled)

    def run(self, *words: str, **variables: str) -> str:
        """Run Python in the copy and return what it prints."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
        source = str(self.folder / "codegen")
        environment = kept | {"PYTHONPATH": source, "CFLAGS": "-O0", "XDG_CACHE_HOME": str(self.folder)}
        environment |= variables
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
        gone = tuple(f"{room}." for room in self.rooms)
        assert listed & COMMANDS.keys() == {
            name for name, (module, _) in COMMANDS.items() if not module.startswith(gone)
        }
        self.run("-c", COMMAND_LINE + (LOAD if "files" not in self.rooms else ""))

    def generate_and_verify_alone(self) -> None:
        """Generate and verify a small folder without the command line."""
        self.run("-c", ALONE)

    def generated(self, robot: str, *, build: bool) -> Path:
        """Return the folder of a robot, generated by this house."""
        return self.folder / self.run("-c", GENERATE.format(robot, build)).splitlines()[-1]

    def test_kernels(self, tests: Sequence[str] = TESTS, *options: str, **environment: str) -> None:
        """Run unit tests and oracles of the kernels."""
        words = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *options, *tests)
        assert " passed" in self.run(*words, **environment)


def functions_of(folder: Path) -> dict[str, str]:
    """Return the C functions of a robot's folder by file and name."""
    files = [folder / f"{folder.name}{suffix}.c" for suffix in ("", "_batch")]
    return {f"{file.name}: {found[1]}": found[0] for file in files for found in _FUNCTION.finditer(file.read_text())}


def functions_of_each(houses: Mapping[str, House]) -> dict[str, dict[str, str]]:
    """Return the C functions of the small robot, by file and name, as each house prints them."""
    folders = {name: house.folder for name, house in houses.items()}
    next(iter(houses.values())).run("-c", IN_A_CHILD + GENERATE_EACH, *map(str, folders.values()))
    return {name: functions_of(folder / "whole" / "chain") for name, folder in folders.items()}


def main() -> None:
    """Delete each room or family alone, in a copy of the package, and check that the others still work."""
    for room in ROOMS:
        with tempfile.TemporaryDirectory() as folder:
            house = House((room,), Path(folder))
            house.generate_and_verify()
            house.test_kernels()
        print(f"without {room}: generates, verifies, loads, passes the kernels' tests", flush=True)


if __name__ == "__main__":
    main()
