# SPDX-License-Identifier: MIT
"""Identify task stiffness and tool in a simulated recording: ``make identify``, or ``make identify-torch``.

    python -m examples.identify {jax,torch} [--robot FOLDER] [--figure FILE]

Two recordings: one whose pushes move and turn the tool, one whose pushes only move it. Prints what was found beside the
truth; exit code 1 if an entry that the recording determines is off by more than 2 %. The figure shows what each
recording determines.
"""

from __future__ import annotations

import argparse
import importlib
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from examples.identify.recording import (
    LOWER,
    SCALE,
    START,
    UPPER,
    Array,
    Certainty,
    Recording,
    certainty,
    record,
)
from stiffgen import GeneratedRobot, open_robot

PUSHES, NOISE = 2000, 0.01
BOUND = 0.02
"""Largest relative error of an entry."""
DETERMINED = BOUND / 3
"""An entry is called identifiable if its posterior standard deviation is at most this part of it."""
KINDS = {True: "pushes that move and turn the tool", False: "pushes that move it only"}


def identify(robot: GeneratedRobot, recording: Recording, framework: str) -> tuple[Array, Array, int]:
    """Identify task stiffness (6, 6) and tool (3,) by L-BFGS in a framework; also return the number of evaluations."""
    wrapper = importlib.import_module(f"{robot.module.__name__}.{framework}")
    model: Any = importlib.import_module(f"examples.identify.in_{framework}")
    found = minimize(
        model.objective(wrapper, recording), START, jac=True, method="L-BFGS-B",
        options={"maxiter": 2000, "maxfun": 4000, "maxcor": 24, "ftol": 0, "gtol": 1e-6},
    )  # fmt: skip
    factor = np.zeros((6, 6))
    factor[LOWER] = found.x[:21]
    factor *= SCALE[:, None]
    return factor @ factor.T, 0.1 * found.x[21:], int(found.nfev)


def figure(certainties: dict[bool, tuple[Recording, Certainty]]) -> str:
    """Return an SVG: for each recording the certainty of every entry of K, and the singular values of both."""
    import matplotlib as mpl

    mpl.use("svg")
    import matplotlib.pyplot as plt

    from examples.style import CONVENTIONAL, CORRECTED, STYLE, themed_svg

    axes_names = ["x", "y", "z", "rx", "ry", "rz"]
    with plt.rc_context(STYLE):
        drawing, places = plt.subplots(1, 3, figsize=(9.6, 3.3), layout="constrained")
        shown = None
        for axes, (turning, (recording, sure)) in zip(places, certainties.items(), strict=False):
            part = 100 * sure.stiffness / np.abs(recording.task_stiffness)
            shown = axes.imshow(part, cmap="viridis_r", norm=mpl.colors.LogNorm(0.05, 100))
            for row in range(6):
                for column in range(6):
                    value = part[row, column]
                    text = f"{value:.2f}" if value < 9.95 else f"{value:.0f}" if value < 1000 else ">999"
                    axes.text(
                        column, row, text, ha="center", va="center", fontsize=6.5,
                        color="#ffffff" if value > 2 else "#101010",
                    )  # fmt: skip
            axes.set(xticks=range(6), yticks=range(6), xticklabels=axes_names, yticklabels=axes_names)
            axes.set_title(f"{KINDS[turning]}")
            axes.grid(visible=False)
        drawing.colorbar(shown, ax=places[:2], shrink=0.8, label="standard deviation of an entry of K [% of it]")
        for (turning, (_, sure)), colour in zip(certainties.items(), (CORRECTED, CONVENTIONAL), strict=True):
            values = sure.singular_values
            places[2].semilogy(range(1, 25), values, "o-", color=colour, markersize=3, label=KINDS[turning])
        places[2].set(xlabel="direction", ylabel="singular value", title="how strongly a direction shows")
        places[2].legend(fontsize=7)
        svg = themed_svg(drawing)
        plt.close(drawing)
    return svg


def main() -> int:
    """Run the example; options stand in the text of this module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("framework", choices=["jax", "torch"])
    parser.add_argument("--robot", type=Path, default=Path("build/robots/iiwa14_tool"))
    parser.add_argument("--figure", type=Path, help="write the figure there, an SVG")
    options = parser.parse_args()
    if options.framework == "jax":
        import jax

        jax.config.update("jax_enable_x64", True)
    else:
        import torch

        torch.set_num_threads(1)  # its threads wait for one another: matrices of 7 x 7 are too small for them
    robot = open_robot(options.robot)
    wrong = 0
    certainties = {}
    for turning, kind in KINDS.items():
        recording = record(robot.module, PUSHES, NOISE, turning=turning)
        started = time.perf_counter()
        stiffness, tool, evaluations = identify(robot, recording, options.framework)
        took = time.perf_counter() - started
        sure = certainty(robot.module, recording, stiffness, tool)
        certainties[turning] = recording, sure
        truth = recording.task_stiffness
        off = np.abs(stiffness - truth) / np.abs(truth)
        determined = sure.stiffness <= DETERMINED * np.abs(truth)
        worst = off[determined].max(initial=0.0)
        wrong += int((off[determined] > BOUND).sum())
        print(f"{kind}: {PUSHES} of them, {100 * NOISE:.0f} % noise, {evaluations} evaluations in {took:.1f} s")
        print(f"  entries of K identifiable: {int(determined[UPPER].sum())} of 21; off by at most {100 * worst:.2f} %")
        place = ", ".join(
            f"{1000 * each:.2f} +- {1000 * width:.2f}" for each, width in zip(tool, sure.tool, strict=True)
        )
        print(f"  tool at {place} mm, truth {1000 * recording.tool} mm")
        print("  K found, in N/m, N/rad and N m/rad (truth below; * not identifiable):")
        for found, true, known in zip(stiffness, truth, determined, strict=True):
            print("   ", *(f"{value:9.2f}{' ' if yes else '*'}" for value, yes in zip(found, known, strict=True)))
            print("   ", *(f"{value:9.2f} " for value in true))
    if options.figure:
        options.figure.write_text(figure(certainties), encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
