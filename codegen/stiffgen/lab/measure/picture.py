# SPDX-License-Identifier: MIT
"""Draw the antisymmetric residual of a measurement, block by block, before and after the sensor's errors found."""

from __future__ import annotations

from typing import Any

import numpy as np

from stiffgen.lab.drawing import draw_svg
from stiffgen.lab.measure.residual import NORMAL, UPPER, Residual

_BLOCKS = (
    (0, 0, "force by translation\n[N/m]"),
    (0, 1, "force by rotation\n[N/rad]"),
    (1, 1, "moment by rotation\n[N m/rad]"),
)
_ROWS, _COLUMNS = ("fx", "fy", "fz", "mx", "my", "mz"), ("x", "y", "z", "rx", "ry", "rz")


def residual_picture(found: Residual) -> str:
    """Return an SVG with the 15 entries of the residual in three blocks, with 95 % intervals.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    spread = NORMAL * np.sqrt(np.diag(found.covariance))

    def draw(figure: Any, style: Any) -> None:
        panes = figure.subplots(1, 3, width_ratios=[3, 9, 3])
        for axes, (row, column, title) in zip(panes, _BLOCKS, strict=True):
            entries = np.flatnonzero((UPPER[0] // 3 == row) & (UPPER[1] // 3 == column))
            x = np.arange(len(entries), dtype=float)
            axes.axhline(0.0, color=style.INK, linewidth=0.6)
            for values, colour, marker, name, shift in (
                (found.values, style.CONVENTIONAL, "o", "measured", -0.12),
                (found.left, style.CORRECTED, "s", "without the errors found", 0.12),
            ):
                axes.errorbar(
                    x + shift, values[entries], spread[entries], fmt=marker, color=colour, markersize=4, capsize=2,
                    label=name,
                )  # fmt: skip
            axes.set_xticks(x, [f"{_ROWS[UPPER[0][k]]} by {_COLUMNS[UPPER[1][k]]}" for k in entries], rotation=60)
            axes.set_title(title)
        figure.legend(*panes[1].get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return draw_svg("the picture", (8, 3.2), draw)
