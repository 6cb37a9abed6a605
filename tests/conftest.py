# SPDX-License-Identifier: MIT
"""Shared fixtures: the golden values, the iiwa 14's chain and model, and its folder, generated and compiled once."""

from __future__ import annotations

import gc
import json
import re
import subprocess
from pathlib import Path

import support.environment  # isort: skip

import numpy as np
import pytest

import stiffgen
from stiffgen.core.emit import build
from stiffgen.core.verify.folder import widths
from support.c_program import STRICT, language_flags
from support.fixtures import _own_cache, kept_objects, mjcf_in_this_process, once, robot, robot_folder
from support.project import ROOT, URDF, Compiled, Once, require_compiler

__all__ = ["_own_cache", "kept_objects", "mjcf_in_this_process", "once", "robot", "robot_folder"]


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
