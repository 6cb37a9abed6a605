# SPDX-License-Identifier: MIT
"""What a robot's functions cost on other machines: ``python tests/campaigns/targets.py``.

Compiles a folder for every machine of tests/support/targets, compares values (the iiwa 14's golden ones, another
robot's with those of this machine), counts the instructions of every function at many states (denormals, limits, zeros;
NaN, infinity and 1e300 in what is no angle) and of the controller's step, and prints the tables of docs/targets.md.
``--json FILE`` writes what was found for ``stiffgen verify --report FILE.html --evidence FILE``. Exit code 1 if a value
is wrong.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.control.page import has_controller
from stiffgen.core.lower.scalar import DOUBLE, SCALARS
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.core.verify.result import as_results
from stiffgen.lab.prove.targets import Target, write_targets
from support.golden_calls import golden_calls
from support.project import ROOT
from support.targets import MACHINES, Count, Machine, built, counts, footprint, run, step_count

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
    """Measure a folder on a machine."""
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
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "generated" / "iiwa14")
    parser.add_argument("--states", type=int, default=100_000, help="a tenth of them where doubles are software")
    parser.add_argument("--machines", nargs="*", default=[machine.name for machine in MACHINES])
    parser.add_argument("--functions", nargs="*", help="default: all")
    parser.add_argument("--json", type=Path, help="a file for what is found")
    parser.add_argument("--scalar", choices=SCALARS, default="double", help="float: the iiwa 14 generated anew for it")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = options.folder
        if options.scalar != "double":
            urdf = ROOT / "urdf" / "iiwa14.urdf"
            folder = stiffgen.generate(urdf, output=place, name="arm", scalar=options.scalar, build=False)
        return tables(open_robot(folder), options)


def tables(robot: GeneratedRobot, options: argparse.Namespace) -> int:
    """Measure and print; 1 if a value is wrong."""
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
    print("| | " + " | ".join(row.machine for row in rows) + " |")
    print("| --- |" + " ---: |" * len(rows))
    table = {f"`{k.qualified_name}`": [told(row.instructions[k.qualified_name]) for row in rows] for k in kernels}
    table["controller's step"] = [told(row.step) for row in rows]
    table["the step, QL iterations at their bound, at most"] = [str(row.longest_step or "-") for row in rows]
    table["flash, all functions [kB]"] = [f"{row.flash / 1000:.0f}" for row in rows]
    table["RAM that stays [bytes]"] = [str(row.ram) for row in rows]
    table["deepest stack of a function [bytes]"] = [str(row.stack or "-") for row in rows]
    table["stack of the step as a whole [bytes]"] = [str(row.step_stack or "-") for row in rows]
    for name, row in table.items():
        print(f"| {name} | {' | '.join(row)} |")
    return int(not all(row.right for row in rows))


if __name__ == "__main__":
    sys.exit(main())
