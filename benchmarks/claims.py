# SPDX-License-Identifier: MIT
"""Sentences about speed that pages may say: those of the last run, word for word."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

from benchmarks.compiled import Timed
from benchmarks.tools import HERE, NATIVE, Row

HEADING = "## What pages may claim"
PAGES = ("README.md", "docs/paper/paper.md")
"""Pages that repeat sentences of the section, each on lines of its own."""
WIDTH = 132
"""Characters of a line of the pages."""


def claims(timed: Timed, single: list[Row], pinocchio: str) -> list[str]:
    """Return the sentences: cycles and nanoseconds of this run, ratios within it.

    Args:
        timed: contenders along a path, where the processor foresees the branches of other code than ours.
        single: rows of one call from Python.
        pinocchio: version of the wheel.

    """
    ns = {name: median for name, median, *_ in timed.rows}
    us = {name: median for name, median, *_ in single}
    own = _least(ns, "stiffgen; ")
    call, many = ns[own], _least(ns, "stiffgen batch; ")

    def times(prefix: str) -> str:
        return f"{min(value for name, value in ns.items() if name.startswith(prefix)) / call:.1f}"

    found = [
        f"One joint stiffness of an iiwa 14 takes {_cycles(timed, own)}.",
        f"In a batch, one configuration takes {_cycles(timed, many)}.",
        f"Seven sines and cosines of the C library take {times('7 libm sincos')} times as long as a joint stiffness, "
        f"CasADi's C of the same formula {times('CasADi C, closed form')} times, and its differentiation "
        f"{times('CasADi C, differentiated')} times.",
    ]
    if any(name.startswith("Pinocchio C++") for name in ns):
        found.append(
            f"The same matrix from the frame Hessian of Pinocchio {pinocchio}, compiled alike, takes "
            f"{times('Pinocchio C++')} times as long."
        )
    python, product = us["stiffgen"], us["numpy.matmul of two 7x7"]
    found.append(
        f"One call from Python takes {python:.1f} us, {python / product:.1f} times NumPy's product of two 7 x 7 arrays."
    )
    return found


def _least(ns: dict[str, float], prefix: str) -> str:
    """Return the fastest contender that is compiled for the machine."""
    return min((name for name in ns if name.startswith(prefix) and name.endswith(NATIVE)), key=lambda name: ns[name])


def _cycles(timed: Timed, name: str) -> str:
    ns = next(median for row, median, *_ in timed.rows if row == name)
    if name not in timed.cycles:
        return f"{ns:.0f} ns"
    share = timed.share(name)
    bound = "" if share is None else f"; its instructions need {100 * share:.0f} % of them at least"
    return f"{timed.cycles[name]:.0f} cycles ({ns:.0f} ns at {timed.gigahertz:.1f} GHz){bound}"


def section(found: list[str]) -> list[str]:
    """Return the section of RESULTS.md."""
    return [HEADING, "", *(f"* {sentence}" for sentence in found), ""]


def stated(text: str) -> list[str]:
    """Return the sentences of a RESULTS.md."""
    part = text.partition(f"{HEADING}\n")[2].partition("\n## ")[0]
    return re.findall(r"^\* (.*)$", part, re.MULTILINE)


def renew(before: list[str], after: list[str], root: Path = HERE.parent) -> list[str]:
    """Put the new sentences where pages have the old ones, each on lines of its own; return the pages that changed."""
    changed = []
    for page in PAGES:
        text = new = (root / page).read_text()
        for old, sentence in zip(before, after, strict=False):
            words = r"\s+".join(map(re.escape, old.split()))
            for bullet, indent in (("* ", "  "), ("", "")):
                wrapped = textwrap.fill(bullet + sentence, WIDTH, subsequent_indent=indent, break_on_hyphens=False)
                pattern = re.compile(f"^{re.escape(bullet)}{words}$", re.MULTILINE)
                found = pattern.search(new)
                new = new if found is None else new[: found.start()] + wrapped + new[found.end() :]
        if new != text:
            (root / page).write_text(new)
            changed.append(page)
    return changed
