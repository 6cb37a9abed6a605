# SPDX-License-Identifier: MIT
"""Send Follow to random legal poses and back: a SCARA, an arm like the RM65, and random arms of six and seven joints.

    python tests/campaigns/follow.py [ROBOT.urdf:TIP ...] [--arms 30] [--legs 60] [--seed 1]

Each leg begins at rest in a random posture within the limits, and goes to the pose of another one, and back. Half of
the legs have only the pose, the others also the posture. A leg ends on its pose (1 mm, 5 mrad), or says UNREACHABLE.
Where it says so, NAME_find_posture looks for a posture of the pose, and with that posture the leg must end on the pose.
Exit code 1: a joint went beyond a limit or its speed, a leg ended elsewhere in silence, or a posture did not lead.
"""

from __future__ import annotations

import argparse
import ctypes
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen
from support.plant.loop import struct
from support.project import ROOT

Array = np.ndarray[Any, np.dtype[Any]]
LEGS = ROOT / "tests" / "support" / "plant" / "legs.c"
UNREACHABLE, SAMPLE_TIME, LONGEST = 8, 2e-3, 10_000
LENGTH, ANGLE = 1e-3, 5e-3
"""Reached: distance [m] and angle [rad]."""
_LINK = (
    '<link name="{name}"><inertial><origin xyz="0 0 0.05"/><mass value="2"/>'
    '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
_JOINT = (
    '<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
    '<origin xyz="{place}" rpy="{turn}"/><axis xyz="0 0 1"/>'
    '<limit lower="{lower:.3f}" upper="{upper:.3f}" effort="100" velocity="{velocity:.2f}"/></joint>'
)
RM65 = (
    ("0 0 0.2405", "0 0 0", 3.106, 3.14),
    ("0 0 0", "-1.570796 -1.570796 0", 2.268, 3.14),
    ("0.256 0 0", "0 0 1.570796", 2.356, 3.92),
    ("0 -0.21 0", "1.570796 0 0", 3.106, 3.92),
    ("0 0 0", "-1.570796 0 0", 2.234, 3.92),
    ("0 0 0.144", "1.570796 0 0", 3.140, 3.92),
)
"""Places, turns, limits [rad] and speeds [rad/s] of the joints of an arm like the RM65."""


def arm_urdf(joints: Iterable[tuple[str, str, float, float, float]]) -> str:
    """Return the URDF of a serial arm: of each joint its place, turn, lower and upper limit, and speed."""
    parts, parent = ['<link name="base"/>'], "base"
    for k, (place, turn, lower, upper, velocity) in enumerate(joints):
        name = f"l{k}"
        parts.append(_LINK.format(name=name))
        parts.append(
            _JOINT.format(name=name, parent=parent, place=place, turn=turn, lower=lower, upper=upper, velocity=velocity)
        )
        parent = name
    parts.append(f'<link name="tip"/><joint name="tip" type="fixed"><parent link="{parent}"/><child link="tip"/>')
    parts.append('<origin xyz="0.05 0.02 0.1"/></joint>')
    return f'<robot name="arm">{"".join(parts)}</robot>'


def random_arm(random: np.random.Generator, joints: int) -> str:
    """Return the URDF of a random arm: axes at right angles or parallel, links up to 0.4 m, ranges of 3 to 6 rad."""
    rows = []
    for k in range(joints):
        turn = random.choice([-np.pi / 2, 0.0, np.pi / 2], p=[0.4, 0.2, 0.4]) if k else 0.0
        length = random.uniform(0.05, 0.4) if k < joints - 2 else random.uniform(0.03, 0.15)
        x, z = random.choice([0.0, length]), random.uniform(0.0, length)
        lower, upper = random.uniform(1.5, 3.0, 2)
        rows.append((f"{x:.3f} 0 {z:.3f}", f"{turn:.4f} 0 0", -lower, upper, random.uniform(1.0, 3.5)))
    return arm_urdf(rows)


class Arm:
    """A robot's Follow and search for postures, compiled from its folder."""

    def __init__(self, urdf: Path, tip: str | None, name: str, folder: Path) -> None:
        """Generate the arm, compile its follower into a library, and read the joint limits (within 3 rad)."""
        stiffgen.generate(urdf, name=name, tip=tip, output=folder, build=False, batches=False)
        robot = folder / name
        self.name, self.n = name, int(re.findall(r"_DOF (\d+)", (robot / f"{name}.h").read_text())[0])
        macros = [f"-DROBOT={name}", f"-DUPPER={name.upper()}", "-include", f"{name}_follow.h"]
        sources = [LEGS, *(robot / f"{name}{part}.c" for part in ("", "_follow", "_find_posture"))]
        command = ["gcc", "-std=gnu99", "-O1", "-shared", "-fPIC", f"-I{robot}", *macros, *map(str, sources)]
        library = folder / f"{name}.so"
        subprocess.run([*command, "-lm", "-o", str(library)], check=True)
        self.library = ctypes.CDLL(str(library))
        self.Leg = struct(LEGS, "leg_t", {}, {})
        limits = (np.array((ctypes.c_double * self.n).in_dll(self.library, f"{name}_{x}")) for x in ("lower", "upper"))
        self.lower, self.upper = (np.clip(limit, -3.0, 3.0) for limit in limits)

    def pose(self, q: Array) -> Array:
        made = np.empty(16)
        getattr(self.library, f"{self.name}_forward_kinematics")(_pointer(q), _pointer(made))
        return made

    def begin(self, q: Array) -> None:
        assert self.library.legs_begin(ctypes.c_double(SAMPLE_TIME), _pointer(q)) == 0

    def go(self, pose: Array, posture: Array) -> tuple[Any, Array]:
        """Return what the leg was, and q0 at its end."""
        leg, q = self.Leg(), np.empty(self.n)
        self.library.legs_go(_pointer(pose), _pointer(posture), LONGEST, _pointer(q), ctypes.byref(leg))
        return leg, q

    def find_posture(self, pose: Array, start: Array) -> Array | None:
        """Return a posture of the pose within what Follow may use, or None."""
        posture = np.empty(self.n)
        search = getattr(self.library, f"{self.name}_find_posture")
        code = search(_pointer(pose), None, _pointer(start), None, None, _pointer(posture))
        return posture if code == 0 else None


def _pointer(array: Array) -> Any:
    return np.ascontiguousarray(array).ctypes.data_as(ctypes.c_void_p)


COUNTS = ("legs", "reached", "unreachable", "other posture", "silent", "not led", "beyond", "too fast", "at rest")


def survey(arm: Arm, legs: int, random: np.random.Generator) -> dict[str, int]:
    """Lead the arm along random legs, there and back; return how many had each of COUNTS."""
    counts = dict.fromkeys(COUNTS, 0)
    for k in range(legs):
        ends = [arm.lower + (arm.upper - arm.lower) * random.uniform(0.1, 0.9, arm.n) for _ in range(2)]
        arm.begin(ends[0])
        for goal in (ends[1], ends[0]):
            leg, q = arm.go(arm.pose(goal), goal if k % 2 else ends[0])
            reached, said = leg.distance < LENGTH and leg.angle < ANGLE, bool(leg.status & UNREACHABLE)
            beyond, fast = leg.beyond > 1e-9, leg.speed > 1.0 + 1e-9
            counts["at rest"] += leg.samples < LONGEST
            counts["legs"] += 1
            counts["reached"] += reached
            counts["unreachable"] += said and not reached
            counts["silent"] += not said and not reached
            posture = None if reached else arm.find_posture(arm.pose(goal), q)
            if posture is not None:
                counts["other posture"] += 1
                leg, _ = arm.go(arm.pose(goal), posture)
                counts["not led"] += not (leg.distance < LENGTH and leg.angle < ANGLE)
                beyond, fast = beyond or leg.beyond > 1e-9, fast or leg.speed > 1.0 + 1e-9
            counts["beyond"] += beyond
            counts["too fast"] += fast
    return counts


def main() -> int:
    """Follow random legs with random arms, count the outcomes, and return 1 if one is bad."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT.urdf:TIP")
    parser.add_argument("--arms", type=int, default=30)
    parser.add_argument("--legs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    total = dict.fromkeys(COUNTS, 0)
    print("| arm | " + " | ".join(COUNTS) + " |\n|---|" + "---|" * len(COUNTS))
    with tempfile.TemporaryDirectory() as made:
        folder, files = Path(made), [tuple(robot.partition(":")[::2]) for robot in options.robots]
        (folder / "rm65.urdf").write_text(arm_urdf((a, b, -most, most, v) for a, b, most, v in RM65))
        if not files:
            files = [(str(ROOT / "tests" / "data" / "scara.urdf"), ""), (str(folder / "rm65.urdf"), "tip")]
        for k in range(options.arms):
            file = folder / f"arm{k}.urdf"
            file.write_text(random_arm(np.random.default_rng([options.seed, k]), 6 + k % 2))
            files.append((str(file), "tip"))
        for k, (file, tip) in enumerate(files):
            name = re.sub(r"\W", "_", Path(file).stem)
            arm = Arm(Path(file), tip or None, name, folder)
            counts = survey(arm, options.legs, np.random.default_rng([options.seed, k, 1]))
            print(f"| {name}, {arm.n} joints | " + " | ".join(map(str, counts.values())) + " |", flush=True)
            total = {each: total[each] + counts[each] for each in COUNTS}
    print(f"| all {len(files)} arms | " + " | ".join(map(str, total.values())) + " |")
    return 1 if any(total[each] for each in ("silent", "not led", "beyond", "too fast")) else 0


if __name__ == "__main__":
    sys.exit(main())
