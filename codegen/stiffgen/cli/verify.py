# SPDX-License-Identifier: MIT
"""The command ``verify``: a folder against independent references."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from types import ModuleType

from rich.table import Table

from stiffgen.cli.arguments import natural, positive
from stiffgen.cli.console import Progress, messages, print_table, table, tables
from stiffgen.cli.folders import add_folder_or_robot, chosen_folder
from stiffgen.cli.kinds import check_kinds, lacking_kinds
from stiffgen.core.errors import StiffgenError, listed
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.opened import open_robot
from stiffgen.core.verify.result import Check
from stiffgen.core.verify.verify import default_count, verify
from stiffgen.rooms import optional


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_folder_or_robot(command, is_optional=True)
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
        "--kinds", action="store_true", help="all kernels on the smallest robot of every kind; ROBOT may be left out"
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
    has_report = page is not None and options.report is not None
    if page is not None and options.evidence and not has_report:
        raise StiffgenError("--evidence fills the page; add --report FILE.html")
    if options.source is None:
        return _run_kinds_alone(options)
    folder = chosen_folder(options)
    urdf = options.urdf or (Path(options.source) if options.source.endswith(".urdf") else None)
    proofs, targets = _checked_evidence(page, options, folder) if page is not None else (None, None)
    checks = _checks(options, folder, urdf)
    chain = open_robot(folder).chain
    _print_verdict(checks, urdf, [] if options.kinds else lacking_kinds(chain))
    if page is not None and has_report:
        page.write_page(
            folder,
            checks,
            options.report,
            postures=options.samples[0] or default_count(chain),
            seed=options.samples[1],
            urdf=urdf,
            proofs=proofs,
            targets=targets,
        )
        print(options.report)
    return 0 if all(check.passed for check in checks) else 1


def _checks(options: argparse.Namespace, folder: Path, urdf: Path | None) -> list[Check]:
    """Return the comparisons of a folder and, with --kinds, of the smallest robots."""
    trusts = options.trust_potentials or _asks(folder)
    count, seed = options.samples
    with Progress(messages(wide=False)).shown() as progress:
        checks = verify(
            folder,
            urdf=urdf,
            count=count,
            seed=seed,
            trust_potentials=trusts,
            other_version=options.other_version,
            progress=progress,
        )
        return checks + check_kinds(seed=seed, progress=progress) if options.kinds else checks


def _run_kinds_alone(options: argparse.Namespace) -> int:
    """Compare all kernels on the smallest robots; return 1 if a comparison fails."""
    if not options.kinds:
        raise StiffgenError("verify what? Give a robot's folder or file, or --kinds")
    with Progress(messages(wide=False)).shown() as progress:
        checks = check_kinds(seed=options.samples[1], progress=progress)
    _print_verdict(checks, Path(), [])
    return 0 if all(check.passed for check in checks) else 1


def _print_verdict(checks: list[Check], urdf: Path | None, lacking: list[str]) -> None:
    """Print what was found. A terminal ends with the verdict; elsewhere each comparison follows as a row of a table."""
    console = tables()
    if console.is_terminal:
        if lacking:
            print(f"{len(lacking)} kinds of robots that this is none of: --kinds compares all kernels on them")
        _print_omissions(urdf, [])
        print("each comparison: pipe the output, as in 'stiffgen verify ROBOT | less'")
        _print_summary(checks)
        return
    _print_summary(checks)
    _print_omissions(urdf, lacking)
    print()
    print_table(console, _check_table(checks))


def _print_omissions(urdf: Path | None, lacking: list[str]) -> None:
    """Print what was not compared: the URDF, and kinds of robots that this robot is not of."""
    if urdf is None:
        print("URDF not checked (name it behind the folder)")
    if lacking:
        print(f"Not of this robot: {', '.join(lacking)} (--kinds compares all kernels on them)")


def _print_summary(checks: list[Check]) -> None:
    """Print how many comparisons passed, and what failed or was not compared."""
    within = sum(check.verdict == "ok" for check in checks)
    missing = sum(not check.is_compared for check in checks)
    print(f"{within} of {len(checks)} comparisons within their bound" + (f", {missing} not compared" * bool(missing)))
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
