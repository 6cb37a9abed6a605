# SPDX-License-Identifier: MIT
"""Schedules of energy.py: what an environment and a planner do to an arm in two seconds, drawn at random and changed.

A schedule is drawn from patterns (fault cycles, pumping, shaking, carrying, ...) or freely.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from support.plant.loop import Loop
from support.plant.statics import random_stiffness

SAMPLES = 2000
SCALED = (
    "damping_ratio", "joint_damping", "posture_stiffness", "stiffness_time", "ramp_time", "energy_limit",
    "engagement_limit", "limit_zone", "limit_stiffness", "velocity_filter_time", "kp_limit", "kd_limit",
)  # fmt: skip
"""Further fields of a configuration that changes while the controller runs."""

Random = np.random.Generator


@dataclass
class Schedule:
    """Fields of the configuration, of the episode, of the segments, and of changed configurations, by name."""

    config: dict[str, Any]
    episode: dict[str, Any]
    parts: list[dict[str, Any]] = field(default_factory=list)
    changes: list[dict[str, Any]] = field(default_factory=list)
    """A segment's ``config`` is 0 for the first configuration, or 1 + the place of its change here."""


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
        made |= {"driven": 2, "driven_to": _at_limits(random, loop), "missed": int(random.random() < 0.5)}
        made |= {"driven_at": loop.velocity * random.uniform(0.02, 0.99), "driven_by": np.full(loop.n, 100.0)}
    if random.random() < 0.4:
        made |= _springs(random, 1, 0.1)
    if random.random() < 0.3:
        made["wrench_command"] = draw_wrench(random)
    if random.random() < 0.2:
        made["torque_offset"] = _offset(random, loop)
    if moving and random.random() < 0.5:
        made["wanted"] = loop.home + random.uniform(-0.8, 0.8, loop.n)
        made["pose"] = int(random.random() < 0.5)
        made["posture"] = loop.home + random.uniform(-0.8, 0.8, loop.n)
        made["wanted_rate"] = random.normal(size=loop.n) * 10 ** random.uniform(-3, 0.5) * (random.random() < 0.4)
        if random.random() < 0.6:
            made |= draw_plan(random, made["wanted_rate"])
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


def draw_plan(random: Random, rate: np.ndarray) -> dict[str, Any]:
    """Return velocity and acceleration of a plan that moves at a rate; half of them lie."""
    velocity = rate if random.random() < 0.5 else random.normal(size=rate.shape) * 10 ** random.uniform(-3, 0.3)
    return {
        "velocity": np.clip(velocity, -1.4, 1.4),
        "acceleration": np.clip(random.normal(size=rate.shape) * 10 ** random.uniform(-2, 1.5), -30, 30)
        * random.integers(0, 2),
    }


def _at_limits(random: Random, loop: Loop) -> np.ndarray:
    """Return a posture with some joints at their limits, up to 0.095 rad beyond them or 0.8 rad inside."""
    limit = np.where(random.random(loop.n) < 0.5, loop.lower, loop.upper)
    limit = np.where(np.isfinite(limit), limit, loop.home + random.uniform(-9, 9, loop.n))  # turns of such joints
    inside = np.sign(limit) * random.uniform(-0.095, 0.8, loop.n)
    return np.where(random.random(loop.n) < 0.6, limit - inside, loop.home)


def schedule(random: Random, loop: Loop, moving: bool = False, sensors: bool = False) -> Schedule:
    """Draw a schedule with a small tank and engagement limit, so that little is hidden below the bound.

    sensors: whether measured positions may be wrong, for which there is no bound.
    """
    delay = int(random.integers(0, 6))
    motor = np.exp(random.uniform(np.log(0.02), np.log(0.3), loop.n))
    energy = {
        "tank_initial": float(10 ** random.uniform(-1, 0.6)),
        "energy_limit": float(10 ** random.uniform(-1, 1)),
        "engagement_limit": float(10 ** random.uniform(-1, 1)),
    }
    made = Schedule(
        {
            **energy,
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
            "communication_reaction": int(random.integers(1, 4)),
            "torque_rate_limit": 10 * loop.effort * 10 ** random.uniform(-1.5, 1.5),
            "limit_zone": float(10 ** random.uniform(-2, -0.1)),
            "limit_stiffness": loop.effort * 10 ** random.uniform(-1.5, 1),
        },
        {
            "delay": delay,
            "motor": motor,
            "differences": int(random.random() < 0.5),
            "q": _first_posture(random, loop),
            "v": np.zeros(loop.n),
        },
        [{"wanted": loop.home} | _springs(random, 1, 0.1) | _command(random, loop)],
    )
    made.episode |= _timing(random)
    if not np.isfinite(loop.upper).all():
        _count_turns(random, loop, made)
    while len(made.parts) < random.integers(3, 12):
        chosen = part(random, loop, moving)
        if sensors or not lies(chosen):
            made.parts.append(chosen)
    if random.random() < 0.3:
        made.config["velocity_filter_time"] = float(10 ** random.uniform(-3.5, -1.5))
    if random.random() < 0.4:
        made.config |= _gains(random)
        made.episode["delay"] = 0
    if random.random() < 0.3:
        change_configuration(random, loop, made)
    return ordered(made)


def _command(random: Random, loop: Loop) -> dict[str, Any]:
    """Return the kind of a constant command: a position, or a pose with a posture that may be far from it."""
    if random.random() < 0.6:
        return {}
    return {"pose": 1, "posture": loop.home + random.uniform(-0.8, 0.8, loop.n) * random.integers(0, 2)}


def _timing(random: Random) -> dict[str, Any]:
    """Return how early calls come, and whether commands have single precision."""
    return {"early": random.random() * (random.random() < 0.2), "single": int(random.random() < 0.2)}


def _count_turns(random: Random, loop: Loop, made: Schedule) -> None:
    """Let encoders of joints without limits wrap or count; gaps may be so long that half a turn passes unseen."""
    if random.random() < 0.7:
        made.episode["wrapped"] = sum(2**i for i in range(loop.n) if not np.isfinite(loop.upper[i]))
    else:
        made.config["continuous_joints"] = int(random.integers(1, 3))
    if random.random() < 0.5:
        made.config |= {"missed_limit": int(10 ** random.uniform(0, 2.7)), "loss_limit": 1000}
    if random.random() < 0.7:
        made.config["velocity_limit"] = loop.velocity * 10 ** random.uniform(0, 1.5)


def change_configuration(random: Random, loop: Loop, made: Schedule) -> None:
    """Let the configuration change to and fro while the controller runs, limits among its fields."""
    base, turning = made.config, np.where(np.isfinite(loop.upper), 1.0, np.inf)
    gains = {"actuation": lambda: int(random.integers(1, 3))} if base["delay_samples"] == 0 else {}
    drawn = gains | {
        "velocity_limit": lambda: (
            loop.velocity * 10 ** random.uniform(-0.7, 1.2, loop.n if random.random() < 0.5 else 1)
        ),
        "call_gap_limit": lambda: int(random.integers(1, 13)),
        "missed_limit": lambda: int(random.integers(1, 30)),
        "effort_limit": lambda: loop.effort * 10 ** random.uniform(-1.5, 0),
        "coriolis": lambda: int(random.integers(1, 3)),
        "communication_reaction": lambda: int(random.integers(1, 4)),
        "lower_limit": lambda: loop.home - 10 ** random.uniform(-1.5, 0.3, loop.n) * turning,
        "upper_limit": lambda: loop.home + 10 ** random.uniform(-1.5, 0.3, loop.n) * turning,
        "position_tolerance": lambda: 10 ** random.uniform(-2, 0),
        "tank_initial": lambda: 10 ** random.uniform(-1, 1),
        "heaviest_wrench": lambda: np.array([100.0, 20.0]) * 10 ** random.uniform(-1, 0.5),
        "loss_limit": lambda: int(random.integers(1, 100)),
        "overspeed_time": lambda: 10 ** random.uniform(-3, 0),
    }
    scaled = [name for name in SCALED if name in base]
    for _ in range(random.integers(1, 4)):
        names = random.choice([*drawn, *drawn, *scaled], random.integers(1, 5))
        made.changes.append({
            name: drawn[name]() if name in drawn else base[name] * 10 ** random.uniform(-1, 0.7) for name in names
        })  # fmt: skip
    for _ in range(random.integers(1, 6)):
        one = made.parts[random.integers(len(made.parts))]
        again = {**one, "start": int(random.integers(1, SAMPLES)), "reset": 0}
        made.parts.append(again | {"config": int(random.integers(0, 1 + len(made.changes)))})


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
        return loop.home.copy()
    return loop.home + random.uniform(-0.6, 0.6, loop.n) if kind < 0.8 else _at_limits(random, loop)


def lies(one: dict[str, Any]) -> bool:
    """Return whether measured positions are wrong; velocities may be."""
    return bool(one.get("q_stuck") or np.any(one.get("q_offset", 0)))


def ordered(made: Schedule) -> Schedule:
    """Segments by their starts."""
    made.parts[1:] = sorted(made.parts[1:], key=lambda p: p["start"])
    return made


def _base(random: Random, loop: Loop) -> Schedule:
    made = schedule(random, loop)
    made.parts = [made.parts[0] | _springs(random, 300, 20)]
    made.episode["q"] = loop.home.copy()
    return made


def _drive(random: Random, loop: Loop, start: float, to: np.ndarray, **others: Any) -> dict[str, Any]:
    rates = {
        "driven_at": loop.velocity * random.uniform(0.3, 0.99),
        "driven_by": np.full(loop.n, 10 ** random.uniform(1, 3)),
    }
    return {"start": round(start), "driven": 2, "driven_to": to, **rates, **others}


def laps(random: Random, loop: Loop) -> Schedule:
    """Return the fault cycle: control lost, the arm moved away, a reset, and on the way back the arm held and freed."""
    made, lap = _base(random, loop), int(random.integers(300, 1000))
    for start in range(5, SAMPLES - lap + 1, lap):
        away = loop.home + random.uniform(-0.6, 0.6, loop.n)
        made.parts += [
            _drive(random, loop, start, away, missed=1, reset=0),
            _drive(random, loop, start + 0.30 * lap, away, missed=0, reset=0),
            _drive(random, loop, start + 0.35 * lap, away, missed=0, reset=1),
            _drive(random, loop, start + 0.75 * lap, loop.home, missed=0, reset=0),
        ]
    return ordered(made)


def pumping(random: Random, loop: Loop) -> Schedule:
    """Away on soft springs, back on stiff ones, in a loop."""
    made, lap = _base(random, loop), int(random.integers(100, 800))
    soft = {"translation": made.parts[0]["translation"] * 0.01, "rotation": made.parts[0]["rotation"] * 0.01}
    stiff = {name: made.parts[0][name] for name in soft}
    away = loop.home + random.uniform(-0.5, 0.5, loop.n)
    for start in range(1, SAMPLES - lap + 1, lap):
        made.parts += [
            _drive(random, loop, start, away, **soft),
            _drive(random, loop, start + 0.35 * lap, away, **stiff),
            _drive(random, loop, start + 0.65 * lap, loop.home, **stiff),
        ]
    return ordered(made)


def shaking(random: Random, loop: Loop) -> Schedule:
    """To and fro at almost the velocity limit, reversed at once, with samples missed in time with it."""
    made, half = _base(random, loop), int(random.integers(1, 8))
    away = loop.home + random.uniform(-0.4, 0.4, loop.n)
    made.parts.append(_drive(random, loop, 1, away))
    start, sign, way = int(random.integers(200, 400)), 1.0, random.choice([-1.0, 0.0, 1.0], loop.n)
    missing, when = int(random.integers(0, 3)), int(random.integers(0, 2))
    while start < SAMPLES - half:
        rates = {"driven": 1, "driven_to": sign * way * loop.velocity * 0.98, "driven_by": np.full(loop.n, 1e6)}
        made.parts.append({"start": start, "missed": 0, **rates})
        if missing:
            made.parts.append({"start": start + when, "missed": 1, **rates})
            made.parts.append({"start": start + when + missing, "missed": 0, **rates})
        start, sign = start + max(half, when + missing + 1), -sign
    return ordered(made)


def zones(random: Random, loop: Loop) -> Schedule:
    """Draw laps: control is lost, the arm is carried into the limit zones, a reset, and the arm is led out slowly."""
    made, lap = _base(random, loop), int(random.integers(500, 1000))
    for start in range(5, SAMPLES - lap + 1, lap):
        inside = _at_limits(random, loop)
        made.parts += [
            _drive(random, loop, start, inside, missed=1, reset=0),
            _drive(random, loop, start + 0.4 * lap, inside, missed=0, reset=0),
            _drive(random, loop, start + 0.45 * lap, inside, missed=0, reset=1),
            _drive(random, loop, start + 0.5 * lap, loop.home, missed=0, reset=0)
            | {"driven_at": loop.velocity * random.uniform(0.02, 0.5)},
        ]
    return ordered(made)


def gaps(random: Random, loop: Loop) -> Schedule:
    """Draw shaking at almost the velocity limit while calls are left out and some calls have no sample."""
    made = shaking(random, loop)
    skip, every = int(random.integers(0, made.config["missed_limit"])), int(random.integers(2, 6))
    made.parts[0]["skip"] = skip
    turns, at, parts = ordered(made).parts, 0, [made.parts[0]]
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
    made.parts[0]["wanted_rate"] = random.normal(size=loop.n) * 10 ** random.uniform(-3, 0.5) * (random.random() < 0.5)
    made.parts[0]["load"] = random.normal(size=6) * [30, 30, 60, 5, 5, 5]
    made.parts += [part(random, loop, True) for _ in range(random.integers(0, 4))]
    made.parts = [one for one in made.parts if not lies(one)]
    return ordered(made)


def presses(random: Random, loop: Loop) -> Schedule:
    """Draw to and fro of the arm while wrenches come and go with it, some samples missing."""
    made, lap = _base(random, loop), int(random.integers(20, 600))
    made.parts[0] |= _springs(random, 1, 0.1)
    away, wrench = loop.home + random.uniform(-0.5, 0.5, loop.n), draw_wrench(random)
    for start in range(1, SAMPLES - lap + 1, lap):
        made.parts += [
            _drive(random, loop, start, away, wrench_command=wrench, missed=0),
            _drive(
                random, loop, start + 0.5 * lap, loop.home, wrench_command=-wrench * random.integers(0, 2), missed=0
            ),
        ]
        if random.random() < 0.2:
            made.parts.append({**made.parts[-1], "start": round(start + 0.9 * lap), "missed": 1})
    return ordered(made)


def plans(random: Random, loop: Loop) -> Schedule:
    """Draw targets that move to and fro with a plan stated at each turn; the arm may be led, also along the plan."""
    made, half = _base(random, loop), int(random.integers(20, 400))
    rate = random.normal(size=loop.n) * 10 ** random.uniform(-4, 0)
    kind, steady = random.integers(0, 3), random.uniform(-1, 1, loop.n) * 0.5 * loop.velocity
    made.parts[0] |= _springs(random, 1, 0.1) if kind == 2 else {}
    for k, start in enumerate(range(1, SAMPLES - half + 1, half)):
        sign = (-1) ** k
        one = {
            "start": start,
            "wanted": loop.home + (0.0 if k % 2 == 0 else 1e-3 * half) * rate,
            "wanted_rate": sign * rate,
        }
        plan, led = draw_plan(random, sign * rate), random.uniform(-0.9, 0.9, loop.n) * loop.velocity
        if kind == 2:  # an acceleration that stays below what is refused, and an arm that goes along
            plan = {"velocity": sign * rate, "acceleration": sign * steady}
            led = 0.4 * sign * np.sign(steady) * loop.velocity
        made.parts.append(one | plan | ({"driven": 1, "driven_by": 1e4, "driven_to": led} if kind else {}))
    return ordered(made)


def limits(random: Random, loop: Loop) -> Schedule:
    """Draw an arm that is led to and fro as fast as the limits in force allow, while they are raised and lowered."""
    made = (pumping, shaking, gaps, presses, zones)[random.integers(5)](random, loop)
    made.episode |= _timing(random)
    turns = list(made.parts)
    made.changes = [_limits(random, loop) for _ in range(random.integers(1, 4))]
    at, period = 0, int(random.integers(30, 500))
    for start in range(int(random.integers(1, 300)), SAMPLES, period):
        while at + 1 < len(turns) and turns[at + 1]["start"] <= start:
            at += 1
        config = int(random.integers(0, 1 + len(made.changes)))
        made.parts.append({**turns[at], "start": start, "reset": 0, "config": config})
    return ordered(made)


def _limits(random: Random, loop: Loop) -> dict[str, Any]:
    """Return limits of velocity, calls and effort, raised or lowered."""
    every = {
        "velocity_limit": loop.velocity * 10 ** random.uniform(-0.5, 1.2, loop.n if random.random() < 0.3 else 1),
        "call_gap_limit": int(random.integers(1, 13)),
        "missed_limit": int(random.integers(1, 30)),
        "effort_limit": loop.effort * 10 ** random.uniform(-1, 0),
    }
    return {name: every[name] for name in random.choice(list(every), random.integers(1, 4))}


def carried(random: Random, loop: Loop) -> Schedule:
    """Draw an arm that is held away from where it is wanted; limits are raised, and it is carried along its torque."""
    made, period = _base(random, loop), int(random.integers(300, 900))
    made.parts[0] |= _springs(random, 30, 3)
    slow = 10 * loop.effort * 10 ** random.uniform(-1.5, 0)
    made.config |= {"tank_initial": float(10 ** random.uniform(-1.5, 0)), "torque_rate_limit": slow}
    made.changes = [_limits(random, loop) for _ in range(random.integers(1, 4))]
    held = loop.home + random.uniform(-0.4, 0.4, loop.n)
    for start in range(1, SAMPLES - period, period):
        raised = start + round(period * random.uniform(0.7, 0.9))
        along = {
            "driven": 3,
            "driven_to": loop.velocity * random.choice([0.5, 0.9999]),
            "driven_by": np.full(loop.n, 1e7),
        }
        along |= {"config": int(random.integers(0, 1 + len(made.changes))), "skip": int(random.choice([0, 11]))}
        made.parts += [
            _drive(random, loop, start, held, missed=0, skip=0, config=0, reset=1),
            {"start": raised, "reset": 0} | along,
            {"start": raised + int(random.integers(1, 4)), "missed": int(random.integers(2))} | along,
            {"start": raised + int(random.integers(5, 40)), "missed": 0} | along,
        ]
    return ordered(made)


def turns(random: Random, loop: Loop) -> Schedule:
    """Draw a joint without limits that is carried by its torque while no sample comes, by more than half a turn.

    Before the next sample the joint stops, so that the shorter way round would be believed.
    """
    made = _base(random, loop)
    joint = int(random.choice(np.flatnonzero(~np.isfinite(loop.upper))))
    speed = loop.velocity * random.uniform(7, 40) / loop.velocity[joint]
    gap = round(1e3 * random.uniform(1.3, 1.97) * np.pi / speed[joint])
    made.config |= {"missed_limit": gap + 10, "loss_limit": 100000, "velocity_limit": speed, "call_gap_limit": 1}
    made.config |= {"tank_initial": float(10 ** random.uniform(-1, 0.6)), "continuous_joints": 1}
    made.episode |= {"wrapped": sum(2**i for i in range(loop.n) if not np.isfinite(loop.upper[i])), "early": 0.0}
    held = loop.home + random.uniform(-0.3, 0.3, loop.n)
    along = loop.velocity * 0.9999 * np.eye(loop.n)[joint]
    lead = int(random.integers(100, 300))
    for start in range(1, SAMPLES - lead - gap, lead + gap + 3):
        carried_along = {"driven": 3, "driven_to": along, "driven_by": np.full(loop.n, 1e7)}
        made.parts += [
            _drive(random, loop, start, held, missed=0, reset=1),
            {"start": start + lead, "reset": 0} | carried_along,
            {"start": start + lead + 1, "missed": 1} | carried_along,
            {"start": start + lead + gap, "driven_to": np.zeros(loop.n)},
            {"start": start + lead + gap + 2, "missed": 0},
        ]
    return ordered(made)


PATTERNS = (laps, pumping, shaking, zones, gaps, streams, presses, plans, limits, carried)
TURNING = (*PATTERNS, turns, turns)
"""Patterns of an arm that has joints without limits."""
