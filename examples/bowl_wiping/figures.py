# SPDX-License-Identifier: MIT
"""Draw the recorded zero-force trajectory beside the two that inverse kinematics makes."""

from __future__ import annotations

from types import ModuleType

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from examples.bowl_wiping.trajectory import Comparison, recorded
from examples.experiments.motion import SAMPLE_TIME
from examples.style import AXES, INK, SHADES, STYLE, themed_svg


def draw(robot: ModuleType, stated: Comparison, measured: Comparison) -> str:
    """Return the figure as SVG text."""
    with mpl.rc_context(STYLE):
        return themed_svg(trajectory(robot, stated, measured))


def trajectory(robot: ModuleType, stated: Comparison, measured: Comparison) -> Figure:
    """Plot the recorded zero-force trajectory and the two computed ones: the tool point from above, and the joints."""
    record = recorded()
    figure = Figure(figsize=(7.5, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, q, line, colour in (
        ("recorded", record, "-", INK),
        ("stated geometry", stated.q, ":", AXES[1]),
        ("measured geometry", measured.q, "--", AXES[0]),
    ):
        tip = robot.forward_kinematics(q)[:, :3, 3]
        left.plot(tip[:, 0], tip[:, 1], line, color=colour, label=name)
    left.set(xlabel="x [m]", ylabel="y [m]", title="tool point from above", aspect="equal")
    for joint, colour in enumerate(SHADES):
        deviation = np.degrees(measured.q[:, joint] - record[:, joint])
        right.plot(SAMPLE_TIME * np.arange(len(record)), deviation, color=colour, linewidth=0.9, label=f"A{joint + 1}")
    right.set(xlabel="time [s]", ylabel="difference [deg]", title="measured geometry minus recorded")
    right.legend(ncols=2, fontsize=7)
    figure.legend(loc="outside lower center", ncols=3, handles=left.lines)
    return figure
