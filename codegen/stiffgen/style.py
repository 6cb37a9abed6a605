# SPDX-License-Identifier: MIT
"""How every figure looks: one style, one colour for one meaning, ink in the colour of the page."""

from __future__ import annotations

import io
from typing import Any

from matplotlib.figure import Figure

from stiffgen.page import DARK_PAGE, PAGE

INK = "#010203"  # stands for the page's text colour until the SVG is written
CORRECTED, CONVENTIONAL, POTENTIAL = "#1f8fd6", "#e0702a", "#2fa36b"
"""The laws: the paper's stiffness blue, the conventional one orange, the gradient of an energy green."""
AXES = ("#b35fc9", "#c9a227", "#6f8fa3")
"""x, y and z, or whatever else comes in threes and is no law."""
SHADES = (*AXES, "#d6456b", "#4fb0a5", "#8a7ff0", "#9a6b4f")
"""Of the seven joints."""
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
    """SVG text of a figure drawn with STYLE, in the colours of the page it is on."""
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    opening = svg.index(">") + 1
    return svg[:opening] + "\n " + THEME + svg[opening:]
