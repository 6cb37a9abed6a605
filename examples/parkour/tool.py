# SPDX-License-Identifier: MIT
"""Describe the parkour's tool; ``python -m examples.parkour.tool`` generates the arm with it.

The paper does not state this tool. Its length follows from the recording: the board between the obstacles is flattest,
0.9 mm in standard deviation, for a point 32 mm from the flange (trajectory.py, ``flatness``). The shape is our choice.
"""

from __future__ import annotations

import sys

from examples.experiments.tool import Cylinder, WorkingTool, generate

TOOL_POINT = 0.032
"""[m] from the flange along its z axis to the tool point, the ball's centre."""
BALL_RADIUS = 0.015
"""[m]"""

BALL = WorkingTool(
    robot="iiwa14_ball",
    point=TOOL_POINT,
    parts=(
        Cylinder(mass=0.255, radius=0.038, start=0.0, end=0.010),  # force/torque sensor
        Cylinder(mass=0.100, radius=0.010, start=0.010, end=TOOL_POINT, rgba=(0.6, 0.6, 0.62, 1)),
    ),
    spheres=((0.0, 0.0, TOOL_POINT),),
    sphere_radius=BALL_RADIUS,
)

if __name__ == "__main__":
    sys.exit(generate(BALL, "python -m examples.parkour.tool"))
