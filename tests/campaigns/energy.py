# SPDX-License-Identifier: MIT
"""Search for schedules that break the controller's energy bound, by hill climbing.

    python tests/campaigns/energy.py [--count 100000] [--seed 1] [--climb 200] [--arm iiwa14] [--python] [--makers]

A schedule (schedules.py) says what an environment and a planner do to the robot in two seconds: loads, pushes, an arm
that is moved whatever it does, into the limit zones and along its torque, too; stiffness and commands that change, and
targets that are streamed with jitter; missed samples, calls left out or early, velocities that lie, torques of the
caller, commands of single precision, resets. Wrenches that the tip is to exert, accelerations of plans and what is said
of their ramps come and go, and lie. Configurations vary in delay, missed_limit, rate limits, damping, tank, with
Coriolis forces and without. The controller begins anew with another one while its torque is in force: limits of
velocity and calls are raised and lowered. Further draws (widened.py): positions of single precision, late calls, old
samples, restarts with another delay, tools.

The work that the robot puts out at its port is summed from the exact motion and the torque that acted, and compared
with the controller's output energy_supplied, from the first sample to the last and at all times between. With
--python the best schedule of each climb is run once more through the class Impedance: its work and its
energy_supplied are those of C. With --makers commands come through Settle, Press and Follow, which are told lies.
Other arms than the iiwa 14 are generated: j2s6s200 and turning have joints without limits, whose encoders wrap, and
which make more than half a turn while no sample comes; hands has two tips, and tools at run time; pair has springs
between the two and absolute ones; five_bar has closed loops.

A climb starts at a random schedule and keeps each change that brings the work nearer to the bound or
beyond. A schedule in which control is lost at the start counts for nothing, and nothing else is exempted.
"""

from __future__ import annotations

import argparse
import copy
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import stiffgen
from campaigns.patterns import PATTERNS, TURNING
from campaigns.python_layer import PythonLayer, module_sources
from campaigns.schedules import (
    SAMPLES,
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
from campaigns.widened import settings, vary, widen
from support.arms.arms import MAKERS
from support.plant.loop import LAW, MAKERS_LAW, Q0, Loop, makers_of
from support.project import ROOT, Once
from support.small_robots import Small, five_bar, turning_arm

TOLERANCE = 1e-9
"""[J] by which the bound may be passed."""

TANK_DEFICIT = 1 << 8
"""Bit of the status that says that an assumption does not hold; test_widened.py compares it with the header."""

LIVE = 20
"""[samples] under control without which a schedule shows nothing."""
CLIMBED = (
    "damping_ratio", "ramp_time", "heaviest_wrench", "torque_rate_limit", "delay_samples", "missed_limit",
    "call_gap_limit", "coriolis",
)  # fmt: skip
"""Fields of the configuration that a climb changes; the tank stays."""


@dataclass(frozen=True)
class Measured:
    """Result of a run: work less energy_supplied [J], its value for a climb, their ratio, the episode's summary."""

    excess: float
    interest: float
    ratio: float
    summary: Any

    @property
    def deficit(self) -> bool:
        """Whether the controller has said that its account does not balance."""
        return bool(self.summary.status_or & TANK_DEFICIT)


def changed(random: Random, loop: Loop, old: Schedule, moving: bool, sensors: bool) -> Schedule:
    """Return a neighbour: numbers shaken, segments moved, doubled, dropped, replaced, or copied from another one."""
    new = copy.deepcopy(old)
    for _ in range(random.integers(1, 4)):
        kind = random.integers(0, 9)
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
        elif kind == 7:
            vary(random, loop, new)
        else:
            change_configuration(random, loop, new)
    if not sensors:
        new.parts = [one for one in new.parts if not lies(one)]
    return ordered(new)


def _change_config(random: Random, new: Schedule) -> None:
    """Change one entry of the configuration: whole numbers are drawn anew, others multiplied by a random factor."""
    name = CLIMBED[random.integers(len(CLIMBED))]
    if name not in new.config:  # only where it is not 0
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
    """Change one part of a schedule by random factors of one size, 1 % to 100 %."""
    size = 10 ** random.uniform(-2, 0)
    for name in ("load", "push", "driven_to", "driven_at", "hand_target", "dq_offset", "wanted_rate", "jitter"):
        if name in one and np.any(one[name]):
            one[name] = one[name] * (1 + size * random.normal(size=np.shape(one[name])))
    if random.random() < 0.1:
        one["wrench_command"] = draw_wrench(random)
    if "acceleration" in one and random.random() < 0.2:
        one |= draw_plan(random, len(one["acceleration"]))
    if random.random() < 0.3 and one.get("driven"):
        one["driven_to"] = -one["driven_to"]
    for name in ("driven_by", "hand_stiffness", "hand_damping", "translation", "rotation"):
        if name in one:
            one[name] = one[name] * np.exp(size * random.normal())


def measure(loop: Loop, chosen: Schedule) -> Measured:
    """Run a schedule. Calls come as often, and the arm is as fast, as the limits in force allow."""
    keeps = {"fastest": 1.0, "rate": chosen.config.get("torque_rate_limit", 10 * loop.effort)}
    episode = loop.episode(**chosen.episode, **keeps, limited=1)
    parts, configs = settings(chosen)
    summary = loop.run(SAMPLES, loop.segments(*parts), episode, [loop.config(**config) for config in configs])
    excess = summary.excess_supplied
    dead = summary.faults and summary.fault_at < LIVE
    bound = summary.port_most - excess
    ratio = summary.port_most / bound if bound > 0 else 0.0  # without a supply the excess alone says what was put out
    interest = 1 + excess if excess > 0 else ratio  # the excess alone would choose the smallest tank
    if summary.status_or & TANK_DEFICIT:
        interest = np.inf
    return Measured(excess, -np.inf if dead and excess <= 0 else interest, ratio, summary)


def attempt(loop: Loop, chosen: Schedule) -> Measured:
    """Run a schedule; one whose configuration is refused at a start counts for nothing."""
    try:
        return measure(loop, chosen)
    except AssertionError:
        return Measured(-np.inf, -np.inf, 0.0, loop.Summary())


def climb(random: Random, loop: Loop, steps: int, moving: bool, sensors: bool = False) -> tuple[Schedule, Measured]:
    """Return the best of a climb, restarted from the best of ten random schedules."""
    patterns = PATTERNS if np.isfinite(loop.upper).all() else TURNING
    pattern = random.integers(0, 2 * len(patterns))
    starts = [
        patterns[pattern](random, loop) if pattern < len(patterns) else schedule(random, loop, moving, sensors)
        for _ in range(min(10, steps))
    ]
    for one in starts:
        widen(random, loop, one)
    best, most = max(((one, attempt(loop, one)) for one in starts), key=lambda pair: pair[1].interest)
    for _ in range(steps - len(starts)):
        new = changed(random, loop, best, moving, sensors)
        got = attempt(loop, new)
        if got.interest >= most.interest:
            best, most = new, got
    return best, most


OTHERS: dict[str, tuple[Small, tuple[float, ...]]] = {
    "turning": (turning_arm(), (2.8, 0.6, -2.9)),
    "five_bar": (five_bar(), (0.1, -0.15)),
}
"""Small robots and their postures [rad]: one without joint limits, and a linkage with two motors."""
ARMS = (*MAKERS, "hands", "pair", *OTHERS)
"""Arms of the search; hands has two tips that take tools at run time, pair has springs between them, too."""

SEARCH_FLAGS = ("-O3", "-march=native")
"""Flags of a long search: a schedule takes 0.7 of the time that it takes with the tests' -O1."""
_loop: Loop | None = None
"""Loop of a worker process."""
_module: ModuleType | None = None
"""Python module of a worker process that compares it with C."""


@dataclass(frozen=True)
class Climbed:
    """Best of a climb: seed, kind, work less supply and work [J], first fault's reason, ratio, Python less C [J]."""

    seed: int
    moving: bool
    excess: float
    port: float
    reason: int
    ratio: float
    apart: float
    deficit: bool

    @property
    def beyond(self) -> bool:
        """Whether more was put out than supplied, or TANK_DEFICIT set."""
        return self.excess > TOLERANCE or self.deficit


def difference(loop: Loop, module: Any, chosen: Schedule) -> float:
    """Return by how much the class Impedance differs from C in a schedule: of work, and of work less supply [J].

    Both refuse the same configurations at a start.
    """
    by_c = measure(loop, chosen)
    with PythonLayer(loop, module, by_time=not chosen.episode.get("stale")) as layer:
        got = measure(loop, chosen)
    if layer.failure:
        raise AssertionError(layer.failure)
    return float(max(abs(got.summary.port_most - by_c.summary.port_most), abs(got.excess - by_c.excess)))


def generate_arm(name: str, folder: Path, build: bool = True) -> tuple[Path, tuple[float, ...]]:
    """Return the folder of an arm, generated unless it is there, and a posture far from limits and singular poses.

    Its functions are those of the controller and the plant: they compile in a quarter of the time of all.
    """
    made = folder / name
    if name in MAKERS:
        file, home = MAKERS[name].urdf, MAKERS[name].posture
        options: dict[str, Any] = {"tip": MAKERS[name].tip}
    elif name in ("hands", "pair"):
        file, home = ROOT / "tests" / "data" / "dual_arm.urdf", (0.2, 0.5, 0.7, -0.4, 0.6)
        options = {"tip": ["left hand", "right-hand"], "runtime_tool": True}
        options |= {"pairs": ["left hand:right-hand"]} if name == "pair" else {}
    else:
        small, home = OTHERS[name]
        file, options = folder / f"{name}.urdf", small.all_options()
        file.write_text(small.urdf)
    if not made.exists():
        stiffgen.generate(file, name=name, output=folder, build=build, kernels="mass_matrix", **options)
    return made, home


def loop_of(once: Once, name: str) -> Loop:
    """Return the controller in the loop with another robot of the adversary's."""

    def make(folder: Path) -> Loop:
        robot, home = generate_arm(name, folder, build=False)
        return Loop(folder, robot, home=home)

    return make(once(f"energy-{name}", make))


def _start(law: Path, robot: Path, home: tuple[float, ...], python: bool) -> None:
    """Build the loop of a worker process, once for all its climbs."""
    global _loop, _module
    _folder = tempfile.mkdtemp()
    made: dict[str, Any] = {"sources": module_sources(robot) if python else None, "flags": ()}
    made |= makers_of(robot) if law == MAKERS_LAW else {}
    flags = (*made["flags"], *SEARCH_FLAGS)  # the last one of a kind counts
    _loop = Loop(Path(_folder), robot, law, made["sources"], flags, home=home)
    _module = stiffgen.open_robot(robot).module if python else None
    shutil.rmtree(_folder)


def _climb(task: tuple[int, int, bool]) -> Climbed:
    seed, steps, moving = task
    assert _loop is not None
    best, got = climb(np.random.default_rng(seed), _loop, steps, moving)
    apart = difference(_loop, _module, best) if _module else 0.0
    return Climbed(seed, moving, got.excess, got.summary.port_most, got.summary.reason, got.ratio, apart, got.deficit)


def _tell(rows: list[Climbed], climb_length: int) -> None:
    """Print the table of results."""
    print("| wanted equilibrium | schedules | climbs beyond | most of work less supply [J] | most put out [J] |")
    print("|---|---|---|---|---|")
    for moving in (False, True):
        some = [row for row in rows if row.moving == moving]
        if some:
            beyond, most = sum(row.beyond for row in some), max(row.excess for row in some)
            name, count = "moving" if moving else "constant", len(some) * climb_length
            print(f"| {name} | {count} | {beyond} | {most:.2e} | {max(row.port for row in some):.3f} |")


def main() -> int:
    """Climb from random schedules to the largest energy put out; return 1 if one is beyond the bound."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--climb", type=int, default=200, help="schedules of a climb")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--arm", choices=ARMS, default="iiwa14")
    parser.add_argument("--python", action="store_true", help="compare the class Impedance with C on each climb's best")
    parser.add_argument(
        "--makers", action="store_true", help="commands come through Settle, Press and Follow, which lie"
    )
    options = parser.parse_args()
    start, climbs = time.monotonic(), -(-options.count // options.climb)
    tasks = [(options.seed + k, options.climb, k % 2 == 1) for k in range(climbs)]
    rows: list[Climbed] = []
    folder = Path(tempfile.mkdtemp())
    robot = (ROOT / "generated" / "iiwa14", Q0) if options.arm == "iiwa14" else generate_arm(options.arm, folder)
    law = MAKERS_LAW if options.makers else LAW
    with multiprocessing.Pool(options.workers, _start, (law, *robot, options.python)) as pool:
        for row in pool.imap_unordered(_climb, tasks):
            rows.append(row)
            if row.beyond:
                print(f"seed {row.seed}{', moving' * row.moving}: {row.excess:.2e} J beyond, reason {row.reason}"
                      f"{', TANK_DEFICIT' * row.deficit}", flush=True)  # fmt: skip
            if row.apart > TOLERANCE:
                print(f"seed {row.seed}: Python and C differ by {row.apart:.2e} J", flush=True)
            if len(rows) % 20 == 0 or len(rows) == climbs:
                beyond = sum(row.beyond for row in rows)
                worst, taken = max(row.ratio for row in rows), time.monotonic() - start
                print(f"{len(rows) * options.climb} schedules, {beyond} climbs beyond the bound, "
                      f"worst ratio {worst:.6f}, {taken:.0f} s", flush=True)  # fmt: skip
    shutil.rmtree(folder)
    _tell(rows, options.climb)
    return 1 if any(row.beyond or row.apart > TOLERANCE for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
