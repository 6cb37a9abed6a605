# SPDX-License-Identifier: MIT
"""Memory that one call on a long array takes beyond its arguments and its result (Linux).

    python benchmarks/stream_memory.py generated/iiwa14 10000000 [spread]

prints the kB by which the process's resident memory peaks during hybrid.joint_stiffness over what it holds before the
call; with "spread", every other element of a wider array is q, so that no configuration is contiguous. The kernel's
figures are good to some 200 kB.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from stiffgen import open_robot


def resident(what: str) -> int:
    """Return a figure of /proc/self/status in kB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(what)).split()[1])


def main() -> None:
    folder, count, spread = sys.argv[1], int(sys.argv[2]), "spread" in sys.argv[3:]
    kernel = open_robot(Path(folder)).module.hybrid.joint_stiffness
    positions = np.linspace(-1.5, 1.5, 14 * 1000).reshape(1000, 14)
    q = np.tile(positions if spread else positions[:, ::2], (count // 1000, 1))
    q = q[:, ::2] if spread else q
    wrench = np.tile(np.linspace(-9.0, 9.0, 6 * 1000).reshape(1000, 6), (count // 1000, 1))
    K = np.diag([700.0, 700, 800, 30, 30, 30])
    out = np.full((count, 7, 7), -1.0)  # all pages are there before the call
    kernel(q[:100], wrench[:100], K, out=out[:100])
    before = resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak
    kernel(q, wrench, K, out=out)
    print(max(resident("VmHWM") - before, 0))
    assert np.array_equal(out[-1000:], out[:1000])


if __name__ == "__main__":
    main()
