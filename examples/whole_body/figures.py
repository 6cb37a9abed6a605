# SPDX-License-Identifier: MIT
"""Draw the example's pictures: softest modes, frequency over load, requested and supplied contact wrench."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from examples.style import AXES, CONVENTIONAL, CORRECTED, INK, POTENTIAL, STYLE, themed_svg
from examples.whole_body.findings import Findings, Loaded
from examples.whole_body.stance import Mode, Stance
from examples.whole_body.trials import APPROACH, PUSHED, Trace, simulated

Array = NDArray[np.float64]

LEGS = ("FL", "FR", "HL", "HR")
LARGEST = 0.07
"""[m] that the farthest point moves in a picture of a mode."""


def draw(findings: Findings) -> dict[str, str]:
    """Return SVG texts by file name."""
    with mpl.rc_context(STYLE):
        return {
            "modes.svg": themed_svg(_modes(findings.standing)),
            "load.svg": themed_svg(_load(findings.loads)),
            "wall.svg": themed_svg(_wall(findings.pressing, findings.not_supplied)),
        }


def skeleton(stance: Stance) -> list[Array]:
    """Return lines (points, 3) [m], by MuJoCo: the trunk's outline through the hips, and each leg."""
    plant = simulated(stance)
    place = {plant.model.body(k).name: np.array(plant.data.xpos[k]) for k in range(plant.model.nbody)}
    hips = [place[f"{leg}_SHOULDER"] for leg in ("FL", "FR", "HR", "HL", "FL")]
    parts = ("SHOULDER", "UPPER_LEG", "LOWER_LEG", "FOOT")
    return [np.array(hips), *(np.array([place[f"{leg}_{part}"] for part in parts]) for leg in LEGS)]


def _projected(points: Array) -> Array:
    """Return points seen from the front left, above: (points, 2)."""
    turn, tilt = np.radians(35), np.radians(20)
    x, y, z = points.T
    right = x * np.cos(turn) + y * -np.sin(turn)
    away = x * np.sin(turn) + y * np.cos(turn)
    return np.stack([right, z * np.cos(tilt) + away * np.sin(tilt)], axis=1)


def _modes(loaded: Loaded) -> Figure:
    """Draw the softest modes as skeletons, displaced both ways."""
    stance, count = loaded.stance, len(loaded.rows)
    figure = Figure(figsize=(7.8, 4.6), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    rest = skeleton(stance)
    for axes, row in zip(panels, loaded.rows, strict=False):
        for sign, colour in ((1, CORRECTED), (-1, POTENTIAL)):
            moved = skeleton(_displaced(stance, row.mode, sign, rest))
            for line in moved:
                axes.plot(*_projected(line).T, color=colour, linewidth=1.6, solid_joinstyle="round")
        for line in rest:
            axes.plot(*_projected(line).T, color=INK, linewidth=1.0, alpha=0.5)
        axes.set(title=f"{row.mode.frequency:.2f} Hz: {row.direction}", aspect="equal", xticks=[], yticks=[],
                 xlim=(-0.36, 0.36), ylim=(-0.12, 0.38))  # fmt: skip
        axes.grid(False)
        axes.spines[:].set_visible(False)
    for axes in panels[count:]:
        axes.set_axis_off()
        for text, colour, at in (("at rest", INK, 0.7), ("one way", CORRECTED, 0.5), ("the other", POTENTIAL, 0.3)):
            axes.plot([0.1, 0.3], [at, at], color=colour, linewidth=1.6, alpha=0.5 if colour == INK else 1)
            axes.text(0.36, at, text, va="center")
        axes.set(xlim=(0, 1), ylim=(0, 1))
    return figure


def _displaced(stance: Stance, mode: Mode, sign: int, rest: list[Array]) -> Stance:
    """Move the stance along a mode until its farthest point has moved LARGEST."""
    small = 1e-4 / np.abs(mode.direction).max()
    moved = skeleton(stance.moved(small * mode.direction))
    farthest = max(float(np.linalg.norm(a - b, axis=1).max()) for a, b in zip(moved, rest, strict=True))
    return stance.moved(sign * small * LARGEST / farthest * mode.direction)


def _load(loads: list[Loaded]) -> Figure:
    """Draw the softest mode [Hz] over the load [N]: predicted, without the base's term, simulated."""
    figure = Figure(figsize=(7.8, 3.3), layout="constrained")
    axes = figure.subplots()
    force = [loaded.force for loaded in loads]
    axes.axhspan(-2, 0, color=INK, alpha=0.06, linewidth=0)
    axes.plot(force, [loaded.softest for loaded in loads], color=CORRECTED, linewidth=2, label="predicted")
    axes.plot(force, [loaded.softest_without for loaded in loads], "--", color=CONVENTIONAL, linewidth=2,
              label="predicted without\nthe base's term")  # fmt: skip
    found = [(loaded.force, loaded.found) for loaded in loads if loaded.found is not None]
    ring: dict[str, Any] = {"markersize": 6, "markerfacecolor": "none", "markeredgewidth": 1.5}
    axes.plot(*np.array(found).T, "o", color=INK, label="found in simulation", clip_on=False, zorder=5, **ring)
    axes.text(2, -0.14, "below zero: falls over, rate over 2 pi", fontsize=8, va="top")
    axes.set(xlabel="load on the base [N]; the robot weighs 24.5 N", ylabel="softest mode [Hz]",
             xlim=(0, max(force)), ylim=(-1.0, 1.5))  # fmt: skip
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _wall(pressing: Trace, not_supplied: Trace) -> Figure:
    """Draw asked and supplied wrench on the base, and how far the base moves [mm]."""
    figure = Figure(figsize=(7.8, 5.4), layout="constrained")
    force, moment, base = figure.subplots(3, 1, sharex=True)
    weight = pressing.asked[0, 2]  # [N] that the ground bears at rest
    for axes, entries, names in (
        (force, (0, 2), ("forward", "up, less the weight")),
        (moment, (4, 5), ("pitch", "yaw")),
    ):
        for entry, name, colour in zip(entries, names, AXES, strict=False):
            shift = weight if entry == 2 else 0.0
            axes.plot(
                pressing.time, pressing.asked[:, entry] - shift, color=colour, linewidth=2, label=f"{name}: asked"
            )
            axes.plot(pressing.time, pressing.supplied[:, entry] - shift, color=INK, linewidth=0.9, alpha=0.8,
                      label=f"{name}: ground gives")  # fmt: skip
    force.set(ylabel="force on the base [N]", ylim=(-2, 7))
    moment.set(ylabel="moment [N m]", ylim=(-1.3, 0.5))
    for trace, colour, label in (
        (pressing, POTENTIAL, "legs give what is asked"),
        (not_supplied, CONVENTIONAL, "they do not"),
    ):
        away = 1000 * np.linalg.norm(trace.base - pressing.base[0], axis=1)
        base.plot(trace.time, away, color=colour, linewidth=1.6, label=label)
    base.set(xlabel="time [s]", ylabel="base from its\nstart [mm]", xlim=(0, pressing.time[-1]), ylim=(0, None))
    for axes in (force, moment, base):
        for at, text in ((APPROACH[0], "the spring moves into the wall"), (PUSHED[0], "push from the side")):
            axes.axvline(at, color=INK, linewidth=0.8, alpha=0.5)
            if axes is force:
                axes.text(at + 0.03, 6.9, text, fontsize=8, va="top")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    return figure


__all__: Any = ["draw", "skeleton"]
