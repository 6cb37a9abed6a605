# SPDX-License-Identifier: MIT
"""Describe the wiping tool; ``python -m examples.bowl_wiping.tool`` generates the arm with it.

The paper states the tool's mass and the length to its tip. The shape is our choice; centre of mass and inertia follow.
"""

from __future__ import annotations

import sys

import numpy as np

from examples.experiments.tool import Cylinder, WorkingTool, generate

TOOL_POINT = 0.24
"""[m] from the flange along its z axis to the tool point, the centre of the plate's face: 0.275 m from joint 7."""
PLATE_RADIUS = 0.10
"""[m] of the plate, to the middle of its rounded edge."""
EDGE_RADIUS = 0.005
"""[m] of the edge's rounding."""
EDGE_SPHERES = 72
"""The edge is a ring of so many spheres: a flat plate in a hollow bowl touches with its edge only."""

PLATE = WorkingTool(
    robot="iiwa14_plate",
    point=TOOL_POINT,
    parts=(
        Cylinder(mass=0.255, radius=0.038, start=0.0, end=0.034),  # force/torque sensor
        Cylinder(mass=0.080, radius=0.012, start=0.034, end=0.230, rgba=(0.6, 0.6, 0.62, 1)),  # tube
        Cylinder(mass=0.120, radius=PLATE_RADIUS, start=0.230, end=TOOL_POINT, rgba=(0.1, 0.45, 0.7, 1)),  # plate
    ),
    spheres=tuple(
        (PLATE_RADIUS * float(np.cos(angle)), PLATE_RADIUS * float(np.sin(angle)), TOOL_POINT - EDGE_RADIUS)
        for angle in 2 * np.pi * np.arange(EDGE_SPHERES) / EDGE_SPHERES
    ),
    sphere_radius=EDGE_RADIUS,
)
"""Sensor, tube and plate of 0.455 kg, the paper's mass."""

if __name__ == "__main__":
    sys.exit(generate(PLATE, "python -m examples.bowl_wiping.tool"))
