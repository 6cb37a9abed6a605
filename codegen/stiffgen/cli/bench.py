# SPDX-License-Identifier: MIT
"""The command ``bench``: time a robot's compiled functions on this machine."""

from __future__ import annotations

import argparse
import math

from stiffgen.cli.console import Progress, messages, table, tables
from stiffgen.cli.folders import add_folder_or_robot, chosen_folder
from stiffgen.lab.bench import bench


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder_or_robot(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Time a robot's functions."""
    folder = chosen_folder(options)
    with Progress(messages(wide=False)).shown() as progress:
        timings = bench(folder, progress=progress)
    numbers = ("Python call [us]", "per configuration of 4096 [us]", "C call [us]")
    shown = table("kernel", *numbers, right=numbers)
    for timing in timings:
        c = f"{timing.c:.3f}" if math.isfinite(timing.c) else "no compiler"
        shown.add_row(timing.kernel, f"{timing.call:.2f}", f"{timing.configuration:.3f}", c)
    tables().print(shown)
    return 0
