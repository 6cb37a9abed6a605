"""The controller in the loop with a simulated arm, compiled once for all workers."""

from __future__ import annotations

from pathlib import Path

import pytest
from filelock import FileLock

from support.plant.loop import Loop


@pytest.fixture(scope="session")
def loop(robot_folder: Path, tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Loop:
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "loop"
    with FileLock(str(folder) + ".lock"):
        folder.mkdir(exist_ok=True)
        return Loop(folder, robot_folder)
