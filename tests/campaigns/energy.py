# SPDX-License-Identifier: MIT
"""Search for schedules that break the controller's energy bound, by hill climbing.

    python tests/campaigns/energy.py [--count 100000] [--seed 1] [--climb 200] [--policy]

A schedule says what an environment and a planner do to the robot in two seconds: loads, pushes, an arm that is moved
whatever it does (into the limit zones, too), stiffness and equilibrium that change, targets that are streamed with
jitter, missed samples, calls left out, velocities that lie, resets. Configurations vary in delay, missed_limit, rate
limits, limit zones, damping, velocity filter, tank and engagement, with Coriolis forces and without, with motors that
have a controller inside and without. Wrenches that the tip is to exert, velocities and accelerations of plans come and
go, and lie. The work that the robot puts out at its port is summed from the exact motion and the torque that acted, and
compared with the controller's output energy_supplied, from the first sample to the last and at all times between. With
--policy all commands reach the controller through the policy port, from a hostile commander (policy_law.c) whose seed
the climb changes. A climb starts at a random schedule and keeps each change that brings the work nearer to the bound or
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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from support.plant.loop import LAW, POLICY, Q0, Loop, N
from support.plant.statics import random_stiffness
from support.project import ROOT

SAMPLES = 2000
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

Random = np.random.Generator


@dataclass
class Schedule:
    """Fields of the configuration, of the episode, and of the segments, by name."""

    config: dict[str, Any]
    episode: dict[str, Any]
    parts: list[dict[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class Measured:
    """Result of a run: work less energy_supplied [J], its value for a climb, their ratio, the episode's summary."""

    excess: float
    interest: float
    ratio: float
    summary: Any


def _springs(random: Random, least: float, least_rotation: float) -> dict[str, np.ndarray]:
    """Random stiffness, up to 4000 N/m and 400 N m/rad."""
    return {
        "translation": random_stiffness(random, least, 4000),
        "rotation": random_stiffness(random, least_rotation, 400),
    }


def part(random: Random, loop: Loop, moving: bool) -> dict[str, Any]:
    """Draw a random segment."""
    made: dict[str, Any] = {
        "start": int(random.integers(1, SAMPLES)),
        "missed": 0,
        "skip": 0,
        "reset": int(random.random() < 0.4),
        "driven": 0,
        "load": np.zeros(6),
        "push": np.zeros(N),
        "hand_stiffness": 0.0,
        "q_stuck": 0,
        "dq_stuck": 0,
        "q_offset": np.zeros(N),
        "dq_offset": np.zeros(N),
    }
    kind = random.integers(0, 10)
    if kind == 0:
        made["load"] = random.normal(size=6) * [30, 30, 30, 5, 5, 5]
    elif kind == 1:
        made["push"] = random.normal(size=N) * 0.05 * loop.effort
    elif kind <= 4:
        speed = random.uniform(0, 1) ** 0.5
        made |= {
            "driven": 1,
            "driven_to": random.uniform(-1, 1, N) * loop.velocity * speed,
            "driven_by": np.exp(random.uniform(np.log(1), np.log(4000), N)),
        }
        if kind > 2:
            made |= {"driven": 2, "driven_at": np.abs(made["driven_to"]), "driven_to": Q0 + random.normal(size=N) * 0.4}
    elif kind == 5:
        made |= {
            "hand_stiffness": 10 ** random.uniform(1, 3),
            "hand_damping": 10 ** random.uniform(0, 2),
            "hand_target": Q0 + random.uniform(-0.7, 0.7, N),
        }
    elif kind == 6:
        made |= {"missed": int(random.random() < 0.7), "skip": int(random.integers(0, 6))}
    elif kind == 7:
        made |= {"q_stuck": int(random.integers(0, 3)), "q_mask": int(random.integers(0, 128))}
        made |= {"dq_stuck": int(random.integers(0, 3)), "dq_mask": int(random.integers(0, 128))}
    elif kind == 8:
        made["q_offset"] = random.normal(size=N) * (random.random(N) < 0.3) * 10 ** random.uniform(-4, 0)
        made["dq_offset"] = random.normal(size=N) * (random.random(N) < 0.3) * 10 ** random.uniform(-2, 1)
    elif kind == 9:
        made |= {"driven": 2, "driven_to": _at_limits(random, loop), "missed": int(random.random() < 0.5)}
        made |= {"driven_at": loop.velocity * random.uniform(0.02, 0.99), "driven_by": np.full(N, 100.0)}
    if random.random() < 0.4:
        made |= _springs(random, 1, 0.1)
    if random.random() < 0.3:
        made["wrench_command"] = _wrench(random)
    if moving and random.random() < 0.5:
        made["wanted"] = Q0 + random.uniform(-0.8, 0.8, N)
        made["pose"] = int(random.random() < 0.5)
        made["posture"] = Q0 + random.uniform(-0.8, 0.8, N)
        made["wanted_rate"] = random.normal(size=N) * 10 ** random.uniform(-3, 0.5) * (random.random() < 0.4)
        if random.random() < 0.6:
            made |= _plan(random, made["wanted_rate"])
        made["jitter"] = 10 ** random.uniform(-13, -1) * (random.random() < 0.4)
    return made


def _wrench(random: Random) -> np.ndarray:
    """Return a wrench that the tip is to exert, up to the default of heaviest_wrench; now and then none."""
    parts = [size * direction / np.linalg.norm(direction) * random.random() ** 0.5
             for size, direction in ((100.0, random.normal(size=3)), (20.0, random.normal(size=3)))]  # fmt: skip
    return np.concatenate(parts) * (random.random() < 0.8) * (1 - 1e-9)


def _plan(random: Random, rate: np.ndarray) -> dict[str, Any]:
    """Return velocity and acceleration of a plan that moves at a rate; half of them lie."""
    velocity = rate if random.random() < 0.5 else random.normal(size=N) * 10 ** random.uniform(-3, 0.3)
    return {
        "velocity": np.clip(velocity, -1.4, 1.4),
        "acceleration": np.clip(random.normal(size=N) * 10 ** random.uniform(-2, 1.5), -30, 30) * random.integers(0, 2),
    }


def _at_limits(random: Random, loop: Loop) -> np.ndarray:
    """Return a posture with some joints at their limits, up to 0.095 rad beyond them or 0.8 rad inside."""
    limit = np.where(random.random(N) < 0.5, loop.lower, loop.upper)
    inside = np.sign(limit) * random.uniform(-0.095, 0.8, N)
    return np.where(random.random(N) < 0.6, limit - inside, Q0)


def schedule(random: Random, loop: Loop, moving: bool = False, sensors: bool = False) -> Schedule:
    """Draw a schedule with a small tank and engagement limit, so that little is hidden below the bound.

    sensors: whether measured positions may be wrong, for which there is no bound.
    """
    delay = int(random.integers(0, 6))
    motor = np.exp(random.uniform(np.log(0.02), np.log(0.3), N))
    energy = {
        "tank_initial": float(10 ** random.uniform(-1, 0.6)),
        "energy_limit": float(10 ** random.uniform(-1, 1)),
        "engagement_limit": float(10 ** random.uniform(-1, 1)),
    }
    made = Schedule(
        {
            **energy,
            "tank_maximum": 4.0,
            "delay_samples": delay,
            "motor_inertia": motor,
            "coriolis": int(random.integers(1, 3)),
            "damping_ratio": float(random.uniform(0, 1.5)),
            "joint_damping": float(10 ** random.uniform(-2, 0)),
            "posture_stiffness": float(10 ** random.uniform(-1, 2)),
            "stiffness_time": float(10 ** random.uniform(-3, -1)),
            "ramp_time": float(10 ** random.uniform(-3, -0.5)),
            "position_quantum": 1e-4 if sensors else 0.0,
            "missed_limit": int(random.integers(1, 7)),
            "call_gap_limit": int(random.integers(1, 7)),
            "communication_reaction": int(random.integers(1, 3)),
            "communication_reset_time": float(random.choice([0.0, 0.05])),
            "torque_rate_limit": 10 * loop.effort * 10 ** random.uniform(-1.5, 1.5),
            "limit_zone": float(10 ** random.uniform(-2, -0.1)),
            "limit_stiffness": loop.effort * 10 ** random.uniform(-1.5, 1),
        },
        {
            "delay": delay,
            "motor": motor,
            "differences": int(random.random() < 0.5),
            "q": _first_posture(random, loop),
            "v": np.zeros(N),
        },
        [{"wanted": Q0} | _springs(random, 1, 0.1)],
    )
    while len(made.parts) < random.integers(3, 12):
        chosen = part(random, loop, moving)
        if sensors or not _lies(chosen):
            made.parts.append(chosen)
    if random.random() < 0.3:
        made.config["velocity_filter_time"] = float(10 ** random.uniform(-3.5, -1.5))
    if random.random() < 0.4:
        made.config |= _gains(random)
        made.episode["delay"] = 0
    return _ordered(made)


def _gains(random: Random) -> dict[str, Any]:
    """Return the configuration of motors with a controller inside, which take no delay."""
    return {
        "actuation": 2,
        "delay_samples": 0,
        "kp_limit": float(10 ** random.uniform(0, 4)),
        "kd_limit": float(10 ** random.uniform(-1, 2)),
    }


def _first_posture(random: Random, loop: Loop) -> np.ndarray:
    kind = random.random()
    if kind < 0.5:
        return Q0.copy()
    return Q0 + random.uniform(-0.6, 0.6, N) if kind < 0.8 else _at_limits(random, loop)


def _lies(one: dict[str, Any]) -> bool:
    """Return whether measured positions are wrong; velocities may be."""
    return bool(one.get("q_stuck") or np.any(one.get("q_offset", 0)))


def _ordered(made: Schedule) -> Schedule:
    """Segments by their starts."""
    made.parts[1:] = sorted(made.parts[1:], key=lambda p: p["start"])
    return made


def _base(random: Random, loop: Loop) -> Schedule:
    made = schedule(random, loop)
    made.parts = [made.parts[0] | _springs(random, 300, 20)]
    made.episode["q"] = Q0.copy()
    return made


def _drive(random: Random, loop: Loop, start: float, to: np.ndarray, **others: Any) -> dict[str, Any]:
    rates = {
        "driven_at": loop.velocity * random.uniform(0.3, 0.99),
        "driven_by": np.full(N, 10 ** random.uniform(1, 3)),
    }
    return {"start": round(start), "driven": 2, "driven_to": to, **rates, **others}


def laps(random: Random, loop: Loop) -> Schedule:
    """Return the fault cycle: control lost, the arm moved away, a reset, and on the way back the arm held and freed."""
    made, lap = _base(random, loop), int(random.integers(300, 1000))
    for start in range(5, SAMPLES - lap + 1, lap):
        away = Q0 + random.uniform(-0.6, 0.6, N)
        made.parts += [
            _drive(random, loop, start, away, missed=1, reset=0),
            _drive(random, loop, start + 0.30 * lap, away, missed=0, reset=0),
            _drive(random, loop, start + 0.35 * lap, away, missed=0, reset=1),
            _drive(random, loop, start + 0.75 * lap, Q0, missed=0, reset=0),
        ]
    return _ordered(made)


def pumping(random: Random, loop: Loop) -> Schedule:
    """Away on soft springs, back on stiff ones, in a loop."""
    made, lap = _base(random, loop), int(random.integers(100, 800))
    soft = {"translation": made.parts[0]["translation"] * 0.01, "rotation": made.parts[0]["rotation"] * 0.01}
    stiff = {name: made.parts[0][name] for name in soft}
    away = Q0 + random.uniform(-0.5, 0.5, N)
    for start in range(1, SAMPLES - lap + 1, lap):
        made.parts += [
            _drive(random, loop, start, away, **soft),
            _drive(random, loop, start + 0.35 * lap, away, **stiff),
            _drive(random, loop, start + 0.65 * lap, Q0, **stiff),
        ]
    return _ordered(made)


def shaking(random: Random, loop: Loop) -> Schedule:
    """To and fro at almost the velocity limit, reversed at once, with samples missed in time with it."""
    made, half = _base(random, loop), int(random.integers(1, 8))
    away = Q0 + random.uniform(-0.4, 0.4, N)
    made.parts.append(_drive(random, loop, 1, away))
    start, sign, way = int(random.integers(200, 400)), 1.0, random.choice([-1.0, 0.0, 1.0], N)
    missing, when = int(random.integers(0, 3)), int(random.integers(0, 2))
    while start < SAMPLES - half:
        rates = {"driven": 1, "driven_to": sign * way * loop.velocity * 0.98, "driven_by": np.full(N, 1e6)}
        made.parts.append({"start": start, "missed": 0, **rates})
        if missing:
            made.parts.append({"start": start + when, "missed": 1, **rates})
            made.parts.append({"start": start + when + missing, "missed": 0, **rates})
        start, sign = start + max(half, when + missing + 1), -sign
    return _ordered(made)


def zones(random: Random, loop: Loop) -> Schedule:
    """Draw laps: control is lost, the arm is carried into the limit zones, a reset, and the arm is led out slowly."""
    made, lap = _base(random, loop), int(random.integers(500, 1000))
    for start in range(5, SAMPLES - lap + 1, lap):
        inside = _at_limits(random, loop)
        made.parts += [
            _drive(random, loop, start, inside, missed=1, reset=0),
            _drive(random, loop, start + 0.4 * lap, inside, missed=0, reset=0),
            _drive(random, loop, start + 0.45 * lap, inside, missed=0, reset=1),
            _drive(random, loop, start + 0.5 * lap, Q0, missed=0, reset=0)
            | {"driven_at": loop.velocity * random.uniform(0.02, 0.5)},
        ]
    return _ordered(made)


def gaps(random: Random, loop: Loop) -> Schedule:
    """Draw shaking at almost the velocity limit while calls are left out and some calls have no sample."""
    made = shaking(random, loop)
    skip, every = int(random.integers(0, made.config["missed_limit"])), int(random.integers(2, 6))
    made.parts[0]["skip"] = skip
    turns, at, parts = _ordered(made).parts, 0, [made.parts[0]]
    for start in range(1, SAMPLES):
        turn = at + 1 < len(turns) and turns[at + 1]["start"] <= start
        at += int(turn)
        if turn or start % (skip + 1) == 0:
            parts.append({**turns[at], "start": start, "missed": int(start // (skip + 1) % every == 0)})
    made.parts = parts
    return made


def streams(random: Random, loop: Loop) -> Schedule:
    """Draw targets that are streamed with jitter while a load hangs at the tip or the arm is moved."""
    made = _base(random, loop)
    made.parts[0]["jitter"] = 10 ** random.uniform(-13, -0.5)
    made.parts[0]["wanted_rate"] = random.normal(size=N) * 10 ** random.uniform(-3, 0.5) * (random.random() < 0.5)
    made.parts[0]["load"] = random.normal(size=6) * [30, 30, 60, 5, 5, 5]
    made.parts += [part(random, loop, True) for _ in range(random.integers(0, 4))]
    made.parts = [one for one in made.parts if not _lies(one)]
    return _ordered(made)


def presses(random: Random, loop: Loop) -> Schedule:
    """Draw to and fro of the arm while wrenches come and go with it, some samples missing."""
    made, lap = _base(random, loop), int(random.integers(20, 600))
    made.parts[0] |= _springs(random, 1, 0.1)
    away, wrench = Q0 + random.uniform(-0.5, 0.5, N), _wrench(random)
    for start in range(1, SAMPLES - lap + 1, lap):
        made.parts += [
            _drive(random, loop, start, away, wrench_command=wrench, missed=0),
            _drive(random, loop, start + 0.5 * lap, Q0, wrench_command=-wrench * random.integers(0, 2), missed=0),
        ]
        if random.random() < 0.2:
            made.parts.append({**made.parts[-1], "start": round(start + 0.9 * lap), "missed": 1})
    return _ordered(made)


def plans(random: Random, loop: Loop) -> Schedule:
    """Draw targets that move to and fro with a plan stated at each turn; the arm may be led, also along the plan."""
    made, half = _base(random, loop), int(random.integers(20, 400))
    rate = random.normal(size=N) * 10 ** random.uniform(-4, 0)
    kind, steady = random.integers(0, 3), random.uniform(-1, 1, N) * 0.5 * loop.velocity
    made.parts[0] |= _springs(random, 1, 0.1) if kind == 2 else {}
    for k, start in enumerate(range(1, SAMPLES - half + 1, half)):
        sign = (-1) ** k
        one = {"start": start, "wanted": Q0 + (0.0 if k % 2 == 0 else 1e-3 * half) * rate, "wanted_rate": sign * rate}
        plan, led = _plan(random, sign * rate), random.uniform(-0.9, 0.9, N) * loop.velocity
        if kind == 2:  # an acceleration that stays below what is refused, and an arm that goes along
            plan = {"velocity": sign * rate, "acceleration": sign * steady}
            led = 0.4 * sign * np.sign(steady) * loop.velocity
        made.parts.append(one | plan | ({"driven": 1, "driven_by": 1e4, "driven_to": led} if kind else {}))
    return _ordered(made)


PATTERNS = (laps, pumping, shaking, zones, gaps, streams, presses, plans)


def changed(random: Random, loop: Loop, old: Schedule, moving: bool, sensors: bool) -> Schedule:
    """Return a neighbour: numbers shaken, segments moved, doubled, dropped, replaced, or copied from another one."""
    new = copy.deepcopy(old)
    for _ in range(random.integers(1, 4)):
        kind = random.integers(0, 7)
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
        else:
            _change_config(random, new)
    if not sensors:
        new.parts = [one for one in new.parts if not _lies(one)]
    return _ordered(new)


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
        one["wrench_command"] = _wrench(random)
    if "velocity" in one and random.random() < 0.2:
        one |= _plan(random, one.get("wanted_rate", np.zeros(N)))
    if random.random() < 0.3 and one.get("driven"):
        one["driven_to"] = -one["driven_to"]
    for name in ("driven_by", "hand_stiffness", "hand_damping", "translation", "rotation"):
        if name in one:
            one[name] = one[name] * np.exp(size * random.normal())


def measure(loop: Loop, chosen: Schedule) -> Measured:
    """Run a schedule. Calls come as often as call_gap_limit and missed_limit say; the arm keeps its velocity limits."""
    most = min(chosen.config.get(name, 3) for name in ("missed_limit", "call_gap_limit")) - 1
    parts = [{**one, "skip": min(one.get("skip", 0), most)} for one in chosen.parts]
    streamed = chosen.episode.get("streamed", 0)
    if streamed:
        ctypes.c_uint.in_dll(loop.library, "policy_seed").value = streamed
    limit = chosen.config["engagement_limit"]
    limits = {"engagement": limit, "fastest": 1.0, "rate": chosen.config.get("torque_rate_limit", 10 * loop.effort)}
    episode = loop.episode(**chosen.episode, **limits)
    summary = loop.run(SAMPLES, loop.segments(*parts), episode, loop.config(**chosen.config))
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
    pattern = random.integers(0, 2 * len(PATTERNS))
    starts = [
        PATTERNS[pattern](random, loop) if pattern < len(PATTERNS) else schedule(random, loop, moving, sensors)
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


def _start(law: Path) -> None:
    global _loop
    _folder = tempfile.mkdtemp()
    _loop = Loop(Path(_folder), ROOT / "generated" / "iiwa14", law)
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
    parser.add_argument("--policy", action="store_true", help="command through the policy port")
    options = parser.parse_args()
    law = POLICY if options.policy else LAW
    start, climbs = time.monotonic(), -(-options.count // options.climb)
    tasks = [(options.seed + k, options.climb, k % 2 == 1) for k in range(climbs)]
    found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    worst = 0.0
    with multiprocessing.Pool(options.workers, _start, (law,)) as pool:
        for done, (seed, moving, excess, port, reason, ratio) in enumerate(pool.imap_unordered(_climb, tasks), 1):
            found[moving].append((excess, port))
            worst = max(worst, ratio)
            if excess > TOLERANCE:
                print(f"seed {seed}{', moving' * moving}: {excess:.2e} J beyond, reason {reason}", flush=True)
            if done % 20 == 0 or done == climbs:
                beyond = sum(x > TOLERANCE for x, _ in found[False] + found[True])
                print(f"{done * options.climb} schedules, {beyond} climbs beyond the bound, "
                      f"worst ratio {worst:.6f}, {time.monotonic() - start:.0f} s", flush=True)  # fmt: skip
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
