# SPDX-License-Identifier: MIT
"""Command random poses, and look where the arm comes to rest.

    python tests/campaigns/poses.py [ROBOT.urdf:TIP ...] [--count 125] [--seed 1]

Every robot starts at rest at a random posture. Four kinds of poses are commanded in turn: of a
posture up to 0.9 rad away in each joint, of any posture within the limits, of a posture near a singular one, and the
pose at the start turned by pi. The arm reaches a pose if it ends within 0.1 mm and 0.02 degrees. Where it does not,
NAME_find_posture searches another posture, which is then commanded as q0; where it finds none, a search over all
postures says whether there is one.
"""

from __future__ import annotations

import argparse
import ctypes
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen
from support.plant.loop import fill, struct
from support.project import ROOT

HERE = ROOT / "tests" / "support" / "plant"
KINDS = ("near", "far", "singular", "half turn")
LENGTH, ANGLE = 1e-4, np.radians(0.02)
"""Reached: distance [m] and angle [rad]."""
Array = np.ndarray


@dataclass(frozen=True)
class Target:
    """Start, commanded pose and wanted posture; kind of KINDS. With ``by_position`` the posture is the command."""

    kind: str
    start: Array
    pose: Array
    posture: Array
    by_position: bool = False


class Arm:
    """A robot's controller and arm, compiled from its folder (tests/support/plant/poses.c)."""

    def __init__(self, folder: Path, robot: Path) -> None:
        name = robot.name
        header = (robot / f"{name}.h").read_text()
        self.n = int(re.findall(rf"#define {name.upper()}_DOF (\d+)", header)[0])
        bits = re.findall(rf"{name.upper()}_STATUS_(\w+) = 1 << (\d+)", (robot / f"{name}_impedance.h").read_text())
        self.status = {bit: 1 << int(place) for bit, place in bits}
        macros = {"ROBOT": name, "UPPER": name.upper(), "HEADER": f"{name}_impedance.h"}
        command = ["gcc", "-std=c99", "-O1", "-march=native", "-shared", "-fPIC", f"-I{robot}"]
        command += [f"-D{key}={value}" for key, value in macros.items()]
        files = [HERE / "poses.c", robot / f"{name}.c", robot / f"{name}_impedance.c"]
        library = folder / f"{name}.so"
        if not library.exists():
            subprocess.run([*command, *map(str, files), "-lm", "-o", str(library)], check=True)
        self.library, self.name, self.folder = ctypes.CDLL(str(library)), name, robot
        self.Config = struct(robot / f"{name}_impedance.h", f"{name}_impedance_config", {}, {})
        self.lower, self.upper = (
            np.array((ctypes.c_double * self.n).in_dll(self.library, f"{name}_{limit}")) for limit in ("lower", "upper")
        )
        self.lower, self.upper = np.maximum(self.lower, -np.pi), np.minimum(self.upper, np.pi)

    def kernel(self, name: str, q: Array, size: int) -> Array:
        q, result = np.ascontiguousarray(q, dtype=float), np.empty(size)
        getattr(self.library, f"{self.name}_{name}")(*(x.ctypes.data_as(ctypes.c_void_p) for x in (q, result)))
        return result

    def pose(self, q: Array) -> Array:
        return self.kernel("forward_kinematics", q, 16).reshape(4, 4)

    def jacobian(self, q: Array) -> Array:
        return self.kernel("hybrid_jacobian", q, 6 * self.n).reshape(6, self.n)

    def config(self, **values: Any) -> Any:
        config = self.Config()
        self.library.poses_default_config(ctypes.byref(config))
        return fill(config, **{"motor_inertia": 0.1, **values})

    def find_posture(self, pose: Array, start: Array, **config: Any) -> Array | None:
        """Return the posture of a pose that NAME_find_posture finds; None if it finds none."""
        arrays, posture = [np.ascontiguousarray(x, dtype=float) for x in (pose, start)], np.empty(self.n)
        search = getattr(self.library, f"{self.name}_find_posture")
        code = search(ctypes.byref(self.config(**config)), *map(_pointer, (*arrays, posture)))
        return posture if code == 0 else None

    def run(
        self, *targets: Target, seconds: float, translation: float = 700.0, rotation: float = 30.0, **config: Any
    ) -> dict[str, Any]:
        """Go to targets one after the other, each for some seconds, from the start of the first.

        Return errors [m, rad] from the last one, the last status of each, the reason of a fault, and the last speed
        [rad/s], posture and reference.
        """
        q, reference = targets[0].start.copy(), np.empty(self.n)
        status, speed = (ctypes.c_uint * len(targets))(), ctypes.c_double()
        poses, postures = (np.stack(each) for each in zip(*((t.pose, t.posture) for t in targets), strict=True))
        positions = np.array([target.by_position for target in targets], np.int32)
        arrays = (poses, postures, positions, translation * np.eye(3), rotation * np.eye(3))
        reason = self.library.poses_run(
            ctypes.byref(self.config(**config)), len(targets), round(seconds / 1e-3), _pointer(q),
            *map(_pointer, arrays), _pointer(reference), status, ctypes.byref(speed),
        )  # fmt: skip
        length, angle = errors(self.pose(q), targets[-1].pose)
        return {"length": length, "angle": angle, "statuses": list(status), "last": status[-1], "reason": reason,
                "speed": speed.value, "q": q, "reference": reference,
                "reached": length <= LENGTH and angle <= ANGLE}  # fmt: skip


def _pointer(x: Array) -> Any:
    return x.ctypes.data_as(ctypes.c_void_p)


def errors(pose: Array, wanted: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    turn = wanted[:3, :3].T @ pose[:3, :3]
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return float(np.linalg.norm(pose[:3, 3] - wanted[:3, 3])), float(np.arctan2(sine, (np.trace(turn) - 1) / 2))


def draw(random: np.random.Generator, arm: Arm, kind: str) -> Target:
    """Draw a target of a kind; starts and postures of poses keep 0.15 rad from the limits."""
    lower, upper = arm.lower + 0.15, arm.upper - 0.15
    start = random.uniform(lower, upper)
    if kind == "half turn":
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        pose = arm.pose(start)
        pose[:3, :3] = (2 * np.outer(axis, axis) - np.eye(3)) @ pose[:3, :3]
        return Target(kind, start, pose, start)
    goal = random.uniform(lower, upper)
    if kind != "far":
        goal = np.clip(start + random.uniform(-0.9, 0.9, arm.n), lower, upper)
    if kind == "singular":
        for _ in range(60):  # down the least singular value
            slope = [_least(arm, goal + d) - _least(arm, goal - d) for d in 1e-5 * np.eye(arm.n)]
            size = np.linalg.norm(slope) / 2e-5
            goal = np.clip(goal - np.array(slope) / 2e-5 / max(size, 1e-9) ** 2 * _least(arm, goal), lower, upper)
    return Target(kind, start, arm.pose(goal), start)


def _least(arm: Arm, q: Array) -> float:
    return float(np.linalg.svd(arm.jacobian(q), compute_uv=False)[-1])


def posture_of(random: np.random.Generator, arm: Arm, wanted: Array, first: Array, tries: int = 30) -> Array | None:
    """Search a posture of a pose 0.1 rad within the limits, from many starts; None if there is none."""
    lower, upper = arm.lower + 0.1, arm.upper - 0.1
    for attempt in range(tries):
        q = first.copy() if attempt == 0 else random.uniform(lower, upper)
        for _ in range(100):
            pose = arm.pose(q)
            turn = wanted[:3, :3] @ pose[:3, :3].T
            w = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
            e = np.concatenate([wanted[:3, 3] - pose[:3, 3], w])
            length, angle = errors(pose, wanted)
            if length < LENGTH / 10 and angle < ANGLE / 10:
                return q
            J = arm.jacobian(q)
            q = np.clip(q + J.T @ np.linalg.solve(J @ J.T + (1e-6 + 0.01 * e @ e) * np.eye(6), e), lower, upper)
    return None


def survey(arm: Arm, count: int, seed: int, seconds: float, **config: Any) -> list[dict[str, Any]]:
    """Run targets; another posture is searched for those not reached, and commanded."""
    found = []
    for k in range(count):
        random = np.random.default_rng([seed, k])
        target = draw(random, arm, KINDS[k % len(KINDS)])
        got = arm.run(target, seconds=seconds, **config)
        row = {**got, "target": target, "kind": target.kind, "led": False, "exists": got["reached"]}
        if not got["reached"] and got["reason"] == 0:
            posture = arm.find_posture(target.pose, got["q"], **config)
            row["exists"] = posture is not None or posture_of(random, arm, target.pose, got["q"]) is not None
            if posture is not None:
                row["led"] = arm.run(
                    target, replace(target, posture=posture, by_position=True), seconds=seconds, **config
                )["reached"]
        found.append(row)
    return found


def report(arm: Arm, rows: list[dict[str, Any]]) -> None:
    """Print a row per kind of target."""
    for kind in KINDS:
        of_kind = [row for row in rows if row["kind"] == kind]
        short = [row for row in of_kind if not row["reached"]]
        led = [row for row in short if row["led"]]
        flagged = sum(bool(row["last"] & arm.status["UNREACHABLE"]) for row in short)
        none, faults = sum(not row["exists"] for row in short), sum(row["reason"] != 0 for row in short)
        counts = (len(of_kind), kind, len(of_kind) - len(short), flagged, len(led), none, faults)
        print(f"| {arm.name} | " + " | ".join(map(str, counts)) + " |", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["urdf/iiwa14.urdf"], metavar="ROBOT.urdf:TIP")
    parser.add_argument("--count", type=int, default=125)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    print("| robot | poses | kind | reached | UNREACHABLE | then reached by find_posture | no posture | faults |")
    print("|---|---|---|---|---|---|---|---|")
    for robot in options.robots:
        file, _, tip = robot.partition(":")
        with tempfile.TemporaryDirectory() as folder:
            name = re.sub(r"\W", "_", Path(file).stem)
            stiffgen.generate(file, name=name, tip=tip or None, output=folder, build=False)
            arm = Arm(Path(folder), Path(folder) / name)
            report(arm, survey(arm, options.count, options.seed, options.seconds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
