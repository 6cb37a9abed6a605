# SPDX-License-Identifier: MIT
"""Run every proof of a folder, one after the other: ``stiffgen prove DIR``."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from stiffgen.errors import OutputError, StiffgenError, listed
from stiffgen.folder import temporary_folder
from stiffgen.opened import GeneratedRobot, open_robot
from stiffgen.prove import esbmc, frama_c, harness
from stiffgen.prove.tools import Provers, find_provers
from stiffgen.prove.verdict import Outcome, Verdict, write_verdicts
from stiffgen.prove.widths import width_verdicts
from stiffgen.symbolic.kernel import Kernel

PARTS = ("memory", "bits", "services", "step", "widths")
"""Parts that can run alone: memory, bits and widths of the kernels; services are all functions of the controller but
its step."""
_MEMORY = "in bounds, initialised, no undefined behaviour, loops bounded, returns, nothing written but the result"
_BITS = "in bounds, loops bounded"
_SYMMETRIC = ", symmetric to the last bit"
_SOLVER = {False: "z3", True: "boolector"}
"""Solver for batches or not. Z3 is faster on single calls (4 s against 13), but gave no result on symmetric batches."""
_AT_ONCE = 2
"""Proofs that run in parallel, each in up to 8 GiB."""
_FRAME = ", configuration and sample not written"
_APART = (
    "factorise_cholesky", "factorise_pencil", "diagonalise_pencil", "solve_pencil", "solve_modes", "soften",
    "design_damping", "step_without_sample",
)  # fmt: skip
"""Functions of the controller whose paths are analysed separately: results exist only on the path of success."""


@dataclass(frozen=True)
class _ProofRun:
    robot: GeneratedRobot
    provers: Provers
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
    """Prove the claims of docs/proofs.md about the C of a robot's folder, for all inputs.

    Args:
        folder: what ``stiffgen generate`` wrote; it need not be compiled.
        parts: the requested ones of "memory", "bits", "services", "step" and "widths".
        only: qualified names of kernels ("hybrid_joint_stiffness"), or none for all.
        timeout: for one function, in seconds of wall clock.
        json: a file for the verdicts, or None.
        progress: called with a few words before each proof.

    Returns:
        One verdict per function and kind of claim.

    Raises:
        MissingExtraError: ESBMC or Frama-C is not installed.
        OutputError: the folder is not one of stiffgen's, lacks a source, or ``json`` cannot be written.
        StiffgenError: an unknown name in ``parts`` or ``only``, or an invalid time-out.

    """
    robot = open_robot(folder)
    robot.require_doubles("'stiffgen prove'")
    chosen = _chosen(robot, only)
    if not set(parts) <= set(PARTS) or not parts:
        raise StiffgenError(f"parts are {', '.join(PARTS)}; not {listed(list(parts)) or 'none'}")
    if not timeout > 0.0:
        raise StiffgenError(f"--timeout {timeout:g}: must be above 0 (seconds)")
    sources = robot.source_digests()
    provers = find_provers()
    if json is not None and not Path(json).parent.is_dir():
        raise OutputError(f"{json}: there is no such folder; give another --json")
    verdicts: list[Verdict] = []
    with temporary_folder("prove") as temporary, ThreadPoolExecutor(_AT_ONCE) as pool:
        run = _ProofRun(robot, provers, temporary.resolve(), timeout, progress)
        entries = [each.qualified_name for each in chosen]
        entries += [f"{each.qualified_name}{batch.suffix}" for each in chosen for batch in each.batches]
        self_check = ["self_check"] * (len(chosen) == len(robot.table))
        memory = pool.submit(_memory, run, chosen, [*entries, *self_check]) if "memory" in parts else None
        with_controller = robot.has_controller and not only and not {"services", "step"}.isdisjoint(parts)
        controller = pool.submit(_controller, run, parts) if with_controller else None
        widths = pool.submit(width_verdicts, robot, chosen, run.work, timeout, progress) if "widths" in parts else None
        if memory is not None:
            verdicts += memory.result()
        if "bits" in parts:
            verdicts += _bits(run, chosen, _not_failed(entries, verdicts), pool)
        for part in (controller, widths):
            verdicts += part.result() if part is not None else []
    if json is not None:
        write_verdicts(Path(json), robot.name, sources, provers.versions, verdicts)
    return verdicts


def _chosen(robot: GeneratedRobot, only: Sequence[str]) -> list[Kernel]:
    """Return the kernels whose names are in ``only``, or all; refuse names that the folder does not have."""
    names = [each.qualified_name for each in robot.table]
    unknown = [each for each in only if each not in names]
    if unknown:
        raise StiffgenError(f"{listed(unknown)}: no kernel of {robot.folder}; it has {listed(names, 60)}")
    return [each for each in robot.table if not only or each.qualified_name in only]


def _not_failed(entries: Sequence[str], verdicts: Sequence[Verdict]) -> list[str]:
    """Return the functions whose memory proof did not fail; a proof of bits means something for these only."""
    failed = {each.function for each in verdicts if each.outcome == "FAILED"}
    return [each for each in entries if each not in failed]


def _memory(run: _ProofRun, chosen: Sequence[Kernel], entries: Sequence[str]) -> list[Verdict]:
    # Frama-C 25 cannot size an initialised array by a quotient; with one lane the quotient equals its dividend.
    (run.work / "one_lane.c").write_text(re.sub(r"\b(\d+) / LANES\b", r"\1", run.robot.kernel_text()), encoding="utf-8")
    file = run.work / "kernels.c"
    file.write_text(harness.kernels_memory(run.robot, chosen, entries))

    def findings(entry: str, count: int) -> frama_c.Findings:
        return frama_c.analyse(run.provers, run.work, file.name, run.includes, run.timeout * count, entry=entry)

    run.progress(f"Frama-C: {len(entries)} kernels and batches, memory")
    together = findings("main", len(entries))
    if not (together.alarms or together.loops or together.trouble) and together.returned >= set(entries):
        return [Verdict(each, _MEMORY, "Frama-C", "proved", together.seconds / len(entries)) for each in entries]
    verdicts = []
    for entry in entries:  # find the entry that failed
        run.progress(f"Frama-C: {entry}, memory")
        alone = findings(f"prove_{entry}", 1)
        outcome, detail = _judge(alone, [entry])
        verdicts.append(Verdict(entry, _MEMORY, "Frama-C", outcome, alone.seconds, detail))
    return verdicts


def _bits(run: _ProofRun, chosen: Sequence[Kernel], entries: Sequence[str], pool: Executor) -> list[Verdict]:
    (run.work / "bodies_apart.c").write_text(harness.bodies_apart(chosen, run.robot.kernel_text()), encoding="utf-8")
    file = run.work / "bits.c"
    file.write_text(harness.kernels_bits(run.robot, chosen))
    symmetric = {each.qualified_name for each in chosen if any(result.symmetric for result in each.results)}

    def bits(entry: str) -> Verdict:
        run.progress(f"ESBMC: {entry}, bits")
        kernel = entry.removesuffix("_batch")
        outcome, seconds, detail = esbmc.check(
            run.provers, file, run.includes, run.timeout, entry=f"prove_{entry}", solver=_SOLVER[entry != kernel]
        )
        claims = _BITS + (_SYMMETRIC if kernel in symmetric else "")
        return Verdict(entry, claims, "ESBMC", outcome, seconds, detail)

    return list(pool.map(bits, entries))


def _judge(result: frama_c.Findings, entries: Sequence[str]) -> tuple[Outcome, str]:
    """Return the verdicts of an analysis: an alarm counts as a fault."""
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


def _controller(run: _ProofRun, parts: Sequence[str]) -> list[Verdict]:
    (run.work / "contracts.h").write_text(harness.contracts(run.robot, run.robot.table))
    runs: list[tuple[str, tuple[str, ...], bool]] = []
    if "services" in parts:
        runs += [("validate", ("validate",), False), ("services", harness.SERVICES, True)]
    if "step" in parts:
        runs += [(step, (step,), True) for step in harness.STEPS]
    verdicts, results = [], []
    text = (run.robot.folder / f"{run.robot.name}_impedance.c").read_text(encoding="utf-8")
    apart = [each for each in _APART if f" {each}(" in text]
    for name, entries, by_contract in runs:
        run.progress(f"Frama-C: controller, {name.replace('_', ' ')}")
        file = run.work / f"{name}.c"
        file.write_text(harness.controller(run.robot, entries, by_contract=by_contract))
        result = frama_c.analyse(
            run.provers, run.work, file.name, run.includes, 4.0 * run.timeout,
            rounds=run.robot.chain.dof + 2, apart=apart, by_contract=["validate"] if by_contract else [],
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
            alarms.setdefault(f"{run.robot.name}_impedance_step", []).extend(loose)
    trouble = [result.trouble for result, _ in results if result.trouble]
    reached = _controller_functions(run.robot, {each for result, _ in results for each in result.reached})
    for function in [*reached, *(each for each in alarms if each not in reached)]:
        found = alarms.get(function, [])
        unless_found: Outcome = "unproved" if trouble else "proved"
        outcome: Outcome = "FAILED" if found else unless_found
        claims = _MEMORY + (_FRAME if function.startswith(f"{run.robot.name}_") else "")
        verdicts.append(
            Verdict(function, claims, "Frama-C", outcome, seconds / len(reached), "; ".join((found or trouble)[:3]))
        )
    return verdicts


def _controller_functions(robot: GeneratedRobot, analysed: set[str]) -> list[str]:
    """Return the analysed functions that the controller's file defines, in its order."""
    text = (robot.folder / f"{robot.name}_impedance.c").read_text(encoding="utf-8")
    places = {name: re.search(rf"^(?:static )?[a-z][\w *]*\b{name}\(", text, re.MULTILINE) for name in analysed}
    return sorted((name for name, place in places.items() if place), key=lambda name: places[name].start())  # type: ignore[union-attr]
