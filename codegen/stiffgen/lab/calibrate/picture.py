# SPDX-License-Identifier: MIT
"""Draw the residuals of a calibration over time."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from stiffgen.core.errors import MissingExtraError, install_command
from stiffgen.lab.calibrate.estimate import Estimate
from stiffgen.lab.calibrate.poses import StandingPoses


def residual_picture(poses: StandingPoses, found: Estimate) -> str:
    """Return an SVG with the residuals of forces and moments at each pose.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    try:
        drawing: Any = import_module("matplotlib.figure")
    except ImportError as error:
        raise MissingExtraError(
            "the picture (--output FILE.svg) needs matplotlib, which is not installed; " + install_command("analyze")
        ) from error
    style: Any = import_module("stiffgen.lab.style")
    has_time = bool(poses.time.any())
    x = poses.time if has_time else range(len(poses))
    with import_module("matplotlib").rc_context(style.STYLE):
        figure = drawing.Figure(figsize=(7, 3.6), layout="constrained")
        # residuals are (P, 6): three forces, three moments
        for k, (axes, unit) in enumerate(zip(figure.subplots(2, 1, sharex=True), ("N", "N m"), strict=True)):
            for channel, (name, colour) in enumerate(zip("xyz", style.AXES, strict=True)):
                axes.plot(x, found.residuals[:, 3 * k + channel], ".-", color=colour, label=name)
            axes.set_ylabel(f"{('force', 'moment')[k]} [{unit}]")
        axes.set_xlabel("time [s]" if has_time else "pose")
        figure.axes[0].legend(ncols=3, loc="upper right")
        text: str = style.themed_svg(figure)
        return text
