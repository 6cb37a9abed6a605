# SPDX-License-Identifier: MIT
"""Run Frama-C's value analysis (Eva) and read its results: alarms, loops not unrolled, calls that return."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stiffgen.lab.prove.tools import Provers, run

_UNROLLED = 4000
"""Largest number of unrolled rounds: the longest loop, over the words of the controller's state, has some 1000."""

_PROVED = ("Valid", "Considered valid", "Dead", "Valid but dead")
"""Status of a property that holds: by proof, by the specification of libc, or because it is not reachable."""


_REFUTED = "Invalid"
"""Beginning of the status of a property that fails wherever it is reached."""


@dataclass(frozen=True)
class Alarm:
    """Property that is not proved. ``is_sure``: it fails for every input that reaches its statement."""

    text: str
    is_sure: bool = False


@dataclass(frozen=True)
class Findings:
    """Results of a run.

    ``alarms``: C function -> properties that are not proved. ``reached``: C functions analysed. ``loops``: places where
    rounds were merged, so that no bound on their number is known. ``returned``: entries whose calls return.
    ``trouble``: reason for a missing result.
    """

    seconds: float
    alarms: dict[str, list[Alarm]] = field(default_factory=dict)
    reached: frozenset[str] = frozenset()
    loops: tuple[str, ...] = ()
    returned: frozenset[str] = frozenset()
    trouble: str = ""

    def open_ends(self, entries: Sequence[str]) -> list[Alarm]:
        """Return the loops and the entries that are not known to end."""
        loops = [f"{place}: this loop's rounds are not known to be bounded" for place in self.loops]
        calls = [f"{entry} is not known to return" for entry in entries if entry not in self.returned]
        return [Alarm(text) for text in (*loops, *([] if self.trouble else calls))]


def _alarms(table: Path, by_contract: Sequence[str]) -> dict[str, list[Alarm]]:
    """Return what Frama-C's report leaves unproved, by function; postconditions of contracts are taken for granted."""
    alarms: dict[str, list[Alarm]] = {}
    with table.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file, delimiter="\t"):
            kind, status = row["property kind"], row["status"]
            is_assumed = kind == "postcondition" and row["function"] in by_contract
            if status in _PROVED or is_assumed or kind in ("assigns clause", "from clause"):
                continue
            text = f"{row['file']}:{row['line']}: {kind}: {row['property']}"
            alarms.setdefault(row["function"], []).append(Alarm(text, status.startswith(_REFUTED)))
    return alarms


def analyse(
    provers: Provers,
    folder: Path,
    source: str,
    includes: Sequence[Path],
    timeout: float,
    *,
    entry: str = "main",
    rounds: int = 0,
    apart: Sequence[str] = (),
    by_contract: Sequence[str] = (),
    by_code: Sequence[str] = (),
) -> Findings:
    """Analyse the file ``source`` in ``folder`` from ``entry`` on.

    Args:
        provers: the programs.
        folder: folder of the harness, and of the files that the run leaves.
        source: file name of the harness.
        includes: folders of headers.
        timeout: in seconds of wall clock.
        entry: the function to begin with.
        rounds: least number of unrolled rounds of every loop, with or without a known bound.
        apart: functions whose branches are analysed separately.
        by_contract: functions that are replaced by their contract.
        by_code: functions whose calls are analysed separately for result 0 and for others.

    """
    table = folder / f"{source}_{entry}.csv"
    table.unlink(missing_ok=True)
    # Without __GNUC__ Frama-C reads its own headers and the folder's plain C: no vectors, no pragmas.
    flags = " ".join(["-DSTIFFGEN_NO_VECTORS", "-U__GNUC__", *(f"-I{each}" for each in includes)])
    command = [provers.frama_c, "-eva", str(folder / source), "-main", entry, "-machdep", "gcc_x86_64"]
    command += [f"-cpp-extra-args={flags}", "-warn-special-float", "none"]  # NaN and infinity are ordinary values
    command += ["-eva-auto-loop-unroll", str(_UNROLLED), "-eva-min-loop-unroll", str(rounds)]
    command += ["-eva-show-progress", "-eva-split-return", "auto"]
    for option, functions in (
        ("-eva-slevel-function", [f"{each}:200" for each in apart]),
        ("-eva-use-spec", by_contract),
        ("-eva-split-return-function", [f"{each}:0" for each in by_code]),
    ):
        command += [option, ",".join(functions)] if functions else []
    command += ["-eva-msg-key=-initial-state,-final-states", "-then", "-report-csv", str(table)]
    result = run(command, folder, timeout)
    if result.timed_out:
        return Findings(result.seconds, trouble=f"none within {timeout:.0f} s")
    if "[eva:summary]" not in result.text or not table.exists():
        lines = [line for line in result.text.splitlines() if "rror" in line]
        return Findings(result.seconds, trouble="Frama-C gave up: " + "; ".join(lines[:3]))
    # The report may break a line between the place and its message.
    text = re.sub(r"\n {2,}", " ", result.text)
    return Findings(
        seconds=result.seconds,
        alarms=_alarms(table, by_contract),
        reached=frozenset(re.findall(r"computing for function (\w+)", text)),
        loops=tuple(re.findall(r"\[eva\] (?:\S*/)?(\S+?): +starting to merge loop iterations", text)),
        returned=frozenset(re.findall(r"Frama_C_show_each_returned_(\w+):", text)),
    )
