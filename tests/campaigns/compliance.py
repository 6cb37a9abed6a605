# SPDX-License-Identifier: MIT
"""Compare the tip's compliance: ``python tests/campaigns/compliance.py [--trees N] [--postures N]``.

Random trees have mimic and sliding joints, one loaded tip or two, and fixed or floating bases. Results must agree
with the oracles of verify where cond(H) is below 1e6. Random postures of one tree have springs at all distances from
the limit of stability, down to 1e-11 of it: unstable ones must be refused, all of them, and no stable one.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from pathlib import Path

import numpy as np

from stiffgen import load_chain
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from support.compliance_limit import Case
from support.exact_tree import tree_urdf

CONDITION, DOUBTFUL = 1e6, 1e-12
TIPS = ["left", "right"]


def tree(folder: Path, seed: int, joints: int, *, floating: bool) -> Chain:
    """Return the chain of a random tree."""
    file = folder / f"{seed}.urdf"
    file.write_text(tree_urdf(seed, joints))
    return load_chain(file, tip=TIPS, floating_base=floating)


def compare_trees(folder: Path, count: int) -> bool:
    """Compare all results of random trees; print the largest errors."""
    largest: dict[str, float] = {}
    failed = 0
    kinds = itertools.cycle(itertools.product(REPRESENTATIONS, (False, True), (False, False, True)))
    for seed, (rep, total, floating) in zip(range(count), kinds, strict=False):
        chain = tree(folder, seed, 4 if floating else 4 + seed % 3, floating=floating)
        case = Case(chain, rep, total=total, seed=seed)
        for distance in (None, 1e-2, -1e-2, 3e-5):
            springs = case.springs if distance is None else case.near_the_limit(distance)
            eigenvalues = case.eigenvalues(springs)
            sizes = np.abs(eigenvalues)
            if sizes.max() < CONDITION * sizes.min():
                failed += set(case.refusals(springs).values()) != {bool(eigenvalues[0] < 0)}
                for check in case.checks(springs):
                    name = check.kernel.rpartition(f"{rep}_")[2].removesuffix("_total")
                    largest[name] = max(check.error, largest.get(name, 0.0))
                    failed += not check.passed
    print(f"{count} trees, largest relative errors: {', '.join(f'{n} {e:.1e}' for n, e in largest.items())}")
    return bool(largest) and not failed


def find_unstable(folder: Path, count: int) -> bool:
    """Compare refusals with the exact smallest eigenvalue; print how many there are."""
    random, per_case, wrong, refused, stable, doubtful = np.random.default_rng(1), 50, 0, 0, 0, 0
    for seed in range(-(-count // per_case)):
        case = Case(tree(folder, seed, 7, floating=False), REPRESENTATIONS[seed % 3], total=False, seed=seed)
        for _ in range(min(per_case, count)):
            distance = float(random.choice([-1, 1]) * 10.0 ** -random.uniform(0.1, 11.5))
            springs = case.near_the_limit(distance)
            eigenvalues = case.eigenvalues(springs)
            if abs(eigenvalues[0]) <= DOUBTFUL * np.abs(eigenvalues).max():
                doubtful += 1
                continue
            refusals = set(case.refusals(springs).values())
            is_refused = True in refusals
            wrong += refusals != {bool(eigenvalues[0] < 0)}
            refused, stable = refused + is_refused, stable + (not is_refused)
    print(f"{refused} postures refused, {stable} not, {doubtful} within 1e-12 of the limit; {wrong} wrong")
    return not wrong


def main() -> int:
    """Run both parts, random trees and postures near the limit of stability; 1 if a value is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--trees", type=int, default=200)
    parser.add_argument("--postures", type=int, default=1000)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        return int(not all((compare_trees(Path(folder), options.trees), find_unstable(Path(folder), options.postures))))


if __name__ == "__main__":
    sys.exit(main())
