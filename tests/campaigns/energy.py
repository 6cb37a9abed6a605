# SPDX-License-Identifier: MIT
"""Search for schedules that break the controller's energy bound, by hill climbing.

    python tests/campaigns/energy.py [--count 100000] [--seed 1] [--climb 200] [--arm iiwa14] [--policy]

A schedule (schedules.py) says what an environment and a planner do to the robot in two seconds: loads, pushes, an arm
that is moved whatever it does, into the limit zones and along its torque, too; stiffness and equilibrium that change;
constant commands by position or by pose, and targets that are streamed with jitter; missed samples, calls left out or
early, velocities that lie, torques of the caller, commands of single precision, resets. Wrenches that the tip is to
exert, velocities and accelerations of plans come and go, and lie. Configurations vary in delay, missed_limit, rate
limits, limit zones, damping, velocity filter, tank and engagement, with Coriolis forces and without, with motors that
have a controller inside and without. They change to and fro while the arm moves: limits of velocity, calls and effort
are raised and lowered, and the environment uses at once those that the outputs name as in force.

The work that the robot puts out at its port is summed from the exact motion and the torque that acted, and compared
with the controller's output energy_supplied, from the first sample to the last and at all times between. With --policy
all commands reach the controller through the policy port, from a hostile commander (policy_law.c) whose seed the climb
changes. Other arms than the iiwa 14 are generated: j2s6s200 and turning have joints without limits, whose encoders
wrap, and which make more than half a turn while no sample comes.

A climb starts at a random schedule and keeps each change that brings the work nearer to the bound or
beyond. A schedule in which control is lost at the start counts for nothing, and nothing else is exempted.
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen
from campaigns.schedules import (
    PATTERNS,
    SAMPLES,
    TURNING,
    Random,
    Schedule,
    change_configuration,
    draw_plan,
    draw_wrench,
    lies,
    ordered,
    part,
    schedule,
)  # fmt: skip
from support.arms.arms import MAKERS
from support.plant.loop import LAW, POLICY, Q0, Loop
from support.project import ROOT
from support.small_robots import turning_arm

TOLERANCE = 1e-9
"""[J] by which the bound may be passed."""

LIVE = 20
"""[samples] under control without which a schedule shows nothing."""
CLIMBED = (
    "damping_ratio", "joint_damping", "posture_stiffness", "stiffness_time", "ramp_time", "energy_limit",
    "torque_rate_limit", "limit_zone", "limit_stiffness", "delay_samples", "missed_limit",
    "call_gap_limit", "coriolis", "velocity_filter_time", "kp_limit", "kd_limit",
)  # fmt: skip
"""Fields of the configuration that a climb changes; tank and engagement limit stay."""


@dataclass(frozen=True)
class Measured:
    """Result of a run: work less energy_supplied [J], its value for a climb, their ratio, the episode's summary."""

    excess: float
    interest: float
    ratio: float
    summary: Any


def changed(random: Random, loop: Loop, old: Schedule, moving: bool, sensors: bool) -> Schedule:
    """Return a neighbour: numbers shaken, segments moved, doubled, dropped, replaced, or copied from another one."""
    new = copy.deepcopy(old)
    for _ in range(random.integers(1, 4)):
        kind = random.integers(0, 8)
        later = new.parts[1:]
        if kind == 0 or not later:
            new.parts.append(part(random, loop, moving))
        elif kind == 1 and len(later) > 1:
            del new.parts[1 + random.integers(len(later))]
        elif kind == 2:
            one = copy.deepcopy(later[random.integers(len(later))])
            one["start"] = int(random.integers(1, SAMPLES))
            new.parts.append(one)
        elif kind == 3:
            one = later[random.integers(len(later))]
            one["start"] = int(np.clip(one["start"] + random.normal() * 20, 1, SAMPLES - 1))
        elif kind == 4:
            one = later[random.integers(len(later))]
            _shake(random, one)
        elif kind == 5:
            one = later[random.integers(len(later))]
            name = ("reset", "missed", "skip")[random.integers(3)]
            one[name] = 0 if one.get(name) else int(random.integers(1, 6)) if name == "skip" else 1
        elif kind == 6:
            _change_config(random, new)
        else:
            change_configuration(random, loop, new)
    if not sensors:
        new.parts = [one for one in new.parts if not lies(one)]
    return ordered(new)


def _change_config(random: Random, new: Schedule) -> None:
    name = CLIMBED[random.integers(len(CLIMBED))]
    gains = new.config.get("actuation") == 2
    if name not in new.config:  # only where it is not 0
        return
    if name == "delay_samples" and gains:
        return
    if name == "delay_samples":
        new.config[name] = new.episode["delay"] = int(random.integers(0, 6))
    elif name == "coriolis":
        new.config[name] = 3 - new.config[name]
    elif name in ("missed_limit", "call_gap_limit"):
        new.config[name] = int(random.integers(1, 7))
    else:
        new.config[name] = new.config[name] * float(np.exp(random.normal() * 0.5))


def _shake(random: Random, one: dict[str, Any]) -> None:
    size = 10 ** random.uniform(-2, 0)
    for name in ("load", "push", "driven_to", "driven_at", "hand_target", "dq_offset", "wanted_rate", "jitter"):
        if name in one and np.any(one[name]):
            one[name] = one[name] * (1 + size * random.normal(size=np.shape(one[name])))
    if random.random() < 0.1:
        one["wrench_command"] = draw_wrench(random)
    if "velocity" in one and random.random() < 0.2:
        one |= draw_plan(random, one.get("wanted_rate", np.zeros(np.shape(one["velocity"]))))
    if random.random() < 0.3 and one.get("driven"):
        one["driven_to"] = -one["driven_to"]
    for name in ("driven_by", "hand_stiffness", "hand_damping", "translation", "rotation"):
        if name in one:
            one[name] = one[name] * np.exp(size * random.normal())


def measure(loop: Loop, chosen: Schedule) -> Measured:
    """Run a schedule. Calls come as often, and the arm is as fast, as the limits in force allow."""
    streamed = chosen.episode.get("streamed", 0)
    if streamed:
        ctypes.c_uint.in_dll(loop.library, "policy_seed").value = streamed
    limit = chosen.config["engagement_limit"]
    keeps = {"engagement": limit, "fastest": 1.0, "rate": chosen.config.get("torque_rate_limit", 10 * loop.effort)}
    episode = loop.episode(**chosen.episode, **keeps, limited=1)
    configs = [loop.config(**chosen.config | change) for change in ({}, *chosen.changes)]
    summary = loop.run(SAMPLES, loop.segments(*chosen.parts), episode, configs)
    excess = summary.excess_supplied
    dead = summary.faults and summary.fault_at < LIVE
    bound = summary.port_most - excess
    ratio = summary.port_most / bound if bound > 0 else np.inf
    interest = 1 + excess if excess > 0 else ratio  # the excess alone would choose the smallest tank
    return Measured(excess, -np.inf if dead and excess <= 0 else interest, ratio, summary)


def _stream(random: Random, loop: Loop, one: Schedule) -> None:
    """Choose another hostile commander, if there is one."""
    if loop.streamed:
        one.episode["streamed"] = int(random.integers(1, 2**31))


def climb(random: Random, loop: Loop, steps: int, moving: bool, sensors: bool = False) -> tuple[Schedule, Measured]:
    """Return the best of a climb, restarted from the best of ten random schedules."""
    patterns = PATTERNS if np.isfinite(loop.upper).all() else TURNING
    pattern = random.integers(0, 2 * len(patterns))
    starts = [
        patterns[pattern](random, loop) if pattern < len(patterns) else schedule(random, loop, moving, sensors)
        for _ in range(min(10, steps))
    ]
    for one in starts:
        _stream(random, loop, one)
    best, most = max(((one, measure(loop, one)) for one in starts), key=lambda pair: pair[1].interest)
    for _ in range(steps - len(starts)):
        new = changed(random, loop, best, moving, sensors)
        if random.random() < 0.3:
            _stream(random, loop, new)
        try:
            got = measure(loop, new)
        except AssertionError:  # a configuration that is refused
            continue
        if got.interest >= most.interest:
            best, most = new, got
    return best, most


_loop: Loop | None = None
"""Of a worker process."""


def generate_arm(name: str, folder: Path) -> tuple[Path, tuple[float, ...]]:
    """Return the folder of an arm, generated unless it is there, and a posture far from limits and singular poses."""
    made = folder / name
    if name in MAKERS:
        file, tip, home = MAKERS[name].urdf, MAKERS[name].tip, MAKERS[name].posture
    else:
        file, tip, home = folder / "turning.urdf", "three", (2.8, 0.6, -2.9)
        file.write_text(turning_arm().urdf)
    if not made.exists():
        stiffgen.generate(file, tip=tip, name=name, output=folder)
    return made, home


def _start(law: Path, robot: Path, home: tuple[float, ...]) -> None:
    global _loop
    _folder = tempfile.mkdtemp()
    _loop = Loop(Path(_folder), robot, law, home=home)
    shutil.rmtree(_folder)


def _climb(task: tuple[int, int, bool]) -> tuple[int, bool, float, float, int, float]:
    seed, steps, moving = task
    assert _loop is not None
    got = climb(np.random.default_rng(seed), _loop, steps, moving)[1]
    return seed, moving, got.excess, got.summary.port_most, got.summary.reason, got.ratio


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--climb", type=int, default=200, help="schedules of a climb")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--arm", choices=[*MAKERS, "turning"], default="iiwa14")
    parser.add_argument("--policy", action="store_true", help="command through the policy port")
    options = parser.parse_args()
    law = POLICY if options.policy else LAW
    start, climbs = time.monotonic(), -(-options.count // options.climb)
    tasks = [(options.seed + k, options.climb, k % 2 == 1) for k in range(climbs)]
    found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    worst = 0.0
    folder = Path(tempfile.mkdtemp())
    robot = (ROOT / "generated" / "iiwa14", Q0) if options.arm == "iiwa14" else generate_arm(options.arm, folder)
    with multiprocessing.Pool(options.workers, _start, (law, *robot)) as pool:
        for done, (seed, moving, excess, port, reason, ratio) in enumerate(pool.imap_unordered(_climb, tasks), 1):
            found[moving].append((excess, port))
            worst = max(worst, ratio)
            if excess > TOLERANCE:
                print(f"seed {seed}{', moving' * moving}: {excess:.2e} J beyond, reason {reason}", flush=True)
            if done % 20 == 0 or done == climbs:
                beyond = sum(x > TOLERANCE for x, _ in found[False] + found[True])
                print(f"{done * options.climb} schedules, {beyond} climbs beyond the bound, "
                      f"worst ratio {worst:.6f}, {time.monotonic() - start:.0f} s", flush=True)  # fmt: skip
    shutil.rmtree(folder)
    print("| wanted equilibrium | schedules | climbs beyond | most of work less supply [J] | most put out [J] |")
    print("|---|---|---|---|---|")
    for moving, rows in found.items():
        if rows:
            beyond, most, port = sum(x > TOLERANCE for x, _ in rows), max(x for x, _ in rows), max(p for _, p in rows)
            name, count = "moving" if moving else "constant", len(rows) * options.climb
            print(f"| {name} | {count} | {beyond} | {most:.2e} | {port:.3f} |")
    return 1 if any(x > TOLERANCE for x, _ in found[False] + found[True]) else 0


if __name__ == "__main__":
    sys.exit(main())
