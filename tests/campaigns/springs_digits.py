# SPDX-License-Identifier: MIT
"""Springs against 60 digits over many poses: python tests/campaigns/springs_digits.py [COUNT [WORKERS [SUBJECT...]]].

Every spring with all axes, its centre of stiffness at the tip's origin and apart from it, at COUNT poses each: at
random, within 1e-9 to 1e-3 of the equilibrium, and within 1e-6 of the edge (turns by pi). First the spring alone, its
pose given as doubles: energy, wrench and covariant Hessian. Then three robots from q: these, torque and joint
stiffness, as CasADi has them, and for the default axes as the compiled module of the folder has them. Tables of the
worst errors; exit code 1 if one is beyond its bound. A SUBJECT ("pose", a robot, "ROBOT, compiled") is a part of that.

* 1e-11 of the largest entry (of a wrench: of its force, and of its moment), where the pose is given, and from q
  wherever that is well conditioned: at random and at the edge everything, near the equilibrium the stiffnesses;
* near the equilibrium from q, energy, wrench and torque are differences of a pose that is rounded to 1e-16. There the
  bound is 1e-11 of the largest entry plus what 16 roundings of the pose cost; the table shows the part of it used.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import stiffgen
from stiffgen.core.symbolic.choices import KINDS
from stiffgen.core.symbolic.placement import Placement
from support import spring_digits as digits

BOUND = 1e-11
CHUNK = 50
SMALL = ("energy", "wrench", "torque")
"""Results that vanish at the equilibrium."""
DEFAULT = [Placement()]
Task = tuple[str, str, int, int, str]
"""What is evaluated, case, number of poses, seed, folder of the robots."""
Table = dict[tuple[str, str, str, str], dict[str, float]]
"""Worst errors by subject, case, kind of spring and measure."""


@cache
def _evaluated(subject: str, work: str) -> tuple[Path, digits.Evaluated]:
    robot = subject.removesuffix(", compiled")
    urdf = digits.urdf_of(robot, Path(work))
    if robot == subject:
        return urdf, cache(digits.by_casadi(stiffgen.load_chain(urdf)))
    return urdf, digits.by_module(Path(work) / robot.replace(" ", "_"))


def run(task: Task) -> tuple[str, Table]:
    """Return the subject of a task and the worst errors, relative and as a share of the bound, at some poses."""
    subject, case, count, seed, work = task
    placements = DEFAULT if subject.endswith("compiled") else digits.PLACEMENTS
    if subject == "pose":
        measured = {"relative": digits.pose_errors(placements, case, count, seed)}
    else:
        urdf, kernels = _evaluated(subject, work)
        relative, allowed = digits.robot_errors(urdf, kernels, placements, case, count, seed)
        measured = {"relative": relative, "of the bound": allowed}
    table: Table = {}
    for measure, errors in measured.items():
        for (kind, _), worst in errors.items():
            _raise(table.setdefault((subject, case, kind, measure), {}), worst)
    return subject, table


def _raise(worst: dict[str, float], by: dict[str, float]) -> None:
    for name, error in by.items():
        worst[name] = max(worst.get(name, 0.0), error)


SUBJECTS = ("pose", *digits.ROBOTS, *(f"{robot}, compiled" for robot in digits.ROBOTS))


def tasks(subjects: Sequence[str], count: int, work: str) -> Iterator[Task]:
    """All poses in chunks, each with a seed of its own."""
    for subject in subjects:
        for case in digits.CASES:
            for start in range(0, count, CHUNK):
                yield subject, case, min(CHUNK, count - start), 1 + start, work


def failures(table: Table) -> list[str]:
    """Return a sentence for each error beyond its bound."""
    beyond = []
    for (subject, case, kind, measure), worst in table.items():
        for name, error in worst.items():
            rounded = subject != "pose" and case == "near" and name in SMALL
            bound = 1.0 if measure == "of the bound" else BOUND
            if error > bound and not (rounded and measure == "relative"):
                beyond.append(f"{subject}, {case}, {kind} spring, {name}: {error:.1e} {measure}, allowed {bound:g}")
    return beyond


def main(count: int = 1000, workers: int = multiprocessing.cpu_count(), *subjects: str) -> int:
    """Count the digits that springs lose in their worst poses, over all robots; return 1 beyond the bounds."""
    subjects = subjects or SUBJECTS
    start, table = time.monotonic(), {}
    with tempfile.TemporaryDirectory() as folder:
        for robot in digits.ROBOTS:
            urdf = digits.urdf_of(robot, Path(folder))
            if f"{robot}, compiled" in subjects:
                stiffgen.generate(urdf, output=folder, name=robot.replace(" ", "_"), springs=KINDS)
        with multiprocessing.Pool(workers) as pool:
            todo = list(tasks(subjects, count, folder))
            for done, (subject, part) in enumerate(pool.imap_unordered(run, todo), start=1):
                for key, worst in part.items():
                    _raise(table.setdefault(key, {}), worst)
                if done % 10 == 0 or done == len(todo):
                    spent = time.monotonic() - start
                    print(f"{done} of {len(todo)} ({subject}), {spent:.0f} s", file=sys.stderr, flush=True)
    print(f"{count} poses a case, {len(digits.PLACEMENTS)} axes and centres, {time.monotonic() - start:.0f} s\n")
    print("| evaluated | case | spring | measure | " + " | ".join(digits.RESULTS) + " |")
    print("|---|---|---|---|" + "---|" * len(digits.RESULTS))
    for key in sorted(table, key=lambda key: SUBJECTS.index(key[0])):
        shown = [f"{table[key][name]:.1e}" if name in table[key] else "" for name in digits.RESULTS]
        print(f"| {' | '.join(key)} | {' | '.join(shown)} |")
    beyond = failures(table)
    print("\n" + "\n".join(beyond or [f"All within their bounds; relative {BOUND:g}."]))
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:3]), *sys.argv[3:]))
