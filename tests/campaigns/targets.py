# SPDX-License-Identifier: MIT
"""What a robot's functions cost on other machines: ``python tests/campaigns/targets.py``.

Compiles a folder for every machine of tests/support/targets, compares values (the iiwa 14's golden ones, another
robot's with those of this machine), counts the instructions of every function at many states (denormals, limits, zeros;
NaN, infinity and 1e300 in what is no angle) and of the controller's step, and prints the tables of docs/guarantees.md:
``--page`` puts the numbers into the page, ``--sizes`` leaves out what is run. ``--json FILE`` writes what was found for
``stiffgen verify --report FILE.html --evidence FILE``. Exit code 1 if a value is wrong.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.control.page import has_controller
from stiffgen.core.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import as_results
from stiffgen.lab.prove.targets import Target, write_targets
from support.golden_calls import golden_calls
from support.project import ROOT
from support.targets import MACHINES, Count, Footprint, Machine, built, counts, footprint, run, step_count

PAGE = ROOT / "docs" / "guarantees.md"
Calls = Sequence[tuple[Kernel, Sequence[np.ndarray], np.ndarray]]


def told(count: Sequence[int] | None) -> str:
    """Format one number, or the fewest and the most."""
    if count is None:
        return "-"
    return str(count[0]) if count[0] == count[1] else f"{count[0]} to {count[1]}"


def ends(count: Count) -> tuple[int, int]:
    """Return the fewest and the most."""
    return count.fewest, count.most


def reference_calls(robot: GeneratedRobot) -> tuple[str, Calls]:
    """Return what values are compared with, in words, and the calls."""
    if robot.chain == open_robot(ROOT / "generated" / "iiwa14").chain:
        return "golden values, 60 digits", golden_calls(6)
    pool = argument_samples(robot.chain, 2, 0, robot.springs)
    calls = []
    for kernel in robot.table:
        for state in range(2):
            given = [pool[argument][state] for argument in kernel.arguments]
            values = as_results(robot.kernels[kernel.qualified_name](*given))
            calls.append((kernel, given, np.concatenate([np.ravel(value) for value in values])))
    return "values of the machine that checks", calls


def measured(machine: Machine, robot: GeneratedRobot, kernels: Sequence[Kernel], states: int) -> Target:
    """Build a folder's functions for a machine, run them there, compare their values and time them."""
    scalar, (reference, calls) = robot.scalar, reference_calls(robot)
    bound = 1e-12 if scalar == DOUBLE else 2e-6
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        plain = [(kernel, given) for kernel, given, _ in calls]
        program = built(machine, robot.folder, robot.chain, plain, work, scalar=scalar)
        right = all(
            np.allclose(found, np.ravel(expected), rtol=0, atol=bound * np.abs(expected).max())
            for (_, _, expected), found in zip(calls, run(machine, program, scalar), strict=True)
        )
        found = counts(machine, built(machine, robot.folder, robot.chain, [], work, kernels, states, scalar), work)
        step = longest = None
        if has_controller(robot.chain, scalar):
            step = ends(step_count(machine, robot.folder, work, states))
            longest = step_count(machine, robot.folder, work, max(states // 100, 500), longest=True).most
        version = subprocess.run([machine.compiler[0], "--version"], capture_output=True, text=True, check=True).stdout
        return Target(
            machine.name,
            " ".join((version.splitlines()[0], "-O2", *machine.compiler[1:])),
            machine.emulator[0],
            reference,
            right,
            states,
            {kernel.qualified_name: ends(count) for kernel, count in zip(kernels, found, strict=True)},
            step,
            longest,
            **asdict(footprint(machine, robot.folder, work)),
        )


def main() -> int:
    """Count instructions of the functions on the target machines, or measure sizes alone (--sizes)."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "generated" / "iiwa14")
    parser.add_argument("--states", type=int, default=100_000, help="a tenth of them where doubles are software")
    parser.add_argument("--machines", nargs="*", default=[machine.name for machine in MACHINES])
    parser.add_argument("--functions", nargs="*", help="default: all")
    parser.add_argument("--json", type=Path, help="a file for what is found")
    parser.add_argument("--scalar", choices=SCALARS, default="double", help="float: the iiwa 14 generated anew for it")
    parser.add_argument("--sizes", action="store_true", help="flash, memory and stacks alone: nothing is run")
    parser.add_argument("--page", action="store_true", help="put the numbers into docs/guarantees.md")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = options.folder
        if options.scalar != "double":
            urdf = ROOT / "urdf" / "iiwa14.urdf"
            folder = stiffgen.generate(urdf, output=place, name="arm", scalar=options.scalar, build=False)
        if not options.sizes:
            return tables(open_robot(folder), options)
        chosen = [machine for machine in MACHINES if machine.name in options.machines]
        table = size_rows([footprint(each, folder, Path(place)) for each in chosen])
        show([each.name for each in chosen], table, SCALARS[options.scalar] if options.page else None)
        return 0


def tables(robot: GeneratedRobot, options: argparse.Namespace) -> int:
    """Measure each machine and print tables of times; 1 if a value is wrong."""
    kernels = [
        kernel for kernel in robot.table if kernel.qualified_name in (options.functions or robot.manifest["kernels"])
    ]
    rows = []
    for machine in (machine for machine in MACHINES if machine.name in options.machines):
        row = measured(machine, robot, kernels, max(options.states // (10 if machine.software else 1), 8))
        rows.append(row)
        print(f"{machine.name}: {row.states} states, values {'right' if row.right else 'WRONG'}", file=sys.stderr)
    if options.json is not None:
        write_targets(options.json, robot, rows)
    counted = {f"`{k.qualified_name}`": [told(row.instructions[k.qualified_name]) for row in rows] for k in kernels}
    counted["controller's step, largest count seen"] = [str(row.step[1]) if row.step else "-" for row in rows]
    counted["the step, turns of the modes at their bound, at most"] = [str(row.longest_step or "-") for row in rows]
    show([row.machine for row in rows], counted | size_rows(rows), robot.scalar if options.page else None)
    return int(not all(row.right for row in rows))


def size_rows(rows: Sequence[Target | Footprint]) -> dict[str, list[str]]:
    """Return the rows of sizes: kernels, then the controller, whose every public function has a stack."""
    stacks = [row.controller_stacks for row in rows]
    table = {
        "flash, all functions [kB]": [f"{row.flash / 1000:.0f}" for row in rows],
        "flash of the controller, in addition [kB]": [_or_dash(row.controller_flash, 1000) for row in rows],
        "RAM that stays [bytes]": [str(row.ram) for row in rows],
        "RAM that stays, controller, in addition [bytes]": [_or_dash(row.controller_ram) for row in rows],
        "deepest stack of a function [bytes]": [str(row.stack or "-") for row in rows],
        "stack of the step as a whole [bytes]": [str(row.step_stack or "-") for row in rows],
    }
    named = dict.fromkeys(name for each in stacks for name in each if name != "impedance_step")
    return table | {f"stack of `{name}` [bytes]": [str(each.get(name, "-")) for each in stacks] for name in named}


def _or_dash(value: int | None, unit: int = 1) -> str:
    return "-" if value is None else f"{value / unit:.0f}"


def show(machines: Sequence[str], table: dict[str, list[str]], scalar: Scalar | None) -> None:
    """Print the table; with ``scalar``, put its numbers into the page's table of this type of numbers."""
    print("| | " + " | ".join(machines) + " |")
    print("| --- |" + " ---: |" * len(machines))
    for name, row in table.items():
        print(f"| {name} | {' | '.join(row)} |")
    if scalar is not None:
        doubles, heading, floats = PAGE.read_text().partition("\n### Single precision on other processors\n")
        if scalar == DOUBLE:
            doubles = filled(doubles, machines, table)
        else:
            floats = filled(floats, machines, table)
        PAGE.write_text(doubles + heading + floats)


def filled(page: str, machines: Sequence[str], table: Mapping[str, Sequence[str]]) -> str:
    """Return a page whose tables have the measured cells: the columns are machines, the rows those of the campaign."""
    lines, columns = [], list[str]()
    for line in page.split("\n"):
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells or not cells[0]:
            columns = cells[1:]
        elif cells[0] in table and set(columns) & set(machines):
            found = dict(zip(machines, table[cells[0]], strict=True))
            line = f"| {' | '.join([cells[0], *map(found.get, columns, cells[1:])])} |"
        lines.append(line)
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
