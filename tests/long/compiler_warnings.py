"""Random robots through gcc at every level: python tests/long/compiler_warnings.py [COUNT] [MOST_MOVING] [FIRST_SEED].

The C of kernels and controller, with the plain build's vectors and with -march=native. Exit code 1 after a warning.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.warnings import LEVELS, complaints, sources_of_random_robot


def main(count: int, most_moving: int, first: int) -> int:
    failed = 0
    for seed in range(first, first + count):
        with tempfile.TemporaryDirectory() as folder:
            sources = sources_of_random_robot(seed, most_moving, Path(folder))
            for flags in [[level, *machine] for level in LEVELS for machine in ((), ("-march=native",))]:
                said = complaints("gcc", flags, sources)
                failed += said != ""
                if said:
                    print(f"robot {seed}, {' '.join(flags)}:\n{said}", flush=True)
        print(f"{seed - first + 1}/{count} robots, {failed} with warnings", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*(given + [30, 12, 0][len(given) :])))
