# SPDX-License-Identifier: MIT
"""Robots of the examples, generated and compiled once for all workers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import stiffgen
from examples import two_arms
from examples.bowl_wiping.__main__ import main as wipe_bowl
from examples.experiments.tool import SENSOR
from examples.parkour.__main__ import main as run_parkour
from examples.parkour.tool import BALL
from examples.stiff_postures import PANDA
from examples.whole_body.plant import URDF as SOLO
from examples.whole_body.stance import FEET
from support.plate import plate, plate_folder
from support.project import URDF, Once

__all__ = ["plate", "plate_folder"]


@pytest.fixture(scope="session")
def ball_folder(once: Once) -> Path:
    """Return the folder of the arm with the parkour's ball."""
    options = {"name": BALL.robot, "tool": BALL.for_generator(), "sensor": SENSOR}
    return once("ball", lambda output: stiffgen.generate(URDF, output=output, **options)) / BALL.robot


@pytest.fixture(scope="session")
def panda(once: Once) -> ModuleType:
    """Return the module of the Panda, without a controller."""
    options = {"tip": "panda_hand", "name": "panda", "controller": False}
    return stiffgen.open_robot(
        once("panda", lambda output: stiffgen.generate(PANDA, output=output, **options)) / "panda"
    ).module


def run_experiment(main: Callable[..., int], *options: object) -> None:
    """Run an experiment by its command line, without a renderer; it returns 1 if a bar does not hold."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MUJOCO_GL", "disable")
        assert main(list(map(str, options))) == 0


@pytest.fixture(scope="session")
def bowl_results(once: Once, plate_folder: Path) -> Path:
    """Return the folder of the whole bowl experiment, run once for all workers."""
    return once("bowl_wiping", lambda folder: run_experiment(wipe_bowl, "--robot", plate_folder, "--output", folder))


@pytest.fixture(scope="session")
def parkour_results(once: Once, ball_folder: Path) -> Path:
    """Return the folder of the parkour at 5 ms, run once for all workers."""
    options = ("--robot", ball_folder, "--sample-time", "0.005", "--output")
    return once("parkour", lambda folder: run_experiment(run_parkour, *options, folder))


@pytest.fixture(scope="session")
def solo_folder(once: Once) -> Path:
    """Return the folder of the quadruped."""
    return (
        once("whole-body", lambda output: stiffgen.generate(SOLO, tip=FEET, floating_base=True, output=output))
        / "solo12"
    )


@pytest.fixture(scope="session")
def solo(solo_folder: Path) -> ModuleType:
    return stiffgen.open_robot(solo_folder).module


@pytest.fixture(scope="session")
def two_arms_folder(once: Once) -> Path:
    """Return the folder of the two iiwa 14 of examples/two_arms.py, with their URDF beside the robot's."""
    return once("two-arms", two_arms.generated)
