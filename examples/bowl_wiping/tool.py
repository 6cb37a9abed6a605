# SPDX-License-Identifier: MIT
"""Describe the experiment's wiping tool; ``python -m examples.bowl_wiping.tool`` generates the arm with the tool.

The paper states the tool's mass and the length to its tip. The shape is our choice; centre of mass and inertia follow.
Simulation (plant.py) and generator read the tool's data from this module.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stiffgen

URDF = Path(__file__).resolve().parents[2] / "urdf" / "iiwa14.urdf"
NAME = "iiwa14_plate"
"""The generated robot, arm and tool."""

TOOL_POINT = 0.24
"""[m] from the flange along its z axis to the tool point, the centre of the plate's face: 0.275 m from joint 7."""
PLATE_RADIUS = 0.10
"""[m] of the plate, to the middle of its rounded edge."""


@dataclass(frozen=True)
class Cylinder:
    """A homogeneous part of the tool on the flange's z axis: mass [kg], radius [m], from where to where [m]."""

    mass: float
    radius: float
    start: float
    end: float

    @property
    def middle(self) -> float:
        """Height of its centre of mass above the flange [m]."""
        return (self.start + self.end) / 2

    def inertia(self, height: float) -> NDArray[np.float64]:
        """(ixx, iyy, izz) about a point of the axis at a height above the flange [kg m^2]."""
        across = self.mass * (self.radius**2 / 4 + (self.end - self.start) ** 2 / 12 + (self.middle - height) ** 2)
        return np.array([across, across, self.mass * self.radius**2 / 2])


PARTS = (
    Cylinder(mass=0.255, radius=0.038, start=0.0, end=0.034),  # force/torque sensor
    Cylinder(mass=0.080, radius=0.012, start=0.034, end=0.230),  # tube
    Cylinder(mass=0.120, radius=PLATE_RADIUS, start=0.230, end=TOOL_POINT),  # plate
)
MASS = round(sum(part.mass for part in PARTS), 6)
"""[kg], the paper's 0.455."""
COM = round(sum(part.mass * part.middle for part in PARTS) / MASS, 4)
"""[m] from the flange along its z axis."""
INERTIA: NDArray[np.float64] = np.round(np.sum([part.inertia(COM) for part in PARTS], axis=0), 6)
"""(ixx, iyy, izz) about the centre of mass, flange axes [kg m^2]."""


def tool() -> stiffgen.Tool:
    """Return the tool as the generator takes it, in the flange's frame."""
    ixx, iyy, izz = map(float, INERTIA)
    return stiffgen.Tool(
        xyz=(0.0, 0.0, TOOL_POINT), mass=MASS, com=(0.0, 0.0, COM), inertia=(ixx, 0.0, 0.0, iyy, 0.0, izz)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Generate and compile the arm with the tool; prints its folder."""
    parser = argparse.ArgumentParser(prog="python -m examples.bowl_wiping.tool", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/robots"), metavar="DIR", help="build/robots")
    output: Path = parser.parse_args(arguments).output
    progress = lambda step: print(f"{step} ...", file=sys.stderr)  # noqa: E731
    try:
        print(stiffgen.generate(URDF, name=NAME, tool=tool(), output=output, progress=progress))
    except stiffgen.StiffgenError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
