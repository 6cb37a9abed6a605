# SPDX-License-Identifier: MIT
"""Hill-climbing attack on the FRI client: schedules of what a robot, a network, a machine and a person may do to it.

    python tests/campaigns/attack_fri.py [FOLDER] [--sessions 100000] [--seed 1] [--version 2.7] [--sanitize]

Sessions run in one process with a virtual clock, network and arm (fri/support/native/attack.cpp), some twenty a second
and more. A schedule is mutated, and the mutant kept if the measure that is climbed on has not become smaller; after a
while the climb starts again, on the next measure. What is beyond a bound is a break: its schedule is printed, made
smaller first. Exit code 1 if there is one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import stiffgen
from fri.robot.messages import VERSIONS, SessionState
from fri.support.session import SANITIZERS, build, write_short_trajectory
from support.plate import NAME, SENSOR, TOOL
from support.project import URDF

DONE, FAULT, REFUSED, EARLY, INTERRUPTED = range(5)
PERIODS = (1, 2, 5, 10)
RELEASE = 0.3
"""[s] within which the torque is down after the client has let go."""
AXIS_DELTA = np.radians(10.0)
TIP_ERROR = 0.2 + 0.1
"""[m] --error-limit, and what the reference covers while it comes to a stand."""
ENERGY = 6.0 + 10.0
"""[J] most that the springs and the controller's tank can have turned into motion."""

KINDS: dict[str, tuple[float, ...] | tuple[str, float, float]] = {
    "drop": ("share", 0, 1), "deaf": ("share", 0, 1), "delay": ("log", 1e-4, 0.3), "burst": (0,),
    "twice": ("share", 0, 1), "replay": (1, 2, 5, 50, 150), "garbage": ("share", 0, 1), "cut": ("share", 0, 1),
    "state": (0, 1, 2, 3, 4), "quality": (0, 1, 2, 3), "safety": (1, 2, 3), "drives": (0, 1), "operation": (0, 1),
    "mode": (0, 1, 2), "period": (0, 1, 2, 4, 5, 6, 10, 20, 100), "multiplier": (2, 3, 5),
    "clock": ("signed", 1e-4, 1e4), "jitter": ("signed", 0.05, 10), "coarse": (1e-3, 5e-3, 1e-2, 0.1, 1.0),
    "frozen": (0,), "counter": (-1000, -100, -50, -5, -1, 1, 2, 3, 50, 1000, 2**20, 2**21, 2**31),
    "counting": (0, 2, 3, 5, 50, 2**20), "stuck": (0,), "without": (1, 2, 4, 8, 16, 32, 3, 18, 17), "nan": (0, 3, 6),
    "offset": ("signed", 1e-3, 0.5), "noise": ("log", 1e-6, 3e-2), "gain": (-1, 0, 2, 10), "button": (0,),
    "held": (0,), "blocked": (0, 1, 2, 3, 4, 5, 6), "push": ("signed", 1, 100), "silence": (0,),
    "slow": ("log", 0.1, 20), "patient": (0,), "stop": (0, 1), "interrupt": (1, 2), "answer": (0, 1),
    "settle": (5, 35, 100), "press": (5, 15, 40), "wall": (-0.05, 0, 0.005, 0.02, 0.05), "numb": (0,), "mute": (0,),
    "weak": (-1, 0, 0.2, 0.5, 2),
}  # fmt: skip
"""An event's values: one of some numbers, or a share, or a number on a logarithmic scale with or without sign."""

LIES = {"offset", "noise", "nan", "gain", "without"}
"""The arm is not where the robot says, or it does not say."""
FORCES = {"push", "slow", "patient", "counter", "counting", "stuck", "silence"}
"""The arm is moved by something else than the client, or by an old torque."""
CUTS = {"drop", "delay", "burst", "garbage", "cut", "silence", "stop", "slow", "stuck", "counter", "counting", "replay",
        "twice", "deaf", "state", "mode", "multiplier", "period", "without", "mute"}  # fmt: skip
"""Messages do not come one a period, or command nothing: a release takes longer, or ends with the patience for it."""


@dataclass(frozen=True)
class Event:
    """From ``start``, for ``length`` [s]: what ``kind`` says, with ``value``."""

    kind: str
    start: float
    length: float
    value: float

    def __str__(self) -> str:
        return f"{self.kind} {self.start:.6f} {self.length:.6f} {self.value:.9g}"


@dataclass(frozen=True)
class Schedule:
    """A hostile session; ``period`` of the robot's messages [ms]."""

    period: int
    seed: int
    events: tuple[Event, ...] = ()

    def __str__(self) -> str:
        return " ".join(map(str, (self.seed, *self.events)))

    @property
    def kinds(self) -> set[str]:
        """Kinds of its events."""
        return {event.kind for event in self.events}


def parse(text: str) -> Schedule:
    """Parse a schedule from its printed form, "PERIOD: SEED KIND START LENGTH VALUE ..."."""
    period, _, line = text.partition(":")
    words = line.split()
    events = [Event(k, *map(float, words[i + 1 : i + 4])) for i, k in enumerate(words) if i % 4 == 1]
    return Schedule(int(period), int(words[0]), tuple(events))


def draw_value(rng: np.random.Generator, kind: str) -> float:
    """Draw a value for an event of that kind, over the orders of magnitude that KINDS states."""
    choice = KINDS[kind]
    if choice[0] == "share":
        return float(rng.choice([rng.uniform(), 1.0, 0.5]))
    if isinstance(choice[0], str):
        size = float(np.exp(rng.uniform(np.log(choice[1]), np.log(choice[2]))))
        return size * float(rng.choice([-1, 1])) if choice[0] == "signed" else size
    return float(rng.choice(np.array(choice, dtype=float)))


def draw_event(rng: np.random.Generator) -> Event:
    """Any event."""
    kind = str(rng.choice(list(KINDS)))
    length = float(np.exp(rng.uniform(np.log(0.001), np.log(4.0))))
    return Event(kind, round(float(rng.uniform(0.0, 4.0)), 6), length, draw_value(rng, kind))


def begin(rng: np.random.Generator) -> Schedule:
    """Begin a climb: without an event, or with a force that is held along a wall, which events alone seldom make."""
    kinds = ("press", "wall") if rng.uniform() < 0.25 else ()
    events = tuple(Event(kind, 0.0, 99.0, draw_value(rng, kind)) for kind in kinds)
    return Schedule(int(rng.choice(PERIODS)), int(rng.integers(1 << 31)), events)


def mutate(rng: np.random.Generator, schedule: Schedule) -> Schedule:
    """Return a neighbour of the schedule: one to three events added, dropped or changed."""
    events = list(schedule.events)
    for _ in range(int(rng.integers(1, 4))):
        choice = rng.integers(6) if events else 0
        k = int(rng.integers(len(events))) if events else 0
        if choice <= 1 and len(events) < 10:
            events.append(draw_event(rng))
        elif choice == 2 and len(events) > 1:
            del events[k]
        elif choice == 3:
            moved = max(0.0, events[k].start + float(rng.normal()) * float(rng.choice([0.001, 0.02, 0.3])))
            events[k] = replace(events[k], start=round(moved, 6))
        elif choice == 4:
            events[k] = replace(events[k], length=events[k].length * float(np.exp(rng.normal(0, 0.5))))
        elif events:
            events[k] = replace(events[k], value=draw_value(rng, events[k].kind))
    seed = schedule.seed if rng.uniform() < 0.8 else int(rng.integers(1 << 31))
    return Schedule(schedule.period, seed, tuple(events))


def measures(schedule: Schedule, told: Mapping[str, Any]) -> dict[str, float]:
    """Return by name what the client came to as a share of what it may; none may be beyond 1."""
    kinds = schedule.kinds
    result = {
        "torque over limit": told["over_limit"],
        "torque's step from answer to answer": told["step"],
        "torque's rate in real time": told["rate"],
        "trajectory ahead of real time": told["lead"],
        "speed of the reference": told["reference"],
        "commands not finite": float(told["not_finite"]),
        "time until it ends": told["time"] / 29.0,
    }
    if "multiplier" in kinds:
        # The rate limit holds for a callback: an answer to n messages moves by n.
        del result["torque's rate in real time"], result["torque's step from answer to answer"]
    if not kinds & {"counter", "counting"}:  # what counts anew is not believed at once
        result["sound messages without an answer"] = 2.0 * float(told["unanswered"])
    if not kinds & (LIES | FORCES):
        result["stored energy"] = told["elastic"] / 1.05  # the governor's limit
        if not kinds & (CUTS | {"frozen", "coarse"}):  # without samples, or time in them, the arm coasts
            result["distance from the reference"] = told["error"] / TIP_ERROR
        result["energy of the arm"] = told["kinetic"] / ENERGY
        result["speed of the arm"] = told["fast"]
        result["commanded position from the arm's"] = told["axis_delta"] / AXIS_DELTA
    if not kinds & CUTS and told["release"] >= 0:
        result["time of the release"] = told["release"] / RELEASE
    result["untrue words"] = 2.0 * len(untrue(schedule, told))
    return {name: float(value) for name, value in result.items()}


def untrue(schedule: Schedule, told: Mapping[str, Any]) -> list[str]:
    """Return what exit code and last line say although it was not so."""
    code, sentence = told["code"], told["sentence"]
    torque = told["state"] == SessionState.COMMANDING_ACTIVE and told["last_torque"] != 0
    wrong = {
        "0 although the trajectory was not followed to its end": code == DONE and not told["done"],
        "0 or 3 without the robot's end": code in (DONE, EARLY) and not told["idle"],
        "0 or 3 although the client let go": code in (DONE, EARLY) and told["let_go"],
        "3 although the trajectory was followed": code == EARLY and told["done"],
        "4 without a person": code == INTERRUPTED and not (told["interrupted"] or told["declined"]),
        "2 without a refusal": (code == REFUSED) != told["refused"],
        "no sentence": len(sentence) < 10,
        "torque at zero, it says": "torque brought to zero" in sentence and torque,
        "refused under torque": code == REFUSED and torque,
        "left under torque while the robot sent": (
            "left at once" in sentence and told["interrupts"] < 2 and not schedule.kinds & CUTS
        ),
    }
    return [text for text, is_so in wrong.items() if is_so]


@dataclass(frozen=True)
class Break:
    """A measure beyond its bound, by a schedule made small, and what the client came to."""

    name: str
    value: float
    schedule: Schedule
    told: Mapping[str, Any]


class Attack:
    """Programs of a version, one process a send period, that play schedules."""

    def __init__(self, program: Path, trajectory: Path, seconds: float = 4.0) -> None:
        self._command = [str(program), str(trajectory)]
        self._seconds = str(seconds)
        self._processes: dict[int, subprocess.Popen[str]] = {}
        self.sessions = 0

    def __enter__(self) -> Attack:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes.values():
            process.kill()
            process.communicate()

    def play(self, schedule: Schedule) -> dict[str, Any]:
        """Play a schedule and return the result of the client.

        Raises
        ------
        RuntimeError
            It crashed, or a sanitizer spoke.

        """
        process = self._processes.get(schedule.period)
        if process is None:
            process = subprocess.Popen([*self._command, str(schedule.period), self._seconds],
                                       stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                       text=True)  # fmt: skip
            self._processes[schedule.period] = process
        assert process.stdin is not None and process.stdout is not None
        self.sessions += 1
        process.stdin.write(f"{schedule}\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            errors = process.communicate()[1]
            del self._processes[schedule.period]
            raise RuntimeError(f"{schedule.period}: {schedule}\n{errors[-3000:]}")
        result: dict[str, Any] = json.loads(line)
        return result

    def breaks(self, schedule: Schedule) -> set[str]:
        """Names of the measures that are beyond 1."""
        return {name for name, value in measures(schedule, self.play(schedule)).items() if not value <= 1 + 1e-6}

    def smaller(self, schedule: Schedule, name: str) -> Schedule:
        """Remove events from the schedule as long as it breaks the same bound."""
        for event in schedule.events:
            less = replace(schedule, events=tuple(e for e in schedule.events if e is not event))
            if name in self.breaks(less):
                schedule = less
        return schedule


def climb(
    attack: Attack, rng: np.random.Generator, sessions: int, tell: Callable[[Break], None] | None = None
) -> tuple[dict[str, float], list[Break]]:
    """Climb; return the largest value of each measure, and each break.

    A name breaks once: climbs on it end there.
    """
    most: dict[str, float] = {}
    breaks: dict[str, Break] = {}
    climbs, end = 0, attack.sessions + sessions
    while attack.sessions < end:
        names = [name for name in sorted(most) if name not in breaks]
        target = names[climbs % len(names)] if names else ""
        climbs += 1
        best, height = begin(rng), -1.0
        for _ in range(60):
            mutant = mutate(rng, best)
            told = attack.play(mutant)
            found = measures(mutant, told)
            for name, value in found.items():
                most[name] = np.maximum(most.get(name, 0.0), value)  # max() would lose a NaN
                if not value <= 1 + 1e-6 and name not in breaks:
                    small = attack.smaller(mutant, name)
                    breaks[name] = Break(name, value, small, attack.play(small))
                    if tell:
                        tell(breaks[name])
            here = found.get(target, 0.0)
            if here >= height:
                best, height = mutant, here
            if attack.sessions >= end or target in breaks:
                break
    return most, list(breaks.values())


def report(found: Break) -> None:
    """Print a break."""
    print(f"BREAK {found.name}: {found.value:.6g}\n  {found.schedule.period}: {found.schedule}")
    print(f"  {untrue(found.schedule, found.told)} {found.told['sentence']}", flush=True)


def main(given: Iterable[str] | None = None) -> int:
    """Search for sessions that break a promise of the client, and print the worst ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("build/fri-attack"))
    parser.add_argument("--sessions", type=int, default=30000, help="of each version (%(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--version", choices=VERSIONS, action="append")
    parser.add_argument("--sanitize", action="store_true", help="under the address and undefined-behaviour sanitizers")
    parser.add_argument("--play", metavar="SCHEDULE", help="one schedule, as a break is printed; what it comes to")
    options = parser.parse_args(None if given is None else list(given))
    broken, base = 0, options.folder.resolve()
    robot = stiffgen.generate(URDF, name=NAME, tool=TOOL, sensor=SENSOR, build=False, output=base / "robots")
    for version in options.version or VERSIONS:
        folder = base / (version + ("-sanitized" if options.sanitize else ""))
        print(f"FRI {version}: building ...", flush=True)
        compiler, flags = ("clang", SANITIZERS) if options.sanitize else ("gcc", "-O1")
        given = [f"-DOPEN_FRI_VERSION={version}", f"-DROBOT_NAME={NAME}", f"-DROBOT_DIR={robot}"]
        build(folder, given, compiler=compiler, flags=flags, targets=["attack"])
        with Attack(folder / "attack", write_short_trajectory(folder / "short.csv")) as attack:
            if options.play:
                schedule = parse(options.play)
                told = attack.play(schedule)
                print(json.dumps({**told, **measures(schedule, told)}, indent=2), *untrue(schedule, told), sep="\n")
                continue
            began = time.monotonic()
            most, breaks = climb(attack, np.random.default_rng(options.seed), options.sessions, report)
            print(f"{attack.sessions} sessions in {time.monotonic() - began:.0f} s; most of what is allowed:")
            for name, value in sorted(most.items()):
                print(f"  {name:40s} {value:.6g}")
            broken += len(breaks)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
