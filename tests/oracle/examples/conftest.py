# SPDX-License-Identifier: MIT
"""Robots of the examples, generated and compiled once for all workers."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

import stiffgen
from examples.parkour.tool import BALL
from examples.whole_body.plant import URDF as SOLO
from examples.whole_body.stance import FEET
from support.plate import plate, plate_folder
from support.project import URDF, Once

__all__ = ["plate", "plate_folder"]


@pytest.fixture(scope="session")
def ball_folder(once: Once) -> Path:
    """Return the folder of the arm with the parkour's ball."""
    options = {"name": BALL.robot, "tool": BALL.for_generator()}
    return once("ball", lambda output: stiffgen.generate(URDF, output=output, **options)) / BALL.robot


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
