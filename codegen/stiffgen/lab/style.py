# SPDX-License-Identifier: MIT
"""Style of stiffgen's figures for matplotlib: one colour per meaning, ink in the colour of the page. Public."""

from __future__ import annotations

import io
from typing import Any

from matplotlib.figure import Figure

from stiffgen.lab.page import DARK_PAGE, PAGE

INK = "#010203"  # replaced by the page's text colour when the SVG is written
CORRECTED, CONVENTIONAL, POTENTIAL = "#1f8fd6", "#e0702a", "#2fa36b"
"""Colours of the laws: the paper's stiffness, the conventional stiffness, the gradient of an energy."""
AXES = ("#b35fc9", "#c9a227", "#6f8fa3")
"""Colours of x, y and z, and of other triples."""
SHADES = (*AXES, "#d6456b", "#4fb0a5", "#8a7ff0", "#9a6b4f")
"""Colours of seven joints."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "stiffgen",  # the same bytes every time
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": INK,
    "grid.alpha": 0.15,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "path.simplify_threshold": 0.6,
}
THEME = (
    f"<style>svg{{color:{PAGE[1]};background:{PAGE[0]}}}"
    f"@media(prefers-color-scheme:dark){{svg{{color:{DARK_PAGE[1]};background:{DARK_PAGE[0]}}}}}</style>"
)


def themed_svg(figure: Figure) -> str:
    """Return a figure drawn with STYLE as SVG text, in the colours of the page."""
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    opening = svg.index(">") + 1
    return svg[:opening] + "\n " + THEME + svg[opening:]
