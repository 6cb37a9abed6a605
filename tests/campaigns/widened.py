# SPDX-License-Identifier: MIT
"""Draws that any schedule of energy.py takes in addition.

Measured positions have single precision. Calls are late by whole sample times, see the sample of the call before them,
or number samples so that the counter wraps. The controller is restarted while the arm moves, with another delay and
another configuration. Arms that take tools are given others at restarts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from campaigns.schedules import SAMPLES, Random, Schedule, ordered
from support.plant.loop import Loop

_LAST_COUNT = 2**32


def widen(random: Random, loop: Loop, made: Schedule) -> Schedule:
    """Add each of the draws to a schedule, or leave it out."""
    if random.random() < 0.25:
        made.episode["single_positions"] = 1
    if random.random() < 0.3:
        made.episode |= _late(random)
    if random.random() < 0.15:
        made.episode["stale"] = float(10 ** random.uniform(-2.5, -0.3))
    if random.random() < 0.3:
        made.parts += [_restart(random, made) for _ in range(random.integers(1, 4))]
    if loop.tools:
        first = made.parts[0]["tool"] = _tool(random, loop)
        for _ in range(random.integers(0, 6)):
            one = made.parts[random.integers(len(made.parts))]
            one["tool"] = _tool(random, loop) if random.random() < 0.6 else first
    return ordered(made)


def vary(random: Random, loop: Loop, made: Schedule) -> None:
    """Add one of the draws, change it or take it away."""
    kind = random.integers(0, 4 + loop.tools)
    if kind == 0:
        made.episode["single_positions"] = 1 - made.episode.get("single_positions", 0)
    elif kind == 1:
        made.episode |= _late(random) if random.random() < 0.8 else {"late": 0.0, "first_counter": 0}
    elif kind == 2:
        made.episode["stale"] = float(10 ** random.uniform(-2.5, -0.3)) * (random.random() < 0.8)
    elif kind == 3:
        made.parts.append(_restart(random, made))
    else:
        made.parts[random.integers(len(made.parts))]["tool"] = _tool(random, loop)


def _late(random: Random) -> dict[str, Any]:
    """Return how often calls are late, and where the counter begins: it may wrap within the schedule."""
    first = _LAST_COUNT - int(random.integers(1, SAMPLES)) if random.random() < 0.5 else 0
    return {"late": float(10 ** random.uniform(-2, 0)), "first_counter": first}


def _restart(random: Random, made: Schedule) -> dict[str, Any]:
    """Return a segment at whose start the controller begins anew, with any of the configurations and a delay."""
    one = made.parts[random.integers(len(made.parts))]
    again = {**one, "start": int(random.integers(1, SAMPLES)), "reset": 0, "restart": int(random.integers(1, 3))}
    return again | {"config": int(random.integers(0, 1 + len(made.changes))), "delay": int(random.integers(0, 6))}


def _tool(random: Random, loop: Loop) -> np.ndarray:
    """Return positions [m] of tools in the tips, and turns [rad] about their x axes; now and then none."""
    tools = random.normal(size=(loop.tips, 4)) * [0.1, 0.1, 0.1, 1.0] * 10 ** random.uniform(-2, 0.3)
    return np.asarray(np.ravel(tools) * (random.random() < 0.8))


def settings(chosen: Schedule) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return segments and configurations: one configuration for every pair of a change and a delay.

    The delay changes at restarts that happen.
    """
    base = int(chosen.config.get("delay_samples", 0))
    every = [chosen.config, *(chosen.config | change for change in chosen.changes)]
    places: dict[tuple[int, int], int] = {}
    parts, config, delay = [], 0, base
    starts = [one.get("start", 0) for one in chosen.parts]
    for one, following in zip(chosen.parts, [*starts[1:], SAMPLES], strict=True):
        config = one.get("config", config)
        begins = following > one.get("start", 0)  # of segments with the same start, only the last one is run
        if one.get("restart") and begins:
            delay = one.get("delay", delay)
        place = places.setdefault((config, delay), len(places))
        fields = {name: value for name, value in one.items() if name != "delay"}
        parts.append(fields | {"config": place, "late_torque": delay - base})
    return parts, [every[k] | {"delay_samples": delay} for k, delay in places]
