"""Adversarial schedules against the controller's energy bound, hill-climbed.

    python tests/long/energy.py [--count 100000] [--seed 1] [--climbs 40]

A schedule is what an environment and a planner do to the robot in a second: loads and held pushes, an arm that is moved
whatever it does, stiffness and equilibrium that change, missed samples, calls left out, sensor faults, resets. What the
robot puts out at its port is summed from the exact positions and the torque that really acted, and held against

    U_0 + T_0 + engagement limit x (returns from a fault, and one if the start is not where the arm is wanted)

with the wanted equilibrium constant (the elastic energy and the tank at the start); a moving one may add the positive
work of the equilibrium's motion, computed here from the springs' energy. A climb starts at a random schedule and keeps
each change that brings the output nearer to the bound or beyond.
"""

from __future__ import annotations

import argparse
import copy
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from support.plant.loop import N, Q0, Loop
from support.project import ROOT

SAMPLES = 1000
TOLERANCE = 1e-9
"""[J] by which the bound may be passed."""

Random = np.random.Generator


@dataclass
class Schedule:
    """Fields of the configuration, of the episode, and of the segments, by name."""

    config: dict[str, Any]
    episode: dict[str, Any]
    parts: list[dict[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class Measured:
    """Of one run: how far the output passed the bound [J], and what the summary of the episode says."""

    excess: float
    summary: Any


def stiffness(random: Random, least: float, most: float) -> np.ndarray:
    Q = np.linalg.qr(random.normal(size=(3, 3)))[0]
    A = Q @ np.diag(np.exp(random.uniform(np.log(least), np.log(most), 3))) @ Q.T
    return np.asarray((A + A.T) / 2)


def part(random: Random, loop: Loop, moving: bool) -> dict[str, Any]:
    """A random segment."""
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
    kind = random.integers(0, 9)
    if kind == 0:
        made["load"] = random.normal(size=6) * [30, 30, 30, 5, 5, 5]
    elif kind == 1:
        made["push"] = random.normal(size=N) * 0.15 * loop.effort
    elif kind <= 4:
        speed = random.uniform(0, 1) ** 0.5
        made |= {
            "driven": 1,
            "driven_to": random.uniform(-1, 1, N) * loop.velocity * speed,
            "driven_by": np.exp(random.uniform(np.log(1), np.log(4000), N)),
        }
    elif kind == 5:
        made |= {
            "hand_stiffness": 10 ** random.uniform(1, 3),
            "hand_damping": 10 ** random.uniform(0, 2),
            "hand_target": Q0 + random.uniform(-0.7, 0.7, N),
        }
    elif kind == 6:
        made |= {"missed": int(random.random() < 0.5), "skip": int(random.random() < 0.5)}
    elif kind == 7:
        made |= {"q_stuck": int(random.integers(0, 3)), "q_mask": int(random.integers(0, 128))}
        made |= {"dq_stuck": int(random.integers(0, 3)), "dq_mask": int(random.integers(0, 128))}
    elif kind == 8:
        made["q_offset"] = random.normal(size=N) * (random.random(N) < 0.3) * 10 ** random.uniform(-4, 0)
        made["dq_offset"] = random.normal(size=N) * (random.random(N) < 0.3) * 10 ** random.uniform(-2, 1)
    if random.random() < 0.4:
        made["translation"], made["rotation"] = stiffness(random, 1, 4000), stiffness(random, 0.1, 400)
    if moving and random.random() < 0.5:
        made["wanted"] = Q0 + random.uniform(-0.8, 0.8, N)
        made["pose"] = int(random.random() < 0.3)
        made["posture"] = Q0 + random.uniform(-0.8, 0.8, N)
    return made


def schedule(random: Random, loop: Loop, moving: bool = False, sensors: bool = False) -> Schedule:
    """Draw one. Small tank and engagement limit: then little is hidden below the bound.

    sensors: whether sensor faults and encoder quanta may come in; the bound is for positions that are right.
    """
    delay = int(random.integers(0, 3))
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
            "damping_ratio": float(random.uniform(0, 1.5)),
            "joint_damping": float(10 ** random.uniform(-2, 0)),
            "posture_stiffness": float(10 ** random.uniform(-1, 2)),
            "stiffness_time": float(10 ** random.uniform(-3, -1)),
            "ramp_time": float(10 ** random.uniform(-3, -0.5)),
            "position_quantum": 1e-4 if sensors else 0.0,
        },
        {
            "delay": delay,
            "motor": motor,
            "differences": int(random.random() < 0.5),
            "q": Q0.copy() if random.random() < 0.5 else Q0 + random.uniform(-0.6, 0.6, N),
            "v": np.zeros(N),
        },
        [{"wanted": Q0, "translation": stiffness(random, 1, 4000), "rotation": stiffness(random, 0.1, 400)}],
    )
    while len(made.parts) < random.integers(3, 12):
        chosen = part(random, loop, moving)
        if sensors or not (chosen["q_stuck"] or chosen["dq_stuck"] or np.any(chosen["q_offset"])):
            made.parts.append(chosen)
    made.parts[1:] = sorted(made.parts[1:], key=lambda p: p["start"])
    return made


def changed(random: Random, loop: Loop, old: Schedule, moving: bool, sensors: bool) -> Schedule:
    """A neighbour: numbers shaken, segments moved, doubled, dropped, replaced, or taken from another schedule."""
    new = copy.deepcopy(old)
    for _ in range(random.integers(1, 4)):
        kind = random.integers(0, 7)
        later = new.parts[1:]
        if kind == 0 or not later:
            new.parts.append(part(random, loop, moving))
        elif kind == 1 and len(later) > 1:
            new.parts.remove(later[random.integers(len(later))])
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
            one[name] = 1 - one[name]
        else:
            names = [name for name in new.config if name not in ("motor_inertia", "delay_samples", "position_quantum")]
            name = names[random.integers(len(names))]
            new.config[name] *= float(np.exp(random.normal() * 0.5))
            new.config["tank_maximum"] = max(new.config["tank_maximum"], new.config["tank_initial"])
    if not sensors:
        new.parts = [p for p in new.parts if not (p.get("q_stuck") or p.get("dq_stuck") or np.any(p.get("q_offset", 0)))]
    new.parts[1:] = sorted(new.parts[1:], key=lambda p: p["start"])
    return new


def _shake(random: Random, one: dict[str, Any]) -> None:
    size = 10 ** random.uniform(-2, 0)
    for name in ("load", "push", "driven_to", "hand_target"):
        if name in one and np.any(one[name]):
            one[name] = one[name] * (1 + size * random.normal(size=np.shape(one[name])))
    if random.random() < 0.3 and one.get("driven"):
        one["driven_to"] = -one["driven_to"]
    for name in ("driven_by", "hand_stiffness", "hand_damping", "translation", "rotation"):
        if name in one:
            one[name] = one[name] * np.exp(size * random.normal())


def measure(loop: Loop, chosen: Schedule) -> Measured:
    """Run one."""
    constant = all("wanted" not in part for part in chosen.parts[1:])
    away = int(bool(np.any(np.asarray(chosen.episode["q"]) != chosen.parts[0]["wanted"])))
    limit = chosen.config["engagement_limit"]
    episode = loop.episode(**chosen.episode, engagement=limit)
    summary = loop.run(SAMPLES, loop.segments(*chosen.parts), episode, loop.config(**chosen.config))
    most = summary.excess if constant else summary.excess_moving
    held = chosen.config["tank_initial"] + (limit * away if constant else 0.0)
    return Measured(most - held, summary)


def climb(random: Random, loop: Loop, steps: int, moving: bool, sensors: bool = False) -> tuple[Schedule, Measured]:
    """The best of a climb, restarted from the best of ten random schedules."""
    starts = [schedule(random, loop, moving, sensors) for _ in range(min(10, steps))]
    best, most = max(((one, measure(loop, one)) for one in starts), key=lambda pair: pair[1].excess)
    for _ in range(steps - len(starts)):
        new = changed(random, loop, best, moving, sensors)
        try:
            got = measure(loop, new)
        except AssertionError:  # a configuration that is refused
            continue
        if got.excess >= most.excess:
            best, most = new, got
    return best, most
