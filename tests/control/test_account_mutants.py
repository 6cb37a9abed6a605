# SPDX-License-Identifier: MIT
"""Faults in the account that the adversary of tests/campaigns/energy.py must see: each breaks its energy bound."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from campaigns import energy, patterns, schedules
from support.plant.loop import Loop
from support.project import ROOT, Once

MOST = 1500
"""Schedules of a search; each of the mutants is seen within a third of them."""
MUTANTS = {
    "reserve x 0.3": (
        "    return sum;\n}\n\n/* Return the reserve R",
        "    return 0.3 * sum;\n}\n\n/* Return the reserve R",
    ),
    "travel not supplied": (
        "    a->tank += lack;\n    a->supplied += lack;\n}\n\n/* Book a change of stiffness",
        "    a->tank += lack;\n}\n\n/* Book a change of stiffness",
    ),
    "half the work booked": ("account_pay(a, m, -work - rise);", "account_pay(a, m, -0.5 * work - rise);"),
    "hold + 1 call": ("m->watch.missed < m->account.hold)", "m->watch.missed < m->account.hold + 1)"),
    "release clipped": (
        "    a->tank += a->springs;\n    a->springs = 0.0;\n}",
        "    a->tank = smaller(a->tank + a->springs, larger(a->tank, 0.1));\n    a->springs = 0.0;\n}",
    ),
    "transit forgotten": ("k <= c->delay_samples; ++k", "k < c->delay_samples; ++k"),
}  # fmt: skip
"""Text of NAME_impedance.c and its replacement."""


def draws() -> Iterator[tuple[int, object]]:
    """Yield seeds with the pattern of their schedule, the sharpest patterns first."""
    kinds = (patterns.carried, patterns.drained, patterns.zones, patterns.limits, patterns.presses, schedules.schedule)
    for seed in range(MOST // len(kinds)):
        for kind in kinds:
            yield seed, kind


def first_beyond(loop: Loop) -> int:
    """Return how many schedules it takes to break the bound, or TANK_DEFICIT; 0 if none does."""
    for count, (seed, kind) in enumerate(draws(), 1):
        got = energy.attempt(loop, kind(np.random.default_rng(seed), loop))  # type: ignore[operator]
        if got.excess > energy.TOLERANCE or got.deficit:
            return count
    return 0


@pytest.fixture(scope="module")
def kernels(once: Once) -> tuple[str, ...]:
    """Return the objects of the kernels, which no mutant changes."""
    names = ("iiwa14", "iiwa14_batch")
    flags = ("-std=c99", "-O1", "-march=native", "-fPIC")

    def make(folder: Path) -> None:
        for name in names:
            command = ["gcc", *flags, "-c", ROOT / "generated" / "iiwa14" / f"{name}.c", "-o", folder / f"{name}.o"]
            subprocess.run(command, check=True)

    return tuple(str(once("kernels-of-mutants", make) / f"{name}.o") for name in names)


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_adversary_sees(mutant: str, kernels: tuple[str, ...], tmp_path: Path) -> None:
    """Seed a fault in the energy account: random schedules must put out more energy than allowed."""
    robot = tmp_path / "iiwa14"
    shutil.copytree(ROOT / "generated" / "iiwa14", robot)
    source, (old, new) = robot / "iiwa14_impedance.c", MUTANTS[mutant]
    text = source.read_text()
    assert text.count(old) == 1
    source.write_text(text.replace(old, new))
    found = first_beyond(Loop(tmp_path, robot, sources=(*kernels, source.name)))
    assert 0 < found < MOST, found
    print(f"{mutant}: seen after {found} schedules")
