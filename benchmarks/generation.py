"""How long ``stiffgen generate`` takes: sources alone, and with the build. Fresh processes, median of five."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

URDF = Path(__file__).resolve().parent.parent / "urdf" / "iiwa14.urdf"
RUNS = 5


def seconds(*options: str) -> float:
    times = []
    for _ in range(RUNS):
        with tempfile.TemporaryDirectory() as output:
            command = [sys.executable, "-m", "stiffgen.cli", "generate", str(URDF), "--output", output, *options]
            start = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    print(f"stiffgen generate iiwa14.urdf --no-build: {seconds('--no-build'):.2f} s")
    print(f"stiffgen generate iiwa14.urdf:            {seconds():.2f} s")


if __name__ == "__main__":
    main()
