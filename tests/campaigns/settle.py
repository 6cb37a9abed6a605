# SPDX-License-Identifier: MIT
"""Random situations of an arm on springs: does it come to rest where statics says, and within the limits?

    python tests/campaigns/settle.py [--count 500] [--seed 1]

Each situation: a posture, stiffness within the accepted range, a load of up to 80 N and 15 N m that hangs at the tip
(grown over half a second, in every fifth dropped on at once) and is measured with a bias, 0 to 2 samples of delay,
motor inertia of 0.02 to 0.3 kg m^2, velocity by differences of an encoder with a quantum of 1e-4 rad; in half the arm
starts away from where it is wanted. The static solution is found without the controller
(tests/support/plant/statics.py), for where the equilibrium ended: short of the wanted one only where the load holds the
stored energy above the governor's limit, or has taken up the work that one engagement may cost. A load may have several
stable solutions: the one that a growing load leads to says whether there is any, and the arm may rest in another that
is as good. A load that is dropped, or that grows so fast that its static solution moves at the velocity limit, may
drive the arm beyond that limit, which is a fault; nothing else may be one.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from stiffgen.control.status_words import REASONS

from support.plant.loop import Loop, N
from support.plant.statics import random_stiffness
from support.project import ROOT

Array = np.ndarray[Any, np.dtype[np.float64]]
DURATION = 20.0
"""[s] of an episode: the softest modes, of the posture's 1 N m/rad, take seconds."""
OVERSPEED = [name for name, _, _ in REASONS].index("overspeed")
"""The controller's reason for the fault."""
RIPPLE = 5e-3
"""[rad] that a joint may still move in the last tenth and be at rest: some quanta of the encoder."""
MARGIN = 0.35
"""[rad] between a posture and its limits: the zone of the limit avoidance is 0.1."""


@dataclass(frozen=True)
class Situation:
    """One of them; units as in the segments and episodes."""

    wanted: Array
    start: Array
    translation: Array
    rotation: Array
    load: Array
    bias: Array
    sudden: bool
    delay: int
    motor: Array
    differences: bool
    quantum: float


@dataclass(frozen=True)
class Outcome:
    """What became of a situation."""

    static: Array | None
    """Posture of rest, or None where there is no stable one inside the joint limits."""
    away: float
    """[m] the tip's deflection in the static solution."""
    miss: float
    """[1] distance of the tip from the static solution over its deflection there (at least 2 mm)."""
    elsewhere: bool
    """Whether that is another stable solution than the one that a growing load leads to."""
    driven: bool
    """Whether the load itself moved the arm at its velocity limit, by statics alone."""
    settled: bool
    speed: float
    """[1] the arm's largest speed over the governor's limits, joints and tip."""
    reference_speed: float
    """[1] the equilibrium's."""
    faults: int
    held: bool
    """Whether the equilibrium ended short of the wanted one."""
    stranded: bool
    """Whether it did although the governor had more to give: neither is the energy limit stored, nor has the load
    taken up all that an engagement may cost (a weight of 50 N lifted by 0.3 m is 15 J of the 20)."""
    energy: float
    """[J] of the springs at rest in the static solution."""
    summary: Any


def situation(random: np.random.Generator, lower: Array, upper: Array, loaded: bool = True) -> Situation:
    """Draw one."""
    wanted = random.uniform(lower + MARGIN, upper - MARGIN)
    start = wanted.copy()
    if random.random() < 0.5:
        away = random.normal(size=N)
        away *= random.uniform(0.1, 1.5) / np.linalg.norm(away)
        start = np.clip(wanted + away, lower + MARGIN, upper - MARGIN)
    force, moment = random.normal(size=3), random.normal(size=3)
    force *= random.uniform(0, 80) / np.linalg.norm(force)
    moment *= random.uniform(0, 15) / np.linalg.norm(moment)
    if random.random() < 0.5:  # a weight
        force = np.array([0, 0, -np.linalg.norm(force)])
    return Situation(
        wanted,
        start,
        random_stiffness(random, 100, 3000),
        random_stiffness(random, 10, 300),
        np.concatenate([force, moment]) if loaded and random.random() < 0.9 else np.zeros(6),
        np.concatenate([random.normal(size=3) * 5, random.normal(size=3)]),
        bool(random.random() < 0.2),
        int(random.integers(0, 3)),
        np.exp(random.uniform(np.log(0.02), np.log(0.3), N)),
        bool(random.random() < 0.8),
        1e-4 if random.random() < 0.8 else 0.0,
    )


def run(loop: Loop, case: Situation, duration: float = DURATION, rows: bool = False, **config: Any) -> Any:
    """Run a situation; the load comes at 0.1 s, at once or in 50 steps."""
    samples = round(duration / 1e-3)
    gains = {"translation": case.translation, "rotation": case.rotation}
    parts: list[dict[str, Any]] = [{"wanted": case.wanted, "measure_wrench": 1, **gains}]
    steps = 1 if case.sudden else 50
    parts += [
        {"start": 100 + 10 * k, "load": case.load * (k + 1) / steps, "wrench_bias": case.bias} for k in range(steps)
    ]
    episode = loop.episode(
        q=case.start,
        delay=case.delay,
        motor=case.motor,
        differences=int(case.differences),
        quantum=case.quantum,
        velocity_limit=np.array(loop.config().reference_velocity_limit),
    )
    options = {"delay_samples": case.delay, "motor_inertia": case.motor, "position_quantum": case.quantum, **config}
    return loop.run(samples, loop.segments(*parts), episode, loop.config(**options), rows=rows)


def judge(loop: Loop, case: Situation, summary: Any) -> Outcome:
    """Hold what happened against statics and the governor's limits."""
    config = loop.config()
    reference = np.array(summary.reference)
    held = bool(np.abs(reference - case.wanted).max() > 1e-6)
    springs = loop.springs(
        reference if held else case.wanted, case.translation, case.rotation, config.posture_stiffness[0]
    )
    found = springs.rest(case.load, np.zeros(N))
    zone = config.limit_zone
    inside = found is not None and bool(
        np.all(found[0] > loop.lower + zone) and np.all(found[0] < loop.upper - zone)
    )  # fmt: skip
    static = found[0] if found is not None and inside else None
    away = miss = np.nan
    q = np.array(summary.q)
    if static is not None:
        rest, tip = loop.pose(static)[:3, 3], loop.pose(q)[:3, 3]
        away = float(np.linalg.norm(rest - springs.equilibrium[:3, 3]))
        miss = float(np.linalg.norm(tip - rest)) / max(away, 2e-3)
    elsewhere = False
    if static is not None and miss > 0.05 and summary.ripple < RIPPLE:
        edges = (loop.lower + zone, loop.upper - zone, np.array(config.limit_stiffness))
        other = replace(springs, zone=edges).near(q, case.load)
        if other is not None:
            elsewhere = True
            miss = float(np.linalg.norm(tip - loop.pose(other)[:3, 3])) / max(away, 2e-3)
    return Outcome(
        static,
        away,
        miss,
        elsewhere,
        bool(summary.faults) and summary.reason == OVERSPEED and (case.sudden or driven(loop, case)),
        summary.ripple < RIPPLE,
        max(summary.speed, summary.tip_speed / config.tip_velocity_limit),
        max(summary.reference_speed, summary.tip_reference_speed / config.tip_velocity_limit),
        summary.faults,
        held,
        held and _stranded(config, summary, springs.energy(static) if static is not None else np.nan),
        springs.energy(static) if static is not None else np.nan,
        summary,
    )


def _stranded(config: Any, summary: Any, stored: float) -> bool:
    given = summary.port + stored
    return stored < 0.8 * config.energy_limit and given < 0.95 * config.engagement_limit


def driven(loop: Loop, case: Situation) -> bool:
    """Whether the static solution passes the velocity limit while the load grows from zero in half a second."""
    springs = loop.springs(case.wanted, case.translation, case.rotation, loop.config().posture_stiffness[0])
    shares = np.linspace(0, 1, 26)
    path = [springs.rest(case.load * share, np.zeros(N)) for share in shares]
    if any(found is None for found in path):
        return True
    speeds = np.diff([found[0] for found in path if found is not None], axis=0) / (0.5 * np.diff(shares)[:, None])
    return bool(np.abs(speeds / np.array(loop.config().velocity_limit)).max() > 1)


def outcomes(loop: Loop, cases: list[Situation], **config: Any) -> Iterator[Outcome]:
    """Run and judge."""
    for case in cases:
        yield judge(loop, case, run(loop, case, **config))


def failures(case: Situation, outcome: Outcome) -> list[str]:
    """Return the promises that a situation's outcome breaks."""
    broken = []
    if not outcome.summary.finite:
        broken.append("torque not finite")
    if outcome.reference_speed > 1 + 1e-9:
        broken.append(f"equilibrium at {outcome.reference_speed:.3f} of the governor's limits")
    if outcome.static is not None:
        if outcome.stranded and not outcome.faults:
            broken.append(f"equilibrium stranded with {outcome.energy:.2f} J in the springs")
        elif outcome.driven:
            pass
        elif not outcome.settled or outcome.faults:
            reason = f", fault for reason {outcome.summary.reason}" if outcome.faults else ""
            broken.append(f"not settled: {outcome.summary.ripple:.1e} rad{reason}")
        elif outcome.miss > 0.05:
            broken.append(f"tip {100 * outcome.miss:.0f} % beside the static solution")
    if not np.any(case.load) and not outcome.faults and outcome.speed > 1.1:
        broken.append(f"arm at {outcome.speed:.2f} of the governor's limits")
    return broken


def build(folder: Path, robot: Path | None = None) -> Loop:
    """Build the loop with the committed robot."""
    return Loop(folder, robot or ROOT / "generated" / "iiwa14")


_loop: Loop | None = None
"""Of a worker process."""


def _start() -> None:
    global _loop
    with tempfile.TemporaryDirectory() as folder:
        _loop = build(Path(folder))


def _settle(case: Situation) -> Outcome:
    assert _loop is not None
    (outcome,) = outcomes(_loop, [case])
    return replace(outcome, summary=_plain(outcome.summary))


def _plain(summary: Any) -> SimpleNamespace:
    """Return the numbers of a summary: a structure of ctypes does not travel between processes."""
    return SimpleNamespace(
        **{name: getattr(summary, name) for name in ("finite", "reason", "ripple", "effort", "torque_step", "faults")}
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    options = parser.parse_args()
    random, start, broken = np.random.default_rng(options.seed), time.monotonic(), 0
    with tempfile.TemporaryDirectory() as folder:
        loop = build(Path(folder))
    cases = [situation(random, loop.lower, loop.upper) for _ in range(options.count)]
    found: list[Outcome] = []
    with multiprocessing.Pool(options.workers, _start) as pool:
        for k, outcome in enumerate(pool.imap(_settle, cases)):
            found.append(outcome)
            words = failures(cases[k], outcome)
            broken += bool(words)
            if words:
                print(f"situation {k} of seed {options.seed}: {'; '.join(words)}", flush=True)
            if (k + 1) % 50 == 0:
                print(f"{k + 1} of {options.count}, {broken} broken, {time.monotonic() - start:.0f} s", flush=True)
    print(table(cases, found))
    return 1 if broken else 0


def table(cases: list[Situation], found: list[Outcome]) -> str:
    """Return the numbers of situations by outcome."""
    lines = ["| | situations |", "|---|---|"]

    def row(name: str, value: Any) -> None:
        lines.append(f"| {name} | {value(found)} |")

    def free(case: Situation, outcome: Outcome) -> bool:
        return not np.any(case.load) and not outcome.faults

    row("situations with a stable static solution inside the limits", lambda t: sum(o.static is not None for o in t))
    row(
        "of these settled, without a fault, tip within 5 % of it",
        lambda t: sum(o.static is not None and o.settled and not o.faults and o.miss <= 0.05 for o in t),
    )
    row("of those settled, in another stable solution than a growing load leads to", lambda t: sum(
        o.static is not None and o.settled and not o.faults and o.miss <= 0.05 and o.elsewhere for o in t
    ))  # fmt: skip
    row("of these, settled without a fault elsewhere", lambda t: sum(
        o.static is not None and o.settled and not o.faults and o.miss > 0.05 for o in t
    ))  # fmt: skip
    row("of these, short of the wanted one, held by the governor", lambda t: sum(
        o.static is not None and o.held and not o.faults for o in t
    ))  # fmt: skip
    row("of these, latched a fault", lambda t: sum(o.static is not None and o.faults > 0 for o in t))
    row("of which the load drove beyond the velocity limit", lambda t: sum(
        o.static is not None and o.driven for o in t
    ))  # fmt: skip
    row("of these, still moving", lambda t: sum(
        o.static is not None and not o.faults and not o.settled for o in t
    ))  # fmt: skip
    row("equilibrium's largest speed over the governor's limits", lambda t: f"{max(o.reference_speed for o in t):.4f}")
    row(
        "arm's largest speed over them, no load, no fault",
        lambda t: (
            f"{max([o.speed for c, o in zip(cases, t, strict=True) if not np.any(c.load) and not o.faults] or [0]):.3f}"
        ),
    )
    row("torque finite, inside its limits", lambda t: sum(
        bool(o.summary.finite) and o.summary.effort <= 1 and o.summary.torque_step <= 1 + 1e-9 for o in t
    ))  # fmt: skip
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
