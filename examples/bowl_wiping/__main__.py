# SPDX-License-Identifier: MIT
"""Run the bowl-wiping experiment: the paper's law, corrected and conventional, and the potential law.

``python -m examples.bowl_wiping`` in the repository's root, or ``make experiment``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from stiffgen import StiffgenError, open_robot

try:
    import matplotlib  # noqa: F401
    import mujoco  # noqa: F401
    import scipy  # noqa: F401
except ImportError as missing:
    print(f"bowl_wiping: {missing.name} is not installed; pip install 'stiffgen[examples]'", file=sys.stderr)
    sys.exit(2)

from examples.bowl_wiping import analysis, figures, render, report, trajectory, trial
from examples.bowl_wiping.plant import DOF, START_POSTURE, Plant

ROBOT = Path("build/robots/iiwa14_plate")
RESULTS = Path("build/bowl_wiping")
PICTURED = (0.0, 0.26, 0.5, 0.63)
"""Shares of the trial's time at which the rendered picture shows the arm, the last one solid."""


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    try:
        return experiment(options)
    except StiffgenError as error:
        print(f"bowl_wiping: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m examples.bowl_wiping", description=__doc__.splitlines()[0])
    parser.add_argument("--robot", type=Path, default=ROBOT, metavar="DIR", help=f"generated folder (default: {ROBOT})")
    parser.add_argument(
        "--output", type=Path, default=RESULTS, metavar="DIR", help=f"folder to write (default: {RESULTS})"
    )
    parser.add_argument("--sample-time", type=float, choices=(0.005, 0.001), default=0.005, help="[s] (default: 0.005)")
    parser.add_argument("--seed", type=int, default=0, help="of the sensor's noise (default: 0)")
    return parser


def experiment(options: argparse.Namespace) -> int:
    console = Console(stderr=True)
    robot = _robot(options.robot)
    steps = len(trajectory.reference(options.sample_time).time)
    trials = []
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        tasks = [progress.add_task(f"{law} trial", total=steps) for law in trial.LAWS]
        work = progress.add_task("analysis and figures", total=4)
        for law, task in zip(trial.LAWS, tasks, strict=True):
            trials.append(
                trial.run(
                    robot,
                    law,
                    sample_time=options.sample_time,
                    seed=options.seed,
                    progress=lambda task=task: progress.advance(task),  # type: ignore[misc]
                )
            )
        found = analysis.findings(robot, trials)
        progress.advance(work)
        compared = [trajectory.compare(robot, geometry) for geometry in (trajectory.STATED, trajectory.MEASURED)]
        progress.advance(work)
        drawn = figures.draw(robot, trials, *compared)
        progress.advance(work)
        options.output.mkdir(parents=True, exist_ok=True)
        picture = _picture(options.output / report.PICTURE, trials[0]["q"])
        progress.advance(work)
    content = report.Content(
        sample_time=options.sample_time,
        seed=options.seed,
        rows=analysis.summary(found),
        trajectory_rows=analysis.trajectory_rows(*compared),
        figures=drawn,
        picture=picture,
        failed=found.failed_bars(),
    )
    for name, svg in drawn.items():
        (options.output / name).write_text(svg)
    np.savez_compressed(options.output / "traces.npz", **trial.join(trials))  # type: ignore[arg-type]
    (options.output / "report.html").write_text(report.page(content))
    _print(content, console)
    print(options.output / "report.html")
    return 1 if content.failed else 0


def _robot(folder: Path) -> ModuleType:
    """Open the generated arm; refuse one without the experiment's tool, whose stiffness is of another point."""
    if not (folder / "manifest.json").is_file():
        raise StiffgenError(f"{folder} is no generated robot; run 'make {ROBOT}', or name one with --robot")
    robot: ModuleType = open_robot(folder).module
    pose = Plant(bowl=False).pose
    if robot.DOF != DOF or not np.allclose(robot.forward_kinematics(START_POSTURE), pose, atol=1e-9):
        raise StiffgenError(f"{folder} is not the arm with the experiment's tool; 'make {ROBOT}' generates it")
    return robot


def _picture(file: Path, q: np.ndarray) -> bytes | str:
    reason = render.render(q[[round(share * (len(q) - 1)) for share in PICTURED]], file)
    return reason if reason is not None else file.read_bytes()


def _print(content: report.Content, console: Console) -> None:
    for head, rows in (
        (("what", "paper", "measured here", "remark"), content.rows),
        (("trajectory from", "geometry", "largest deviation from the recording", "remark"), content.trajectory_rows),
    ):
        table = Table(*head, show_lines=True)
        for row in rows:
            table.add_row(row.what, row.paper, row.measured, row.remark)
        console.print(table, markup=False)
    if isinstance(content.picture, str):
        console.print(f"no picture of the postures: {content.picture}", markup=False)
    for bar in content.failed:
        console.print(f"bar does not hold: {bar}", markup=False)


if __name__ == "__main__":
    sys.exit(main())
