# SPDX-License-Identifier: MIT
"""A long batch by a pool of threads (docs/performance.md): configurations a second with one thread and more.

    python benchmarks/threads.py [COUNT]

COUNT is 10^7 unless given: 5 GB of arguments and results. For whole matrices and for upper triangles a line a number of
threads, the fastest of three rounds.
"""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import stiffgen

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmarks.throughput import in_blocks, rate

Array = NDArray[np.float64]
URDF = Path(__file__).resolve().parent.parent / "urdf" / "iiwa14.urdf"


def main() -> None:
    """Measure and print."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10**7
    with TemporaryDirectory() as folder:
        robot = stiffgen.open_robot(stiffgen.generate(URDF, output=folder)).module
    random = np.random.default_rng(0)
    q = random.uniform(robot.LOWER, robot.UPPER, (count, robot.DOF))
    wrench = random.uniform(-20, 20, (count, 6))
    task_stiffness = np.diag([700.0, 700, 800, 30, 30, 30])
    for title, function in (
        ("whole matrices", robot.hybrid.joint_stiffness),
        ("upper triangles", robot.packed.hybrid_joint_stiffness),
    ):
        print(title, flush=True)
        one = function(q[0], wrench[0], task_stiffness)
        scaling(function, (q, wrench), task_stiffness, np.empty((count, *one.shape)))


def scaling(function: np.ufunc, each: tuple[Array, ...], shared: Array, result: Array) -> None:
    """Print how many configurations a second a function computes, with one thread and more."""

    def block(part: slice) -> None:
        function(*(array[part] for array in each), shared, out=result[part])

    cores, count = os.cpu_count() or 1, len(result)
    one = 0.0
    for threads in sorted({1, *(2**k for k in range(1, 9) if 2**k < cores), cores}):
        with ThreadPoolExecutor(threads) as pool:
            measured = rate(partial(in_blocks, block, count, pool), count, 3)
        one = one or measured
        moved = measured * sum(array[0].nbytes for array in (*each, result)) / 1e9
        print(
            f"{threads} threads: {measured:.3g} a second, {measured / one:.2f} times one, {moved:.1f} GB/s", flush=True
        )


if __name__ == "__main__":
    main()
