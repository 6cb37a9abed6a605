# SPDX-License-Identifier: MIT
"""The command ``prove``: properties of a folder's C for all inputs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from stiffgen.cli.arguments import add_folder
from stiffgen.cli.console import Progress, messages, table, tables
from stiffgen.lab.prove.run import PARTS, prove
from stiffgen.lab.prove.verdict import EXIT_CODES, Outcome, worst_outcome


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder(command)
    command.add_argument(
        "claims",
        nargs="*",
        metavar="PART|KERNEL",
        help=f"parts to prove, of {', '.join(PARTS)}, and kernels (default: all)",
    )
    command.add_argument(
        "--timeout", type=float, default=300.0, metavar="S", help="time limit per function [s] (default: 300)"
    )
    command.add_argument("--json", type=Path, metavar="FILE", help="write the verdicts")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the provers on a folder; return 1 if a claim is refuted, else 3 if one is not proved."""
    with Progress(messages(wide=False)).shown() as progress:
        verdicts = prove(
            options.folder,
            parts=tuple(part for part in PARTS if part in options.claims) or PARTS,
            only=tuple(claim for claim in options.claims if claim not in PARTS),
            timeout=options.timeout,
            json=options.json,
            progress=progress,
        )
    shown = table("function", "for all inputs", "by", "time [s]", "", right=("time [s]",))
    for each in verdicts:
        shown.add_row(each.function, each.claims, each.tool, f"{each.seconds:.1f}", each.outcome)
    tables().print(shown)
    tally = {outcome: sum(each.outcome == outcome for each in verdicts) for outcome in get_args(Outcome)}
    for each in verdicts:
        if each.outcome != "proved":
            print(f"{each.outcome}: {each.function}, by {each.tool}: {each.detail}")
    print(", ".join(f"{count} {outcome}" for outcome, count in tally.items()))
    if options.json is not None:
        print(options.json)
    return EXIT_CODES[worst_outcome(verdicts)]
