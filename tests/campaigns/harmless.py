# SPDX-License-Identifier: MIT
"""Count alarms in harmless sessions, and measure what wrong wiring does to an arm.

    python tests/campaigns/harmless.py [--sessions 1000] [--seed 1] [--arms iiwa14,panda,ur5] [--no-wirings]

A session lasts two seconds: a step or a slow move of q0, with a push or a payload or without. Friction is up to 3 % of
the effort limits, noise of dq up to 0.02 rad/s and not declared, the delay 0 to 2 samples and declared; the resolution
of the positions is declared. Joints are stiff, or elastic at 400 N/m and 20 N m/rad with a delay of at most 1: beyond
it elastic joints do shake. A fault is an alarm.

Wrong wiring: the sign of one joint, or two neighbours in each other's place, in q, dq and q0, under a load of 3 kg. The
work of the torque and the fastest joint in the first 0.3 s are measured. The exit code is 1 for an alarm, and for more
than 40 J (UR5: 37.8 J, joint 1 flipped) or 4 velocity limits.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from support.arms.arms import MAKERS, Arm
from support.controller_inputs import Arm as SimpleArm

SAMPLES = 2000
LOAD = np.array([0.0, 0, -3 * 9.81, 0, 0, 0])
WORK, SPEED = 40.0, 4.0
"""[J] and [velocity limits] that wrong wiring may reach."""
Wiring = Callable[[np.ndarray], np.ndarray]


def session(arm: Arm, random: np.random.Generator) -> np.ndarray:
    """Run a harmless session: a motion within 0.25 rad, at times a push of up to 25 N or a payload; return its rows."""
    flexible = random.random() < 0.3
    delay = int(random.integers(0, 2 if flexible else 3))
    way = random.uniform(-0.25, 0.25, arm.n)
    rise = 1.0 if random.random() < 0.5 else np.clip((np.arange(SAMPLES)[:, None] - 200) / 1200, 0, 1)
    # 0.2 s of rest, then a jump or a ramp of 1.2 s
    goal = arm.posture + np.where(np.arange(SAMPLES)[:, None] >= 200, rise * way, 0.0)
    load, payload = np.zeros((SAMPLES, 6)), np.zeros(SAMPLES)
    if random.random() < 0.4:
        load[800 : 800 + int(random.integers(50, 800)), :3] = random.uniform(-25, 25, 3)
    if random.random() < 0.2:
        payload[:] = random.uniform(0, 1.5)
    stiffness = 400.0 if flexible else random.uniform(200, 800)
    plant = arm.plant(flexible, delay=delay, coulomb=random.uniform(0, 0.03) * arm.effort)
    config = arm.config(delay_samples=delay, position_quantum=arm.maker.sensors.position_quantum)
    noise = random.uniform(0, 0.02) * random.normal(size=(SAMPLES, arm.n))
    springs = {"translation": stiffness, "rotation": stiffness / 20}
    return arm.run(plant, SAMPLES, config, goal=goal, load=load, payload=payload, noise=noise, **springs)


def alarms(arm: Arm, sessions: int, seed: int) -> Iterator[str]:
    """Yield a line for each harmless session with a fault."""
    for k in range(sessions):
        rows = session(arm, np.random.default_rng([seed, k]))
        if rows["faulted"].any():
            at = int(np.argmax(rows["faulted"]))
            yield f"{arm.name}: {arm.module.Reason(int(rows['reason'][at])).name} in session {k} at {at} ms"


def wirings(n: int) -> dict[str, Wiring]:
    """Return flips of one joint and swaps of two neighbours."""
    flips = {f"flip {k}": np.diag(np.where(np.arange(n) == k, -1.0, 1.0)) for k in range(n)}
    swaps = {f"swap {k}": np.eye(n)[[*range(k), k + 1, k, *range(k + 2, n)]] for k in range(n - 1)}
    return {name: lambda x, P=P: P @ x for name, P in (flips | swaps).items()}


def measure_wiring(arm: Arm, wiring: Wiring) -> tuple[float, float, str]:
    """Return work [J] and fastest joint [velocity limits] in the first 0.3 s of the load, and the reason at the end."""
    robot, home = arm.module, arm.posture
    stated = {
        "sample_time": 1e-3,
        "delay_samples": 0,
        "motor_inertia": arm.maker.motor,
        "heaviest_wrench": (100.0, 20.0),
    }
    controller = robot.Impedance(**stated, lower_limit=-1e3, upper_limit=1e3, errors="ignore")
    springs = {"translation_stiffness": 700.0 * np.eye(3), "rotation_stiffness": 30.0 * np.eye(3)}
    plant, work, most, fastest = SimpleArm(robot, home, arm.maker.motor), 0.0, 0.0, 0.0
    for k in range(350):
        sample = {"q": wiring(plant.q), "dq": wiring(plant.dq), "q0": wiring(home)}
        out = controller.step(**sample, **springs, counter=k)
        before = plant.q
        plant.step(out.torque, LOAD if k > 50 else None)
        work += float(out.torque @ (plant.q - before))
        most, fastest = max(most, work), max(fastest, float((np.abs(plant.dq) / robot.VELOCITY).max()))
    return most, fastest, out.reason.name


def main() -> int:
    """Run harmless sessions, which must raise no alarm, and wrong wirings, which must stay within work and speed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=1000, help="harmless sessions of all arms together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arms", default="iiwa14,panda,ur5")
    parser.add_argument("--no-wirings", action="store_true", help="leave out wrong wiring")
    parser.add_argument("--folder", type=Path, help="where robots are generated and compiled")
    options = parser.parse_args()
    names, wrong = options.arms.split(","), 0
    with tempfile.TemporaryDirectory() as made:
        for name in names:
            assert name in MAKERS
            arm, count = Arm(name, options.folder or Path(made)), -(-options.sessions // len(names))
            found = list(alarms(arm, count, options.seed))
            print(f"{name}: {len(found)} alarms in {count} harmless sessions", *found[:10], sep="\n    ", flush=True)
            wrong += len(found)
            kinds: dict[str, Wiring] = {} if options.no_wirings or name == "panda" else wirings(arm.n)
            for kind, wiring in kinds.items():
                work, speed, reason = measure_wiring(arm, wiring)
                wrong += work > WORK or speed > SPEED
                print(f"    {kind}: {work:5.1f} J, {speed:.1f} velocity limits, {reason}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
