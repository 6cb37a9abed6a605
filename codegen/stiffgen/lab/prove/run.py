# SPDX-License-Identifier: MIT
"""Run every proof of a folder, one after the other: ``stiffgen prove DIR``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from stiffgen.core.errors import OutputError, StiffgenError, listed
from stiffgen.core.folder import temporary_folder
from stiffgen.core.opened import GeneratedRobot, open_robot
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.lab.prove import esbmc, frama_c, harness
from stiffgen.lab.prove.tools import Provers, find_provers
from stiffgen.lab.prove.verdict import Outcome, Verdict, write_verdicts
from stiffgen.lab.prove.widths import find_sanitizers, width_verdicts

PARTS = ("memory", "bits", "services", "step", "paper", "widths")
"""Parts that can run alone: memory, bits and widths of the kernels; services are all functions of the controller but
its step; paper is the paper's law by itself."""
_MEMORY = "in bounds, initialised, no undefined behaviour, loops bounded, returns, nothing written but the result"
_BITS = "in bounds, loops bounded"
_SYMMETRIC = ", symmetric to the last bit"
_SOLVER = {False: "z3", True: "boolector"}
"""Solver for batches or not. Z3 is faster on single calls (4 s against 13), but gave no result on symmetric batches."""
_AT_ONCE = 2
"""Proofs that run in parallel, each in up to 8 GiB."""
_SHOWN = 3
"""Findings that a verdict shows."""
_LIMITS = 4.0
"""Time of an analysis of the controller in time limits of one function: it covers many functions."""
_FRAME = ", configuration and sample not written"
_APART = ("factorise", "covered_share", "initialise", "step", "take_input", "do_step")
"""Functions of the controller whose paths are analysed separately: results exist only on the path of success."""


@dataclass(frozen=True)
class _ProofRun:
    """Robot, programs, folder of the harnesses, time-out [s] and report of progress, for all parts."""

    robot: GeneratedRobot
    provers: Provers
    work: Path
    timeout: float
    progress: Callable[[str], None]

    @property
    def includes(self) -> list[Path]:
        return [self.work, self.robot.folder.resolve()]


class _ControllerAnalysis(NamedTuple):
    """Analysis of a part of the controller: its name, entries, whether the contract of validate takes its place."""

    name: str
    entries: tuple[str, ...]
    by_contract: bool = True


def prove(
    folder: str | Path,
    *,
    parts: Sequence[str] = PARTS,
    only: Sequence[str] = (),
    timeout: float = 300.0,
    json: str | Path | None = None,
    progress: Callable[[str], None] = lambda step: None,
) -> list[Verdict]:
    """Prove the claims of docs/guarantees.md about the C of a robot's folder, for all inputs.

    Args:
        folder: what ``stiffgen generate`` wrote; it need not be compiled.
        parts: the requested ones of "memory", "bits", "services", "step", "paper" and "widths".
        only: qualified names of kernels ("hybrid_joint_stiffness"), or none for all.
        timeout: for one function, in seconds of wall clock.
        json: a file for the verdicts, or None.
        progress: called with a few words before each proof.

    Returns:
        One verdict per function and kind of claim.

    Raises:
        MissingExtraError: ESBMC or Frama-C is not installed; or, for widths, clang or its sanitizers' runtime library.
        OutputError: the folder is not one of stiffgen's, lacks a source, or ``json`` cannot be written.
        StiffgenError: an unknown name in ``parts`` or ``only``, or an invalid time-out.

    """
    robot = open_robot(folder)
    robot.require_doubles("'stiffgen prove'")
    chosen = _chosen(robot, only)
    _check_options(parts, timeout)
    with_controller = _includes_controller(robot, parts, only)
    sources = robot.source_digests()
    if json is not None and not Path(json).parent.is_dir():
        raise OutputError(f"{json}: there is no such folder; give another --json")
    provers = find_provers()
    clang = find_sanitizers() if "widths" in parts else ""
    with temporary_folder("prove") as temporary, ThreadPoolExecutor(_AT_ONCE) as pool:
        run = _ProofRun(robot, provers, temporary.resolve(), timeout, progress)
        # these run beside each other; bits come after memory, which tells whose bits mean something
        entries, self_check = _entries(chosen), ["self_check"] * (len(chosen) == len(robot.table))
        memory = pool.submit(_memory, run, chosen, [*entries, *self_check]) if "memory" in parts else None
        controller = pool.submit(_controller, run, parts) if with_controller else None
        widths = pool.submit(width_verdicts, robot, chosen, run.work, timeout, progress, clang) if clang else None
        verdicts = memory.result() if memory is not None else []
        bits = _bits(run, chosen, _without_alarm(entries, verdicts), pool) if "bits" in parts else []
        verdicts = [*verdicts, *bits]
        for part in (controller, widths):
            verdicts += part.result() if part is not None else []
    if json is not None:
        write_verdicts(Path(json), robot.name, sources, provers.versions, verdicts)
    return verdicts


def _check_options(parts: Sequence[str], timeout: float) -> None:
    if not set(parts) <= set(PARTS) or not parts:
        raise StiffgenError(f"parts are {', '.join(PARTS)}; not {listed(list(parts)) or 'none'}")
    if not timeout > 0.0:
        raise StiffgenError(f"--timeout {timeout:g}: must be above 0 (seconds)")


def _entries(chosen: Sequence[Kernel]) -> list[str]:
    """Return the names of kernels, then of their batches."""
    batches = [f"{each.qualified_name}{batch.suffix}" for each in chosen for batch in each.batches]
    return [*(each.qualified_name for each in chosen), *batches]


def _includes_controller(robot: GeneratedRobot, parts: Sequence[str], only: Sequence[str]) -> bool:
    """Return whether the controller is to be proved; refuse parts of it alone where it is not."""
    own = {"services", "step", "paper"}
    included = robot.has_controller and not only and not own.isdisjoint(parts)
    if not included and own.issuperset(parts):
        why = "kernels alone were named" if only else f"{robot.folder} has no controller"
        raise StiffgenError(f"nothing to prove: {why}; parts of kernels are memory, bits, widths")
    if set(parts) == {"paper"} and not (robot.folder / f"{robot.name}_paper.c").exists():
        raise StiffgenError(f"nothing to prove: {robot.folder} has no {robot.name}_paper.c (one tip, no closed loops)")
    return included


def _chosen(robot: GeneratedRobot, only: Sequence[str]) -> list[Kernel]:
    """Return the kernels whose names are in ``only``, or all; refuse names that the folder does not have."""
    names = [each.qualified_name for each in robot.table]
    unknown = [each for each in only if each not in names]
    if unknown:
        raise StiffgenError(f"{listed(unknown)}: no kernel of {robot.folder}; it has {listed(names, 60)}")
    return [each for each in robot.table if not only or each.qualified_name in only]


def _without_alarm(entries: Sequence[str], verdicts: Sequence[Verdict]) -> list[str]:
    """Return the functions whose memory is not refuted or alarming; a proof of bits means something for these only."""
    bad = {each.function for each in verdicts if each.outcome in ("refuted", "alarm")}
    return [each for each in entries if each not in bad]


def _memory(run: _ProofRun, chosen: Sequence[Kernel], entries: Sequence[str]) -> list[Verdict]:
    """Prove the memory of all entries in one analysis; if it finds anything, of each one alone."""
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
        found = [alarm for each in alone.alarms.values() for alarm in each] + alone.open_ends([entry])
        outcome, detail = _judge(found, [alone.trouble] if alone.trouble else [])
        verdicts.append(Verdict(entry, _MEMORY, "Frama-C", outcome, alone.seconds, detail))
    return verdicts


def _bits(run: _ProofRun, chosen: Sequence[Kernel], entries: Sequence[str], pool: Executor) -> list[Verdict]:
    """Prove bounds, loops and symmetry of each entry by ESBMC; ``entries`` are kernels, and batches by their suffix."""
    (run.work / "bodies_apart.c").write_text(harness.bodies_apart(chosen, run.robot.kernel_text()), encoding="utf-8")
    file = run.work / "bits.c"
    file.write_text(harness.kernels_bits(run.robot, chosen))
    symmetric = {each.qualified_name for each in chosen if any(result.symmetric for result in each.results)}

    def bits(entry: str) -> Verdict:
        """Compare the bits of the printed function with those of its model, by ESBMC."""
        run.progress(f"ESBMC: {entry}, bits")
        kernel = entry.removesuffix("_batch")
        outcome, seconds, detail = esbmc.check(
            run.provers, file, run.includes, run.timeout, entry=f"prove_{entry}", solver=_SOLVER[entry != kernel]
        )
        claims = _BITS + (_SYMMETRIC if kernel in symmetric else "")
        return Verdict(entry, claims, "ESBMC", outcome, seconds, detail)

    return list(pool.map(bits, entries))


def _judge(found: Sequence[frama_c.Alarm], trouble: Sequence[str]) -> tuple[Outcome, str]:
    """Return the verdict of an analysis by its alarms and what kept it from an answer; the sure alarms come first."""
    if not found:
        return ("no answer" if trouble else "proved"), "; ".join(trouble[:_SHOWN])
    texts = [alarm.text for alarm in sorted(found, key=lambda alarm: not alarm.is_sure)]
    more = f" and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    outcome: Outcome = "refuted" if any(alarm.is_sure for alarm in found) else "alarm"
    return outcome, "; ".join(texts[:_SHOWN]) + more


def _controller(run: _ProofRun, parts: Sequence[str]) -> list[Verdict]:
    """Prove the controller's functions, and the paper's law. Each run gives verdicts about all functions it reaches.

    validate is proved by itself; in all other runs its contract takes its place.
    """
    (run.work / "contracts.h").write_text(harness.contracts(run.robot, run.robot.table))
    analyses: list[_ControllerAnalysis] = []
    if "services" in parts:
        analyses += [
            _ControllerAnalysis("validate", ("validate",), by_contract=False),
            _ControllerAnalysis("services", harness.SERVICES),
        ]
    if "step" in parts:
        analyses += [_ControllerAnalysis(step, (step,)) for step in harness.STEPS]
    results = {each.name: _findings(run, each) for each in analyses}
    own = _controller_verdicts(run.robot, results, f"{run.robot.name}_impedance.c")
    return [*own, *(_paper(run) if "paper" in parts else []), _comparisons(run)]


def _findings(run: _ProofRun, analysis: _ControllerAnalysis) -> frama_c.Findings:
    """Return the findings of an analysis; loops and entries that may not end are alarms of the controller's step.

    Verdicts are of functions. An open end names none: it is the place of a loop, or an entry of the harness.
    """
    name, entries, by_contract = analysis
    run.progress(f"Frama-C: controller, {name.replace('_', ' ')}")
    file = run.work / f"{name}.c"
    file.write_text(harness.controller(run.robot, entries, by_contract=by_contract))
    source = f"{run.robot.name}_impedance.c"
    text = harness.with_comparisons(run.robot, (run.robot.folder / source).read_text(encoding="utf-8"))
    (run.work / source).write_text(text, encoding="utf-8")  # in the place of the folder's
    result = frama_c.analyse(
        run.provers,
        run.work,
        file.name,
        run.includes,
        _LIMITS * run.timeout,
        rounds=run.robot.chain.dof + 2,  # no loop over the joints is merged, with two rounds to spare
        apart=[*_APART, f"{run.robot.name}_impedance_step", *(f"prove_{entry}" for entry in entries)],
        by_contract=["validate"] if by_contract else [],
        by_code=["step", f"{run.robot.name}_impedance_step", "initialise", f"{run.robot.name}_impedance_init"],
    )
    if ends := result.open_ends(entries):
        result.alarms.setdefault(f"{run.robot.name}_impedance_step", []).extend(ends)
    return result


def _paper(run: _ProofRun) -> list[Verdict]:
    """Prove the law of the paper; none where the folder has no such file: it needs one tip and no closed loops."""
    source = f"{run.robot.name}_paper.c"
    if not (run.robot.folder / source).exists():
        return []
    run.progress("Frama-C: the paper's law")
    file = run.work / "paper_proof.c"
    file.write_text(harness.paper(run.robot))
    found = frama_c.analyse(run.provers, run.work, file.name, run.includes, _LIMITS * run.timeout)
    if ends := found.open_ends(harness.PAPER):
        found.alarms.setdefault(f"{run.robot.name}_paper_step", []).extend(ends)
    return _controller_verdicts(run.robot, {"the paper's law": found}, source)


def _comparisons(run: _ProofRun) -> Verdict:
    """Prove with ESBMC the property of comparisons that the controller's contracts admit."""
    file = run.work / "comparisons.c"
    file.write_text(harness.comparisons(run.robot))
    outcome, seconds, detail = esbmc.check(
        run.provers, file, run.includes, run.timeout, entry="prove_comparisons", solver=_SOLVER[False]
    )
    claims = "a true comparison has no NaN operand, as the models of fmax and fmin admit"
    return Verdict("comparisons", claims, "ESBMC", outcome, seconds, detail)


def _controller_verdicts(robot: GeneratedRobot, runs: Mapping[str, frama_c.Findings], source: str) -> list[Verdict]:
    """Return a verdict per function of a source of the controller, and one per run that gave no answer."""
    verdicts = [
        Verdict(f"controller, {name.replace('_', ' ')}", _MEMORY, "Frama-C", "no answer", each.seconds, each.trouble)
        for name, each in runs.items()
        if each.trouble
    ]
    trouble = [each.trouble for each in runs.values() if each.trouble]
    alarms: dict[str, list[frama_c.Alarm]] = {}  # of all runs
    for each in runs.values():
        for function, found in each.alarms.items():
            alarms.setdefault(function, []).extend(found)
    reached = {function for each in runs.values() for function in each.reached}
    functions = _functions(robot.folder / source, reached)
    functions += [function for function in alarms if function not in functions]
    seconds = sum(each.seconds for each in runs.values()) / max(len(functions), 1)
    for function in functions:
        outcome, detail = _judge(alarms.get(function, []), trouble)
        is_public = function.startswith(f"{robot.name}_")
        claims = _MEMORY + (_FRAME if is_public else "")
        verdicts.append(Verdict(function, claims, "Frama-C", outcome, seconds, detail))
    return verdicts


def _functions(source: Path, analysed: set[str]) -> list[str]:
    """Return the analysed functions that a source defines, in its order."""
    text = source.read_text(encoding="utf-8")
    places = {}
    for name in analysed:
        definition = re.search(rf"^(?:static )?[a-z][\w *]*\b{name}\(", text, re.MULTILINE)
        if definition:
            places[name] = definition.start()
    return sorted(places, key=places.__getitem__)
