# SPDX-License-Identifier: MIT
"""Schedules of energy.py: what an environment and a planner do to an arm in two seconds, drawn freely.

patterns.py draws fault cycles, pumping, shaking, carrying and others; widened.py adds sensors in single precision, late
calls, restarts and tools to any schedule.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from support.plant.loop import Loop
from support.plant.statics import random_stiffness

SAMPLES = 2000
SCALED = ("damping_ratio", "ramp_time", "heaviest_wrench")
"""Further fields of a configuration with which the controller begins anew."""

Random = np.random.Generator


@dataclass
class Schedule:
    """Fields of the configuration, of the episode, of the segments, and of changed configurations, by name."""

    config: dict[str, Any]
    episode: dict[str, Any]
    parts: list[dict[str, Any]] = field(default_factory=list)
    changes: list[dict[str, Any]] = field(default_factory=list)
    """A segment's ``config`` is 0 for the first configuration, or 1 + the place of its change here.

    A segment that restarts the controller may have its ``delay`` [samples], which holds until the next restart.
    """


def springs(random: Random, loop: Loop, least: float, least_rotation: float) -> dict[str, np.ndarray]:
    """Return random stiffness of each tip, up to 4000 N/m and 400 N m/rad."""
    return {
        "translation": np.stack([random_stiffness(random, least, 4000) for _ in range(loop.tips)]),
        "rotation": np.stack([random_stiffness(random, least_rotation, 400) for _ in range(loop.tips)]),
    }


def part(random: Random, loop: Loop, moving: bool) -> dict[str, Any]:
    """Draw a random segment of an episode: when it starts, what is lost, commanded, pushed or loaded from then on."""
    made: dict[str, Any] = {
        "start": int(random.integers(1, SAMPLES)),
        "missed": 0,
        "skip": 0,
        "reset": int(random.random() < 0.4),
        "driven": 0,
        "load": np.zeros(6),
        "push": np.zeros(loop.n),
        "hand_stiffness": 0.0,
        "q_stuck": 0,
        "dq_stuck": 0,
        "q_offset": np.zeros(loop.n),
        "dq_offset": np.zeros(loop.n),
    }
    kind = random.integers(0, 10)
    if kind == 0:
        made["load"] = random.normal(size=6) * [30, 30, 30, 5, 5, 5]
    elif kind == 1:
        made["push"] = random.normal(size=loop.n) * 0.05 * loop.effort
    elif kind <= 4:
        speed = random.uniform(0, 1) ** 0.5
        made |= {
            "driven": 1,
            "driven_to": random.uniform(-1, 1, loop.n) * loop.velocity * speed,
            "driven_by": np.exp(random.uniform(np.log(1), np.log(4000), loop.n)),
        }
        if kind > 2:
            made |= {
                "driven": 2,
                "driven_at": np.abs(made["driven_to"]),
                "driven_to": loop.home + random.normal(size=loop.n) * 0.4,
            }
    elif kind == 5:
        made |= {
            "hand_stiffness": 10 ** random.uniform(1, 3),
            "hand_damping": 10 ** random.uniform(0, 2),
            "hand_target": loop.home + random.uniform(-0.7, 0.7, loop.n),
        }
    elif kind == 6:
        made |= {"missed": int(random.random() < 0.7), "skip": int(random.integers(0, 6))}
    elif kind == 7:
        made |= {"q_stuck": int(random.integers(0, 3)), "q_mask": int(random.integers(0, 128))}
        made |= {"dq_stuck": int(random.integers(0, 3)), "dq_mask": int(random.integers(0, 128))}
    elif kind == 8:
        made["q_offset"] = random.normal(size=loop.n) * (random.random(loop.n) < 0.3) * 10 ** random.uniform(-4, 0)
        made["dq_offset"] = random.normal(size=loop.n) * (random.random(loop.n) < 0.3) * 10 ** random.uniform(-2, 1)
    elif kind == 9:
        made |= {"driven": 2, "driven_to": at_limits(random, loop), "missed": int(random.random() < 0.5)}
        made |= {"driven_at": loop.velocity * random.uniform(0.02, 0.99), "driven_by": np.full(loop.n, 100.0)}
    if random.random() < 0.4:
        made |= springs(random, loop, 1, 0.1)
    if random.random() < 0.3:
        made["wrench_command"] = draw_wrench(random)
    if random.random() < 0.2:
        made["torque_offset"] = _offset(random, loop)
    if moving and random.random() < 0.5:
        made["wanted"] = loop.home + random.uniform(-0.8, 0.8, loop.n)
        made["joint"] = float(10 ** random.uniform(-1, 2))
        made["wanted_rate"] = random.normal(size=loop.n) * 10 ** random.uniform(-3, 0.5) * (random.random() < 0.4)
        if random.random() < 0.6:
            made |= draw_plan(random, loop.n)
        made["jitter"] = 10 ** random.uniform(-13, -1) * (random.random() < 0.4)
    return made


def _offset(random: Random, loop: Loop) -> np.ndarray:
    """Return a torque that the caller adds; now and then none."""
    return np.asarray(random.normal(size=loop.n) * loop.effort * 10 ** random.uniform(-2, 0) * (random.random() < 0.8))


def draw_wrench(random: Random) -> np.ndarray:
    """Return a wrench that the tip is to exert, up to the default of heaviest_wrench; now and then none."""
    parts = [size * direction / np.linalg.norm(direction) * random.random() ** 0.5
             for size, direction in ((100.0, random.normal(size=3)), (20.0, random.normal(size=3)))]  # fmt: skip
    return np.concatenate(parts) * (random.random() < 0.8) * (1 - 1e-9)


def draw_friction(random: Random, loop: Loop) -> np.ndarray:
    """Return the friction that the controller is told, up to the effort limits; the plant has none. Often it is 0."""
    return np.asarray(loop.effort * 10 ** random.uniform(-3, 0, loop.n) * (random.random() < 0.4))


def draw_plan(random: Random, joints: int) -> dict[str, Any]:
    """Return what a plan says of q0: that it has ramps already, and its acceleration; half of them lie."""
    acceleration = np.clip(random.normal(size=joints) * 10 ** random.uniform(-2, 1.5), -30, 30)
    return {"shaped": int(random.random() < 0.7), "acceleration": acceleration * random.integers(0, 2)}


def at_limits(random: Random, loop: Loop) -> np.ndarray:
    """Return a posture with some joints at their limits, up to 0.095 rad beyond them or 0.8 rad inside."""
    limit = np.where(random.random(loop.n) < 0.5, loop.lower, loop.upper)
    limit = np.where(np.isfinite(limit), limit, loop.home + random.uniform(-9, 9, loop.n))  # turns of such joints
    inside = np.sign(limit) * random.uniform(-0.095, 0.8, loop.n)
    return np.where(random.random(loop.n) < 0.6, limit - inside, loop.home)


def schedule(random: Random, loop: Loop, moving: bool = False, sensors: bool = False) -> Schedule:
    """Draw a schedule with a small tank, so that little is hidden below the bound.

    sensors: whether measured positions may be wrong, for which there is no bound.
    """
    delay = int(random.integers(0, 6))
    motor = np.exp(random.uniform(np.log(0.02), np.log(0.3), loop.n))
    made = Schedule(
        {
            "tank_initial": float(10 ** random.uniform(-1, 0.6)),  # [J] 0.1 to 4
            "heaviest_wrench": np.array([100.0, 20.0]) * 10 ** random.uniform(-1, 0.5),
            "delay_samples": delay,
            "motor_inertia": motor,
            "coriolis": int(random.integers(1, 3)),
            "damping_ratio": float(random.uniform(0, 1.5)),
            "coulomb_friction": draw_friction(random, loop),
            "ramp_time": float(10 ** random.uniform(-3, -0.5)),
            "position_quantum": 1e-4 if sensors else float(random.choice([0.0, 2e-6, 2e-6])),
            "missed_limit": int(random.integers(1, 7)),
            "call_gap_limit": int(random.integers(1, 7)),
            "communication_reaction": int(random.integers(1, 4)),
            "torque_rate_limit": 10 * loop.effort * 10 ** random.uniform(-1.5, 1.5),  # [N m/s]
        },
        {
            "delay": delay,
            "motor": motor,
            "differences": int(random.random() < 0.5),
            "q": _first_posture(random, loop),
            "v": np.zeros(loop.n),
        },
        [{"wanted": loop.home, "joint": float(10 ** random.uniform(-1, 2))} | springs(random, loop, 1, 0.1)],
    )
    made.episode |= timing(random)
    if not np.isfinite(loop.upper).all():
        _count_turns(random, loop, made)
    while len(made.parts) < random.integers(3, 12):
        chosen = part(random, loop, moving)
        if sensors or not lies(chosen):
            made.parts.append(chosen)
    if random.random() < 0.3:
        change_configuration(random, loop, made)
    return ordered(made)


def timing(random: Random) -> dict[str, Any]:
    """Return how early calls come, and whether commands have single precision."""
    return {"early": random.random() * (random.random() < 0.2), "single": int(random.random() < 0.2)}


def _count_turns(random: Random, loop: Loop, made: Schedule) -> None:
    """Let encoders of joints without limits wrap or count; gaps may be so long that half a turn passes unseen."""
    if random.random() < 0.7:
        made.episode["wrapped"] = sum(2**i for i in range(loop.n) if not np.isfinite(loop.upper[i]))
    if random.random() < 0.5:
        made.config |= {"missed_limit": int(10 ** random.uniform(0, 2))}
    if random.random() < 0.7:
        made.config["velocity_limit"] = loop.velocity * 10 ** random.uniform(0, 1.5)


def change_configuration(random: Random, loop: Loop, made: Schedule) -> None:
    """Let the controller begin anew with other configurations, limits among their fields, and the torque in force."""
    base, turning = made.config, np.where(np.isfinite(loop.upper), 1.0, np.inf)
    drawn: dict[str, Any] = {
        "velocity_limit": lambda: (
            loop.velocity * 10 ** random.uniform(-0.7, 1.2, loop.n if random.random() < 0.5 else 1)
        ),
        "call_gap_limit": lambda: int(random.integers(1, 13)),
        "missed_limit": lambda: int(random.integers(1, 30)),
        "coriolis": lambda: int(random.integers(1, 3)),
        "coulomb_friction": lambda: draw_friction(random, loop),
        "communication_reaction": lambda: int(random.integers(1, 4)),
        "lower_limit": lambda: loop.home - 10 ** random.uniform(-1.5, 0.3, loop.n) * turning,
        "upper_limit": lambda: loop.home + 10 ** random.uniform(-1.5, 0.3, loop.n) * turning,
        "tank_initial": lambda: 10 ** random.uniform(-1, 1),
        "heaviest_wrench": lambda: np.array([100.0, 20.0]) * 10 ** random.uniform(-1, 0.5),
    }
    scaled = [name for name in SCALED if name in base]
    for _ in range(random.integers(1, 4)):
        names = random.choice([*drawn, *drawn, *scaled], random.integers(1, 5))
        made.changes.append({
            name: drawn[name]() if name in drawn else base[name] * 10 ** random.uniform(-1, 0.1) for name in names
        })  # fmt: skip
    for _ in range(random.integers(1, 6)):
        one = made.parts[random.integers(len(made.parts))]
        again = {**one, "start": int(random.integers(1, SAMPLES)), "reset": 0, "restart": 2}
        made.parts.append(again | {"config": int(random.integers(0, 1 + len(made.changes)))})


def _first_posture(random: Random, loop: Loop) -> np.ndarray:
    kind = random.random()
    if kind < 0.5:
        return loop.home.copy()
    return loop.home + random.uniform(-0.6, 0.6, loop.n) if kind < 0.8 else at_limits(random, loop)


def lies(one: dict[str, Any]) -> bool:
    """Return whether measured positions are wrong; velocities may be."""
    return bool(one.get("q_stuck") or np.any(one.get("q_offset", 0)))


def ordered(made: Schedule) -> Schedule:
    """Segments by their starts."""
    made.parts[1:] = sorted(made.parts[1:], key=lambda p: p["start"])
    return made
