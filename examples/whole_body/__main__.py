# SPDX-License-Identifier: MIT
"""Analyse a quadruped on springs: predicted and simulated modes, and the law of the potential at a wall.

``python -m examples.whole_body`` in the repository's root, or ``make whole-body``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from stiffgen import StiffgenError, open_robot

try:
    import matplotlib  # noqa: F401
    import mujoco  # noqa: F401
    import scipy  # noqa: F401
except ImportError as missing:
    print(f"whole_body: {missing.name} is not installed; pip install -e '.[examples]'", file=sys.stderr)
    sys.exit(2)

from examples.whole_body import figures, findings
from examples.whole_body.stance import FEET

ROBOT = Path("build/robots/solo12")
RESULTS = Path("build/whole_body")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the example for a generated folder; return 2 if it cannot be run."""
    parser = argparse.ArgumentParser(prog="python -m examples.whole_body", description=__doc__.splitlines()[0])
    parser.add_argument("--robot", type=Path, default=ROBOT, metavar="DIR", help=f"generated folder (default: {ROBOT})")
    parser.add_argument(
        "--output", type=Path, default=RESULTS, metavar="DIR", help=f"folder to write (default: {RESULTS})"
    )
    options = parser.parse_args(arguments)
    try:
        return report(_robot(options.robot), options.output)
    except StiffgenError as error:
        print(f"whole_body: {error}", file=sys.stderr)
        return 2


def _robot(folder: Path) -> ModuleType:
    if not (folder / "manifest.json").is_file():
        raise StiffgenError(f"{folder} is no generated robot; run 'make {ROBOT}', or name one with --robot")
    robot: ModuleType = open_robot(folder).module
    if robot.DOF != 18 or not all(hasattr(robot, foot) for foot in FEET):
        raise StiffgenError(f"{folder} is not Solo 12 on a floating base with four feet; 'make {ROBOT}' generates it")
    return robot


def report(robot: ModuleType, output: Path) -> int:
    """Run all trials, write tables and figures, and return 1 if a bar does not hold."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        kicks = progress.add_task("kicked stances", total=findings.RUNS)
        wall = progress.add_task("a foot on the wall", total=findings.CYCLES)
        found = findings.gather(robot, lambda: progress.advance(kicks), lambda: progress.advance(wall))
    output.mkdir(parents=True, exist_ok=True)
    tables = findings.tables(found)
    (output / "tables.txt").write_text(tables + "\n")
    for name, svg in figures.draw(found).items():
        (output / name).write_text(svg)
    print(tables)
    failed = found.failed_bars()
    for bar in failed:
        print(f"bar does not hold: {bar}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
