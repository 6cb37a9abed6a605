# SPDX-License-Identifier: MIT
"""Random linkages against 60 digits: python tests/campaigns/linkages.py [COUNT [FIRST]].

Linkages with one to three loops, planar and spatial, with joints before and after them (support/exact_linkage.py). The
table has the largest error of each function relative to its largest entry; exit code 1 if one is beyond 1e-11.
Configurations with a condition number above 1000 are drawn again; a linkage without another one is counted.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.exact_linkage import linkage_errors

BOUND = 1e-11


def main(count: int = 200, first: int = 0) -> int:
    """Compare linkages; return 1 if an error is beyond the bound."""
    worst: dict[str, tuple[float, int]] = {}
    without = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            try:
                errors = linkage_errors(seed, Path(folder) / "linkage.urdf")
            except ArithmeticError:
                without.append(seed)
                continue
            for name, error in errors.items():
                worst[name] = max(worst.get(name, (0.0, 0)), (error, seed))
    for name, (error, seed) in worst.items():
        print(f"{name:36} {error:8.1e}  seed {seed}")
    print(f"{count - len(without)} linkages compared; only near singularities: {without}")
    return int(not worst or max(error for error, _ in worst.values()) > BOUND)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
