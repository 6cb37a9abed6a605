# SPDX-License-Identifier: MIT
"""Compare this controller with four laws in use, on the same plants with the same gains, in one table.

    python tests/campaigns/compare.py [--arms iiwa14,panda,ur5,j2s6s200] [--count] [--output docs/results.md]

The laws stand in tests/support/arms/laws.c, each written from its formula: a rotation vector with a projected
nullspace; a quaternion with clipped error and an integral; operational space, decoupled by inertia; the first one with
clipped error. All have the same limits of torque and torque rate. Poses reach this controller through Follow.

Rows of Settle and Press compare these makers, with 90 % of the friction fed forward, with the same laws. What those
know of a force is their spring: their pose lies F / K inside the surface. The second one's integral is clipped to 20 N.

The plant (tests/support/arms/arms.c) has friction that sticks and slips, flexible joints, the maker's sensors and one
sample of delay. 600 N/m and 30 N m/rad unless a row says more.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from support.arms.arms import FLAGS, Arm

Array = np.ndarray[Any, np.dtype[Any]]
LAWS = ("stiffgen", "rotation vector", "quaternion, clipped", "operational space", "rotation vector, clipped")
FORCE, DEPTH = 15.0, 0.02
"""Force that is to be held [N], and how far the surface is away at the start [m]."""
MARK = "<!-- laws in use -->"


def turned(pose: Array, shift: Any = (0, 0, 0), axis: int = 2, angle: float = 0.0) -> Array:
    """Return a pose moved by a shift, and turned about an axis of the base."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[a, a] = R[b, b] = np.cos(angle)
    R[a, b], R[b, a] = -np.sin(angle), np.sin(angle)
    made = pose.copy()
    made[:3, 3] += shift
    made[:3, :3] = R @ pose[:3, :3]
    return made


class Bench:
    """An arm under one law; each method is a row of the table and returns its number."""

    def __init__(self, arm: Arm, law: int) -> None:
        self.arm, self.law = arm, law
        self.pose = arm.module.forward_kinematics(arm.posture)

    def run(
        self, samples: int, poses: Any, plant: dict[str, Any] | None = None, friction: float = 0.0, **inputs: Any
    ) -> Array:
        """Return the rows of an episode; a share of the true friction is fed forward by this controller alone."""
        arm, sensors = self.arm, self.arm.maker.sensors
        made = arm.plant(flexible=True, law=self.law, **(plant or {}))
        config = arm.config(
            delay_samples=made.delay,
            position_quantum=sensors.position_quantum,
            velocity_noise=max(sensors.velocity_noise, sensors.velocity_quantum),
            coulomb_friction=friction * arm.maker.friction * arm.effort,
        )
        poses = np.broadcast_to(poses, (samples, 4, 4))
        return arm.run(made, samples, config, goal=arm.posture, pose=poses, **inputs)

    def away(self, rows: Array, poses: Any) -> Array:
        return np.asarray(1e3 * np.linalg.norm(rows["pose"].reshape(-1, 4, 4)[:, :3, 3] - poses[..., :3, 3], axis=1))

    def speed(self, rows: Array) -> float:
        return float((np.abs(rows["v"]) / self.arm.velocity).max())

    def self_motion(self, rows: Array) -> float:
        """Return the largest speed of the self-motion n [rad/s], J n = 0 and |n| = 1; 0 for an arm without one.

        The velocity is n a + M^-1 J^T b, and |a| is returned. M has the rotors: a force at the tip then drives b alone.
        """
        arm, most = self.arm, 0.0
        for q, v in zip(rows["q"], rows["v"], strict=True):
            J = np.reshape(arm.module.hybrid.jacobian(q), (6, arm.n))
            M = arm.module.mass_matrix(q) + arm.maker.motor * np.eye(arm.n)
            for n in np.linalg.svd(J)[2][6:]:
                most = max(most, abs(float(n @ M @ v / (n @ M @ n))))
        return most

    def step(self) -> float:
        goal = turned(self.pose, (0.0, 0.08, -0.06))
        return float(self.away(self.run(5000, goal), goal)[-500:].mean())

    def held(self, payload: float) -> float:
        """Return the error [mm] that the encoders see 7 s after a step of 10 cm, with a payload [kg] nobody stated."""
        goal = turned(self.pose, (0.0, 0.08, -0.06))
        rows = self.settled(np.tile(goal, (7000, 1, 1)), payload=payload)
        seen = self.arm.module.forward_kinematics(np.ascontiguousarray(rows["motors"][-1])).reshape(4, 4)
        return 1e3 * float(np.linalg.norm(seen[:3, 3] - goal[:3, 3]))

    def settled(self, poses: Array, **inputs: Any) -> Array:
        """Return the rows of an episode with Settle and friction fed forward; other laws go as they are."""
        makers = {"makers": 1, "settle_force": (40.0, 4.0), "wrench_delay": 1} if self.law == 0 else {}
        return self.run(len(poses), poses, makers, 0.9, **inputs)

    def pressed(self, poses: Array, inwards: Array, plant: dict[str, Any], **inputs: Any) -> Array:
        """Return the motion of a tip that is to press with FORCE along unit vectors: by Press, or F / K inside."""
        if self.law == 0:
            noise = 0.3 * np.random.default_rng(1).normal(size=(len(poses), 6))
            order = np.concatenate([inwards, np.full((len(poses), 1), FORCE), np.zeros((len(poses), 1))], axis=1)
            return self.run(
                len(poses), poses, plant | {"makers": 1, "wrench_delay": 1}, press=order, wrench_noise=noise, **inputs
            )
        inside = poses.copy()
        inside[:, :3, 3] += (DEPTH + FORCE / 600.0) * inwards
        return self.run(len(poses), inside, plant, **inputs)

    def wall_force(self, way: float) -> float:
        """Return the rms error [N] of the force on a wall of 1e4 N/m, still or moving by a way [m] at 0.5 Hz."""
        time, down = np.arange(9000) * 1e-3, np.tile([0.0, 0.0, -1.0], (9000, 1))
        wall = {"wall_stiffness": 1e4, "wall_point": self.pose[:3, 3] - [0, 0, DEPTH]}
        moved = way * np.clip(time - 3.0, 0.0, 1.0) * np.sin(np.pi * time)
        rows = self.pressed(np.tile(self.pose, (9000, 1, 1)), down, wall, wall=moved)
        return float(np.sqrt(np.mean((rows["contact"][4000:, 2] - FORCE) ** 2)))

    def wiped(self) -> float:
        """Return the rms error [N] of the force across a cylinder of 0.3 m that is wiped at 0.1 m/s, friction 0.2."""
        time, radius = np.arange(8000) * 1e-3, 0.3
        angle = 0.4 * np.sin(0.1 / (0.4 * radius) * np.maximum(time - 3.0, 0.0))  # [rad] about the cylinder
        normal = np.stack([np.zeros(8000), np.sin(angle), np.cos(angle)], axis=1)
        poses = np.tile(self.pose, (8000, 1, 1))
        poses[:, :3, 3] += radius * (normal - [0.0, 0.0, 1.0])
        wall = {
            "wall_stiffness": 1e4, "wall_point": self.pose[:3, 3] - [0, 0, DEPTH + radius], "wall_radius": radius,
            "wall_axis": (1.0, 0.0, 0.0), "wall_friction": 0.2,
        }  # fmt: skip
        rows = self.pressed(poses, -normal, wall)
        force = (rows["contact"][:, :3] * normal).sum(axis=1)
        return float(np.sqrt(np.mean((force[4000:] - FORCE) ** 2)))

    def overshoot(self) -> float:
        """Return how far [mm] the tip goes beyond the end of a step of 10 cm."""
        way = np.array((0.0, 0.08, -0.06))
        moved = self.run(3000, turned(self.pose, way))["pose"].reshape(-1, 4, 4)[:, :3, 3] - self.pose[:3, 3]
        return 1e3 * float((moved @ way).max() / np.linalg.norm(way) - np.linalg.norm(way))

    def out_and_back(self, after: float, makers: bool = False) -> tuple[Array, Array]:
        """Return motion and target, until some time after a target that was 0.5 m out of reach is back at the start."""
        outwards = self.pose[:3, 3] / np.linalg.norm(self.pose[:3, 3])
        time = np.arange(6000 + round(1e3 * after) + 1) * 1e-3
        share = np.where(time < 6.0, 0.5 * (1.0 - np.cos(2 * np.pi * time / 6.0)), 0.0)
        goal = np.array([turned(self.pose, 0.5 * x * outwards) for x in share])
        return (self.settled(goal) if makers else self.run(len(goal), goal)), goal

    def back(self, after: float, makers: bool = False) -> float:
        return float(self.away(*self.out_and_back(after, makers))[-1])

    def sine(self) -> float:
        """Return the rms error [mm] of a swing of 5 cm at 1 Hz that has grown within a second."""
        time = np.arange(4000) * 1e-3
        sway = 0.05 * np.minimum(time, 1.0) * np.sin(2 * np.pi * time)
        goal = np.array([turned(self.pose, (0, x, 0)) for x in sway])
        return float(np.sqrt(np.mean(self.away(self.run(4000, goal), goal)[1000:] ** 2)))

    def late(self) -> float:
        """Return the tip's rms acceleration [m/s^2] at rest after a step of 10 cm, with torques 3 samples late."""
        rows = self.run(4000, turned(self.pose, (0.0, 0.08, -0.06)), {"delay": 3})
        return float(np.sqrt((self.acceleration(rows)[-1000:] ** 2).sum(axis=1).mean()))

    def acceleration(self, rows: Array) -> Array:
        """Return the tip's acceleration [m/s^2], a mean of 5 samples: the sampled poses have noise of their own."""
        bend = np.diff(rows["pose"].reshape(-1, 4, 4)[:, :3, 3], 2, axis=0) / 1e-6
        return np.array([np.convolve(axis, np.ones(5) / 5, "same") for axis in bend.T]).T

    def line(self) -> float:
        way = 0.2 * np.clip((np.arange(3000) - 500) * 1e-3, 0, 1)[:, None, None] * np.eye(4)[[1]].T * np.eye(4)[3]
        goal = self.pose + way
        away = self.away(self.run(3000, goal), goal)
        return float(np.sqrt(np.mean(away[500:1500] ** 2)))

    def wall(self, stiffness: float) -> float:
        goal = turned(self.pose, (0.0, 0.0, -0.05))
        plant = {"wall_point": self.pose[:3, 3] - [0, 0, 0.02], "wall_stiffness": stiffness}
        force = self.run(5000, goal, plant)["contact"][-1000:, 2]
        return float(np.ptp(force))

    def clamped(self, rise: float) -> Array:
        """Return the motion of an arm whose tip is clamped while its target swings."""
        time = np.arange(5000) * 1e-3
        sway = 0.05 * np.minimum((time + 1e-3) / rise, 1.0) * np.sin(2 * np.pi * time)
        goal = np.array([turned(self.pose, (0, x, 0)) for x in sway])
        return self.run(5000, goal, {"clamp_start": 10})

    def loaded(self) -> float:
        """Return the largest self-motion of a tip that is moved 15 cm in 0.6 s under a load of 20, 50 or 80 N."""
        most, time = 0.0, np.arange(3000) * 1e-3  # [s]
        share = np.clip((time - 1.0) / 0.6, 0.0, 1.0)
        for force in (20.0, 50.0, 80.0):
            load = np.zeros((3000, 6))
            load[:, 2] = -force * np.minimum(time / 0.5, 1.0)  # [N] hung on within 0.5 s
            for way in ((0.0, 0.15, 0.0), (0.0, 0.0, 0.15)):
                goal = np.array([turned(self.pose, np.array(way) * x) for x in share])
                most = max(most, self.self_motion(self.run(3000, goal, load=load)[1000:]))
        return most

    def limit(self) -> float:
        """Return how far [mrad] a joint goes beyond its limit if its goal is 0.3 rad beyond; negative: not at all."""
        arm, beyond = self.arm, -np.inf
        for joint, most in enumerate(arm.module.UPPER):
            if not np.isfinite(most):  # a continuous joint
                continue
            start = arm.posture.copy()
            start[joint] = most - 0.4
            q = arm.posture.copy()
            q[joint] = most + 0.3
            goal = arm.module.forward_kinematics(q)
            rows = self.run(3000, goal, start=start)
            beyond = max(beyond, float((rows["q"][:, joint] - most).max()))
        return 1e3 * beyond

    def singular(self) -> float:
        away = self.pose[:3, 3] / np.linalg.norm(self.pose[:3, 3])
        return self.speed(self.run(6000, turned(self.pose, 1.0 * away)))

    def half_turn(self) -> float:
        return self.speed(self.run(6000, turned(self.pose, angle=np.pi - 1e-3)))

    def fast_targets(self) -> tuple[float, float]:
        random = np.random.default_rng(1)
        goals = [turned(self.pose, random.uniform(-0.15, 0.15, 3), 2, random.uniform(-0.8, 0.8)) for _ in range(50)]
        rows = self.run(5000, np.repeat(goals, 100, axis=0))
        return self.speed(rows), 100 * float(rows["saturated"].mean())

    def scattered(self) -> tuple[float, float]:
        """Return rms acceleration [m/s^2] and error [mm] of the tip under a target at 10 Hz that scatters by 1 cm."""
        time, random = np.arange(8000) * 1e-3, np.random.default_rng(1)
        angle = 2 * np.pi * 0.25 * time
        # [m] an ellipse at 0.25 Hz
        goal = np.array([turned(self.pose, (0.0, 0.1 * np.sin(a), 0.05 * (1.0 - np.cos(a)))) for a in angle])
        targets = goal[::100].copy()  # one in 100 ms
        targets[:, :3, 3] += 0.01 * random.normal(size=(len(targets), 3))
        rows = self.run(8000, np.repeat(targets, 100, axis=0))
        away = self.away(rows, goal)[1000:]
        acceleration = self.acceleration(rows)[1000:]
        return float(np.sqrt((acceleration**2).sum(axis=1).mean())), float(np.sqrt((away**2).mean()))

    def drop(self) -> float:
        payload = 3.0 * (np.arange(5000) < 3000)
        return self.speed(self.run(5000, self.pose, payload=payload)[3000:])

    def switched(self) -> float:
        stiff = np.where(np.arange(5000) // 100 % 2 == 0, 100.0, 2000.0)[:, None] * np.ones(3)
        load = np.array([0, 30.0, 0, 0, 0, 0]) * np.sin(2 * np.pi * 5 * np.arange(5000) * 1e-3)[:, None]
        return float(self.run(5000, self.pose, translation=stiff, load=load)["work"].max())

    def orbit(self) -> float:
        angle = 2 * np.pi * np.arange(6000) * 1e-3
        load = np.zeros((6000, 6))
        load[:, 0], load[:, 1], load[:, 5] = 20 * np.cos(angle), 20 * np.sin(angle), 2 * np.sin(angle)
        work = self.run(6000, self.pose, load=load)["work"]
        return float(work[5999] - work[1999]) / 4


ROWS: dict[str, Callable[[Bench], float]] = {
    "step of 10 cm: error at rest [mm]": Bench.step,
    "the same: overshoot [mm]": Bench.overshoot,
    "line at 0.2 m/s: rms error [mm]": Bench.line,
    "swing of 5 cm at 1 Hz: rms error [mm]": Bench.sine,
    "step of 10 cm, torques 3 samples late: rms acceleration at rest [m/s^2]": Bench.late,
    "wall of 1e4 N/m: swing of the force at rest [N]": lambda b: b.wall(1e4),
    "wall of 1e5 N/m [N]": lambda b: b.wall(1e5),
    "wall of 1e6 N/m [N]": lambda b: b.wall(1e6),
    "tip clamped, target swings 5 cm at 1 Hz, at once: self-motion [rad/s]": lambda b: b.self_motion(b.clamped(1e-3)),
    "the same: fastest joint [rad/s]": lambda b: float(np.abs(b.clamped(1e-3)["v"]).max()),
    "the same, but the swing grows within a second [rad/s]": lambda b: float(np.abs(b.clamped(1.0)["v"]).max()),
    "target moved by 15 cm under 20, 50 and 80 N: self-motion [rad/s]": Bench.loaded,
    "target 0.3 rad beyond a joint's limit: joint beyond its limit by [mrad]": Bench.limit,
    "target 1 m out of reach: largest speed over its limit": Bench.singular,
    "target 0.5 m out and back within 6 s: error on its return [mm]": lambda b: b.back(0.0),
    "the same, 1 s later [mm]": lambda b: b.back(1.0),
    "the same: largest speed over its limit": lambda b: b.speed(b.out_and_back(1.0)[0]),
    "target half a turn away: largest speed over its limit": Bench.half_turn,
    "targets at 10 Hz: largest speed over its limit": lambda b: b.fast_targets()[0],
    "targets at 10 Hz: time in saturation [%]": lambda b: b.fast_targets()[1],
    "target at 10 Hz that scatters by 1 cm: rms acceleration of the tip [m/s^2]": lambda b: b.scattered()[0],
    "the same: rms error [mm]": lambda b: b.scattered()[1],
    "payload of 3 kg dropped: largest speed over its limit": Bench.drop,
    "stiffness switched 100 to 2000 N/m at 5 Hz, 30 N swing: most work put out [J]": Bench.switched,
    "orbit of a 20 N force: work put out per turn [J]": Bench.orbit,
    "Settle, step of 10 cm: error at the motors [mm]": lambda b: b.held(0.0),
    "Settle, 3 kg [mm]": lambda b: b.held(3.0),
    "Settle, out of reach and back, 1 s later [mm]": lambda b: b.back(1.0, True),
    "Press, 15 N on 1e4 N/m: rms error [N]": lambda b: b.wall_force(0.0),
    "Press, wall moves by 2 cm at 0.5 Hz [N]": lambda b: b.wall_force(0.02),
    "Press, cylinder wiped at 0.1 m/s [N]": Bench.wiped,
}
STEPS = 200
COUNTED = (*("-O3" if flag == "-O1" else flag for flag in FLAGS), "-mno-avx512f")
"""Flags of gcc for the count of instructions: a user's, but valgrind knows no AVX-512."""
CSV = "compare.csv"


def run_line(name: str, folder: str, law: int) -> None:
    """Run a law along the start of a line: what valgrind counts."""
    arm = Arm(name, Path(folder), flags=COUNTED)
    bench = Bench(arm, law)
    bench.run(STEPS, [turned(bench.pose, (0, 2e-4 * k, 0)) for k in range(STEPS)])


def count_instructions(arm: Arm, folder: Path) -> list[float]:
    """Return the mean number of instructions of a step of each law, counted by callgrind."""
    folder = folder / "counted"
    folder.mkdir(exist_ok=True)
    environment = os.environ | {"CC": f"gcc {COUNTED[-1]}"}
    made = []
    for law, step in enumerate((f"{arm.name}_impedance_step", *("textbook",) * (len(LAWS) - 1))):
        counts = folder / f"{arm.name}.{law}"
        code = f"from campaigns.compare import run_line; run_line({arm.name!r}, {str(folder)!r}, {law})"
        python = [sys.executable, "-c", code]
        counter = ["valgrind", "-q", "--tool=callgrind", f"--callgrind-out-file={counts}", "--collect-atstart=no"]
        if law == 0:
            subprocess.run(python, check=True, env=environment)  # compiles
        subprocess.run([*counter, f"--toggle-collect={step}", *python], check=True, env=environment)
        summary = next(line for line in counts.read_text().splitlines() if line.startswith("summary:"))
        made.append(int(summary.split()[1]) / STEPS)
    return made


def measure(arm: Arm) -> dict[str, list[float]]:
    """Return the numbers of all laws, by the title of their row."""
    made = {}
    for title, row in ROWS.items():
        made[title] = [row(Bench(arm, law)) for law in range(len(LAWS))]
        print(f"{arm.name}: {title}: {', '.join(f'{value:.3g}' for value in made[title])}", flush=True)
    return made


def csv_text(measured: dict[str, dict[str, list[float]]]) -> str:
    """Return a CSV line per situation and arm, with a number of each law."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("situation", "arm", *LAWS))
    for title in next(iter(measured.values())):
        for name, numbers in measured.items():
            writer.writerow((title, name, *map(_rounded, numbers[title])))
    return text.getvalue()


def table(text: str) -> str:
    """Return the table of the page in Markdown, made of the CSV: of each situation and law the largest of all arms."""
    rows = list(csv.DictReader(io.StringIO(text)))
    lines = [f"| | {' | '.join(LAWS)} |", "|---|" + "---|" * len(LAWS)]
    for title in dict.fromkeys(row["situation"] for row in rows):
        largest = (_rounded(max(float(row[law]) for row in rows if row["situation"] == title)) for law in LAWS)
        lines.append(f"| {title} | {' | '.join(largest)} |")
    return "\n".join(lines)


def _rounded(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"


def main() -> int:
    """Measure all arms, print or write the table, and return 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", default="iiwa14,panda,ur5,j2s6s200")
    parser.add_argument("--output", type=Path, help="page whose table is written anew, with its CSV")
    parser.add_argument("--count", action="store_true", help="count the instructions of a step, too (valgrind)")
    parser.add_argument("--folder", type=Path, help="where robots are generated and compiled")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = options.folder or Path(made)
        arms = [Arm(name, folder) for name in options.arms.split(",")]
        measured = {arm.name: measure(arm) for arm in arms}
        for arm in arms if options.count else ():
            measured[arm.name]["instructions of a step"] = count_instructions(arm, folder)
    text = csv_text(measured)
    if options.output:
        head, *_ = options.output.read_text(encoding="utf-8").partition(MARK)
        options.output.write_text(f"{head}{MARK}\n\n{table(text)}\n", encoding="utf-8")
        options.output.with_name(CSV).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
