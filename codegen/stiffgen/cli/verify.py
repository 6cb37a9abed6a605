# SPDX-License-Identifier: MIT
"""The command ``verify``: a folder against independent references."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from types import ModuleType

from rich.table import Table

from stiffgen.cli.arguments import natural, positive
from stiffgen.cli.console import Progress, messages, table, tables
from stiffgen.cli.folders import add_folder_or_robot, chosen_folder
from stiffgen.core.errors import StiffgenError, listed
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.result import Check
from stiffgen.core.verify.verify import default_count, verify
from stiffgen.rooms import optional


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder_or_robot(command)
    command.add_argument(
        "urdf",
        nargs="?",
        type=Path,
        metavar="URDF",
        help="read the robot's file again and compare the chain (default: ROBOT, if that is a URDF)",
    )
    command.add_argument(
        "--samples",
        type=_count_and_seed,
        default=(None, 0),
        metavar="COUNT[,SEED]",
        help="number of random configurations (default: 200 up to 7 joints, fewer for more), and their seed (0)",
    )
    command.add_argument(
        "--trust-potentials", action="store_true", help="run the source of potentials in manifest.json [ask]"
    )
    command.add_argument(
        "--other-version", action="store_true", help="accept that the text of another version is not compared"
    )
    command.set_defaults(run=run, report=None)
    if optional("lab.prove.safety_page") is not None:
        command.add_argument("--report", type=Path, metavar="FILE.html", help="write the evidence as one page")
        command.add_argument(
            "--evidence",
            type=Path,
            action="append",
            default=[],
            metavar="FILE",
            help="verdicts of 'stiffgen prove --json', or measurements on other processors; repeatable",
        )


def _count_and_seed(text: str) -> tuple[int | None, int]:
    """Return the number of configurations and the seed."""
    count, _, seed = text.partition(",")
    return positive(count), natural(seed or "0")


def run(options: argparse.Namespace) -> int:
    """Verify a robot; return 1 if a comparison fails, or cannot be made and that is not accepted."""
    page = optional("lab.prove.safety_page")  # None if the room has been taken out, with its options
    if page is not None and options.report is None and options.evidence:
        raise StiffgenError("--evidence fills the page; add --report FILE.html")
    folder = chosen_folder(options)
    urdf = Path(options.source) if options.urdf is None and options.source.endswith(".urdf") else options.urdf
    proofs, targets = _checked_evidence(page, options, folder) if page is not None else (None, None)
    trusts = options.trust_potentials or _asks(folder)
    with Progress(messages(wide=False)).shown() as progress:
        checks = verify(
            folder,
            urdf=urdf,
            count=options.samples[0],
            seed=options.samples[1],
            trust_potentials=trusts,
            other_version=options.other_version,
            progress=progress,
        )
    failed = [check for check in checks if not check.passed]
    _print_summary(checks, compares_urdf=urdf is not None)
    print()
    tables().print(_check_table(checks))
    if page is not None and options.report is not None:
        page.write_page(
            folder,
            checks,
            options.report,
            postures=options.samples[0] or default_count(open_robot(folder).chain),
            seed=options.samples[1],
            urdf=urdf,
            proofs=proofs,
            targets=targets,
        )
        print(options.report)
    return 1 if failed else 0


def _print_summary(checks: list[Check], *, compares_urdf: bool) -> None:
    """Print counts, and what failed or was not compared."""
    within = sum(check.verdict == "ok" for check in checks)
    missing = sum(not check.is_compared for check in checks)
    print(f"{within} of {len(checks)} comparisons within their bound" + (f", {missing} not compared" * bool(missing)))
    if not compares_urdf:
        print("URDF not checked (name it behind the folder)")
    for check in checks:
        if check.verdict != "ok":
            word = check.verdict if check.verdict == "FAILED" else "NOT COMPARED"
            print(f"{word} {check.kernel}, {check.oracle}" + (f": {check.detail}" if check.detail else ""))


def _asks(folder: Path) -> bool:
    """Return whether a person at the terminal lets the potentials of a folder run; False where nobody can answer."""
    names = [each.name for each in open_robot(folder).springs.potentials]
    if not names or not sys.stdin.isatty():
        return False
    print(f"Verification runs the Python source of {listed(names)} in {folder / MANIFEST}. Run it? [y/N] ", end="")
    return input().strip().lower() in ("y", "yes")


def _checked_evidence(page: ModuleType, options: argparse.Namespace, folder: Path) -> tuple[Path | None, Path | None]:
    """Return the files of verdicts and measurements; refuse what the page cannot show, before the long part."""
    proofs, targets = page.divided(options.evidence)
    if options.report is not None:
        open_robot(folder).require_doubles("the page of --report")
    if proofs is not None:
        page.filed_for(open_robot(folder), proofs)
    if targets is not None:
        page.targets_for(open_robot(folder), targets)
    return proofs, targets


def _check_table(checks: list[Check]) -> Table:
    """Return a row per comparison."""
    shown = table(
        "kernel", "verified against", "worst relative error", "bound", "", right=("worst relative error", "bound")
    )
    for check in checks:
        numbers = (f"{check.error:.1e}", f"{check.bound:.0e}") if check.is_compared else ("", "")
        shown.add_row(check.kernel, check.oracle, *numbers, check.verdict)
    return shown
