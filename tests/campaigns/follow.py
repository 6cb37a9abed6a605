# SPDX-License-Identifier: MIT
"""Send Follow to random legal poses and back, on random arms of six and seven joints.

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
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen
from support.plant.loop import fill, struct
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
    '<origin xyz="{x:.3f} {y:.3f} {z:.3f}" rpy="{roll:.4f} {pitch:.4f} 0"/><axis xyz="0 0 1"/>'
    '<limit lower="{lower:.3f}" upper="{upper:.3f}" effort="100" velocity="{velocity:.2f}"/></joint>'
)


def random_arm(random: np.random.Generator, joints: int) -> str:
    """Return the URDF of a random arm: axes at right angles or parallel, links up to 0.4 m, ranges of 3 to 6 rad."""
    parts, parent = ['<link name="base"/>'], "base"
    for k in range(joints):
        turn = random.choice([-np.pi / 2, 0.0, np.pi / 2], p=[0.4, 0.2, 0.4]) if k else 0.0
        length = random.uniform(0.05, 0.4) if k < joints - 2 else random.uniform(0.03, 0.15)
        x, z = random.choice([0.0, length]), random.uniform(0.0, length)
        half = random.uniform(1.5, 3.0, 2)
        parts.append(_LINK.format(name=f"l{k}"))
        parts.append(
            _JOINT.format(
                name=f"l{k}", parent=parent, x=x, y=0.0, z=z, roll=turn, pitch=0.0, lower=-half[0], upper=half[1],
                velocity=random.uniform(1.0, 3.5),
            )
        )  # fmt: skip
        parent = f"l{k}"
    parts.append('<link name="tip"/><joint name="tip" type="fixed"><parent link="' + parent + '"/><child link="tip"/>')
    parts.append('<origin xyz="0.05 0.02 0.1"/></joint>')
    return f'<robot name="arm">{"".join(parts)}</robot>'


class Arm:
    """A robot's Follow and search for postures, compiled from its folder."""

    def __init__(self, urdf: Path, tip: str | None, name: str, folder: Path) -> None:
        stiffgen.generate(urdf, name=name, tip=tip, output=folder, build=False, batches=False)
        robot = folder / name
        self.name, self.n = name, int(re.findall(r"_DOF (\d+)", (robot / f"{name}.h").read_text())[0])
        macros = [f"-DROBOT={name}", f"-DUPPER={name.upper()}", "-include", f"{name}_follow.h"]
        sources = [LEGS, *(robot / f"{name}{part}.c" for part in ("", "_follow", "_impedance"))]
        command = ["gcc", "-std=gnu99", "-O1", "-shared", "-fPIC", f"-I{robot}", *macros, *map(str, sources)]
        library = folder / f"{name}.so"
        subprocess.run([*command, "-lm", "-o", str(library)], check=True)
        self.library, known = ctypes.CDLL(str(library)), dict[str, Any]()
        self.Leg = struct(LEGS, "leg_t", known, {})
        self.Config = struct(robot / f"{name}_impedance.h", f"{name}_impedance_config", known, {})
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
        config, posture = self.Config(), np.empty(self.n)
        getattr(self.library, f"{self.name}_impedance_default_config")(ctypes.byref(config))
        search = getattr(self.library, f"{self.name}_find_posture")
        fill(config, motor_inertia=0.1)
        return posture if search(ctypes.byref(config), *map(_pointer, (pose, start, posture))) == 0 else None


def _pointer(array: Array) -> Any:
    return np.ascontiguousarray(array).ctypes.data_as(ctypes.c_void_p)


COUNTS = ("legs", "reached", "unreachable", "other posture", "silent", "not led", "beyond", "too fast", "at rest")


def survey(arm: Arm, legs: int, random: np.random.Generator) -> dict[str, int]:
    """Return counts of legs."""
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", metavar="ROBOT.urdf:TIP")
    parser.add_argument("--arms", type=int, default=30)
    parser.add_argument("--legs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    bad = 0
    print("| arm | " + " | ".join(COUNTS) + " |\n|---|" + "---|" * len(COUNTS))
    with tempfile.TemporaryDirectory() as made:
        folder, files = Path(made), [tuple(robot.partition(":")[::2]) for robot in options.robots]
        for k in range(options.arms):
            file = folder / f"arm{k}.urdf"
            file.write_text(random_arm(np.random.default_rng([options.seed, k]), 6 + k % 2))
            files.append((str(file), "tip"))
        for k, (file, tip) in enumerate(files):
            name = re.sub(r"\W", "_", Path(file).stem)
            arm = Arm(Path(file), tip or None, name, folder)
            counts = survey(arm, options.legs, np.random.default_rng([options.seed, k, 1]))
            print(f"| {name}, {arm.n} joints | " + " | ".join(map(str, counts.values())) + " |", flush=True)
            bad += sum(counts[name] for name in ("silent", "not led", "beyond", "too fast"))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
