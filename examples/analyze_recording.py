# SPDX-License-Identifier: MIT
"""Draw docs/analyze_stiffness.svg and docs/analyze_moment.svg: ``python -m examples.analyze_recording``.

The recording is the paper's zero-force trajectory, twice round the bowl in 28 s, with a made-up wrench: pressing with
20 N, moments of some N m that come and go.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from examples.bowl_wiping import trajectory
from stiffgen import analyze

ROOT = Path(__file__).resolve().parents[1]
TASK_STIFFNESS = (700, 700, 800, 30, 30, 30)
PERIOD = 0.005


def recording() -> dict[str, NDArray[np.float64]]:
    """Return time [s], joint positions [rad] and wrench [N, N m] in base axes, two rounds."""
    q = np.concatenate([trajectory.recorded()] * 2)
    time = PERIOD * np.arange(len(q))
    turn = 2 * np.pi * time[:, None] / time[-1]
    wrench = np.hstack([np.sin(turn * [3, 5, 2]) * [6, 4, 5] - [0, 0, 20], np.sin(turn * [2, 3, 5]) * [4, 3, 1.5]])
    return {"time": time, "q": q, "wrench": wrench}


def draw(robot: Path) -> dict[str, str]:
    """Analyse the recording with the robot's folder; return two of the figures by the name of their file in docs/."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "bowl.npz"
        np.savez(log, **recording())  # type: ignore[arg-type]
        made = analyze(log, robot, np.diag(TASK_STIFFNESS), output=Path(folder) / "analysis").folder
        return {f"analyze_{name}.svg": (made / f"{name}.svg").read_text() for name in ("stiffness", "moment")}


def main() -> None:
    """Write the figures."""
    for name, svg in draw(ROOT / "generated" / "iiwa14").items():
        (ROOT / "docs" / name).write_text(svg)


if __name__ == "__main__":
    main()
