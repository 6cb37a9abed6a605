# SPDX-License-Identifier: MIT
"""The certified bounds of rounding errors against what is measured: ``python tests/campaigns/rounding_errors.py``.

Every function of a robot that has a bound is run at many states, half of them random (often at the ends of the stated
ranges), half beside the worst ones so far (the largest errors, and the largest parts of a bound). Every entry of its
results is compared with the same statements in long doubles (64 bits on x86) or, if asked for, __float128. The errors
of the thirty worst states on every width of vectors are found again with 80 digits. Printed is a table: the bound, the
largest error, their ratio, how near the nearest entry came to its own bound, and how much less than with 80 digits the
error was measured, as part of it. Exit code 1 if an error is beyond its bound, or a bound more than a thousand times
the largest error seen.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE, SCALARS
from stiffgen.core.opened import open_robot
from stiffgen.core.symbolic.kernels import chain_kernels
from support.project import ROOT
from support.quad import WIDTHS, Measured, can_run, climbed, kernels_with_bounds, with_eighty_digits

LARGEST_RATIO = 1000
LARGEST_OFF = 0.01


def main() -> int:
    """Compare random values of each function with those in longer numbers; 1 if an error is beyond its bound."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--robot", default="iiwa14", help="a folder in generated/")
    parser.add_argument("--scalar", choices=SCALARS, default="double", help="float: the robot is generated anew for it")
    parser.add_argument("--states", type=int, default=1_000_000, help="of each function")
    parser.add_argument("--functions", nargs="*", help="default: all that have a bound")
    parser.add_argument("--width", choices=WIDTHS, help="vectors (default: each in turn, round by round)")
    parser.add_argument("--exact", choices=("long double", "__float128"), default="long double")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    doubles, scalar = ROOT / "generated" / options.robot, SCALARS[options.scalar]
    chain = open_robot(doubles).chain
    bounds = kernels_with_bounds(chain, Ranges(), chain_kernels(chain), scalar)
    kernels = [kernel for kernel in chain_kernels(chain) if kernel.qualified_name in (options.functions or bounds)]
    widths = [options.width] if options.width else [width for width in WIDTHS if can_run(WIDTHS[width])]
    print(f"{options.robot}, vectors: {', '.join(widths)}")
    print(
        f"{'function':45} {'states':>9} {'bound':>9} {'largest':>9} {'ratio':>6} {'nearest':>8} {'off':>8} "
        f"{'time [s]':>8}"
    )
    wrong = 0
    with tempfile.TemporaryDirectory() as work:
        folder, measured = doubles, []
        if scalar != DOUBLE:
            urdf, name = ROOT / "urdf" / f"{options.robot}.urdf", options.robot
            folder = stiffgen.generate(urdf, output=work, name=name, scalar=scalar.name, build=False)
        for index, width in enumerate(widths):
            place = Path(work) / str(index)
            place.mkdir()
            measured.append(
                Measured(
                    folder,
                    options.robot,
                    chain,
                    kernels,
                    place,
                    WIDTHS[width],
                    batches=True,
                    exact=doubles,
                    longer=options.exact,
                )
            )
        for number, kernel in enumerate(kernels):
            name = kernel.qualified_name
            started, errors, states, off = time.perf_counter(), np.zeros(1), 0, 0.0
            for index, each in enumerate(measured):
                random = np.random.default_rng((options.seed, number, index))
                count = -(-options.states // len(measured))
                found = climbed(each, kernel, Ranges(), count, random, bounds=bounds[name])
                errors, states = np.maximum(errors, found.errors), states + found.states
                largest, of_reference = with_eighty_digits(each, kernel, found.worst)
                errors[np.argmax(errors)] = max(errors.max(), largest)
                off = max(off, of_reference)
            bound = bounds[name]
            nearest = np.max(errors / np.maximum(bound, 1e-300))
            ratio = bound.max() / errors.max() if errors.any() else 1.0
            verdict = "" if nearest <= 1 else "  BEYOND THE BOUND"
            verdict += "" if ratio <= LARGEST_RATIO or options.states < 10_000 else "  TOO FAR AWAY"
            verdict += "" if off < LARGEST_OFF else "  WRONG REFERENCE"
            wrong += bool(verdict)
            print(
                f"{name:45} {states:9} {bound.max():9.2e} {errors.max():9.2e} {ratio:6.0f} {nearest:8.3f} "
                f"{off:8.1e} {time.perf_counter() - started:8.1f}{verdict}",
                flush=True,
            )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
