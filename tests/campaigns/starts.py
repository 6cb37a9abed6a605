# SPDX-License-Identifier: MIT
"""Start four arms with first samples that are wrong, and with memory that holds anything.

    python tests/campaigns/starts.py [--episodes 1000] [--trials 100000] [--seed 1] [--arms iiwa14,panda,ur5,j2s6s200]

The first part starts a simulated arm at rest. Its encoders are wrong from the first sample on: off by turns, half turns
or anything, in degrees, or standing still; or an encoder jumps later. Faults are reset twice a second, with friction or
without. No joint may become faster than its velocity limit, no torque may pass its effort limit. A wrong position that
lies inside all limits cannot be told: its speed is printed, and bounded by nothing. The second part is memory.c: memory
of patterns, random numbers and parts of a good state. The exit code is 1 if a bound is broken.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from support.arms.arms import MAKERS, Q_FROZEN, Arm
from support.arms.memory import MemoryProgram

SAMPLES = 2000
TOLERANCE = 0.1  # [rad] beyond a limit that is no fault (docs/controller.md)
TURN, DEGREES = 2.0 * np.pi, 180.0 / np.pi
KINDS = ("turn", "turns", "degrees", "one in degrees", "half turn", "anything", "still", "later turn", "later")


def wrong_sensors(
    arm: Arm, kind: str, start: np.ndarray, random: np.random.Generator
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw wrong encoders of an arm at `start`: fields of the plant, and inputs."""
    n, joint = arm.n, int(random.integers(arm.n))
    unit, offset, sensor = np.ones(n), np.zeros((SAMPLES, n)), np.zeros(SAMPLES)
    first = int(random.integers(300, 1000)) if kind.startswith("later") else 0
    if kind in ("turn", "later turn"):
        offset[first:, joint] = random.choice([-TURN, TURN])
    elif kind == "turns":
        offset[:] = TURN * random.integers(-3, 4, n)
    elif kind == "degrees":
        unit[:] = DEGREES
    elif kind == "one in degrees":
        farthest = int(np.argmax(np.abs(start)))  # beyond its limits: inside them, no one can tell
        unit[farthest] = DEGREES
    elif kind == "half turn":
        offset[:, joint] = random.choice([-0.5, 0.5]) * TURN
    elif kind in ("anything", "later"):
        offset[first:] = random.normal(size=n) * 10.0 ** random.uniform(-1, 3) * (random.random(n) < 0.5)
    else:
        sensor[:] = Q_FROZEN
    return {"unit": unit}, {"offset": offset, "sensor": sensor}


def episode(arm: Arm, kind: str, random: np.random.Generator) -> tuple[np.ndarray, bool]:
    """Run an episode; return its rows, and whether the fault can be told: a wrong position inside all limits cannot."""
    start = arm.posture + random.uniform(-0.3, 0.3, arm.n)
    plant, inputs = wrong_sensors(arm, kind, start, random)
    if random.random() < 0.5:
        plant |= {"coulomb": 0.0, "viscous": 0.0}
    stiffness: dict[str, Any] = {"translation": random.uniform(200, 1500), "rotation": random.uniform(10, 60)}
    # a limp arm that moves may speed up one of its joints without any torque: arms rest before a later jump
    away = 0.0 if kind.startswith("later") else random.choice([0.0, 0.3])
    goal = start + away * random.normal(size=arm.n)
    rows = arm.run(arm.plant(reset_after=500, **plant), SAMPLES, start=start, goal=goal, **inputs, **stiffness)
    first = plant["unit"] * start + inputs["offset"][0]
    beyond = np.maximum(first - arm.module.UPPER, arm.module.LOWER - first).max() > TOLERANCE
    return rows, bool(beyond or kind in ("still", "later", "later turn"))


def broken(arm: Arm, rows: np.ndarray, told: bool) -> str:
    """Return which bound an episode breaks; empty for none."""
    speed, effort = np.abs(rows["v"]) / arm.velocity, np.abs(rows["torque"]) / arm.effort
    if not np.isfinite(rows["torque"]).all() or effort.max() > 1.0:
        return f"torque {effort.max():.2f} of its limit"
    return f"speed {speed.max():.2f} of its limit" if told and speed.max() > 1.0 else ""


def starts(arm: Arm, episodes: int, seed: int) -> list[str]:
    """Run the episodes; print the largest speed of each kind and return the bounds that break."""
    found, most = [], {f"{kind}{inside}": 0.0 for kind in KINDS for inside in ("", ", inside")}
    for k in range(episodes):
        kind = KINDS[k % len(KINDS)]
        rows, told = episode(arm, kind, np.random.default_rng([seed, k]))
        title = kind if told else f"{kind}, inside"
        most[title] = max(most[title], float((np.abs(rows["v"]) / arm.velocity).max()))
        said = broken(arm, rows, told)
        found += [f"{said}: {kind}, episode {k}"] if said else []
    print("    speed over its limit: " + "; ".join(f"{kind} {value:.2f}" for kind, value in most.items()), flush=True)
    return found


def main() -> int:
    """Start the controller in random ways, and with damaged memory; return 1 if a start breaks a bound."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=1000, help="episodes per arm")
    parser.add_argument("--trials", type=int, default=100_000, help="trials of memory per arm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arms", default=",".join(MAKERS))
    parser.add_argument("--folder", type=Path, help="where robots are generated and compiled")
    options = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as made:
        folder = options.folder or Path(made)
        for name in options.arms.split(","):
            arm, start = Arm(name, folder), time.monotonic()
            found = starts(arm, options.episodes, options.seed)
            done = MemoryProgram(name, folder, folder / name).run(options.trials, options.seed)
            print(f"{name}: {len(found)} of {options.episodes} starts break a bound; {time.monotonic() - start:.0f} s")
            print("".join(f"    {line}\n" for line in [*found[:10], (done.stdout + done.stderr).strip()]), flush=True)
            failed |= bool(found) or done.returncode != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
