# SPDX-License-Identifier: MIT
"""Draw the figures as SVG in the text colour of the page, so that one file suits light and dark pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from examples.experiments.analysis import closed_form
from examples.experiments.motion import APPROACH_TIME
from examples.experiments.trial import LAWS, Trace
from examples.style import AXES, CONVENTIONAL, CORRECTED, INK, POTENTIAL, SHADES, STYLE, themed_svg

Column = Callable[[Trace], Any]

Trials = Mapping[str, Trace]
"""Traces by law."""
LINES = dict(zip(LAWS, ("-", "--", "-.", ":"), strict=True))
COLOURS = dict(zip(LAWS, (CORRECTED, CONVENTIONAL, POTENTIAL, SHADES[3]), strict=True))
CAPTIONS = {
    "antisymmetric.svg": "Largest singular value of the antisymmetric part of the joint stiffness that the controller "
    "applied. With the correction it is zero at every step. Without it, it is the closed form, and follows the moment "
    "at the tool. The vertical line in this and the other figures is the end of the approach.",
    "joints.svg": "Joint positions of the trials; dotted in the text's colour the zero-force trajectory. The distance "
    "from it is the spring's deflection, with which the arm presses on the surface.",
    "wrench.svg": "Forces and moments of the environment on the robot at the tool point in base axes, from the "
    "force/torque sensor, the tool's weight and inertia taken out, mean of three samples.",
    "singular_values.svg": "Largest singular values of both parts of the joint stiffness: applied in the paper's law, "
    "the tangent of the torque in the others. Corrected and conventional symmetric parts differ only as far as the "
    "motions do.",
    "eigenvalues.svg": "Eigenvalues of the symmetric part. Symmetric is not positive definite: where the smallest one "
    "is below zero in the paper's law, which pulls by this matrix, the spring pushes away from its zero-force "
    "position, and damping alone slows it. In the potential law the matrix pulls nothing: it says that the torque "
    "falls as the arm yields, and the energy bounds where that ends.",
    "energy.svg": "Energy account of the controller (docs/energy.md). The paper's law and the Cartesian law have "
    "no energy: what they put out is all that is known. The potential law's tank and springs cover its torques, and "
    "its bound on the work put out grows with the reference's travel alone.",
}
"""Captions of the figures, in the order of the page."""


def draw(robot: ModuleType, trials: Trials) -> dict[str, str]:
    """Draw the figures of the trials.

    Returns:
        File name to SVG text.

    """
    with mpl.rc_context(STYLE):
        return {
            "antisymmetric.svg": themed_svg(antisymmetric(robot, trials)),
            "joints.svg": themed_svg(joints(trials)),
            "wrench.svg": themed_svg(wrench(trials)),
            "singular_values.svg": themed_svg(singular_values(trials)),
            "eigenvalues.svg": themed_svg(eigenvalues(trials)),
            "energy.svg": themed_svg(energy(trials)),
        }


def antisymmetric(robot: ModuleType, trials: Trials) -> Figure:
    """Plot the central figure: largest singular value of the antisymmetric part, with and without the correction."""
    corrected, conventional = trials["corrected"], trials["conventional"]
    figure = Figure(figsize=(7.5, 3.2), layout="constrained")
    axes = figure.subplots()
    _approach(axes)
    axes.plot(conventional["time"], conventional["antisymmetric"], "--", color=CONVENTIONAL, label="conventional")
    axes.plot(corrected["time"], corrected["antisymmetric"], color=CORRECTED, linewidth=2, label="corrected")
    # some 40 dots on the line
    every = slice(None, None, max(1, len(conventional["time"]) // 40))
    form = closed_form(robot, conventional["q"][every], conventional["wrench_used"][every])
    axes.plot(
        conventional["time"][every],
        np.linalg.norm(form, 2, axis=(1, 2)),
        ".",
        color=INK,
        markersize=4,
        label=r"closed form $\frac{1}{2}\,J_r^T [m]_\times J_r$",
    )
    axes.set(
        xlabel="time [s]", ylabel="largest singular value [N m/rad]", title="antisymmetric part of the joint stiffness"
    )
    _legend(figure, axes)
    return figure


def joints(trials: Trials) -> Figure:
    """Plot joint positions of all trials and the zero-force trajectory."""
    figure = Figure(figsize=(7.5, 7.6), layout="constrained")
    panels = figure.subplots(4, 2, sharex=True).ravel()
    corrected, conventional = trials["corrected"], trials["conventional"]
    for joint, axes in enumerate(panels[:7]):
        _approach(axes)
        axes.plot(corrected["time"], np.degrees(corrected["q0"][:, joint]), ":", color=INK, label="zero-force $q_0$")
        _all(axes, trials, _column("q", joint, np.degrees(1)))
        axes.set(title=f"A{joint + 1}", ylabel="angle [deg]")
    last = panels[7]
    _approach(last)
    for joint, colour in enumerate(SHADES):
        difference = np.degrees(corrected["q"][:, joint] - conventional["q"][:, joint])
        last.plot(corrected["time"], difference, color=colour, linewidth=0.9, label=f"A{joint + 1}")
    last.set(title="corrected minus conventional", ylabel="difference [deg]", xlabel="time [s]")
    panels[6].set(xlabel="time [s]")
    last.legend(ncols=4, fontsize=7, loc="upper left", columnspacing=0.8, handlelength=1)
    _legend(figure, panels[0])
    return figure


def wrench(trials: Trials) -> Figure:
    """Plot forces and moments of the environment on the robot at the tool point, in base axes, as controlled on."""
    figure = Figure(figsize=(7.5, 5.2), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    for axes, first, symbol, unit in ((panels[0], 0, "f", "force [N]"), (panels[1], 3, "m", "moment [N m]")):
        _approach(axes)
        for index, (name, colour) in enumerate(zip("xyz", AXES, strict=True)):
            _all(axes, trials, _column("wrench_used", first + index), f"${symbol}_{name}$", colour)
        axes.set(ylabel=unit)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    panels[0].set(title="environment on the robot, tool point, base axes")
    panels[1].set(xlabel="time [s]")
    handles = [Line2D([], [], color=INK, linestyle=LINES[law], label=law) for law in trials]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def singular_values(trials: Trials) -> Figure:
    """Plot the largest singular values of the symmetric and of the antisymmetric part of the joint stiffness."""
    figure = Figure(figsize=(7.5, 4.8), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    for axes, name in zip(panels, ("symmetric", "antisymmetric"), strict=True):
        _approach(axes)
        _all(axes, trials, _column(name))
        axes.set(ylabel="singular value [N m/rad]", title=f"{name} part, largest singular value")
    panels[1].set(xlabel="time [s]")
    _legend(figure, panels[0])
    return figure


def eigenvalues(trials: Trials) -> Figure:
    """Plot the eigenvalues of the symmetric part on an axis with both signs; below, the smallest alone."""
    figure = Figure(figsize=(7.5, 6.2), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for axes, count in zip(panels, (7, 1), strict=True):
        _approach(axes)
        for index in range(count):
            _all(axes, trials, _column("eigenvalues", index))
        axes.axhline(0, color=INK, linewidth=0.8)
        axes.set(ylabel="eigenvalue [N m/rad]")
    panels[0].set_yscale("symlog", linthresh=1.0, linscale=0.6)
    panels[0].set_yticks([-10, -1, 0, 1, 10, 100, 1000], labels=["-10", "-1", "0", "1", "10", "100", "1000"])
    panels[0].minorticks_off()
    panels[0].set(title="all seven; linear between -1 and 1, logarithmic outside")
    panels[1].set(xlabel="time [s]", title="the smallest; below zero, Kq is indefinite")
    _legend(figure, panels[0])
    return figure


def energy(trials: Trials) -> Figure:
    """Plot the controller's energy account: work at the port in all trials, and the account of the potential law."""
    figure = Figure(figsize=(7.5, 5.4), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    potential = trials["potential"]
    for axes in panels:
        _approach(axes)
        axes.set(ylabel="energy [J]")
    for law, trace in trials.items():
        panels[0].plot(trace["time"], trace["port_total"], LINES[law], color=COLOURS[law], label=law)
    for name, label, colour in (
        ("elastic_energy", "elastic", SHADES[0]),
        ("tank_energy", "tank", SHADES[2]),
        ("supplied_total", "bound on the work\nput out", SHADES[3]),
        ("port_total", "put out at the port", POTENTIAL),
    ):
        panels[1].plot(potential["time"], potential[name], color=colour, label=label)
    for axes in panels:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    panels[0].set(title="work put out at the robot's port")
    panels[1].set(xlabel="time [s]", title="the potential law's account")
    return figure


def _column(name: str, index: int | None = None, factor: float = 1.0) -> Column:
    """Return an array of the trace, or one of its columns, times a factor."""
    return lambda trace: factor * (trace[name] if index is None else trace[name][:, index])


def _all(axes: Axes, trials: Trials, column: Column, label: str = "", colour: str = "") -> None:
    """Plot all trials with one line style each; in their colours, or in one colour with one label."""
    for index, (law, trace) in enumerate(trials.items()):
        name = law
        if label:
            name = label if index == 0 else "_"
        axes.plot(trace["time"], column(trace), LINES[law], color=colour or COLOURS[law], label=name)


def _approach(axes: Axes) -> None:
    """Mark the end of the approach."""
    axes.axvline(APPROACH_TIME, color=INK, linewidth=0.8, alpha=0.5)
    axes.margins(x=0.01)


def _legend(figure: Figure, axes: Axes) -> None:
    """Draw one legend below the figure, each label once."""
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside lower center", ncols=len(once))
