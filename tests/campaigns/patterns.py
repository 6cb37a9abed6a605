# SPDX-License-Identifier: MIT
"""Patterns of schedules.py: fault cycles, pumping, shaking, carrying and others, each with random numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from campaigns.schedules import (
    SAMPLES,
    Random,
    Schedule,
    at_limits,
    draw_plan,
    draw_wrench,
    lies,
    ordered,
    part,
    schedule,
    springs,
    timing,
)
from support.plant.loop import Loop


def _base(random: Random, loop: Loop) -> Schedule:
    made = schedule(random, loop)
    made.parts = [made.parts[0] | springs(random, loop, 300, 20)]
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
        inside = at_limits(random, loop)
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
    made.parts[0]["jitter"] = 10 ** random.uniform(-13, -0.5)  # [rad] from rounding to a third of a radian
    made.parts[0]["wanted_rate"] = random.normal(size=loop.n) * 10 ** random.uniform(-3, 0.5) * (random.random() < 0.5)
    made.parts[0]["load"] = random.normal(size=6) * [30, 30, 60, 5, 5, 5]  # [N], [N m]
    made.parts += [part(random, loop, True) for _ in range(random.integers(0, 4))]
    made.parts = [one for one in made.parts if not lies(one)]
    return ordered(made)


def presses(random: Random, loop: Loop) -> Schedule:
    """Draw to and fro of the arm while wrenches come and go with it, some samples missing."""
    made, lap = _base(random, loop), int(random.integers(20, 600))
    made.parts[0] |= springs(random, loop, 1, 0.1)
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
    made.parts[0] |= springs(random, loop, 1, 0.1) if kind == 2 else {}
    for k, start in enumerate(range(1, SAMPLES - half + 1, half)):
        sign = (-1) ** k
        one = {
            "start": start,
            "wanted": loop.home + (0.0 if k % 2 == 0 else 1e-3 * half) * rate,
            "wanted_rate": sign * rate,
        }
        plan, led = draw_plan(random, loop.n), random.uniform(-0.9, 0.9, loop.n) * loop.velocity
        if kind == 2:  # an acceleration that stays below what is refused, and an arm that goes along
            plan = {"shaped": 1, "acceleration": sign * steady}
            led = 0.4 * sign * np.sign(steady) * loop.velocity
        made.parts.append(one | plan | ({"driven": 1, "driven_by": 1e4, "driven_to": led} if kind else {}))
    return ordered(made)


def limits(random: Random, loop: Loop) -> Schedule:
    """Draw an arm that is led to and fro as fast as the limits allow, which change as the controller begins anew."""
    made = (pumping, shaking, gaps, presses, zones)[random.integers(5)](random, loop)
    made.episode |= timing(random)
    turns = list(made.parts)
    made.changes = [_limits(random, loop) for _ in range(random.integers(1, 4))]
    at, period = 0, int(random.integers(30, 500))
    for start in range(int(random.integers(1, 300)), SAMPLES, period):
        while at + 1 < len(turns) and turns[at + 1]["start"] <= start:
            at += 1
        config = int(random.integers(0, 1 + len(made.changes)))
        made.parts.append({**turns[at], "start": start, "reset": 0, "restart": 2, "config": config})
    return ordered(made)


def _limits(random: Random, loop: Loop) -> dict[str, Any]:
    """Return limits of velocity and calls, raised or lowered."""
    every = {
        "velocity_limit": loop.velocity * 10 ** random.uniform(-0.5, 1.2, loop.n if random.random() < 0.3 else 1),
        "call_gap_limit": int(random.integers(1, 13)),
        "missed_limit": int(random.integers(1, 30)),
    }
    return {name: every[name] for name in random.choice(list(every), random.integers(1, 4))}


def carried(random: Random, loop: Loop) -> Schedule:
    """Draw an arm that is held away from where it is wanted; after a start anew it is carried along its torque."""
    made, period = _base(random, loop), int(random.integers(300, 900))
    made.parts[0] |= springs(random, loop, 30, 3)
    slow = 10 * loop.effort * 10 ** random.uniform(-1.5, 0)  # [N m/s]
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
            {"start": raised, "reset": 0, "restart": 2} | along,
            {"start": raised + int(random.integers(1, 4)), "missed": int(random.integers(2))} | along,
            {"start": raised + int(random.integers(5, 40)), "missed": 0} | along,
        ]
    return ordered(made)


def drained(random: Random, loop: Loop) -> Schedule:
    """Draw laps: the arm is led away against its springs, and then carried along its torque until nothing is left."""
    made, lap = _base(random, loop), int(random.integers(100, 700))
    made.parts[0] |= springs(random, loop, 30, 3)
    fast = loop.velocity * random.choice([0.1, 0.5, 0.9999])
    along = {"driven": 3, "driven_to": fast, "driven_by": np.full(loop.n, 10 ** random.uniform(2, 7))}
    away = loop.home + random.uniform(-0.5, 0.5, loop.n)
    loses = {"missed": int(random.integers(0, 2)), "skip": int(random.integers(0, 6))}  # samples; calls
    for start in range(int(random.integers(1, 200)), SAMPLES - lap + 1, lap):
        freed = start + round(lap * random.uniform(0.3, 0.8))
        made.parts += [
            _drive(random, loop, start, away, missed=0, skip=0, reset=1),
            {"start": freed, "reset": 0} | along,
            {"start": freed + int(random.integers(1, 40))} | along | (loses if random.random() < 0.4 else {}),
            {"start": freed + int(random.integers(40, 60)), "missed": 0, "skip": 0} | along,
        ]
    return ordered(made)


def turns(random: Random, loop: Loop) -> Schedule:
    """Draw a joint without limits that is carried by its torque while no sample comes, by more than half a turn.

    Before the next sample the joint stops, so that the shorter way round would be believed.
    """
    made = _base(random, loop)
    joint = int(random.choice(np.flatnonzero(~np.isfinite(loop.upper))))
    speed = loop.velocity * random.uniform(7, 40) / loop.velocity[joint]
    gap = round(1e3 * random.uniform(1.3, 1.97) * np.pi / speed[joint])  # [ms] for more than half a turn
    made.config |= {"missed_limit": 100, "velocity_limit": speed, "call_gap_limit": 1}
    made.config |= {"tank_initial": float(10 ** random.uniform(-1, 0.6))}
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


PATTERNS = (laps, pumping, shaking, zones, gaps, streams, presses, plans, limits, carried, drained)
TURNING = (*PATTERNS, turns, turns)
"""Patterns of an arm that has joints without limits."""
