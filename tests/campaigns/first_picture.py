# SPDX-License-Identifier: MIT
"""Time the way of a new user, from the wheel to the playground: the bar is 120 s with downloads in pip's cache.

Run the first time, it downloads; the second time counts.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from support.project import ROOT, URDF

BAR = 120.0


def main() -> int:
    """Install the wheel into a fresh environment, generate and draw; return 1 if all of it takes longer than BAR."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="folder for the virtual environment (default: a temporary one)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
        subprocess.run(
            [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)],
            env=environment, check=True, capture_output=True,
        )  # fmt: skip
        (wheel,) = folder.glob("stiffgen-*.whl")
        steps = (
            [sys.executable, "-m", "venv", "venv"],
            ["venv/bin/pip", "install", "--quiet", wheel.name],
            ["venv/bin/stiffgen", "generate", str(URDF), "--output", "."],
            ["venv/bin/stiffgen", "play", "iiwa14", "--output", "iiwa14.html"],
        )
        total = 0.0
        for step in steps:
            start = time.perf_counter()
            subprocess.run(step, cwd=folder, env=environment, check=True, capture_output=True)
            total += (took := time.perf_counter() - start)
            print(f"{took:6.1f} s  {' '.join(Path(word).name for word in step)}", flush=True)
        page = next(folder.rglob("iiwa14.html"))
        size = sum(each.stat().st_size for each in (folder / "venv").rglob("*") if each.is_file())
        print(f"{total:6.1f} s in all (bar: {BAR:.0f} s); {page.name}; installed: {size / 1e6:.0f} MB")
    return 0 if total <= BAR else 1


if __name__ == "__main__":
    sys.exit(main())
