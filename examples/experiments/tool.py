# SPDX-License-Identifier: MIT
"""Describe a tool of the experiments: its parts, its mass and inertia, and what of it can touch.

Simulation (plant.py) and generator read a tool from one description.
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
SENSOR = stiffgen.Sensor("link_ee", sign="robot")
"""Force-torque sensor between flange and tool; MuJoCo's sensors report the wrench of the robot on the tool."""


@dataclass(frozen=True)
class Cylinder:
    """A homogeneous part of the tool on the flange's z axis: mass [kg], radius [m], from where to where [m], colour."""

    mass: float
    radius: float
    start: float
    end: float
    rgba: tuple[float, float, float, float] = (0.2, 0.2, 0.22, 1.0)

    @property
    def middle(self) -> float:
        """Height of its centre of mass above the flange [m]."""
        return (self.start + self.end) / 2

    def inertia(self, height: float) -> NDArray[np.float64]:
        """(ixx, iyy, izz) about a point of the axis at a height above the flange [kg m^2]."""
        across = self.mass * (self.radius**2 / 4 + (self.end - self.start) ** 2 / 12 + (self.middle - height) ** 2)
        return np.array([across, across, self.mass * self.radius**2 / 2])


@dataclass(frozen=True)
class WorkingTool:
    """Tool on the flange's z axis.

    Attributes:
        robot: name of the generated arm with this tool.
        point: from the flange to the tool point [m].
        parts: cylinders with the tool's mass.
        spheres: what touches: centres in the flange's frame [m].
        sphere_radius: their radius [m].

    """

    robot: str
    point: float
    parts: tuple[Cylinder, ...]
    spheres: tuple[tuple[float, float, float], ...]
    sphere_radius: float

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return round(sum(part.mass for part in self.parts), 6)

    @property
    def com(self) -> float:
        """Distance of the centre of mass from the flange [m]."""
        return round(sum(part.mass * part.middle for part in self.parts) / self.mass, 4)

    @property
    def inertia(self) -> NDArray[np.float64]:
        """(ixx, iyy, izz) about the centre of mass, flange axes [kg m^2]."""
        return np.asarray(np.round(np.sum([part.inertia(self.com) for part in self.parts], axis=0), 6))

    def for_generator(self) -> stiffgen.Tool:
        """Return the tool as the generator takes it, in the flange's frame."""
        ixx, iyy, izz = map(float, self.inertia)
        return stiffgen.Tool(
            xyz=(0.0, 0.0, self.point), mass=self.mass, com=(0.0, 0.0, self.com), inertia=(ixx, 0.0, 0.0, iyy, 0.0, izz)
        )


def generate(tool: WorkingTool, program: str, arguments: Sequence[str] | None = None) -> int:
    """Generate and compile the arm with a tool, as a program; print its folder and return the exit code."""
    parser = argparse.ArgumentParser(prog=program, description="Generate the arm with the experiment's tool.")
    parser.add_argument("--output", type=Path, default=Path("build/robots"), metavar="DIR", help="build/robots")
    output: Path = parser.parse_args(arguments).output
    progress = lambda step: print(f"{step} ...", file=sys.stderr)  # noqa: E731
    try:
        arm = tool.for_generator()
        print(stiffgen.generate(URDF, name=tool.robot, tool=arm, sensor=SENSOR, output=output, progress=progress))
    except stiffgen.StiffgenError as error:
        print(error, file=sys.stderr)
        return 2
    return 0
