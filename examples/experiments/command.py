# SPDX-License-Identifier: MIT
"""Run an experiment as a program: trials side by side in processes, then analysis, figures, film and report."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, fields
from multiprocessing import Array as SharedArray
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from examples.experiments import render, report
from examples.experiments.motion import Motion
from examples.experiments.plant import DOF, Plant
from examples.experiments.tool import WorkingTool
from examples.experiments.trial import Trace, join, run
from stiffgen import StiffgenError, open_robot

Trials = dict[float, dict[str, Trace]]
"""Traces by sample time [s] and law."""


@dataclass(frozen=True)
class Experiment:
    """An experiment.

    Attributes:
        name: of its package in examples/ and of the folder of its results.
        tool: the arm's tool.
        laws: the trials.
        sample_times: of the controller [s]; the figures and the stored traces are of the first.
        motion: equilibrium's motion at a sample time.
        plant: arm over its surface, with a time step [s] and start configuration, and without the surface.
        camera: view of the rendered picture.
        pictured: shares of the trial's time at which the picture shows the arm, the last one solid.

    """

    name: str
    tool: WorkingTool
    laws: tuple[str, ...]
    sample_times: tuple[float, ...]
    motion: Callable[[float], Motion]
    plant: Callable[..., Plant]
    camera: render.Camera
    pictured: tuple[float, ...]

    @property
    def robot(self) -> Path:
        """Folder of the generated arm."""
        return Path("build/robots") / self.tool.robot

    @property
    def results(self) -> Path:
        """Folder of the results."""
        return Path("build") / self.name


_Describe = Callable[[ModuleType, Trials], report.Content]
TRACES = "traces.npz"
"""File of the trials at the first sample time."""
_DONE: Any = None
"""Steps that each trial has done, shared by the processes."""


def main(experiment: Experiment, describe: _Describe, arguments: Sequence[str] | None = None) -> int:
    """Run the experiment's program.

    Args:
        experiment: the experiment.
        describe: analyses the trials and draws the figures.
        arguments: of the command line.

    Returns:
        Exit code: 0 if all bars hold, 1 if one fails, 2 if input is refused.

    """
    options = _parser(experiment).parse_args(arguments)
    try:
        return _experiment(experiment, describe, options)
    except StiffgenError as error:
        print(f"{experiment.name}: {error}", file=sys.stderr)
        return 2


def _parser(experiment: Experiment) -> argparse.ArgumentParser:
    """Return the parser of an experiment's command."""
    first, *more = experiment.sample_times
    others = f", and {', '.join(f'{each:g}' for each in more)} for the table" if more else ""
    parser = argparse.ArgumentParser(
        prog=f"python -m examples.{experiment.name}",
        description="Run the experiment in simulation, usually in a minute or two on two free cores.",
    )
    parser.add_argument(
        "--robot", type=Path, default=experiment.robot, metavar="DIR", help=f"generated folder ({experiment.robot})"
    )
    parser.add_argument(
        "--output", type=Path, default=experiment.results, metavar="DIR", help=f"folder to write ({experiment.results})"
    )
    parser.add_argument(
        "--sample-time", type=float, choices=(0.005, 0.001), help=f"of the controller [s] ({first:g}{others})"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the sensor's noise (0)")
    return parser


def _experiment(experiment: Experiment, describe: _Describe, options: argparse.Namespace) -> int:
    """Run the trials, write report, figures, picture and film, and return 1 if a bar does not hold."""
    console = Console(stderr=True)
    robot = open_arm(experiment, options.robot)
    times = (options.sample_time,) if options.sample_time else experiment.sample_times
    bar = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"), TimeRemainingColumn())
    with Progress(*bar, console=console) as progress:
        trials = _trials(experiment, options, times, progress)
        work = progress.add_task("analysis and figures", total=3)
        content = describe(robot, trials)
        progress.advance(work)
        options.output.mkdir(parents=True, exist_ok=True)
        q = next(iter(trials[times[0]].values()))["q"]
        picture, film = options.output / report.PICTURE, options.output / report.FILM
        # without MuJoCo or a display there is none
        content.picture = _made(render.picture, experiment, q[_places(experiment.pictured, len(q))], picture)
        progress.advance(work)
        content.film = _made(render.film, experiment, q[:: round(1 / (render.FRAMES_PER_SECOND * times[0]))], film)
        progress.advance(work)
    content.sample_times, content.seed = times, options.seed
    _write(options.output, content, list(trials[times[0]].values()))
    _print(content, console)
    print(options.output / "report.html")
    return 1 if content.failed else 0


def _made(draw: Callable[[str, Any, Path], str | None], experiment: Experiment, q: Any, file: Path) -> bytes | str:
    """Draw a picture or a film; return its bytes, or why there is none."""
    reason = draw(experiment.name, q, file)
    return file.read_bytes() if reason is None else reason


def _places(shares: Sequence[float], count: int) -> list[int]:
    return [round(share * (count - 1)) for share in shares]


def open_arm(experiment: Experiment, folder: Path) -> ModuleType:
    """Open the generated arm; refuse one without the experiment's tool, whose stiffness is of another point."""
    if not (folder / "manifest.json").is_file():
        raise StiffgenError(f"{folder} is no generated robot; run 'make {experiment.robot}', or name one with --robot")
    robot: ModuleType = open_robot(folder).module
    plant = experiment.plant(surface=False)
    fits = robot.DOF == DOF and hasattr(robot, "sensor")
    if not fits or not np.allclose(robot.forward_kinematics(plant.q), plant.pose, atol=1e-9):
        raise StiffgenError(
            f"{folder} is not the arm with the experiment's tool and sensor; 'make {experiment.robot}' generates it"
        )
    return robot


def _trials(experiment: Experiment, options: argparse.Namespace, times: Sequence[float], progress: Progress) -> Trials:
    """Run all trials, as many at once as there are processors."""
    jobs = [(law, sample_time) for sample_time in times for law in experiment.laws]
    done = SharedArray("l", len(jobs), lock=False)
    tasks = [
        progress.add_task(f"{law}, {1e3 * sample_time:g} ms", total=len(experiment.motion(sample_time).time))
        for law, sample_time in jobs
    ]
    workers = min(len(jobs), len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)
    with ProcessPoolExecutor(workers, initializer=_share, initargs=(done,)) as pool:
        futures: list[Future[Trace]] = [
            pool.submit(_trial, experiment, options.robot, law, sample_time, options.seed, index)
            for index, (law, sample_time) in enumerate(jobs)
        ]
        while not all(future.done() for future in futures):
            for task, count in zip(tasks, done, strict=True):
                progress.update(task, completed=count)
            time.sleep(0.2)
        traces = [future.result() for future in futures]
    trials: Trials = {sample_time: {} for sample_time in times}
    for (law, sample_time), trace in zip(jobs, traces, strict=True):
        trials[sample_time][law] = trace
    return trials


def _share(done: Any) -> None:
    global _DONE
    _DONE = done


def _trial(experiment: Experiment, folder: Path, law: str, sample_time: float, seed: int, index: int) -> Trace:
    def advance() -> None:
        _DONE[index] += 1

    robot = open_robot(folder).module
    plant, motion = experiment.plant(sample_time), experiment.motion(sample_time)
    return run(robot, law, plant, motion, seed=seed, progress=advance)


def _write(output: Path, content: report.Content, trials: list[Trace]) -> None:
    for name, svg in content.figures.items():
        (output / name).write_text(svg)
    np.savez_compressed(output / TRACES, **join(trials))  # type: ignore[arg-type]
    (output / "report.html").write_text(report.page(content))


def read_traces(experiment: Experiment, folder: Path) -> dict[str, Trace]:
    """Return the trials of an experiment, by law, as its program wrote them into a folder.

    Raises:
        StiffgenError: the folder has none.

    """
    file = folder / TRACES
    if not file.exists():
        raise StiffgenError(f"{file}: does not exist; run 'make experiment'")
    with np.load(file) as columns:
        joined = dict(columns)
    return {
        law: {name: values[joined["trial"] == k] for name, values in joined.items()}
        for k, law in enumerate(experiment.laws)
    }


def _print(content: report.Content, console: Console) -> None:
    """Print the report's tables, and which pictures and bars fail."""
    for section in content.sections:
        table = Table(*section.head, title=section.title, show_lines=True)
        for row in section.rows:
            table.add_row(*(getattr(row, field.name) for field in fields(row)))
        console.print(table, markup=False)
    for what, reason in (("picture of the postures", content.picture), ("film", content.film)):
        if isinstance(reason, str):
            console.print(f"no {what}: {reason}", markup=False)
    for failed in content.failed:
        console.print(f"bar does not hold: {failed}", markup=False)
