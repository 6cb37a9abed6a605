# SPDX-License-Identifier: MIT
"""Freeze measured positions under the FRI client, and count what it takes for frozen in harmless sessions.

    python tests/campaigns/frozen_fri.py [FOLDER] [--faulty 1000] [--harmless 1000] [--seed 1] [--version 2.7]

The bowl is wiped in one process, with a virtual clock, network and arm (fri/support/native/attack.cpp) and without a
robot stiffness. In a faulty session the positions of one, several or all joints stand still from some moment on, or
stand still but for one bit that toggles, or are those of long ago. In a harmless session the arm rests, is pushed,
blocked or held. Dry friction, motor inertia, the positions' resolution, noise and offset of the external torque are
drawn for both.

Exit code 1 if in a faulty session a joint exceeds its velocity or position limit, if the client lets go later than
60 ms after a joint has parted by 0.02 rad from its measured position and it is 0.1 rad away by then, or if a harmless
session ends with a fault of a sensor. Those that let go late, but nearer, are counted.
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
LATEST = 0.06
"""[s] from a joint's 0.02 rad to letting go."""
APART = 0.1
"""[rad] A joint that parts so slowly that friction could hold its torque is let go later, but nearer than this."""
MOTORS = (0.07, 0.2)
"""[kg m^2] inertia of the motors, of which the client has been told 0.1."""
EVER = 99.0
FAULTS = ("one", "several", "all", "toggling", "late", "misled")
HARMLESS = ("none", "rest", "push", "blocked", "held", "silent")
WORDS = ("does not follow the torque", "are not believed", "repeat those of")
"""Words of a last line about positions."""


def draw_faulty(rng: np.random.Generator, kind: str) -> Schedule:
    """Draw a session in which positions stand still, or are old, from a moment of the motion on."""
    start, joint = round(float(rng.uniform(1.0, 11.0)), 6), int(rng.integers(7))
    joints = 1 << joint
    if kind == "several":
        joints = int(sum(1 << int(i) for i in rng.choice(7, int(rng.integers(2, 7)), replace=False)))
    joints = 127 if kind == "all" else joints
    word, value = "still", float(joints)
    if kind == "toggling":
        word, value = "toggling", float(100 * joints + rng.integers(0, 52))
    elif kind == "late":
        word, value = "late", float(10000 * joints + rng.integers(5, 60))
    events = [Event(word, start, EVER, value)]
    events += [Event("misled", start, EVER, float(rng.integers(1, 3)))] if kind == "misled" else []
    return Schedule(int(rng.choice(PERIODS)), int(rng.integers(1 << 31)), (*events, *draw_sensors(rng)))


def draw_sensors(rng: np.random.Generator) -> list[Event]:
    """Draw dry friction and offset of torques (shares of the effort limits), motor inertia, resolution and noise."""
    friction, quantum = float(rng.choice([0.0, rng.uniform(0.0, 0.012)])), float(rng.choice([0.0, 1e-6, 1e-5]))
    hum = float(rng.choice([0.0, rng.uniform(0.0, 0.3)]))
    bias, motor = float(rng.choice([0.0, rng.uniform(0.0, 0.01)])), float(rng.uniform(*MOTORS))
    given = {"sticky": friction, "quantum": quantum, "hum": hum, "bias": bias, "motor": motor}
    return [Event(word, 0.0, EVER, value) for word, value in given.items() if value > 0.0]


def draw_harmless(rng: np.random.Generator, kind: str) -> Schedule:
    """Draw a session without a fault: rests, pushes, and joints or an arm that somebody holds."""
    events = draw_sensors(rng)
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
    """Result of a faulty session: share of a velocity limit, delay of letting go [s] (None: no joint parted).

    ``held`` is a share of the effort limit: friction that holds as much would make the measured position true.
    """

    fast: float
    late: float | None
    beyond: float
    apart: float
    held: float

    @property
    def safe(self) -> bool:
        """Whether no joint exceeded its limits."""
        return self.fast <= 1.0 and self.beyond <= 0.0

    @property
    def prompt(self) -> bool:
        """Whether the client let go in time."""
        return self.late is None or self.late <= LATEST


def judge(told: Mapping[str, Any]) -> Verdict:
    """Judge a faulty session."""
    gone = told["let_go_time"] if told["let_go_time"] >= 0.0 else np.inf
    late = gone - told["parted"] if told["parted"] >= 0.0 else None
    return Verdict(told["fast"], late, told["beyond"], told["apart"], told["held"])


def blames_position(told: Mapping[str, Any]) -> bool:
    """Return whether a session ended because of a measured position."""
    return any(word in told["sentence"] for word in WORDS)


def faulty(attack: Attack, rng: np.random.Generator, count: int, kinds: list[str]) -> list[str]:
    """Play faulty sessions, and print each kind's worst; return those beyond the bar."""
    found: list[str] = []
    worst: dict[str, list[Verdict]] = {kind: [] for kind in kinds}
    for k in range(count):
        kind = kinds[k % len(kinds)]
        schedule = draw_faulty(rng, kind)
        told = attack.play(schedule)
        verdict = judge(told)
        worst[kind].append(verdict)
        if not (verdict.safe and (verdict.prompt or verdict.apart <= APART)):
            found.append(f"{kind} {schedule.period}: {schedule}\n    {verdict} {told['sentence'][:90]}")
    for kind, verdicts in worst.items():
        if not verdicts:
            continue
        late = [v.late for v in verdicts if v.late is not None]
        print(f"{kind:9} {len(verdicts)} sessions, {sum(not v.safe for v in verdicts)} beyond a limit, "
              f"{sum(not v.prompt for v in verdicts)} let go late; at most {max(v.fast for v in verdicts):.2f} of a "
              f"velocity limit, {1e3 * max(late, default=0.0):.0f} ms after 0.02 rad, "
              f"{max(v.apart for v in verdicts):.3f} rad apart", flush=True)  # fmt: skip
        held = sorted(100.0 * v.held for v in verdicts if not v.prompt)
        if held:
            print(f"          late: dry friction of {held[0]:.1f} to {held[-1]:.1f} % of the effort limit would hold "
                  f"the joint (median {held[len(held) // 2]:.1f} %)", flush=True)  # fmt: skip
    return found


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
