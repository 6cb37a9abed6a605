# SPDX-License-Identifier: MIT
"""Fixtures: the arm with the bowl-wiping tool, of the FRI client's tests and of the examples'."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

import stiffgen
from stiffgen import Sensor, Tool, open_robot
from support.project import URDF, Once

NAME = "iiwa14_plate"
TOOL = Tool(
    xyz=(0.0, 0.0, 0.24),
    mass=0.455,
    com=(0.0, 0.0, 0.0947),
    inertia=(0.00469, 0.0, 0.0, 0.00469, 0.0, 0.00079),
)
"""Sensor, tube and plate of examples/bowl_wiping, bit for bit."""
SENSOR = Sensor("link_ee", sign="robot")
"""Sensor between flange and tool; it reports the wrench of the robot on the tool, as MuJoCo's do."""
PAYLOAD = (0.455, 0.0, 0.0, 0.455 * 0.0947)
"""Mass and first moment of the tool about the sensor's origin, in sensor axes [kg, kg m]."""
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
            stiffgen.generate(URDF, name=NAME, tool=TOOL, sensor=SENSOR, batches=False, output=output)

    return once("robots", make) / NAME


@pytest.fixture(scope="session")
def plate(plate_folder: Path) -> ModuleType:
    return open_robot(plate_folder).module
