# SPDX-License-Identifier: MIT
"""Compare the predictions with the simulation, and print the report's tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from examples.whole_body import identify, trials
from examples.whole_body.stance import BASE_DIRECTIONS, Mode, Stance, base_shares, standing
from examples.whole_body.trials import CONTROL_CYCLES, DIRECTIONS, Trace, at_wall, identified

Array = NDArray[np.float64]

SOFTEST = 5
"""Modes that are compared."""
BAR = 0.02
"""Largest relative deviation of a frequency."""
DURATION = 2.4
"""Duration of free motion recorded after each kick [s], and RISING if the stance falls."""
RISING = 0.8
LEANING: Array = np.array([2.0, -1.5, -35.0])
"""Load of the second stance [N]: a rope that pulls down and aside."""
LOADS = np.arange(0.0, 61.0, 2.5)
"""Loads of the curve, downwards [N]; every SIMULATED-th is simulated."""
SIMULATED = 4


@dataclass(frozen=True)
class Row:
    """Softest mode: prediction, the base's motion in words, and result of the simulation."""

    mode: Mode
    direction: str
    found: identify.Found
    agreement: float

    @property
    def deviation(self) -> float:
        """Return the relative deviation of the predicted frequency."""
        return self.mode.frequency / self.found.frequency - 1


@dataclass(frozen=True)
class Loaded:
    """A stance under a load. ``softest_without``: without the base's term; ``found``: in simulation, if it was run."""

    stance: Stance
    force: float
    softest: float
    softest_without: float
    found: float | None
    rows: list[Row]


@dataclass(frozen=True)
class Findings:
    """All findings of the report."""

    standing: Loaded
    leaning: Loaded
    loads: list[Loaded]
    pressing: Trace
    not_supplied: Trace

    def failed_bars(self) -> list[str]:
        """Return the findings that do not hold, in words."""
        failed = []
        for name, loaded in (("standing", self.standing), ("with a load", self.leaning)):
            failed += [
                f"{name}: {row.mode.frequency:.3f} Hz predicted, {row.found.frequency:.3f} Hz found"
                for row in loaded.rows
                if not abs(row.deviation) <= BAR or not row.agreement >= 1 - BAR
            ]
        for loaded in self.loads:
            if loaded.found is not None and not abs(loaded.softest - loaded.found) <= BAR * abs(loaded.found):
                failed.append(
                    f"load of {loaded.force:g} N: {loaded.softest:.3f} Hz predicted, {loaded.found:.3f} Hz found"
                )
        difference = self.rest_difference()
        if not difference <= BAR:
            failed.append(f"the ground gives another wrench than is asked for, by {difference:.3f} of it")
        return failed

    def rest_difference(self) -> float:
        """Return the relative difference of requested and supplied contact wrench at rest at the wall."""
        asked, given = (trace[_resting(self.pressing)] for trace in (self.pressing.asked, self.pressing.supplied))
        return float(np.abs(asked - given).max() / np.abs(asked).max())


def _resting(trace: Trace) -> int:
    """Return the last sample before the push."""
    return int(np.searchsorted(trace.time, trials.PUSHED[0])) - 1


RUNS = DIRECTIONS * (2 + len(LOADS[::SIMULATED]))
"""Number of calls of ``rung``."""
CYCLES = 2 * CONTROL_CYCLES
"""Number of calls of ``controlled``."""


def gather(robot: ModuleType, rung: Callable[[], None], controlled: Callable[[], None]) -> Findings:
    """Run everything; the progress of the kicks, and of the control cycles at the wall."""
    loads = [
        _loaded(robot, np.array([0.0, 0.0, -force]), 1, rung if k % SIMULATED == 0 else None)
        for k, force in enumerate(LOADS)
    ]
    return Findings(
        _loaded(robot, np.zeros(3), SOFTEST, rung),
        _loaded(robot, LEANING, SOFTEST, rung),
        loads,
        at_wall(robot, supplies=True, progress=controlled),
        at_wall(robot, supplies=False, progress=controlled),
    )


def _loaded(robot: ModuleType, load: Array, softest: int, rung: Callable[[], None] | None) -> Loaded:
    """Return predicted and simulated modes under a load (3) [N]; without `rung`, predictions only."""
    stance = standing(robot, load)
    modes = stance.modes()
    without = stance.modes(stance.stiffness_without_base_term())[0].frequency
    rows: list[Row] = []
    if rung is not None:
        found = identified(stance, DURATION if modes[0].frequency > 0 else RISING, rung)
        rows = [_row(stance, mode, found) for mode in modes[:softest]]
    measured = rows[0].found.frequency if rows else None
    return Loaded(stance, -float(load[2]), modes[0].frequency, without, measured, rows)


def _row(stance: Stance, mode: Mode, found: list[identify.Found]) -> Row:
    """Return the found mode whose direction is nearest, whatever its frequency."""
    M = stance.mass_matrix()
    agreements = [identify.agreement(M, mode.direction, each.shape) for each in found]
    best = int(np.argmax(agreements))
    shares = base_shares(stance, mode)
    words = " + ".join(BASE_DIRECTIONS[k] for k in np.argsort(-shares, kind="stable") if shares[k] > 0.05)
    return Row(mode, words, found[best], agreements[best])


def tables(findings: Findings) -> str:
    """Return the report's tables as text."""
    parts = [
        _mode_table("standing, no load", findings.standing),
        _mode_table("load (2, -1.5, -35) N on the base", findings.leaning),
        _load_table(findings.loads),
        _wall_table(findings),
    ]
    return "\n\n".join(parts)


def _mode_table(title: str, loaded: Loaded) -> str:
    """Return the table of modes: predicted, found, and predicted with terms left out."""
    stance = loaded.stance
    variants = (
        stance.stiffness_without_base_term(),
        stance.contacts_without_base_term(),
        stance.without_gravity(),
    )
    others = [stance.modes(K) for K in variants]
    lines = [
        title,
        f"{'moves':14s}{'predicted':>10s}{'found':>9s}{'off':>9s}{'direction':>11s}"
        f"{'no base term':>14s}{'not in contacts':>17s}{'no gravity':>12s}",
        f"{'':14s}{'[Hz]':>10s}{'[Hz]':>9s}{'[%]':>9s}{'[0..1]':>11s}{'[Hz]':>14s}{'[Hz]':>17s}{'[Hz]':>12s}",
    ]
    for k, row in enumerate(loaded.rows):
        without = "".join(f"{each[k].frequency:{width}.3f}" for each, width in zip(others, (14, 17, 12), strict=True))
        lines.append(
            f"{row.direction:14s}{row.mode.frequency:10.3f}{row.found.frequency:9.3f}{100 * abs(row.deviation):9.2f}"
            f"{row.agreement:11.4f}{without}"
        )
    asymmetry = [float(np.abs(K - K.T).max()) for K in (stance.stiffness(), *variants[:2])]
    lines.append(
        f"largest |Kq - Kq^T|: {asymmetry[0]:g}; no base term {asymmetry[1]:.1f}; not in contacts {asymmetry[2]:.1f}"
    )
    return "\n".join(lines)


def _load_table(loads: list[Loaded]) -> str:
    """Return the table of the softest mode over the load."""
    lines = ["softest mode under a load [Hz]; below zero: growth rate / 2 pi of a fall",
             f"{'load [N]':>10s}{'predicted':>12s}{'found':>10s}{'without the base term':>24s}"]  # fmt: skip
    lines += [
        f"{loaded.force:10.0f}{loaded.softest:12.3f}{loaded.found:10.3f}{loaded.softest_without:24.3f}"
        for loaded in loads
        if loaded.found is not None
    ]
    return "\n".join(lines)


def _wall_table(findings: Findings) -> str:
    """Return the table of asked and supplied wrenches on the base, at rest on the wall."""
    trace, other = findings.pressing, findings.not_supplied
    at = _resting(trace)
    head = "".join(f"{name:>9s}" for name in ("fx", "fy", "fz", "mx", "my", "mz"))
    lines = ["three feet stand, the fourth presses on the wall; wrench on the base [N, N m]", f"{'':16s}{head}"]
    for name, values in (("law asks", trace.asked[at]), ("ground gives", trace.supplied[at])):
        lines.append(f"{name:16s}" + "".join(f"{value + 0.0:9.3f}" for value in np.round(values, 3)))
    away = [1000 * float(np.linalg.norm(each.base[at] - each.base[0])) for each in (trace, other)]
    normal = float(trace.ground[at, 1:, 2].min())
    lines.append(
        f"wall {-trace.wall[at, 0]:.3f} N; least normal force of a foot {normal:.2f} N; "
        f"base moved {away[0]:.1f} mm, {away[1]:.1f} mm where the legs do not give it"
    )
    return "\n".join(lines)
