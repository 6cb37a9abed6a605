# SPDX-License-Identifier: MIT
"""Shared fixtures: the golden values, the iiwa 14's chain and model, and its folder, generated and compiled once."""

from __future__ import annotations

import gc
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

# Matrices here are small: threads of the linear algebra would only keep the workers from their cores.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
# Folders of single tests are compiled without optimisation, much faster than a release; `robot_folder` is a release.
os.environ.setdefault("CFLAGS", "-O0")

import numpy as np
import pytest
from filelock import FileLock

import stiffgen
from stiffgen import open_robot
from stiffgen.emit import build
from stiffgen.verify import widths
from support.c_program import STRICT, language_flags
from support.kept_objects import KeptObjects
from support.project import ROOT, URDF, Compiled, Once, require_compiler


def pytest_collection_finish() -> None:
    """Spare the garbage collector the modules and tests: a third of the time of an FRI session."""
    gc.collect()
    gc.freeze()


class Sample:
    """One state of the golden file: attributes of arrays, and ``by[representation]`` with the results."""

    def __init__(self, data: dict) -> None:
        self.q, self.wrench, self.task_stiffness, self.pose = (
            np.array(data[key]) for key in ("q", "wrench", "task_stiffness", "pose")
        )
        self.by = {
            rep: {key: np.array(value) for key, value in data[rep].items()} for rep in ("body", "spatial", "hybrid")
        }
        self.potential = {key: np.array(value) for key, value in data["potential"].items()}


@pytest.fixture(scope="session")
def golden() -> list[Sample]:
    data = json.loads((ROOT / "tests" / "data" / "golden_iiwa14.json").read_text())
    return [Sample(sample) for sample in data["samples"]]


@pytest.fixture(scope="session")
def chain() -> stiffgen.Chain:
    return stiffgen.load_chain(URDF, tip="link_ee")


@pytest.fixture(scope="session")
def model(chain: stiffgen.Chain) -> stiffgen.StiffnessModel:
    return stiffgen.StiffnessModel(chain)


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return ``once(name, make)``: a folder of that name, filled by ``make`` in the first worker that asks."""
    base = tmp_path_factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def made(name: str, make: Callable[[Path], object]) -> Path:
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
def kept_objects(once: Once) -> Iterator[KeptObjects]:
    """Compile each C file of generated folders once for all workers, in the process of the tests."""
    kept = KeptObjects(once("objects", lambda folder: None))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "_run", kept.run)
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
def unoptimised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile folders, and libraries of verify, without optimisation: for tests that do not look at the compiler."""
    monkeypatch.setenv("CFLAGS", "-O0")
    monkeypatch.setattr(build, "_FAST_TO_COMPILE", ("-O0",))


@pytest.fixture
def narrowest_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let verify build batches of one width alone: for tests that do not look at vectors."""
    monkeypatch.setattr(widths, "WIDTHS", widths.WIDTHS[:2])


@pytest.fixture(scope="session")
def compiled(once: Once, robot_folder: Path) -> Compiled:
    """Return a function that compiles the iiwa 14 without a warning, once for all workers."""

    def made(compiler: str, language: str, level: str) -> Path:
        command = [require_compiler(compiler), *language_flags(language), level, *STRICT, "-fno-stack-protector"]
        sources = [robot_folder / "iiwa14.c", robot_folder / "iiwa14_batch.c"]
        name = re.sub(r"\W+", "_", f"object {compiler} {language} {level}")
        linked = ["-r", "-nostdlib", *map(str, sources)]
        return once(name, lambda folder: subprocess.run([*command, *linked, "-o", folder / "o"], check=True)) / "o"

    return made
