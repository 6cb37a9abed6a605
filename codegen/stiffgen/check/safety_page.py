# SPDX-License-Identifier: MIT
"""The page of ``stiffgen verify DIR --report FILE.html``: what a folder claims, and the evidence, for a safety file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from stiffgen.check.prove.verdict import Filed, Verdict, read_verdicts
from stiffgen.check.result import BOUND, Array, Check
from stiffgen.emit.controller import has_controller
from stiffgen.errors import OutputError
from stiffgen.opened import GeneratedRobot, open_robot
from stiffgen.page import STYLE
from stiffgen.rendering import environment

_DECADES = (-18, -8)
"""Powers of ten that errors are drawn over."""
_PER_DECADE = 4

_CONTRACTS = (
    ("Every result is what its equation says", "the comparisons below, each against an oracle of its own"),
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
class _Bar:
    x: float
    height: float
    title: str


def write_page(
    folder: str | Path,
    checks: Sequence[Check],
    file: Path,
    *,
    postures: int,
    seed: int,
    urdf: Path | None,
    proofs: Path | None = None,
    date: str | None = None,
) -> None:
    """Write the page.

    Args:
        folder: the robot's folder.
        checks: what ``verify`` found.
        file: where to write.
        postures: random ones that were asked for.
        seed: of these.
        urdf: the file that the chain was compared with, or None.
        proofs: the verdicts' file of ``stiffgen prove DIR --json FILE``, or None.
        date: a date to print, or None: then the page has none.

    Raises:
        OutputError: ``file`` cannot be written, ``proofs`` cannot be read or is about other C files.

    """
    robot = open_robot(folder)
    filed = filed_for(robot, proofs) if proofs is not None else None
    page = (
        environment("stiffgen.check", escaped=True)
        .get_template("safety.html.j2")
        .render(
            style=Markup(STYLE),
            robot=robot,
            manifest=robot.manifest,
            versions=dict(robot.manifest["versions"]) | {"checked with numpy": version("numpy")},
            digests=robot.manifest["files"],
            postures=postures,
            seed=seed,
            urdf=urdf.name if urdf is not None else None,
            date=date,
            checks=checks,
            failed=[check for check in checks if not check.passed],
            groups=_groups(checks),
            least=_DECADES[0],
            most=_DECADES[1],
            bound=(math.log10(BOUND) - _DECADES[0]) / (_DECADES[1] - _DECADES[0]),
            contracts=_CONTRACTS,
            filed=filed,
            tally=_tally(filed.verdicts) if filed else {},
            rounding=_rounding(robot.manifest.get("rounding")),
            ranges=", ".join(
                f"{name} {value:g}" for name, value in robot.manifest.get("rounding", {}).get("ranges", {}).items()
            ),
            uncovered=_uncovered(robot, filed, urdf is not None),
        )
    )
    try:
        file.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{file}: cannot be written ({error.strerror}); give another --report") from error


def filed_for(robot: GeneratedRobot, proofs: Path) -> Filed:
    """Verdicts that are about the C in the robot's folder, byte for byte.

    Raises:
        OutputError: the file cannot be read, or is about other bytes.

    """
    filed = read_verdicts(proofs)
    for source, digest in filed.sources.items():
        try:
            same = hashlib.sha256((robot.folder / source).read_bytes()).hexdigest() == digest
        except OSError:
            same = False
        if not same:
            raise OutputError(
                f"{proofs}: is about another {source} than {robot.folder} has; run 'stiffgen prove' again"
            )
    return filed


def _tally(verdicts: Sequence[Verdict]) -> dict[str, int]:
    return {outcome: sum(each.outcome == outcome for each in verdicts) for outcome in ("proved", "FAILED", "unproved")}


def _groups(checks: Sequence[Check]) -> list[tuple[str, int, float, list[_Bar]]]:
    """Oracle, number of samples, worst error and the histogram of all errors held against it."""
    by_oracle: dict[str, list[Array]] = {}
    for check in checks:
        if check.errors is not None and len(check.errors):
            by_oracle.setdefault(check.oracle, []).append(check.errors)
    groups = []
    for oracle, parts in by_oracle.items():
        errors = np.concatenate(parts)
        groups.append((oracle, len(errors), float(errors.max()), _bars(errors)))
    return groups


def _bars(errors: Array) -> list[_Bar]:
    """Bars over the decimal logarithm; 0 and what is less than the least decade stands in the first bar."""
    bins = (_DECADES[1] - _DECADES[0]) * _PER_DECADE
    finite = errors[np.isfinite(errors)]
    places = np.floor((np.log10(np.maximum(finite, 10.0 ** _DECADES[0])) - _DECADES[0]) * _PER_DECADE).astype(int)
    counts = np.bincount(np.clip(places, 0, bins - 1), minlength=bins)
    top = max(int(counts.max()), 1)
    return [
        _Bar(k / bins, float(count) / top, f"{count} from 1e{_DECADES[0] + k / _PER_DECADE:g} on")
        for k, count in enumerate(counts)
        if count
    ]


def _rounding(bounds: Any) -> list[tuple[str, str, str]]:
    """Function, part of its result and bound, from the manifest's bounds; none of an older folder."""
    if bounds is None:
        return []
    return [
        (kernel, each["what"], f"{each['bound']:.1e} {each['unit']}")
        for kernel, parts in bounds["bounds"].items()
        for each in parts
    ]


def _uncovered(robot: GeneratedRobot, filed: Filed | None, compared: bool) -> list[str]:
    """What this page does not show, for the reader who has to show it otherwise."""
    lines = [
        "Comparisons are at random postures and the sizes of wrench and stiffness that stiffgen draws; they prove "
        "nothing of the values in between. A worst error is the worst one met.",
        "Whether the URDF describes the arm that is bolted to the floor: masses, dimensions, limits and the tool.",
        "The compiler, its flags, libm, the processor and the operating system of the machine that runs the arm.",
        "Hardware faults, timing on the target, the robot's own controller, and everything that calls these functions.",
        "A hazard analysis of the application. docs/controller.md has the controller's own safety case.",
    ]
    if not compared:
        lines.insert(1, "The chain is the manifest's: the URDF was not read again (--urdf).")
    if filed is None:
        lines.insert(0, "Proofs: none were given (stiffgen prove DIR --json FILE, then --proofs FILE).")
    else:
        lines.insert(
            0,
            "Proofs are about the C text, not about what a compiler made of it; docs/proofs.md lists what they take "
            "for granted.",
        )
        lines += [
            f"Not proved: {each.function}: {each.claims} ({each.detail})"
            for each in filed.verdicts
            if each.outcome != "proved"
        ]
    if has_controller(robot.chain):
        lines.append(
            "That the closed loop is stable on the arm: the controller's theorem has assumptions, which "
            "docs/controller.md lists."
        )
    return lines
