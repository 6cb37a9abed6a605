# SPDX-License-Identifier: MIT
"""Freeze measured positions under the FRI client, and count what it takes for frozen in harmless sessions.

    python tests/campaigns/frozen_fri.py [FOLDER] [--faulty 1000] [--harmless 1000] [--seed 1] [--version 2.7]

The bowl is wiped in one process, with a virtual clock, network and arm (fri/support/native/attack.cpp) and without a
robot stiffness. In a faulty session the positions of one, several or all joints stand still from some moment on, or
stand still but for one bit that toggles, or are those of long ago. In a harmless session the arm rests, is pushed,
blocked or held. Dry friction (up to 10 % of the effort limits, in harmless sessions 2 %), motor inertia, the positions'
resolution, noise and offset of the external torque are drawn for both. A resolution above 1e-6 rad is declared to the
client (--position-quantum).

Exit code 1 if a harmless session ends with a fault of a sensor, or a faulty one does harm:

- positions that stand still, resolution up to 1e-6 rad: a joint exceeds 0.8 of a velocity limit or a position limit, or
  the arm's kinetic energy 0.5 J (the wiping itself comes to 0.73 and 0.44 J)
- late copies, and a coarser resolution: printed, and no reason for exit code 1
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from campaigns.attack_fri import PERIODS, Attack, Event, Schedule
from fri.robot.messages import VERSIONS
from fri.support.session import TRAJECTORY, build

SECONDS = 14.0
"""[s] of a session; the bowl is wiped after 12 s."""
FASTEST, MOST_ENERGY = 0.8, 0.5
"""Most of a velocity limit, and of kinetic energy [J], in a session whose positions stand still."""
FINE = 1e-6
"""[rad] Coarsest resolution whose last bit shows that a joint gives way."""
FRICTION, HARMLESS_FRICTION = 0.1, 0.02
"""Most dry friction as a share of the effort limits."""
MOTORS = (0.07, 0.2)
"""[kg m^2] inertia of the motors, of which the client has been told 0.1."""
EVER = 99.0
FAULTS = ("one", "several", "all", "toggling", "late", "misled")
HARMLESS = ("none", "rest", "push", "blocked", "held", "silent")
WORDS = ("are not believed", "repeat those of")
"""Words of a last line about positions."""


def draw_faulty(rng: np.random.Generator, kind: str) -> Schedule:
    """Draw a session in which positions stand still, or are old, from a moment of the motion on."""
    start, joint = round(float(rng.uniform(1.0, 11.0)), 6), int(rng.integers(7))
    joints = 1 << joint
    if kind == "several":
        joints = int(sum(1 << int(i) for i in rng.choice(7, int(rng.integers(2, 7)), replace=False)))
    joints = 127 if kind == "all" else joints  # bits of the seven joints
    word, value = "still", float(joints)
    if kind == "toggling":
        word, value = "toggling", float(100 * joints + rng.integers(0, 52))
    elif kind == "late":
        word, value = "late", float(10000 * joints + rng.integers(5, 60))
    events = [Event(word, start, EVER, value)]
    events += [Event("misled", start, EVER, float(rng.integers(1, 3)))] if kind == "misled" else []
    events += draw_sensors(rng, FRICTION)
    return Schedule(int(rng.choice(PERIODS)), int(rng.integers(1 << 31)), tuple(events))


def draw_sensors(rng: np.random.Generator, friction: float) -> list[Event]:
    """Draw dry friction and offset of torques (shares of the effort limits), motor inertia, resolution and noise."""
    friction, quantum = float(rng.choice([0.0, rng.uniform(0.0, friction)])), float(rng.choice([0.0, 1e-6, 1e-5]))
    hum = float(rng.choice([0.0, rng.uniform(0.0, 0.3)]))
    bias, motor = float(rng.choice([0.0, rng.uniform(0.0, 0.01)])), float(rng.uniform(*MOTORS))
    given = {"sticky": friction, "quantum": quantum, "hum": hum, "bias": bias, "motor": motor}
    return [Event(word, 0.0, EVER, value) for word, value in given.items() if value > 0.0]


def draw_harmless(rng: np.random.Generator, kind: str) -> Schedule:
    """Draw a session without a fault: rests, pushes, and joints or an arm that somebody holds."""
    events = draw_sensors(rng, HARMLESS_FRICTION)
    for _ in range(int(rng.integers(1, 4))):
        start, length = round(float(rng.uniform(1.0, 11.0)), 6), float(rng.uniform(0.05, 3.0))
        if kind == "rest":
            events.append(Event("button", start, length, 0.0))
        elif kind in ("push", "silent"):
            events.append(Event("push", start, length, float(rng.uniform(-10.0, 10.0))))
        elif kind == "blocked":
            events.append(Event("blocked", start, length, float(rng.integers(7))))
        elif kind == "held":
            events.append(Event("held", start, min(length, 1.0), 0.0))
    events += [Event("gain", 0.0, EVER, 0.0)] if kind == "silent" else []
    return Schedule(int(rng.choice(PERIODS)), int(rng.integers(1 << 31)), tuple(events))


@dataclass(frozen=True)
class Verdict:
    """Result of a faulty session: share of a velocity limit, kinetic energy [J], and distances.

    ``late`` is the time [s] from a joint's 0.02 rad beside its measured position to letting go (None: no joint parted),
    ``beyond`` and ``apart`` [rad] lie beyond a limit and, at that time, from the measured position. ``held`` is a share
    of the effort limit: friction that holds as much would make the measured position true.
    """

    fast: float
    kinetic: float
    late: float | None
    beyond: float
    apart: float
    held: float

    @property
    def harmless(self) -> bool:
        """Whether no joint was too fast or beyond a limit, and the arm had little energy."""
        return self.fast <= FASTEST and self.kinetic <= MOST_ENERGY and self.beyond <= 0.0


def judge(told: Mapping[str, Any]) -> Verdict:
    """Judge a faulty session."""
    gone = told["let_go_time"] if told["let_go_time"] >= 0.0 else np.inf
    late = gone - told["parted"] if told["parted"] >= 0.0 else None
    return Verdict(told["fast"], told["kinetic"], late, told["beyond"], told["apart"], told["held"])


def blames_position(told: Mapping[str, Any]) -> bool:
    """Return whether a session ended because of a measured position."""
    return any(word in told["sentence"] for word in WORDS)


def is_fine(schedule: Schedule) -> bool:
    """Return whether the last bit of the positions shows that a joint gives way."""
    return all(event.value <= FINE for event in schedule.events if event.kind == "quantum")


def faulty(attack: Attack, rng: np.random.Generator, count: int, kinds: list[str]) -> list[str]:
    """Play faulty sessions, and print the worst of each kind and resolution; return those beyond the bar."""
    found: list[str] = []
    verdicts: dict[str, list[Verdict]] = {}
    for k in range(count):
        kind = kinds[k % len(kinds)]
        schedule = draw_faulty(rng, kind)
        told = attack.play(schedule)
        verdict, fine = judge(told), is_fine(schedule)
        verdicts.setdefault(f"{kind}, {'fine' if fine else 'coarse'}", []).append(verdict)
        if fine and kind != "late" and not verdict.harmless:
            found.append(f"{kind} {schedule.period}: {schedule}\n    {verdict} {told['sentence'][:90]}")
    for name in sorted(verdicts):
        print_worst(name, verdicts[name])
    return found


def print_worst(name: str, verdicts: list[Verdict]) -> None:
    """Print the largest of each number of some sessions, and how many did harm."""
    late = [v.late for v in verdicts if v.late is not None]
    print(f"{name:16} {len(verdicts)} sessions, {sum(not v.harmless for v in verdicts)} did harm; at most "
          f"{max(v.fast for v in verdicts):.2f} of a velocity limit, {max(v.kinetic for v in verdicts):.2f} J, "
          f"{max(v.beyond for v in verdicts):.3f} rad beyond a limit, {max(late, default=0.0):.2f} s after 0.02 rad, "
          f"{max(v.apart for v in verdicts):.3f} rad apart", flush=True)  # fmt: skip


def harmless(attack: Attack, rng: np.random.Generator, count: int) -> list[str]:
    """Play harmless sessions; return those that ended with a fault of a sensor."""
    found, kinds = [], Counter[str]()
    for k in range(count):
        kind = HARMLESS[k % len(HARMLESS)]
        schedule = draw_harmless(rng, kind)
        told = attack.play(schedule)
        if blames_position(told):
            kinds[kind] += 1
            found.append(f"{kind} {schedule.period}: {schedule}\n    {told['time']:.3f} s {told['sentence'][:90]}")
    print(f"harmless: {len(found)} faults of a sensor in {count} sessions {dict(kinds) or ''}", flush=True)
    return found


def main(given: Iterable[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/fri-attack"))
    parser.add_argument("--faulty", type=int, default=1000, help="sessions with frozen positions (%(default)s)")
    parser.add_argument("--harmless", type=int, default=1000, help="sessions without a fault (%(default)s)")
    parser.add_argument("--kinds", default=",".join(FAULTS), help="of faulty sessions (%(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--version", choices=VERSIONS, default=VERSIONS[-1])
    options = parser.parse_args(None if given is None else list(given))
    folder = options.folder.resolve() / options.version
    build(folder, [f"-DOPEN_FRI_VERSION={options.version}"], compiler="gcc", flags="-O1", targets=["attack"])
    begin = time.monotonic()
    with Attack(folder / "attack", TRAJECTORY, SECONDS) as attack:
        found = faulty(attack, np.random.default_rng([options.seed, 0]), options.faulty, options.kinds.split(","))
        found += harmless(attack, np.random.default_rng([options.seed, 1]), options.harmless)
    print(*found[:20], f"{time.monotonic() - begin:.0f} s", sep="\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
