# SPDX-License-Identifier: MIT
"""Draw the residuals of a calibration over time."""

from __future__ import annotations

from typing import Any

from stiffgen.lab.calibrate.estimate import Estimate
from stiffgen.lab.calibrate.poses import StandingPoses
from stiffgen.lab.drawing import draw_svg


def residual_picture(poses: StandingPoses, found: Estimate) -> str:
    """Return an SVG with the residuals of forces and moments at each pose.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    has_time = bool(poses.time.any())
    x = poses.time if has_time else range(len(poses))

    def draw(figure: Any, style: Any) -> None:
        """Draw the residuals over time or pose: forces [N] above, moments [N m] below."""
        # residuals are (P, 6): three forces, three moments
        for k, (axes, unit) in enumerate(zip(figure.subplots(2, 1, sharex=True), ("N", "N m"), strict=True)):
            for channel, (name, colour) in enumerate(zip("xyz", style.AXES, strict=True)):
                axes.plot(x, found.residuals[:, 3 * k + channel], ".-", color=colour, label=name)
            axes.set_ylabel(f"{('force', 'moment')[k]} [{unit}]")
        axes.set_xlabel("time [s]" if has_time else "pose")
        figure.axes[0].legend(ncols=3, loc="upper right")

    return draw_svg("the picture (--output FILE.svg)", (7, 3.6), draw)
