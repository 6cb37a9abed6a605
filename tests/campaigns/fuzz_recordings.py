# SPDX-License-Identifier: MIT
"""Read many damaged recordings (support/damaged_recordings.py) in all formats.

    python tests/campaigns/fuzz_recordings.py [COUNT] [--first NUMBER] [--jobs N] [--one NUMBER]

Each file has a number, which is its seed. The exit code is 1 if a file ended in a traceback, a value that is not in
the file, a control character, or a crash.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor

from support import damaged_recordings


def main() -> int:
    """Run the campaign in two processes, one batch of 1000 files after the other; name the faults at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=200_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--one", type=int, help="read this file alone")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    if options.one is not None:
        print(damaged_recordings.run(options.one, 1))
        return 0
    total: dict[str, int] = {}
    faults = []
    with ProcessPoolExecutor(options.jobs) as pool:
        starts = range(options.first, options.first + options.count, 1000)
        for start, future in [(start, pool.submit(damaged_recordings.run, start, 1000)) for start in starts]:
            try:
                for outcome, count in future.result().items():
                    total[outcome] = total.get(outcome, 0) + count
            except Exception as error:  # a crash of the process, too
                faults.append(f"files from {start}: {error}")
                print(faults[-1], flush=True)
    for outcome, count in sorted(total.items()):
        print(f"{outcome}: {count}")
    print(f"{sum(total.values())} files, {len(faults)} batches with a fault")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
