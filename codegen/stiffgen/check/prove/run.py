# SPDX-License-Identifier: MIT
"""``stiffgen prove DIR``: every proof of a folder, one after the other, and what all of them say."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from stiffgen.check.prove import esbmc, frama_c, harness
from stiffgen.check.prove.tools import Tools, find_tools
from stiffgen.check.prove.verdict import Outcome, Verdict, write_verdicts
from stiffgen.check.prove.widths import width_verdicts
from stiffgen.emit.controller import has_controller
from stiffgen.errors import OutputError, StiffgenError, listed
from stiffgen.opened import GeneratedRobot, open_robot

PARTS = ("kernels", "services", "step", "widths")
"""What can be asked for alone; services are the controller's functions but its step."""
_MEMORY = "in bounds, initialised, no undefined behaviour, loops bounded, returns"
_BITS = "in bounds, loops bounded, arguments not written"
_FRAME = ", configuration and sample not written"
_APART = ("cholesky", "pencil", "soften", "design_damping", "blind")
"""Functions of the controller whose ways are kept apart: only where one succeeds has it results, or a number room."""


@dataclass(frozen=True)
class _Job:
    robot: GeneratedRobot
    functions: list[harness.Function]
    tools: Tools
    work: Path
    timeout: float
    progress: Callable[[str], None]

    @property
    def includes(self) -> list[Path]:
        return [self.work, self.robot.folder.resolve()]


def prove(
    folder: str | Path,
    *,
    parts: Sequence[str] = PARTS,
    only: Sequence[str] = (),
    timeout: float = 300.0,
    json: str | Path | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> list[Verdict]:
    """Prove of the C of a robot's folder, for all inputs, what docs/proofs.md lists.

    Args:
        folder: what ``stiffgen generate`` wrote; it need not be compiled.
        parts: of "kernels", "services", "step" and "widths" those that are wanted.
        only: qualified names of kernels ("hybrid_joint_stiffness"), or none for all.
        timeout: for one function, in seconds of wall clock.
        json: a file for the verdicts, or None.
        progress: called with a few words before each proof.

    Returns:
        One verdict a function and kind of claim.

    Raises:
        MissingExtraError: ESBMC or Frama-C is not installed.
        OutputError: the folder is none of stiffgen's, lacks a source, or ``json`` cannot be written.
        StiffgenError: an unknown name in ``parts`` or ``only``, or a time-out that is none.

    """
    robot = open_robot(folder)
    robot.require_doubles("'stiffgen prove'")
    functions = harness.functions(robot)
    names = [each.qualified_name for each in functions]
    unknown = [each for each in only if each not in names]
    if unknown:
        raise StiffgenError(f"{listed(unknown)}: no kernel of {robot.folder}; it has {listed(names, 60)}")
    if not set(parts) <= set(PARTS) or not parts:
        raise StiffgenError(f"parts are {', '.join(PARTS)}; not {listed(list(parts)) or 'none'}")
    if not timeout > 0.0:
        raise StiffgenError(f"--timeout {timeout:g}: must be above 0 (seconds)")
    sources = _digests(robot)
    tools = find_tools()
    if json is not None and not Path(json).parent.is_dir():
        raise OutputError(f"{json}: there is no such folder; give another --json")
    chosen = [each for each in functions if not only or each.qualified_name in only]
    verdicts: list[Verdict] = []
    with tempfile.TemporaryDirectory(prefix="stiffgen-prove-") as temporary:
        job = _Job(robot, functions, tools, Path(temporary).resolve(), timeout, progress)
        if "kernels" in parts:
            verdicts += _kernels(job, chosen)
        if has_controller(robot.chain) and not only and {"services", "step"} & set(parts):
            verdicts += _controller(job, parts)
        if "widths" in parts:
            progress("vector builds, run under sanitizers")
            verdicts += width_verdicts(robot, chosen, job.work, timeout)
    if json is not None:
        write_verdicts(Path(json), robot.name, sources, tools.versions, verdicts)
    return verdicts


def _digests(robot: GeneratedRobot) -> dict[str, str]:
    """SHA-256 of the C files that proofs are about."""
    files = [f"{robot.name}.c", f"{robot.name}.h"]
    if has_controller(robot.chain):
        files += [f"{robot.name}_impedance.c", f"{robot.name}_impedance.h"]
    try:
        return {file: hashlib.sha256((robot.folder / file).read_bytes()).hexdigest() for file in files}
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be read ({error.strerror}); generate the folder again") from error


def _kernels(job: _Job, chosen: Sequence[harness.Function]) -> list[Verdict]:
    # Frama-C 25 cannot size an initialised array by a quotient; with one lane the quotient is its dividend.
    text = (job.robot.folder / f"{job.robot.name}.c").read_text(encoding="utf-8")
    (job.work / "one_lane.c").write_text(re.sub(r"\b(\d+) / LANES\b", r"\1", text), encoding="utf-8")
    entries = [each.qualified_name for each in chosen]
    entries += [f"{each.qualified_name}_batch" for each in chosen if each.batch]
    if len(chosen) == len(job.functions):
        entries.append("self_check")
    harness_file = job.work / "kernels.c"
    harness_file.write_text(harness.kernels_memory(job.robot, chosen, entries))
    job.progress(f"Frama-C: {len(entries)} kernels and batches, memory")

    def analysis(entry: str) -> frama_c.Analysis:
        limit = job.timeout * (len(entries) if entry == "main" else 1)
        return frama_c.analyse(job.tools, job.work, harness_file.name, job.includes, limit, entry=entry)

    together = analysis("main")
    clean = not (together.alarms or together.loops or together.trouble) and together.returned >= set(entries)
    verdicts = []
    for entry in entries:
        if clean:
            outcome: Outcome = "proved"
            seconds, detail = together.seconds / len(entries), ""
        else:  # which of them is it?
            job.progress(f"Frama-C: {entry}, memory")
            alone = analysis(f"prove_{entry}")
            outcome, detail = _judge(alone, [entry])
            seconds = alone.seconds
        verdicts.append(Verdict(entry, _MEMORY, "Frama-C", outcome, seconds, detail))
    for each in chosen:
        for batch in (False, True) if each.batch else (False,):
            name = each.qualified_name + ("_batch" if batch else "")
            if any(found.function == name and found.outcome == "FAILED" for found in verdicts):
                continue  # its bits mean nothing
            job.progress(f"ESBMC: {name}, bits")
            file = job.work / f"{name}.c"
            file.write_text(harness.kernel_bits(job.robot, each, batch=batch))
            outcome, seconds, detail = esbmc.check(job.tools, file, job.includes, job.timeout)
            claims = _BITS + (", symmetric to the last bit" if each.symmetric else "")
            verdicts.append(Verdict(name, claims, "ESBMC", outcome, seconds, detail))
    return verdicts


def _judge(result: frama_c.Analysis, entries: Sequence[str]) -> tuple[Outcome, str]:
    """What an analysis says of its entries: an alarm is a fault until somebody shows that it is none."""
    if result.trouble:
        return "unproved", result.trouble
    found = [alarm for each in result.alarms.values() for alarm in each]
    found += [f"{place}: this loop's rounds are not known to be bounded" for place in result.loops]
    found += [f"{entry} is not known to return" for entry in entries if entry not in result.returned]
    return (
        ("FAILED", "; ".join(found[:3]) + (f" and {len(found) - 3} more" if len(found) > 3 else ""))
        if found
        else ("proved", "")
    )


def _controller(job: _Job, parts: Sequence[str]) -> list[Verdict]:
    (job.work / "contracts.h").write_text(harness.contracts(job.robot, job.functions))
    runs: list[tuple[str, tuple[str, ...], bool]] = []
    if "services" in parts:
        runs += [("validate", ("validate",), False), ("services", harness.SERVICES, True)]
    if "step" in parts:
        runs += [(step, (step,), True) for step in harness.STEPS]
    verdicts, results = [], []
    text = (job.robot.folder / f"{job.robot.name}_impedance.c").read_text(encoding="utf-8")
    apart = [each for each in _APART if f" {each}(" in text]
    for name, entries, by_contract in runs:
        job.progress(f"Frama-C: controller, {name.replace('_', ' ')}")
        file = job.work / f"{name}.c"
        file.write_text(harness.controller(job.robot, entries, by_contract=by_contract))
        result = frama_c.analyse(
            job.tools, job.work, file.name, job.includes, 4.0 * job.timeout,
            rounds=job.robot.chain.dof + 2, apart=apart, by_contract=["validate"] if by_contract else [],
        )  # fmt: skip
        results.append((result, entries))
    seconds = sum(result.seconds for result, _ in results)
    alarms: dict[str, list[str]] = {}
    for result, entries in results:
        for function, found in result.alarms.items():
            alarms.setdefault(function, []).extend(found)
        loose = [f"{place}: this loop's rounds are not known to be bounded" for place in result.loops]
        loose += [
            f"{entry} is not known to return"
            for entry in entries
            if entry not in result.returned | {""} and not result.trouble
        ]
        if loose:
            alarms.setdefault(f"{job.robot.name}_impedance_step", []).extend(loose)
    trouble = [result.trouble for result, _ in results if result.trouble]
    reached = _controller_functions(job.robot, {each for result, _ in results for each in result.reached})
    for function in [*reached, *(each for each in alarms if each not in reached)]:
        found = alarms.get(function, [])
        outcome: Outcome = "FAILED" if found else "unproved" if trouble else "proved"
        claims = _MEMORY + (_FRAME if function.startswith(f"{job.robot.name}_") else "")
        verdicts.append(
            Verdict(function, claims, "Frama-C", outcome, seconds / len(reached), "; ".join((found or trouble)[:3]))
        )
    return verdicts


def _controller_functions(robot: GeneratedRobot, analysed: set[str]) -> list[str]:
    """Of the functions that were analysed those that the controller's file defines, in its order."""
    text = (robot.folder / f"{robot.name}_impedance.c").read_text(encoding="utf-8")
    places = {name: re.search(rf"^(?:static )?[a-z][\w *]*\b{name}\(", text, re.MULTILINE) for name in analysed}
    return sorted((name for name, place in places.items() if place), key=lambda name: places[name].start())  # type: ignore[union-attr]
