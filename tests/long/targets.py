# SPDX-License-Identifier: MIT
"""What a robot's functions cost on other machines: ``python tests/long/targets.py``.

Compiles the folder for every machine of tests/support/targets, runs the golden values, counts the instructions of every
function at many states (denormals, limits, zeros; NaN, infinity and 1e300 in what is no angle) and of the controller's
step, and prints the tables of docs/targets.md. Exit code 1 if a golden value is wrong.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.emit.controller import has_controller
from stiffgen.emit.target import DOUBLE, SCALARS, Scalar
from stiffgen.opened import open_robot
from stiffgen.symbolic.kernels import KERNELS
from support.golden_calls import golden_calls
from support.project import ROOT
from support.targets import MACHINES, Count, Footprint, built, counts, footprint, run, step_count


def told(count: Count) -> str:
    """One number, or the fewest and the most."""
    return str(count.fewest) if count.fewest == count.most else f"{count.fewest} to {count.most}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--states", type=int, default=100_000, help="a tenth of them on a Cortex-M")
    parser.add_argument("--machines", nargs="*", default=[machine.name for machine in MACHINES])
    parser.add_argument("--functions", nargs="*", help="default: all")
    parser.add_argument("--scalar", choices=SCALARS, default="double", help="float: the robot is generated anew for it")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = ROOT / "generated" / "iiwa14"
        if options.scalar != "double":
            urdf = ROOT / "urdf" / "iiwa14.urdf"
            folder = stiffgen.generate(urdf, output=place, name="arm", scalar=options.scalar, build=False)
        return tables(folder, SCALARS[options.scalar], options)


def tables(folder: Path, scalar: Scalar, options: argparse.Namespace) -> int:
    """Print them; 1 if a golden value is wrong."""
    bound = 1e-12 if scalar == DOUBLE else 2e-6
    chain = open_robot(folder).chain
    kernels = [kernel for kernel in KERNELS if kernel.qualified_name in (options.functions or kernel.qualified_name)]
    calls, wrong = golden_calls(6), False
    table: dict[str, list[str]] = {kernel.qualified_name: [] for kernel in kernels}
    steps: list[Count] = []
    sizes: list[Footprint] = []
    machines = [machine for machine in MACHINES if machine.name in options.machines]
    for machine in machines:
        states = max(options.states // (10 if machine.bare else 1), 8)
        with tempfile.TemporaryDirectory() as place:
            work = Path(place)
            plain = [(kernel, given) for kernel, given, _ in calls]
            results = run(machine, built(machine, folder, chain, plain, work, scalar=scalar), scalar)
            for (_, _, expected), found in zip(calls, results, strict=True):
                wrong |= not np.allclose(found, np.ravel(expected), rtol=0, atol=bound * np.abs(expected).max())
            found = counts(machine, built(machine, folder, chain, [], work, kernels, states, scalar), work)
            for kernel, count in zip(kernels, found, strict=True):
                table[kernel.qualified_name].append(told(count))
            if has_controller(chain, scalar):
                steps.append(step_count(machine, folder, work, states))
            sizes.append(footprint(machine, folder, work))
        print(f"{machine.name}: {states} states, golden values {'WRONG' if wrong else 'right'}", file=sys.stderr)
    print("| | " + " | ".join(machine.name for machine in machines) + " |")
    print("| --- |" + " ---: |" * len(machines))
    for name, row in table.items():
        print(f"| `{name}` | {' | '.join(row)} |")
    if steps:
        print(f"| controller's step | {' | '.join(map(told, steps))} |")
    print(f"| flash, all functions [kB] | {' | '.join(f'{size.flash / 1000:.0f}' for size in sizes)} |")
    print(f"| RAM that stays [bytes] | {' | '.join(str(size.ram) for size in sizes)} |")
    print(f"| deepest stack [bytes] | {' | '.join(str(size.stack) for size in sizes)} |")
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
