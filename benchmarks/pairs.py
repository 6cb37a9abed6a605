# SPDX-License-Identifier: MIT
"""Time the joint stiffness of a spring between two arms against those of two ordinary springs, in batches.

    python -m benchmarks.pairs

Two iiwa 14 on a stand, whose springs have a result of 14 x 14, and one by itself: NumPy calls of 4096 configurations
each, in turn in one process. The fastest rounds are compared: others on a shared machine can only add.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import stiffgen
from benchmarks.tools import COUNT, URDF, least
from examples.two_arms import IIWA, SIDES, described

ROUNDS = 101


def measured(folder: Path, rounds: int = ROUNDS) -> dict[str, float]:
    """Return the times [ns] a configuration of the spring between the arms, and of a spring at each hand."""
    (folder / "two_arms.urdf").write_text(described())
    tips = [f"{side}_{IIWA.tip}" for side in SIDES]
    two = stiffgen.generate(
        folder / "two_arms.urdf", tip=tips, pairs=[":".join(tips)], kernels=["pair", "spring"], output=folder,
        controller=False,
    )  # fmt: skip
    one = stiffgen.generate(URDF, name="one_arm", kernels="spring", output=folder, controller=False)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (COUNT, 14))
    pose, K = np.eye(4), (300.0 * np.eye(3), 20.0 * np.eye(3))
    arms, arm = (stiffgen.open_robot(made).module for made in (two, one))
    halves = [np.ascontiguousarray(q[:, side]) for side in (slice(7), slice(7, 14))]
    hands = [getattr(arms, tip).spring for tip in tips]
    times = least(
        {
            "pair of arms": lambda: arms.pair.joint_stiffness(q, pose, *K),
            "two springs of the two arms": lambda: [hand.joint_stiffness(q, pose, *K) for hand in hands],
            "two springs of one arm": lambda: [arm.spring.joint_stiffness(half, pose, *K) for half in halves],
        },
        rounds,
    )
    return {name: 1e9 / COUNT * seconds for name, seconds in times.items()}


def main() -> None:
    """Print the times, and the pair's over the others."""
    with tempfile.TemporaryDirectory() as folder:
        times = measured(Path(folder))
    print("joint stiffness in batches, ns a configuration")
    for name, time_ns in times.items():
        print(f"  {name}: {time_ns:.0f}, the pair's is {times['pair of arms'] / time_ns:.2f} of it")


if __name__ == "__main__":
    main()
