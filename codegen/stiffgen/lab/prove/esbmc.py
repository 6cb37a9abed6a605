# SPDX-License-Identifier: MIT
"""Run ESBMC, the bounded model checker, on one harness."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from stiffgen.lab.prove.tools import Provers, run
from stiffgen.lab.prove.verdict import Outcome

_UNWOUND = 2000
"""Number of rounds from which a loop counts as unbounded; one property is that the loop ends before."""


def check(
    provers: Provers, source: Path, includes: Sequence[Path], timeout: float, *, entry: str, solver: str
) -> tuple[Outcome, float, str]:
    """Return outcome, processor time and failed claims of a harness, with doubles in IEEE arithmetic.

    Args:
        provers: the programs.
        source: the harness.
        includes: folders of headers and sources.
        timeout: in seconds of wall clock.
        entry: the function to begin with.
        solver: the solver of ESBMC that decides the formula.

    """
    command = [
        *(provers.esbmc, str(source), *(f"-I{each}" for each in includes)),
        *(
            "-DSTIFFGEN_NO_VECTORS",
            "--unwind",
            str(_UNWOUND),
            f"--{solver}",
            "--floatbv",
            "--quiet",
            "--color",
            "never",
        ),
        *("--no-div-by-zero-check", "--ub-shift-check", "--function", entry),  # 1.0 / 0.0 is a number of IEEE
    ]
    result = run(command, source.parent, timeout)
    if result.timed_out:
        return "no answer", result.seconds, f"none within {timeout:.0f} s"
    if "VERIFICATION SUCCESSFUL" in result.text:
        return "proved", result.seconds, ""
    failed = re.findall(r"^\s*FAILED\s+(.+)$", result.text, re.MULTILINE)
    if "VERIFICATION FAILED" in result.text:
        return "refuted", result.seconds, "; ".join(" ".join(each.split()) for each in failed[:3])
    lines = [line for line in result.text.splitlines() if "ERROR" in line or "rror:" in line]
    return "no answer", result.seconds, f"ESBMC gave up: {'; '.join(lines[:2]) or result.text[-200:].strip()}"
