# SPDX-License-Identifier: MIT
"""Single precision against double: ``make campaign NAME=single-precision``.

Generates the iiwa 14 twice, of doubles and of floats, compiles both with the same flags and calls the batches of each
by turns: medians, and the time of floats as a share of that of doubles. Then the errors of the floats' batches, at
random states within the ranges of their bounds, against the doubles' batches at the same states: the largest of each
kind, and the bound that the header states for it. Exit code 1 if one is beyond its bound.
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.core.emit.build import build_library
from stiffgen.core.lower.ranges import Ranges
from stiffgen.core.lower.scalar import DOUBLE, FLOAT, Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.families.rounding.bounds import ErrorBounds, NoBound, argument_sizes, chain_reach, rounded_up
from support.project import URDF

WIDTHS = {
    "native": ["-O3", "-march=native"],
    "AVX2": ["-O3", "-mavx2", "-mfma"],
    "SSE2": ["-O3"],
}
COUNT, ROUNDS = 4096, 41
AT_ONCE = 10_000


class Batches:
    """The batches of a folder of one type of numbers, compiled."""

    def __init__(self, chain: Chain, scalar: Scalar, flags: Sequence[str], work: Path) -> None:
        self.chain, self.scalar, self.name = chain, scalar, f"arm_{scalar.name}"
        folder = stiffgen.generate(URDF, output=work, name=self.name, scalar=scalar.name, build=False)
        self.library = ctypes.CDLL(str(build_library(folder, self.name, work, flags)))

    def call(self, kernel: Kernel, given: Sequence[np.ndarray], results: Sequence[np.ndarray]) -> Callable[[], None]:
        """Return a call of a batch; the arrays have this folder's type and must outlive it."""
        function = self.library[f"{self.name}_{kernel.qualified_name}_batch"]
        arguments: list[object] = [ctypes.c_size_t(len(given[0]))]
        for each in given:
            arguments += [ctypes.c_void_p(each.ctypes.data), ctypes.c_ssize_t(each[0].size)]
        arguments += [ctypes.c_void_p(each.ctypes.data) for each in results]
        return lambda: function(*arguments)

    def outputs(self, kernel: Kernel, count: int) -> list[np.ndarray]:
        """Room for the results of so many configurations."""
        return [np.empty((count, result.array(self.chain).size), self.scalar.dtype) for result in kernel.results]


def timed(calls: Sequence[Callable[[], None]]) -> list[float]:
    """Return the medians of the calls' durations [s], measured by turns."""
    rounds: list[list[float]] = [[] for _ in calls]
    for _ in range(ROUNDS):
        for call, times in zip(calls, rounds, strict=True):
            start = time.perf_counter()
            call()
            times.append(time.perf_counter() - start)
    return [statistics.median(times[1:]) for times in rounds]


def compare_times(chain: Chain, kernels: Sequence[Kernel], both: Sequence[Batches]) -> None:
    """Print the times per state [ns] of batches in double and single precision, and their ratio."""
    pool = argument_samples(chain, COUNT, 0)
    print(f"{'batch of ' + str(COUNT):40} {'double [ns]':>12} {'float [ns]':>12} {'ratio':>7}")
    for kernel in kernels:
        calls, kept = [], []
        for batches in both:
            given = [np.ascontiguousarray(pool[a], dtype=batches.scalar.dtype) for a in kernel.arguments]
            results = batches.outputs(kernel, COUNT)
            kept.append((given, results))
            calls.append(batches.call(kernel, given, results))
        double, single = (1e9 * seconds / COUNT for seconds in timed(calls))
        print(f"{kernel.qualified_name:40} {double:12.1f} {single:12.1f} {single / double:7.2f}", flush=True)


def drawn(chain: Chain, kernel: Kernel, count: int, random: np.random.Generator) -> list[np.ndarray]:
    """Arguments within the bounds' ranges, half of them at the ends; floats, as both types read them."""
    ranges = Ranges()
    reach = chain_reach(chain, ranges, FLOAT)
    given = []
    for argument in kernel.arguments:
        sizes = np.array(argument_sizes(chain, argument, ranges, reach, FLOAT))
        values = random.uniform(-1, 1, (count, len(sizes)))
        if argument.name == "q":
            lower, upper = ([getattr(c, side) for c in chain.coordinates] for side in ("lower", "upper"))
            values = np.clip(values * sizes, lower, upper)
        else:
            values = np.where(random.random((count, 1)) < 0.5, np.sign(values), values) * sizes
        if argument.name == "equilibrium":
            poses = values.reshape(-1, 4, 4)
            poses[:, :3, :3] = np.linalg.qr(random.normal(size=(count, 3, 3)))[0]
        given.append(values.astype(np.float32))
    return given


def compare_errors(chain: Chain, kernels: Sequence[Kernel], both: Sequence[Batches], states: int) -> bool:
    """Print the errors of single precision beside their bounds; return whether all are within."""
    print(f"\nerrors of floats over {states} states, and the bounds of header and manifest")
    bounds, exact = ErrorBounds(chain, scalar=FLOAT), ErrorBounds(chain, scalar=DOUBLE)
    held = True
    for number, kernel in enumerate(kernels):
        try:
            of_floats, of_doubles = bounds.of(kernel), exact.of(kernel)
        except NoBound:
            print(f"{kernel.qualified_name:40} no bound")
            continue
        random, done = np.random.default_rng(number), 0
        worst = [np.zeros(len(of_floats[result.name])) for result in kernel.results]
        while done < states:
            given = drawn(chain, kernel, AT_ONCE, random)
            found = []
            for batches in both:
                own = [np.ascontiguousarray(each, dtype=batches.scalar.dtype) for each in given]
                found.append(batches.outputs(kernel, AT_ONCE))
                batches.call(kernel, own, found[-1])()
            for k, (double, single) in enumerate(zip(*found, strict=True)):
                worst[k] = np.maximum(worst[k], np.abs(single - double).max(axis=0))
            done += AT_ONCE
        for result, error in zip(kernel.results, worst, strict=True):
            bound = np.array(of_floats[result.name])
            within = bool((error + of_doubles[result.name] <= bound).all())  # the doubles are off, too, by far less
            held &= within
            print(
                f"{kernel.qualified_name + ', ' + result.name:64} {error.max():9.1e} {result.unit:12} "
                f"bound {rounded_up(bound.max(), FLOAT):7.1e} {'' if within else 'BEYOND THE BOUND'}",
                flush=True,
            )
    return held


def main() -> int:
    """Compare times and errors of batches in single and in double precision; return 1 beyond a bound."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--states", type=int, default=1_000_000)
    parser.add_argument("--width", choices=list(WIDTHS), default="native")
    parser.add_argument("--kernels", nargs="*", help="default: all with a batch")
    options = parser.parse_args()
    chain = stiffgen.load_chain(URDF)
    kernels = [k for k in chain_kernels(chain) if k.batch and k.qualified_name in (options.kernels or k.qualified_name)]
    with tempfile.TemporaryDirectory() as work:
        both = [Batches(chain, scalar, WIDTHS[options.width], Path(work)) for scalar in (DOUBLE, FLOAT)]
        compare_times(chain, kernels, both)
        held = compare_errors(chain, kernels, both, options.states) if options.states else True
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
