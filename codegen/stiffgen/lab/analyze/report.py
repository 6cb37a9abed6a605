# SPDX-License-Identifier: MIT
"""Figures and the HTML report of an analysis, for light and for dark pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from stiffgen.core.rendering import environment
from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.lab.analyze.measures import (
    GRID_DECADES,
    GRID_PER_DECADE,
    MEASURES,
    SMALL_MOMENT,
    Envelope,
    Summary,
    stiffness_unit,
)
from stiffgen.lab.analyze.recording import Recording
from stiffgen.lab.page import POLICY
from stiffgen.lab.page import STYLE as PAGE_STYLE

LABELS: Mapping[str, str] = {
    "singular_value_symmetric": "largest singular value, symmetric part, conventional",
    "singular_value_antisymmetric": "largest singular value, antisymmetric part, conventional",
    "corrected_antisymmetric": "largest entry, antisymmetric part, corrected",
    "eigenvalue_smallest": "smallest eigenvalue, corrected",
    "eigenvalue_largest": "largest eigenvalue, corrected",
    "antisymmetric_per_moment": "antisymmetric singular value per moment",
    "antisymmetric_deviation": "standard deviation of the antisymmetric part, from the sensor",
    "eigenvalue_smallest_deviation": "standard deviation of the smallest eigenvalue, from the sensor",
    "closed_form_difference": "largest entry, antisymmetric part less its closed form",
    "force": "force",
    "moment": "moment",
}
"""Rows of the table, in order, with their labels."""
FROM_SENSOR = ("antisymmetric_deviation", "eigenvalue_smallest_deviation")
"""Of these, what only a sensor's calibration gives."""


@dataclass(frozen=True)
class _Line:
    """Measure to draw in one panel, with the measure that is its standard deviation."""

    measure: str
    label: str
    colour: str
    dashes: tuple[float, float] | None = None
    width: float = 1.2
    deviation: str | None = None


def table_rows(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the cells of the measures in LABELS, in the columns of TABLE_HEAD; "" where there is no number."""
    rows = []
    for name, label in LABELS.items():
        measure = summary["measures"][name]
        if not measure["count"] and name in FROM_SENSOR:
            continue
        if not measure["count"]:
            rows.append((label, measure["unit"], *[""] * 7))
            continue
        numbers = [measure.get(key) for key in ("least", "mean", "median", "quantile_99", "most")]
        shown = ["" if number is None else f"{number:.4g}" for number in numbers]
        rows.append((label, measure["unit"], *shown, measure["least_at"], measure["most_at"]))
    return rows


TABLE_HEAD = ("quantity", "unit", "least", "mean", "median", "99 %", "most", "least at", "most at")


def tool_words(chain: Chain) -> str:
    """Return the tool in words: its place on the tip link and its mass, where it has one."""
    if chain.tool is None:
        return "without a tool"
    place = " ".join(f"{x:g}" for x in chain.tool.xyz)
    return f"tool at {place} m, {chain.tool.mass:g} kg"


def statements(recording: Recording, result: Summary, summary: Mapping[str, Any]) -> list[str]:
    """Return the findings in sentences."""
    worst = summary["measures"]["singular_value_antisymmetric"]
    deviation = summary["measures"]["antisymmetric_deviation"]
    within = f" +- {2 * deviation['most']:.2g} by the sensor's noise" if deviation["count"] else ""
    lines = [
        f"{result.good} of {result.rows} rows analysed.",
        "The corrected stiffness is symmetric to the last bit at every row."
        if not result.asymmetric
        else f"The corrected stiffness is NOT symmetric at {result.asymmetric} rows.",
        f"The conventional stiffness is asymmetric by up to {worst['most']:.4g} {worst['unit']}{within} "
        f"({worst['most_at']}).",
        f"The corrected stiffness is indefinite at {100 * summary['share_indefinite']:.3g} % of the rows. It is "
        f"that of wrench and --task-stiffness at the tip of {summary['folder']} ({summary['tool']}); a posture spring "
        "of the controller is not in it.",
        *beside_torque_limits(summary),
    ]
    return lines + list(recording.notes)


BAND = "within two standard deviations of the sensor"
DEFLECTION = 0.1
"""Joint deflection [rad] at which the asymmetry is compared with the torque limits."""


def beside_torque_limits(summary: Mapping[str, Any]) -> list[str]:
    """Return a sentence that compares the asymmetry with the smallest torque limit; none for sliding joints."""
    worst = summary["measures"]["singular_value_antisymmetric"]
    if worst["unit"] != "N m/rad":
        return []
    torque = DEFLECTION * worst["most"]
    line = (
        f"At a joint deflection |dq| of {DEFLECTION:g} rad ({math.degrees(DEFLECTION):.2g} deg) this asymmetry is a "
        f"torque of at most {torque:.3g} N m"
    )
    limit = summary["smallest_torque_limit"]
    if limit is None:
        return [f"{line}; the robot's description has no torque limits to compare with."]
    return [f"{line}, {100 * torque / limit['limit']:.2g} % of the smallest torque limit ({limit['joint']}, "
            f"{limit['limit']:g} N m)."]  # fmt: skip


def bad_rows(recording: Recording, result: Summary, most: int = 5) -> list[str]:
    """Return lines about skipped rows: counts by reason, then the first rows by name."""
    if not result.bad:
        return []
    counts = ", ".join(f"{category} {count}" for category, count in sorted(result.bad.items()))
    lines = [counts]
    lines += [f"{recording.row_name(row)}: {text}" for row, text in result.named[:most]]
    left = sum(result.bad.values()) - min(most, len(result.named))
    if left:
        lines.append(f"and {left} more")
    if result.bad.get("beyond joint limits", 0) > result.rows / 2:
        lines.append(
            "joint positions are read in radians (metres): are these degrees (--q PREFIX:deg), or another order of "
            "joints?"
        )
    return lines


def late_rows(recording: Recording, result: Summary, most: int = 3) -> str:
    """Return a sentence about time that runs backwards, or ""."""
    if not result.backwards:
        return ""
    shown = ", ".join(recording.row_name(row) for row in result.backwards_named[:most])
    more = f" and {result.backwards - most} more" if result.backwards > most else ""
    return f"time runs backwards at {shown}{more}; these rows are analysed, and the figures are drawn over rows"


def warnings(recording: Recording, result: Summary) -> list[str]:
    """Return the reasons to doubt the numbers; empty if there are none."""
    lines = []
    if result.bad:
        head, *rest = bad_rows(recording, result)
        lines.append(f"{sum(result.bad.values())} of {result.rows} rows left out ({head}): " + "; ".join(rest))
    late = late_rows(recording, result)
    return [*lines, late] if late else lines


def write_report(folder: Path, recording: Recording, chain: Chain, result: Summary, summary: Mapping[str, Any]) -> None:
    """Write ``report.html`` and the SVG figures beside it.

    Args:
        folder: folder to write into.
        recording: the recording.
        chain: the robot.
        result: the summary of all rows.
        summary: the contents of ``summary.json``.

    """
    shown = _draw_over_time(folder, chain, result, summary["representation"])
    if summary["measures"]["antisymmetric_per_moment"]["count"]:
        text = (
            f"Rows by moment and antisymmetric part, darker (on a dark page: brighter) where there are more; "
            f"rows below {SMALL_MOMENT} N m are left out of the ratio. The lines have the least and the largest ratio."
        )
        if summary["representation"] != "hybrid":
            text += (
                " In this representation a force, too, makes the stiffness asymmetric: the points need not lie between."
            )
        (folder / "moment.svg").write_text(_moment_figure(chain, result, summary), encoding="utf-8")
        shown.append(("moment.svg", "Antisymmetric part against the moment", text))
    page = (
        environment("stiffgen.lab.analyze", escaped=True)
        .get_template("report.html.j2")
        .render(
            summary=summary,
            statements=statements(recording, result, summary),
            warnings=warnings(recording, result),
            head=TABLE_HEAD,
            table=table_rows(summary),
            figures=shown,
            envelope=result.envelope is not None and result.envelope.shift > 0,
            bin_rows=1 << result.envelope.shift if result.envelope else 1,
            policy=POLICY,
            style=Markup(PAGE_STYLE),
        )
    )
    (folder / "report.html").write_text(page, encoding="utf-8")


def _symmetric_lines(representation: str) -> tuple[list[_Line], str]:
    """Return the lines of the symmetric part, and a sentence that says whether they coincide."""
    from stiffgen.lab.style import CONVENTIONAL, CORRECTED

    parts = [_Line("singular_value_symmetric", "conventional", CONVENTIONAL, width=3.0)]
    if representation == "hybrid":
        parts.append(_Line("singular_value_symmetric", "corrected: the same", CORRECTED, (10, 10), 2.0))
        same = (
            "In the hybrid representation Gamma F is antisymmetric, so that the symmetric part of the conventional "
            "stiffness is the corrected stiffness: the two lines coincide."
        )
    else:
        same = (
            f"In the {representation} representation the corrected stiffness is not this symmetric part: Gamma F has a "
            "symmetric part of its own."
        )
    return parts, same


def _draw_over_time(folder: Path, chain: Chain, result: Summary, representation: str) -> list[tuple[str, str, str]]:
    """Draw the figures over time; return file, title and text of each."""
    from stiffgen.lab.style import AXES, CONVENTIONAL, CORRECTED

    unit = stiffness_unit(chain)
    symmetric = "corrected: 0 at every row" if not result.asymmetric else "corrected (largest entry)"
    share = 100 * result.indefinite / result.good
    parts, same = _symmetric_lines(representation)
    figures = []

    def draw(file: str, title: str, text: str, panels: Mapping[str, Sequence[_Line]]) -> None:
        (folder / file).write_text(_over_time(panels, result), encoding="utf-8")
        figures.append((file, title, text))

    draw(
        "stiffness.svg",
        "Largest singular values of the joint stiffness",
        "Symmetric part (K + K^T)/2 and antisymmetric part (K - K^T)/2 of the conventional stiffness; "
        f"antisymmetric part of the corrected one. {same}",
        {
            f"symmetric part [{unit}]": parts,
            f"antisymmetric part [{unit}]": [
                _Line(
                    "singular_value_antisymmetric", "conventional", CONVENTIONAL, deviation="antisymmetric_deviation"
                ),
                _Line("corrected_antisymmetric", symmetric, CORRECTED),
            ],
        },
    )
    draw(
        "eigenvalues.svg",
        "Eigenvalues of the corrected joint stiffness",
        f"Where the smallest one is negative the stiffness is indefinite: {share:.3g} % of the rows.",
        {
            f"largest [{unit}]": [_Line("eigenvalue_largest", "corrected, largest eigenvalue", CORRECTED)],
            f"smallest [{unit}]": [
                _Line(
                    "eigenvalue_smallest",
                    "corrected, smallest eigenvalue",
                    CORRECTED,
                    deviation="eigenvalue_smallest_deviation",
                )
            ],
        },
    )
    draw(
        "wrench.svg",
        "Wrench of the environment on the robot",
        "As analysed, in the representation named above.",
        {
            f"{part} [{unit}]": [_Line(f"{part}_{axis}", axis, AXES[k]) for k, axis in enumerate("xyz")]
            for part, unit in (("force", "N"), ("moment", "N m"))
        },
    )
    return figures


def _abscissa(result: Summary) -> tuple[FloatArray, str]:
    """Return the places of the bins: time since the first row, or row numbers where time cannot be used."""
    envelope = result.envelope
    assert envelope is not None
    if result.times is not None and not result.backwards:
        span = result.times[1] - result.times[0]
        # A pause longer than all other steps together is a broken clock.
        if span > 0 and (result.longest_step <= span / 2 or result.good < 4):
            middle = np.full(len(envelope.start), np.nan)
            some = envelope.start <= envelope.stop
            middle[some] = (envelope.start[some] + envelope.stop[some]) / 2
            scale, unit = next(
                (s, u) for s, u, least in ((3600, "h", 7200), (60, "min", 600), (1, "s", 0)) if span >= least
            )
            return np.asarray((middle - result.times[0]) / scale, dtype=float), f"time since the first row [{unit}]"
    bins = np.arange(len(envelope.start)) + envelope.first + 0.5
    return np.asarray(bins * 2.0**envelope.shift - 0.5, dtype=float), "row, counted from 0"


def _curves(envelope: Envelope, measure: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, least and most of a measure in each bin; NaN where there is none."""
    index = MEASURES.index(measure)
    some = envelope.count[:, index] > 0
    mean, least, most = (np.full(len(some), np.nan) for _ in range(3))
    mean[some] = envelope.total[some, index] / envelope.count[some, index]
    least[some], most[some] = envelope.least[some, index], envelope.most[some, index]
    return mean, least, most


def _over_time(panels: Mapping[str, Sequence[_Line]], result: Summary) -> str:
    """Draw panels from top to bottom, each with its axis label and lines."""
    x, x_label = _abscissa(result)
    envelope = result.envelope
    assert envelope is not None
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from stiffgen.lab.style import INK, STYLE, themed_svg

    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(8.4, 4.8), layout="constrained")
        axes = drawing.subplots(len(panels), 1, sharex=True)
        for panel, (label, lines) in zip(axes, panels.items(), strict=True):
            for line in lines:
                mean, least, most = _curves(envelope, line.measure)
                if envelope.shift:  # a bin has several rows
                    panel.fill_between(x, least, most, color=line.colour, alpha=0.25, linewidth=0)
                twice = 2 * _curves(envelope, line.deviation)[0] if line.deviation else mean * np.nan
                if (twice > 0).any():
                    panel.fill_between(x, mean - twice, mean + twice, color=INK, alpha=0.25, linewidth=0, label=BAND)
                marker = "o" if (~np.isnan(mean)).sum() < 3 else None  # a single point has no line
                panel.plot(
                    x,
                    mean,
                    linestyle=(0, line.dashes) if line.dashes else "-",
                    linewidth=line.width,
                    color=line.colour,
                    label=line.label,
                    marker=marker,
                    markersize=3,
                )
            if any(line.measure == "eigenvalue_smallest" for line in lines):
                panel.axhline(0, color=INK, linewidth=0.8)
            panel.set_ylabel(label)
            panel.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, ncols=3)
        axes[-1].set_xlabel(x_label)
        return themed_svg(drawing)


def _moment_figure(chain: Chain, result: Summary, summary: Mapping[str, Any]) -> str:
    """Draw the number of rows by moment and antisymmetric part, with lines of the least and the largest ratio."""
    assert result.grid is not None
    import matplotlib as mpl
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import ListedColormap, LogNorm, to_rgba
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    from stiffgen.lab.style import CONVENTIONAL, INK, STYLE, themed_svg

    edges = 10 ** (GRID_DECADES[0] + np.arange(result.grid.shape[0] - 1) / GRID_PER_DECADE)
    counts = result.grid[1:-1, 1:-1].T  # without the bins below and above the grid
    ratio = summary["measures"]["antisymmetric_per_moment"]
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(6.4, 4.8), layout="constrained")
        axes = drawing.subplots()
        shades = ListedColormap([to_rgba(CONVENTIONAL, alpha) for alpha in np.linspace(0.2, 1, 10)])
        top = max(int(counts.max()), 10)
        filled = np.argwhere(counts > 0)
        cells = [[(edges[x + i], edges[y + j]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))] for y, x in filled]
        mesh = PolyCollection(cells, array=counts[tuple(filled.T)], cmap=shades, norm=LogNorm(1, top), linewidth=0)
        axes.add_collection(mesh)
        drawing.colorbar(mesh, ax=axes, label="rows", format="{x:g}").ax.yaxis.set_minor_formatter(NullFormatter())
        spread = np.array([SMALL_MOMENT, edges[-1]])
        for value, style, name in ((ratio["least"], "--", "least"), (ratio["most"], "-", "largest")):
            if value > 0:
                axes.plot(
                    spread,
                    value * spread,
                    style,
                    color=INK,
                    linewidth=1.2,
                    label=f"{name} ratio, {value:.3g} per rad",
                )
        axes.set(xscale="log", yscale="log", xlabel="moment [N m]")
        axes.set_ylabel(f"antisymmetric part, conventional [{stiffness_unit(chain)}]")
        if len(filled):
            (low_y, low_x), (high_y, high_x) = filled.min(axis=0), filled.max(axis=0)
            axes.set_xlim(edges[low_x] / 1.5, edges[high_x + 1] * 1.5)
            axes.set_ylim(edges[low_y] / 1.5, edges[high_y + 1] * 1.5)
        for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("{x:g}" if high < 20 * low else NullFormatter())  # few ticks, or decades alone
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, ncols=2)
        return themed_svg(drawing)
