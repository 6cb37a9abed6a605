# SPDX-License-Identifier: MIT
"""Compile random robots by gcc at every level.

python tests/campaigns/compiler_warnings.py [COUNT] [MOST_MOVING] [FIRST_SEED]

The C of kernels and controller at -O0 to -O3 and -Os; the width of the vectors goes round from robot to robot, and so
do the options (tests/support/warnings.py). A source is compiled once for each text: the controller is the same for all
robots with as many joints. Exit code 1 after a warning.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.warnings import LEVELS, VECTORS, complaints, preprocessed, sources_of_varied_robot


def main(count: int, most_moving: int, first: int) -> int:
    """Compile `count` random robots from seed `first` on, with all levels of warnings; return 1 if one was warned
    about.
    """
    seen: set[int] = set()
    failed, kinds = 0, Counter[str]()
    with ThreadPoolExecutor(int(os.environ.get("WORKERS", os.cpu_count() or 1))) as pool:
        for seed in range(first, first + count):
            vectors = VECTORS[seed // 6 % len(VECTORS)]  # every width with every option
            with tempfile.TemporaryDirectory() as folder:
                kind, sources = sources_of_varied_robot(seed, most_moving, Path(folder))
                kinds[kind] += 1
                new = {source: hash(preprocessed("gcc", vectors, source)) for source in sources}
                sources = [source for source, text in new.items() if text not in seen]
                seen |= set(new.values())
                runs = [([level, *vectors], source) for level in LEVELS for source in sources]
                said = list(pool.map(lambda run: complaints("gcc", run[0], [run[1]]), runs))
            failed += any(said)
            for (flags, source), words in zip(runs, said, strict=True):
                if words:
                    print(f"robot {seed} ({kind}), {source.name}, {' '.join(flags)}:\n{words}", flush=True)
            taken = ", ".join(f"{number} {name}" for name, number in kinds.items())
            print(f"{seed - first + 1}/{count} robots ({taken}), {failed} with warnings", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:]]
    sys.exit(main(*(given + [300, 4, 0][len(given) :])))
