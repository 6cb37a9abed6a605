# SPDX-License-Identifier: MIT
"""Count the controller's faults in harmless episodes: four arms with their makers' sensors, eight seconds each.

    python tests/campaigns/nuisance.py [--episodes 250] [--seed 1] [--arms iiwa14,panda,ur5,j2s6s200]

An episode moves between random postures at 0.3 of the velocity limits and has one of five disturbances: a push of 10
to 40 N, a bump of 80 N for 30 ms, a wall in the way, a payload of up to 2 kg (Kinova 1 kg), or none. All have friction
that sticks and slips, one sample of delay and 0.1 % of the samples lost. ``stiffgen.estimate_sensors`` estimates quanta
and noise at a standstill, and they are declared; all other fields have their defaults. Then each fault of a sensor is
put in while the arm moves, and the time to its detection is printed. The exit code is 1 if more than one episode of
1000 faults, or a sensor's fault is missed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen
from support.arms.arms import (
    BOTH_FROZEN,
    COUNTER_FROZEN,
    DQ_FROZEN,
    DQ_REVERSED,
    DQ_ZERO,
    LOST,
    MAKERS,
    NOT_A_NUMBER,
    Q_FROZEN,
    SKIPPED,
    Arm,
)

SAMPLES = 8000
KINDS = ("push", "bump", "wall", "payload", "none")
FAULTS = {
    "q frozen": Q_FROZEN, "dq frozen": DQ_FROZEN, "dq zero": DQ_ZERO, "dq times -3": DQ_REVERSED, "NaN": NOT_A_NUMBER,
    "counter frozen": COUNTER_FROZEN, "samples lost": LOST, "calls skipped": SKIPPED, "q jumps": 0,
    "state frozen": BOTH_FROZEN,
}  # fmt: skip


def moves(arm: Arm, random: np.random.Generator, start: np.ndarray, share: float = 0.3) -> np.ndarray:
    """Return joint positions (samples, n) that go between random postures with a peak of that share of the limits."""
    path, here, at = np.empty((SAMPLES, arm.n)), start, 0
    while at < SAMPLES:
        there = arm.posture + random.uniform(-0.5, 0.5, arm.n)
        time_needed = np.pi / 2 * np.abs((there - here) / arm.velocity).max() / share
        steps = max(int(time_needed / 1e-3), 1)
        rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, steps + 1) / steps)
        rest = int(random.integers(0, 800))
        part = np.vstack([here + rise[:, None] * (there - here), np.tile(there, (rest, 1))])[: SAMPLES - at]
        path[at : at + len(part)] = part
        at, here = at + len(part), there
    return path


def episode(arm: Arm, random: np.random.Generator, kind: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Draw an episode of samples of 1 ms: fields of the plant, and inputs (goal, load [N, N m], payload [kg],
    springs).
    """
    start = arm.posture + random.uniform(-0.3, 0.3, arm.n)
    goal = moves(arm, random, start)
    load, payload, plant = np.zeros((SAMPLES, 6)), np.zeros(SAMPLES), {}
    direction = random.normal(size=3)
    direction /= np.linalg.norm(direction)
    if kind == "push":
        at = int(random.integers(500, 5000))
        load[at : at + int(random.integers(300, 2500)), :3] = random.uniform(10, 40) * direction
    elif kind == "bump":
        for at in random.integers(500, 7500, 4):  # four bumps of 80 N for 30 ms
            load[at : at + 30, :3] = 80 * direction
    elif kind == "payload":
        payload[int(random.integers(500, 4000)) :] = random.uniform(0.2, 1.0 if arm.name == "j2s6s200" else 2.0)
    elif kind == "wall":
        tips = arm.module.forward_kinematics(goal)[:, :3, 3]
        away = tips - tips[0]
        far = int(np.argmax(np.linalg.norm(away, axis=1)))
        plant = {"wall_point": tips[0] + 0.6 * away[far], "wall_normal": -away[far] / np.linalg.norm(away[far]),
                 "wall_stiffness": 10 ** random.uniform(4, 5.5)}  # [N/m]  # fmt: skip
    lost = np.where(random.random(SAMPLES) < 1e-3, LOST, 0)
    inputs = {"goal": goal, "load": load, "payload": payload, "sensor": lost, "start": start,
              "translation": random.uniform(200, 1500), "rotation": random.uniform(10, 60)}  # fmt: skip
    return plant, inputs


def declared(arm: Arm, seed: int = 99) -> dict[str, float]:
    """Return the configuration that two seconds at a standstill give."""
    sensors, random = arm.maker.sensors, np.random.default_rng(seed)
    swing = 2e-5 * np.sin(np.linspace(0, 20, 2000))[:, None] + 2e-6 * random.normal(size=(2000, arm.n))
    q = arm.posture + swing + 2.0 * sensors.position_quantum * random.random((2000, arm.n))
    q = sensors.position_quantum * np.round(q / sensors.position_quantum)
    noise = sensors.velocity_noise * random.normal(size=q.shape)
    if sensors.velocity_quantum > 0.0:
        noise = sensors.velocity_quantum * np.round(noise / sensors.velocity_quantum)
    dq = np.gradient(q, 1e-3, axis=0) if sensors.differences else noise
    return stiffgen.estimate_sensors(q, dq).fields


def nuisances(arm: Arm, episodes: int, seed: int) -> list[str]:
    """Run the episodes; return the fault of each that has one."""
    found, config = [], arm.config(**declared(arm))
    for k in range(episodes):
        random, kind = np.random.default_rng([seed, k]), KINDS[k % len(KINDS)]
        plant, inputs = episode(arm, random, kind)
        rows = arm.run(arm.plant(**plant), SAMPLES, config, seed=seed * 100003 + k, **inputs)
        if rows["faulted"].any():
            at = int(np.argmax(rows["faulted"]))
            reason = arm.module.Reason(int(rows["reason"][at])).name
            found.append(f"{reason} in {kind}, episode {k} at {at} ms")
    return found


def detections(arm: Arm) -> list[str]:
    """Put each fault of a sensor in while the arm moves at 0.2 of its limits; return reasons and times to detection."""
    lines, at = [], 3000
    for title, fault in FAULTS.items():
        config = arm.config(**declared(arm))
        times = 1e-3 * np.arange(SAMPLES)[:, None]
        goal = arm.posture + 0.15 * np.sin(0.2 * arm.velocity / 0.15 * times)
        sensor, offset = np.zeros(SAMPLES), np.zeros((SAMPLES, arm.n))
        sensor[at : at + 9 if fault == SKIPPED else SAMPLES] = (
            fault  # 9: more than call_gap_limit and missed_limit allow
        )
        offset[at:, 1] = 0.5 * (fault == 0)
        rows = arm.run(arm.plant(), SAMPLES, config, goal=goal, sensor=sensor, offset=offset)
        found = int(np.argmax(rows["faulted"])) if rows["faulted"].any() else SAMPLES
        reason = arm.module.Reason(int(rows["reason"][min(found, SAMPLES - 1)])).name
        lines.append(f"{title:16} {reason:14} {f'{found - at} ms' if at <= found < SAMPLES else 'MISSED'}")
    return lines


def main() -> int:
    """Run ordinary episodes, of which at most one in a thousand may raise a fault, and the faults to be detected."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=250, help="episodes per arm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arms", default=",".join(MAKERS))
    parser.add_argument("--folder", type=Path, help="where robots are generated and compiled")
    options = parser.parse_args()
    total = count = missed = 0
    with tempfile.TemporaryDirectory() as made:
        for name in options.arms.split(","):
            arm, start = Arm(name, options.folder or Path(made)), time.monotonic()
            found = nuisances(arm, options.episodes, options.seed)
            print(
                f"{name}: {len(found)} faults in {options.episodes} episodes, {time.monotonic() - start:.0f} s",
                flush=True,
            )
            for line in found[:10]:
                print(f"    {line}")
            said = detections(arm)
            missed += sum("MISSED  " not in line and line.endswith("MISSED") for line in said)
            for line in said:
                print(f"    {line}", flush=True)
            total, count = total + len(found), count + options.episodes
    return 1 if total > count / 1000 or missed else 0


if __name__ == "__main__":
    sys.exit(main())
