# SPDX-License-Identifier: MIT
"""Time of ``stiffgen generate`` and size of its C: the iiwa 14, and a chain of 40 joints with nothing aligned.

Fresh processes, median of five (two for the long chain).
"""

from __future__ import annotations

import random
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

IIWA14 = Path(__file__).resolve().parent.parent / "urdf" / "iiwa14.urdf"
LINK = (
    '<link name="l{0}"><inertial><origin xyz="0.01 0.02 0.05" rpy="0.1 0.2 0.3"/><mass value="1.5"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial></link>'
)
JOINT = (
    '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/><origin xyz="{2}" rpy="{3}"/>'
    '<axis xyz="{4}"/><limit lower="-3" upper="3" velocity="1" effort="10"/></joint>'
)


def long_chain(joints: int) -> str:
    """Return a URDF with arbitrary origins and axes, the same every time."""
    source = random.Random(1)

    def vector(size: float) -> str:
        return " ".join(f"{source.uniform(-size, size):.6f}" for _ in range(3))

    links = [LINK.format(k) for k in range(joints + 1)]
    connections = [JOINT.format(k, k + 1, vector(0.3), vector(3), vector(1)) for k in range(joints)]
    return f'<robot name="chain">{"".join(links + connections)}</robot>'


def measure(urdf: Path, runs: int, *options: str) -> tuple[float, int]:
    """Seconds (median) and the size of the C source in bytes."""
    times, size = [], 0
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as output:
            command = [sys.executable, "-m", "stiffgen.cli", "generate", str(urdf), "--output", output, *options]
            start = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            times.append(time.perf_counter() - start)
            (folder,) = Path(output).iterdir()
            size = (folder / f"{folder.name}.c").stat().st_size
    return statistics.median(times), size


def main() -> None:
    with tempfile.TemporaryDirectory() as work:
        chain = Path(work) / "chain.urdf"
        chain.write_text(long_chain(40))
        for title, urdf, runs in (("iiwa14", IIWA14, 5), ("40 joints", chain, 2)):
            for options in (("--no-build",), ()):
                seconds, size = measure(urdf, runs, *options)
                how = "sources alone" if options else "with the build"
                print(f"{title:10} {how:15} {seconds:6.2f} s   C source {size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
