# SPDX-License-Identifier: MIT
"""Fixtures of all folders with tests: what is made once for all workers, and the iiwa 14's folder."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from filelock import FileLock

import stiffgen
from stiffgen import open_robot
from stiffgen.core.emit import build
from support.kept_objects import KeptObjects
from support.project import URDF, Once


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return ``once(name, make)``: a folder of that name, filled by ``make`` in the first worker that asks."""
    base = tmp_path_factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name: str, make: Callable[[Path], object]) -> Path:
        """Return the folder `name`, made by one worker while the others wait."""
        folder, done = root / name, root / f"{name}.made"
        with FileLock(f"{folder}.lock"):
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)  # of one that failed
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return made


@pytest.fixture(scope="session", autouse=True)
def _own_cache(once: Once) -> Iterator[None]:
    """Keep the cache of whoever runs the tests as it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STIFFGEN_CACHE", str(once("cache", lambda folder: None)))
        yield


@pytest.fixture(scope="session", autouse=True)
def kept_objects(once: Once) -> Iterator[KeptObjects]:
    """Compile each C file of generated folders once for all workers, in the process of the tests."""
    kept = KeptObjects(once("objects", lambda folder: None))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "run_all", kept.run)
        yield kept


@pytest.fixture(scope="session")
def robot_folder(once: Once) -> Path:
    """Return the iiwa 14's folder, compiled once for all workers as a user's. Read only.

    STIFFGEN_ROBOT_FOLDER names another one, to see a test fail (tests/campaigns/hazards.py).
    """
    if "STIFFGEN_ROBOT_FOLDER" in os.environ:
        return Path(os.environ["STIFFGEN_ROBOT_FOLDER"])

    def make(output: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("CFLAGS")
            stiffgen.generate(URDF, output=output)

    return once("generated", make) / "iiwa14"


@pytest.fixture(scope="session")
def robot(robot_folder: Path) -> ModuleType:
    return open_robot(robot_folder).module


@pytest.fixture
def mjcf_in_this_process(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let MuJoCo compile MJCF files here, as the reader's script does: its process takes most of a short test.

    tests/files/test_mjcf.py reads files by the script, too. MuJoCo logs into the current folder, an empty one.
    """
    from stiffgen.files import compilation  # a room that the tests of the core go without

    monkeypatch.chdir(tmp_path_factory.mktemp("log"))

    def answer(script: str, file: str, request: dict[str, str], *_: str) -> Any:
        assert script == "compilation.py"
        return json.loads(json.dumps(compilation.answer_for(Path(request["file"]))))

    monkeypatch.setattr("stiffgen.files.mjcf.answer_of", answer)
