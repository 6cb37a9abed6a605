# SPDX-License-Identifier: MIT
"""Fixtures: the arm with the bowl-wiping tool, of the FRI client's tests and of the examples'."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

import stiffgen
from examples.bowl_wiping.tool import PLATE
from stiffgen import open_robot
from support.project import URDF, Once

EXACT = "-ffp-contract=off"
"""Each product and sum is rounded: builds of one robot by other compilers compute the same bits."""


@pytest.fixture(scope="session")
def plate_folder(once: Once) -> Path:
    """Return the folder of the arm with the bowl-wiping tool, compiled once for all workers.

    Its products and sums are rounded each: other builds of it compute the same bits (EXACT),
    so that it need not take the time of -O3.
    """

    def make(output: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CFLAGS", f"-O1 {EXACT}")
            stiffgen.generate(URDF, name=PLATE.robot, tool=PLATE.for_generator(), batches=False, output=output)

    return once("robots", make) / PLATE.robot


@pytest.fixture(scope="session")
def plate(plate_folder: Path) -> ModuleType:
    return open_robot(plate_folder).module
