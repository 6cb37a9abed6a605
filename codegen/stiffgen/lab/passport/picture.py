# SPDX-License-Identifier: MIT
"""Draw the map of a passport: each posture at the place of its tip, in the colour of what it can do."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from stiffgen.lab.drawing import draw_svg
from stiffgen.lab.passport.passport import Passport, Quantity

_LEAST_RANGE = 0.01
"""Half of the least range of a colour bar, over the value: where all postures have one value, it is in the middle."""


def draw_map(passport: Passport) -> str:
    """Return an SVG in the page's colours: stiffness in one panel, the least force of all directions in another.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    shown = [each for each in (passport.quantity("rendered"), _force(passport)) if each is not None]

    def draw(figure: Any, style: Any) -> None:
        for axes, quantity in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            _panel(figure, axes, passport, quantity, style.INK)

    return draw_svg("the map of a passport", (4.3 * len(shown), 4.0), draw)


def _force(passport: Passport) -> Quantity | None:
    """Return the least force of all directions; None for a robot without effort limits."""
    if passport.force is None:
        return None
    least = passport.force.min(axis=1)
    return Quantity(name="force in every direction", unit="N", meaning="", verified="", values=least)


def _panel(figure: Any, axes: Any, passport: Passport, quantity: Quantity, ink: str) -> None:
    """Draw one quantity over reach and height [m], a dot a posture; the worst posture has a ring."""
    scale: Any = import_module("matplotlib.colors")
    across, up = np.linalg.norm(passport.tip[:, :2], axis=1), passport.tip[:, 2]
    values = np.maximum(quantity.values, 1e-9)
    low, high = np.quantile(values, [0.02, 0.98])  # ends of the colours: single extreme postures do not stretch them
    if high < (1 + _LEAST_RANGE) * low:  # else every tick of the bar has one label
        low, high = (1 - _LEAST_RANGE) * low, (1 + _LEAST_RANGE) * high
    wide = high > 5 * low > 0  # values over more than a factor of 5 get a logarithmic scale
    norm = scale.LogNorm(max(low, high / 1e3), high) if wide else scale.Normalize(low, high)
    order = np.argsort(-values)  # the weak postures lie on top
    dots = axes.scatter(
        across[order], up[order], c=values[order], norm=norm, cmap="viridis", s=26, linewidth=0.6, edgecolor=ink
    )
    worst = quantity.worst
    axes.scatter(across[worst], up[worst], s=110, facecolor="none", edgecolor="#d6456b", linewidth=1.6)
    bar = figure.colorbar(dots, ax=axes, label=f"[{quantity.unit}]", extend="both", format="{x:g}")
    bar.ax.yaxis.set_minor_formatter(import_module("matplotlib.ticker").NullFormatter())
    bar.outline.set_edgecolor(ink)  # the darkest colour vanishes on a dark page without a line round it
    axes.plot(0, 0, "s", color=ink, markersize=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="distance from the base's axis [m]", ylabel="height above the base [m]", title=quantity.name)
