# SPDX-License-Identifier: MIT
"""Runs of ESBMC, the bounded model checker, on one harness."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from stiffgen.prove.tools import Tools, run
from stiffgen.prove.verdict import Outcome

_UNWOUND = 2000
"""Rounds after which a loop counts as unbounded; that it ends before is one of the properties."""


def check(
    tools: Tools, source: Path, includes: Sequence[Path], timeout: float, *, entry: str, solver: str
) -> tuple[Outcome, float, str]:
    """Outcome, processor time and what failed of a harness, doubles in IEEE arithmetic.

    Args:
        tools: the programs.
        source: the harness.
        includes: folders of headers and sources.
        timeout: in seconds of wall clock.
        entry: the function to begin with.
        solver: which of ESBMC's decides the formula.

    """
    command = [
        *(tools.esbmc, str(source), *(f"-I{each}" for each in includes)),
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
        return "unproved", result.seconds, f"no answer within {timeout:.0f} s"
    if "VERIFICATION SUCCESSFUL" in result.said:
        return "proved", result.seconds, ""
    failed = re.findall(r"^\s*FAILED\s+(.+)$", result.said, re.MULTILINE)
    if "VERIFICATION FAILED" in result.said:
        return "FAILED", result.seconds, "; ".join(" ".join(each.split()) for each in failed[:3])
    lines = [line for line in result.said.splitlines() if "ERROR" in line or "rror:" in line]
    return "unproved", result.seconds, f"ESBMC gave up: {'; '.join(lines[:2]) or result.said[-200:].strip()}"
