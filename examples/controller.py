# SPDX-License-Identifier: MIT
"""Draw the picture of docs/controller.md: phases of a step, one reference, one purse.

python -m examples.controller     writes docs/controller_loop.svg (needs matplotlib: the extra examples)
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

ROW, HEIGHT, PURSE = 2.4, 0.9, 0.3
"""Lower edge and height of the phases, and lower edge of the purse."""
PHASES = (
    (1.5, 1.5, "reference r", "moves to $q_0$"),
    (3.9, 1.7, "law", r"$-l\,\partial U/\partial q + B(\dot r - \dot q)$"),
    (6.6, 1.5, "guard", "is it covered?"),
    (9.0, 1.2, "arm", ""),
)
"""Left edge, width, name and content of each phase."""
SIGNALS = ((0.3, 1.5, "$q_0$, $K$"), (3.0, 3.9, "pose of r"), (5.6, 6.6, r"$\tau$"), (8.1, 9.0, r"$\tau$"))
"""Beginning, end and name of each signal along the row."""
PAYMENTS = (
    (1.65, False, "travel\nsupplies"),
    (2.7, True, "moves that\nstretch springs"),
    (4.75, True, "stiffness,\nfeed-forward"),
    (7.35, True, r"$R(\tau) \leq A$"),
    (9.6, False, r"work $\tau \cdot dq$"),
)
"""Place, whether it comes out of the purse, and name of each payment."""


def figure() -> str:
    """Return the SVG text of the controller's block diagram: boxes of phases, signals and payments between them."""
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

    from examples.style import AXES, CORRECTED, INK, POTENTIAL, STYLE, themed_svg

    def box(axes: Axes, x: float, y: float, width: float, colour: str, name: str, content: str) -> None:
        style = "round,pad=0,rounding_size=0.1"
        patch = FancyBboxPatch((x, y), width, HEIGHT, style, facecolor="none", edgecolor=colour, linewidth=1.4)
        axes.add_patch(patch)
        low = 0.32 if content else 0.0
        axes.text(x + width / 2, y + HEIGHT / 2 + low / 2, name, ha="center", va="center")
        axes.text(x + width / 2, y + HEIGHT / 2 - low / 2, content, ha="center", va="center", fontsize=7.5)

    def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
        axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=9, color=INK, shrinkA=0, shrinkB=0))

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 3.2), layout="constrained")
        axes = drawing.subplots()
        axes.set(xlim=(0.2, 10.4), ylim=(0.1, 4.4))
        axes.set_axis_off()
        for (x, width, name, content), colour in zip(PHASES, (POTENTIAL, POTENTIAL, AXES[0], CORRECTED), strict=True):
            box(axes, x, ROW, width, colour, name, content)
        content = "never below what the torques under way can put out"
        box(axes, 1.5, PURSE, 8.7, AXES[1], "purse: A = tank + energy of the springs", content)
        for start, end, name in SIGNALS:
            arrow(axes, (start, ROW + HEIGHT / 2), (end, ROW + HEIGHT / 2))
            axes.text((start + end) / 2, ROW + HEIGHT / 2 + 0.07, name, ha="center", va="bottom", fontsize=7.5)
        for x, is_out, name in PAYMENTS:
            low, high = (x, PURSE + HEIGHT), (x, ROW)
            arrow(axes, *((low, high) if is_out else (high, low)))
            axes.text(x + 0.08, (PURSE + HEIGHT + ROW) / 2, name, ha="left", va="center", fontsize=7.5)
        back = [(9.6, ROW + HEIGHT), (9.6, 4.0), (4.75, 4.0)]
        axes.plot(*zip(*back, strict=True), color=INK, linewidth=1.0)
        arrow(axes, back[-1], (4.75, ROW + HEIGHT))
        axes.text(7.2, 4.06, "q, dq, if the sample is believed", ha="center", va="bottom", fontsize=7.5)
        return themed_svg(drawing)


def draw() -> dict[str, str]:
    """Return SVG texts by file name in docs/."""
    return {"controller_loop.svg": figure()}


def main() -> None:
    """Write the picture."""
    for name, svg in draw().items():
        (ROOT / "docs" / name).write_text(svg)


if __name__ == "__main__":
    main()
