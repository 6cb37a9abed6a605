# SPDX-License-Identifier: MIT
"""Write the page of ``stiffgen verify DIR --report FILE.html``: a folder's claims and evidence, for a safety file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

import numpy as np
from markupsafe import Markup

from stiffgen.core.errors import OutputError, listed
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.rendering import environment
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.verify.result import NO_ORACLE, Check
from stiffgen.families.rounding.certified import CERTIFIED
from stiffgen.lab.page import POLICY, STYLE
from stiffgen.lab.prove.targets import Target, read_targets
from stiffgen.lab.prove.verdict import Outcome, Verdict, VerdictFile, read_content, read_verdicts

_BELOW, _ABOVE = 6, 4
"""Decades of the plots below and above the bound."""
_PER_DECADE = 4

_CONTRACTS = (
    ("Every result is what its equation says", "the comparisons below; functions without an oracle are named below"),
    (
        "Rounding errors stay below the bounds of header and manifest, for all inputs in their ranges",
        f"the analysis (docs/guarantees.md), done again; rows '{CERTIFIED}' hold the compiled functions to it",
    ),
    (
        "Accesses stay in their arrays, nothing uninitialised is read, no undefined behaviour, loops are bounded, "
        "arguments are not written, claimed symmetries hold to the last bit: for all inputs",
        "proofs",
    ),
    (
        "NaN or infinity in gives NaN out, in every entry that depends on it",
        "rows 'NaN and infinity in' of the comparisons",
    ),
    ("Batches give what single calls give", "rows on batches and stacks"),
    ("Files are the generator's, unchanged", "rows on files and tables: SHA-256 against the manifest"),
    (
        "Compiled with flags that keep the arithmetic",
        "the self-check, run when the folder was compiled; flags that can be seen are refused by the source",
    ),
    (
        "Allocation-free, reentrant, deterministic, no library but libm",
        "by construction: no allocation, no object that changes, no call but libm's in the printed C; tested by "
        "stiffgen's own tests, not by this report",
    ),
)


@dataclass(frozen=True)
class _ErrorHistogram:
    """Histogram of all errors relative to an oracle.

    ``count`` is the number of errors, ``worst`` the largest. The first of the ``bars``, each a number of errors, begins
    at the decimal logarithm ``least`` and takes what is smaller, too.
    """

    oracle: str
    count: int
    worst: float
    least: int
    bars: list[int]


def write_page(
    folder: str | Path,
    checks: Sequence[Check],
    file: Path,
    *,
    postures: int,
    seed: int,
    urdf: Path | None,
    proofs: Path | None = None,
    targets: Path | None = None,
) -> None:
    """Write the page of evidence as HTML.

    Args:
        folder: the robot's folder.
        checks: results of ``verify``.
        file: where to write.
        postures: requested number of random configurations.
        seed: of the random generator.
        urdf: the file that the chain was compared with, or None.
        proofs: the verdicts' file of ``stiffgen prove DIR --json FILE``, or None.
        targets: measurements on other machines (docs/guarantees.md), or None.

    Raises:
        OutputError: ``file`` cannot be written, ``proofs`` or ``targets`` cannot be read or are about other C files.

    """
    robot = open_robot(folder)
    filed = filed_for(robot, proofs) if proofs is not None else None
    machines = targets_for(robot, targets) if targets is not None else ()
    template = environment("stiffgen.lab.prove", escaped=True).get_template("safety.html.j2")
    page = template.render(
        policy=POLICY,
        style=Markup(STYLE),
        robot=robot,
        manifest=robot.manifest,
        versions=dict(robot.manifest["versions"]) | {"checked with numpy": version("numpy")},
        digests=robot.manifest["files"],
        postures=postures,
        seed=seed,
        urdf=urdf.name if urdf is not None else None,
        checks=checks,
        failed=[check for check in checks if check.verdict != "ok"],
        plots=_plots(checks),
        decades=_BELOW + _ABOVE,
        below=_BELOW,
        per_decade=_PER_DECADE,
        contracts=_CONTRACTS,
        filed=filed,
        tally=_tally(filed.verdicts) if filed else {},
        rounding=_rounding(robot.manifest.get("rounding"), checks),
        targets=machines,
        ranges=_ranges(robot),
        uncovered=_uncovered(checks, robot, filed, machines, compared=urdf is not None),
    )
    _write(file, page)


def _ranges(robot: GeneratedRobot) -> str:
    """Return the ranges of arguments for which the folder states rounding bounds, as text."""
    ranges = robot.manifest.get("rounding", {}).get("ranges", {})
    return ", ".join(f"{name} {value:g}" for name, value in ranges.items())


def _write(file: Path, page: str) -> None:
    try:
        file.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{file}: cannot be written ({error.strerror}); give another --report") from error


def divided(files: Sequence[Path]) -> tuple[Path | None, Path | None]:
    """Return the file of verdicts and the file of measurements among some files, each None where there is none.

    Raises:
        OutputError: two files are of one kind.

    """
    found: dict[bool, Path] = {}
    for file in files:
        of_targets = _has_targets(file)
        if of_targets in found:
            raise OutputError(f"{file}: says the same as {found[of_targets]}; give one of the two")
        found[of_targets] = file
    return found.get(False), found.get(True)


def _has_targets(file: Path) -> bool:
    """Return whether a file holds measurements; the reader of verdicts names the fault of one that cannot be read."""
    try:
        return "targets" in read_content(file)
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def filed_for(robot: GeneratedRobot, proofs: Path) -> VerdictFile:
    """Read verdicts; their C sources must equal the folder's, byte for byte.

    Raises:
        OutputError: the file cannot be read, or is about other bytes.

    """
    filed = read_verdicts(proofs)
    if filed.robot != robot.name:
        raise OutputError(f"{proofs}: is about another robot, {filed.robot!r}; run 'stiffgen prove' again")
    _must_be_of(robot, filed.sources, proofs, "run 'stiffgen prove' again")
    return filed


def targets_for(robot: GeneratedRobot, file: Path) -> tuple[Target, ...]:
    """Read measurements on other machines; their C sources must equal the folder's, byte for byte.

    Raises:
        OutputError: the file cannot be read, or is about other bytes.

    """
    sources, targets = read_targets(file)
    _must_be_of(robot, sources, file, "measure this folder again, as docs/guarantees.md says")
    return targets


def _must_be_of(robot: GeneratedRobot, filed: Mapping[str, str], file: Path, remedy: str) -> None:
    """Raise OutputError unless ``filed`` has the digest of every C source of the folder, and of nothing else."""
    present = robot.source_digests()
    for source in sorted(present.keys() | filed.keys()):
        if source not in filed:
            raise OutputError(f"{file}: has no digest of {source}, which {robot.folder} has; {remedy}")
        if filed[source] != present.get(source):
            raise OutputError(f"{file}: is about another {source} than {robot.folder} has; {remedy}")


def _tally(verdicts: Sequence[Verdict]) -> dict[str, int]:
    return {outcome: sum(each.outcome == outcome for each in verdicts) for outcome in get_args(Outcome)}


def _plots(checks: Sequence[Check]) -> list[_ErrorHistogram]:
    """Return one plot per oracle and bound."""
    grouped: dict[tuple[str, int], list[FloatArray]] = {}
    for check in checks:
        if check.errors is not None and len(check.errors):
            grouped.setdefault((check.oracle, round(math.log10(check.bound))), []).append(check.errors)
    plots = []
    for (oracle, bound), parts in grouped.items():
        errors, least = np.concatenate(parts), bound - _BELOW
        plots.append(_ErrorHistogram(oracle, len(errors), float(errors.max()), least, _bars(errors, least)))
    return plots


def _bars(errors: FloatArray, least: int) -> list[int]:
    """Return the errors per bar over the decimal logarithm; the first bar has 0 and values below the least decade."""
    bins = (_BELOW + _ABOVE) * _PER_DECADE
    finite = errors[np.isfinite(errors)]
    places = np.floor((np.log10(np.maximum(finite, 10.0**least)) - least) * _PER_DECADE).astype(int)
    return [int(count) for count in np.bincount(np.clip(places, 0, bins - 1), minlength=bins)]


def _rounding(bounds: Any, checks: Sequence[Check]) -> list[tuple[str, str, str, str]]:
    """Return function, part of its result, bound, and its largest used fraction; nothing for an older folder."""
    if bounds is None:
        return []
    met = {check.kernel: f"{check.error:.1e}" for check in checks if check.oracle == CERTIFIED}
    return [
        (
            kernel,
            each["what"],
            f"{each['bound']:.1e} {each['unit']}" if each["bound"] else "exact but for underflow",
            met.get(kernel, "") if k == 0 else "",
        )
        for kernel, parts in bounds["bounds"].items()
        for k, each in enumerate(parts)
    ]


def _varying_times(targets: Sequence[Target]) -> list[str]:
    """Return a sentence about the functions whose instructions depend on the input, for the machines that share it."""
    varying: dict[str, list[str]] = {}
    for target in targets:
        if target.varying:
            varying.setdefault(listed(target.varying), []).append(target.machine)
    return [
        f"A constant time of {functions}: how many instructions they take depends on the input ({listed(machines)})."
        for functions, machines in varying.items()
    ]


def _uncovered(
    checks: Sequence[Check],
    robot: GeneratedRobot,
    filed: VerdictFile | None,
    targets: Sequence[Target],
    *,
    compared: bool,
) -> list[str]:
    """Return the evidence that this page lacks and that a reader must find elsewhere."""
    without = [check.kernel for check in checks if check.oracle == NO_ORACLE]
    lines = [
        f"Values without an oracle, which nothing independent confirms: {listed(without)}."
        if without
        else "Values without an oracle: none.",
        "Comparisons are at random postures and the sizes of wrench and stiffness that stiffgen draws; they prove "
        "nothing of the values in between. A worst error is the worst one met.",
        "Whether the URDF describes the arm that is bolted to the floor: masses, dimensions, limits and the tool.",
        "The compiler, its flags, libm, the processor and the operating system of the machine that runs the arm.",
        "Hardware faults, time on the target, the robot's own controller, and everything that calls these functions.",
        "A hazard analysis of the application. docs/controller.md has the controller's own safety case.",
    ]
    if not compared:
        lines.insert(1, "The chain is the manifest's: the URDF was not read again.")
    if filed is None:
        lines.insert(0, "Proofs: none were given (stiffgen prove DIR --json FILE, then verify --evidence FILE).")
    else:
        lines.insert(
            0,
            "Proofs are about the C text, not about what a compiler made of it; docs/guarantees.md lists what they "
            "take for granted.",
        )
        lines += [
            f"Not proved: {each.function}: {each.claims} ({each.detail})"
            for each in filed.verdicts
            if each.outcome != "proved"
        ]
    if not targets:
        lines.append("Other machines than the one that checked: none were run (the section on targets says how).")
    lines += _varying_times(targets)
    stated = robot.manifest.get("rounding", {}).get("bounds", {})
    unbounded = [kernel.qualified_name for kernel in robot.table if kernel.qualified_name not in stated]
    if unbounded:
        lines.append(
            f"Rounding of functions that divide or choose, which have no certified bound: {listed(unbounded, 99)}."
        )
    if robot.has_controller:
        lines.append(
            "That the closed loop is stable on the arm: the controller's theorem has assumptions, which "
            "docs/controller.md lists."
        )
    return lines
