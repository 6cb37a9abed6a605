# SPDX-License-Identifier: MIT
"""Measure Settle, Press and friction on simulated arms, and compare each figure with its bar.

    python tests/campaigns/force.py [--arms iiwa14,panda,ur5] [--postures 20] [--rows rest,wall] [--share 0.9]
        [--figure docs/held.svg]

The plants (tests/support/arms/arms.c) have friction that sticks and slips, elastic joints, the makers' sensors and one
sample of delay. The force sensor has 0.3 N of noise, and is a sample late. 600 N/m, 30 N m/rad, 15 N. A row prints the
median and the worst of the postures; a figure beyond its bar ends the campaign with exit code 1.
With --figure it draws errors at rest and on a slow line, before and after, instead of comparing.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from support.arms.arms import Arm

Array = np.ndarray[Any, np.dtype[Any]]
FORCE, NOISE, DEPTH, RADIUS, MM = 15.0, 0.3, 0.02, 0.3, 1e3
SETTLE = (40.0, 4.0)
"""settle_force [N, N m]: 3 kg and friction."""
PRESSING = 0.6
"""Share of the true friction that is fed forward while pressing: at 0.9 a UR5 loses a hard wall that moves."""
STEP = np.array([0.0, 0.08, -0.06])
DOWN = np.array([0.0, 0.0, -1.0])
TITLES = {"iiwa14": "iiwa 14", "panda": "Panda", "ur5": "UR5"}
PERIOD = 5000
"""[samples] of a slow line, 0.2 Hz."""
LOST = 3
"""Stage of Press."""


@dataclass(frozen=True)
class Bar:
    """Figure of a row: name, largest value; by arm where it differs; of the median instead of the worst."""

    name: str
    most: float
    of: tuple[tuple[str, float], ...] = ()
    median: bool = False
    median_of: str = ""

    def holds(self, arm: str, values: Array) -> bool:
        """Return whether the postures' values are within the bar."""
        value = np.median(values) if self.median or arm == self.median_of else values.max()
        return bool(value <= dict(self.of).get(arm, self.most))


class Bench:
    """An arm at a posture; a method measures a row there and returns its figures."""

    def __init__(self, arm: Arm, q: Array, share: float) -> None:
        self.arm, self.q, self.share = arm, q, share
        self.kinematics = arm.module.forward_kinematics
        self.pose = self.kinematics(q)

    def run(self, samples: int, plant: dict[str, Any], share: float | None = None, **rows: Any) -> Array:
        """Return the rows of an episode without a fault."""
        sensors = self.arm.maker.sensors
        config = self.arm.config(
            coulomb_friction=(self.share if share is None else share) * self.arm.maker.friction * self.arm.effort,
            position_quantum=sensors.position_quantum,
            velocity_noise=max(sensors.velocity_noise, sensors.velocity_quantum),
        )
        noise = NOISE * np.random.default_rng(1).normal(size=(samples, 6))
        made = self.arm.plant(flexible=True, **({"makers": 1, "wrench_delay": 1} | plant))
        given = {"start": self.q, "goal": self.q, "pose": self.pose, "wrench_noise": noise} | rows
        done = self.arm.run(made, samples, config, **given)
        assert not done["faulted"].any(), f"{self.arm.name}: fault {done['reason'].max()}"
        return done

    def motors(self, rows: Array) -> Array:
        """Return where the encoders see the tip [m], per sample."""
        return np.asarray(np.reshape(self.kinematics(np.ascontiguousarray(rows["motors"])), (-1, 4, 4))[:, :3, 3])

    def rests(self, payload: float) -> tuple[list[float], list[float]]:
        """Return errors at rest after a step of 10 cm, and overshoots [mm]: today, and with Settle and friction."""
        goal = self.pose.copy()
        goal[:3, 3] += STEP
        errors, beyond = list[float](), list[float]()
        for settle, share in (((0.0, 0.0), 0.0), (SETTLE, self.share)):
            rows = self.run(7000, {"settle_force": settle}, share, pose=goal, payload=payload)
            away = MM * (self.motors(rows) - goal[:3, 3])
            errors.append(float(np.linalg.norm(away[-1])))
            beyond.append(max(float((away @ STEP).max() / np.linalg.norm(STEP)), 0.0))
        return errors, beyond

    def rest(self, payload: float) -> tuple[float, ...]:
        """Return the error at rest with Settle [mm], and what the overshoot is more than today's [mm]."""
        errors, beyond = self.rests(payload)
        return errors[1], beyond[1] - beyond[0] if payload == 0.0 else 0.0

    def lines(self) -> list[float]:
        """Return the rms error of a line of 10 cm at 0.2 Hz [mm]: today, and with friction."""
        time, errors = np.arange(2 * PERIOD) / PERIOD, []
        poses = np.tile(self.pose, (len(time), 1, 1))
        poses[:, 1, 3] += 0.1 * np.minimum(4 * time, 1.0) * np.sin(2 * np.pi * time)
        for share in (0.0, self.share):
            tips = self.run(len(time), {}, share, pose=poses)["pose"].reshape(-1, 4, 4)[:, :3, 3]
            away = np.linalg.norm(tips - poses[:, :3, 3], axis=1)[PERIOD:]
            errors.append(MM * float(np.sqrt(np.mean(away**2))))
        return errors

    def travel(self) -> tuple[float, ...]:
        """Return the way [mm] of the offset in the last 30 of 60 s at rest."""
        goal = self.pose.copy()
        goal[:3, 3] += STEP
        rows = self.run(60000, {"settle_force": SETTLE}, pose=goal)
        moved = rows["command"].reshape(-1, 4, 4)[30000:, :3, 3]
        return (MM * float(np.linalg.norm(np.diff(moved, axis=0), axis=1).sum()),)

    def line(self) -> tuple[float, ...]:
        """Return the largest change [mm] that Settle makes to a moving line: none."""
        time = np.arange(4000) * 1e-3
        poses = np.tile(self.pose, (4000, 1, 1))
        poses[:, 1, 3] += 0.1 * np.sin(2 * np.pi * 0.2 * time)
        tips = [self.run(4000, {"settle_force": force}, pose=poses)["pose"] for force in ((0.0, 0.0), SETTLE)]
        return (MM * float(np.abs(tips[1] - tips[0]).max()),)

    def blocked(self) -> tuple[float, ...]:
        """Return what a tip that is blocked 3 cm before its goal exerts more with Settle, without a sensor [N]."""
        goal, wall = self.pose.copy(), self.wall(1e4)
        goal[2, 3] -= DEPTH + 0.03
        force = [
            self.run(6000, wall | {"settle_force": each, "wrench_delay": 6000}, pose=goal)["contact"][-500:, 2].mean()
            for each in ((0.0, 0.0), SETTLE)
        ]
        return (float(force[1] - force[0]),)

    def wall(self, stiffness: float, outwards: Any = -DOWN, **plant: Any) -> dict[str, Any]:
        """Return a wall 2 cm from the tip; of a cylinder or bowl, where its surface is nearest."""
        point = self.pose[:3, 3] - np.asarray(outwards) * (DEPTH + plant.get("wall_radius", 0.0))
        return {"wall_stiffness": stiffness, "wall_normal": outwards, "wall_point": point, **plant}

    def press(self, samples: int, plant: dict[str, Any], axis: Any = DOWN, **rows: Any) -> tuple[Array, Array]:
        """Return the rows of an arm that presses, and the force against the axis [N]."""
        done = self.run(samples, plant, PRESSING, press=np.r_[axis, FORCE, 0.0], **rows)
        return done, -done["contact"][:, :3] @ np.asarray(axis)

    def still(self, stiffness: float, axis: Any = DOWN) -> tuple[float, ...]:
        """Return the rms error in the last 2 s, and the impact [N]."""
        _, force = self.press(7000, self.wall(stiffness, -np.asarray(axis)), axis)
        return rms(force[-2000:]), float(force.max())

    def tilted(self) -> tuple[float, ...]:
        """As on a still wall, with one that is tilted by 40 degrees."""
        return self.still(1e4, np.array([np.sin(0.7), 0.0, -np.cos(0.7)]))

    def moving(self, stiffness: float) -> tuple[float, ...]:
        """Return the rms error [N] on a wall that moves by 2 cm at 0.5 Hz."""
        time = np.arange(9000) * 1e-3
        way = 0.02 * np.clip(time - 3.0, 0.0, 1.0) * np.sin(np.pi * time)
        _, force = self.press(9000, self.wall(stiffness), wall=way)
        return (rms(force[4000:]),)

    def wipe(self, radius: float = RADIUS, axis: Any = (1.0, 0.0, 0.0), normal: int = 0) -> tuple[float, ...]:
        """Return the rms error [N] of wiping at 0.1 m/s with friction 0.2; a bowl has a negative radius."""
        time = np.arange(8000) * 1e-3
        angle = 0.4 * np.sin(0.1 / (0.4 * abs(radius)) * np.maximum(time - 3.0, 0.0)) * np.sign(radius)
        poses = np.tile(self.pose, (8000, 1, 1))
        poses[:, 1, 3] += radius * np.sin(angle)
        poses[:, 2, 3] += radius * (np.cos(angle) - 1.0)
        shape = {"wall_radius": radius, "wall_axis": axis, "wall_friction": 0.2, "normal": normal}
        rows, _ = self.press(8000, self.wall(1e4, **shape), pose=poses)
        force = rows["contact"][:, 1] * np.sin(angle) + rows["contact"][:, 2] * np.cos(angle)
        return (rms(force[4000:]),)

    def lost(self) -> tuple[float, ...]:
        """Return the fastest [m/s] and the farthest [mm] that the tip goes when its wall is taken away."""
        gone = np.where(np.arange(8000) > 5000, -1.0, 0.0)
        rows, _ = self.press(8000, self.wall(1e4) | {"wall_damping": 0.0}, wall=gone)
        height = rows["pose"].reshape(-1, 4, 4)[5000:, 2, 3]
        assert rows["detail"][-1, 1] == LOST
        return float(np.abs(np.diff(height)).max() / 1e-3), MM * float(height[0] - height.min())


def rms(force: Array) -> float:
    return float(np.sqrt(np.mean((force - FORCE) ** 2)))


RMS, IMPACT = Bar("N rms", 0.4), Bar("impact N", 35.0)
MOVING = Bar("N rms", 3.1, (("ur5", 6.0),), median_of="ur5")
WIPED = Bar("N rms", 1.8, (("ur5", 2.7),))
ROWS: dict[str, tuple[Callable[[Bench], tuple[float, ...]], tuple[Bar, ...]]] = {
    "rest": (lambda b: b.rest(0.0), (Bar("mm at the motors", 1.0), Bar("mm more overshoot", 3.0))),
    "rest with 3 kg": (lambda b: b.rest(3.0), (Bar("mm at the motors", 1.0), Bar("-", 0.0))),
    "travel": (Bench.travel, (Bar("mm in 30 s", 15.0),)),
    "line": (Bench.line, (Bar("mm changed", 0.0),)),
    "blocked": (Bench.blocked, (Bar("N more", SETTLE[0]),)),
    "wall 1e3": (lambda b: b.still(1e3), (RMS, IMPACT)),
    "wall 1e4": (lambda b: b.still(1e4), (RMS, IMPACT)),
    "wall 1e5": (lambda b: b.still(1e5), (RMS, IMPACT)),
    "tilted wall": (Bench.tilted, (RMS, IMPACT)),
    "moving wall 1e4": (lambda b: b.moving(1e4), (MOVING,)),
    "moving wall 1e5": (lambda b: b.moving(1e5), (MOVING,)),
    "wiping": (Bench.wipe, (WIPED,)),
    "wiping by the normal": (lambda b: b.wipe(normal=1), (WIPED,)),
    "bowl": (lambda b: b.wipe(-RADIUS, (0.0, 0.0, 0.0), 1), (WIPED,)),
    "lost": (Bench.lost, (Bar("m/s", 0.17), Bar("mm", 20.0))),
}


def postures(arm: Arm, count: int) -> list[Array]:
    """Return random postures near the arm's own, away from limits and singular ones."""
    random = np.random.default_rng(3)
    found: list[Array] = []
    while len(found) < count:
        q = arm.posture + random.uniform(-0.5, 0.5, arm.n)
        inside = (q > arm.module.LOWER + 0.3).all() and (q < arm.module.UPPER - 0.3).all()
        J = np.reshape(arm.module.hybrid.jacobian(q), (6, arm.n))
        if inside and np.linalg.svd(J)[1][-1] > 0.06:
            found.append(q)
    return found


def draw(benches: dict[str, list[Bench]]) -> str:
    """Return the picture: medians before and after, by arm, at rest without and with 3 kg, and on a slow line."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from stiffgen.style import CONVENTIONAL, CORRECTED, STYLE, themed_svg

    measures: dict[str, Callable[[Bench], list[float]]] = {
        "at rest": lambda b: b.rests(0.0)[0],
        "at rest, with 3 kg": lambda b: b.rests(3.0)[0],
        "on a line, 0.2 Hz": Bench.lines,
    }
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(7.5, 2.6), layout="constrained")
        for axes, (title, measure) in zip(drawing.subplots(1, 3, sharey=True), measures.items(), strict=True):
            medians = np.array([np.median([measure(b) for b in some], axis=0) for some in benches.values()])
            print(
                f"{title}: "
                + ", ".join(f"{n} {b:.1f} to {a:.1f} mm" for n, (b, a) in zip(benches, medians, strict=True))
            )
            rows = np.arange(len(benches))
            axes.hlines(rows, medians[:, 1], medians[:, 0], color=CONVENTIONAL, linewidth=1)
            axes.plot(medians[:, 0], rows, "o", color=CONVENTIONAL, label="before")
            axes.plot(medians[:, 1], rows, "o", color=CORRECTED, label="after")
            axes.set(title=title, xlabel="error [mm]", xscale="log", xlim=(0.4, 100))
            axes.set_xticks([1, 10, 100], ["1", "10", "100"])
            axes.set_yticks(rows, [TITLES[name] for name in benches])
            axes.set_ylim(len(benches) - 0.5, -0.5)
        drawing.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return themed_svg(drawing)


def main() -> int:
    """Measure force control of all arms and postures, compare with the bars, and return 1 if a row is beyond."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", default="iiwa14,panda,ur5")
    parser.add_argument("--postures", type=int, default=20)
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--share", type=float, default=0.9, help="of the true friction that is fed forward")
    parser.add_argument("--folder", type=Path, help="where the arms are compiled, or were")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw errors before and after instead")
    options = parser.parse_args()
    beyond, benches = 0, dict[str, list[Bench]]()
    with tempfile.TemporaryDirectory() as made:
        for name in options.arms.split(","):
            arm = Arm(name, options.folder or Path(made))
            benches[name] = [Bench(arm, q, options.share) for q in postures(arm, options.postures)]
            for row in options.rows.split(",") if not options.figure else ():
                measure, bars = ROWS[row]
                figures = np.array([measure(bench) for bench in benches[name]])
                good = [bar.holds(name, column) for bar, column in zip(bars, figures.T, strict=False)]
                told = [
                    f"{np.median(column):.2f} / {column.max():.2f} {bar.name}"
                    for bar, column in zip(bars, figures.T, strict=False)
                ]
                beyond += not all(good)
                print(f"{name}, {row}: {', '.join(told)}{'' if all(good) else '  BEYOND'}", flush=True)
        if options.figure:
            options.figure.write_text(draw(benches))
            return 0
    print(f"{beyond} rows beyond their bars")
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())
