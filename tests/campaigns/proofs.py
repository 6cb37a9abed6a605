# SPDX-License-Identifier: MIT
"""Whole folders proved: the iiwa 14, a 6-axis arm and a 12-joint chain of random geometry. Minutes to an hour.

python tests/campaigns/proofs.py [iiwa14] [6] [12] prints what is not proved, and the processor time of each.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import stiffgen
from stiffgen.lab.prove.run import prove

ROOT = Path(__file__).resolve().parents[2]


def random_arm(joints: int) -> str:
    """Return the URDF of a chain of revolute joints with random axes, masses and inertias."""
    draw = np.random.default_rng(joints)

    def three(size: float) -> str:
        return " ".join(f"{x:.6f}" for x in draw.uniform(-size, size, 3))

    links = ['<link name="l0"/>']
    for k in range(joints):
        links.append(
            f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{three(0.4)}" rpy="{three(3.0)}"/><axis xyz="{three(1.0)}"/>'
            f'<limit lower="-2.5" upper="2.5" velocity="2" effort="100"/></joint><link name="l{k + 1}"><inertial>'
            f'<origin xyz="{three(0.1)}"/><mass value="{draw.uniform(0.5, 4.0):.4f}"/>'
            f'<inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="0.002" iyz="0.001"/></inertial></link>'
        )
    return '<robot name="other">' + "".join(links) + "</robot>"


def main(names: list[str]) -> int:
    """Prove the functions of the robots, given by name or number of joints; return 1 if one stays open."""
    open_ones = 0
    for name in names or ["iiwa14", "6", "12"]:
        with tempfile.TemporaryDirectory() as folder:
            robot = ROOT / "generated" / name
            if name.isdigit():
                urdf = Path(folder) / "robot.urdf"
                urdf.write_text(random_arm(int(name)))
                robot = stiffgen.generate(urdf, output=folder, name="other", build=False)
            start = time.monotonic()
            verdicts = prove(robot, progress=lambda step: print(f"  {step}", flush=True))
        for verdict in verdicts:
            if verdict.outcome != "proved":
                open_ones += 1
                print(f"{name}: {verdict.outcome}: {verdict.function} ({verdict.tool}): {verdict.detail}")
        seconds = sum(verdict.seconds for verdict in verdicts)
        print(
            f"{name}: {len(verdicts)} verdicts, {seconds:.0f} s processor, {time.monotonic() - start:.0f} s", flush=True
        )
    return 1 if open_ones else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
