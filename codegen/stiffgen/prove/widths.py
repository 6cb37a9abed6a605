# SPDX-License-Identifier: MIT
"""Run the vector builds of a folder's kernels in arrays of exact size under clang's sanitizers.

The proofs cover one lane. More lanes change only the accessed entries, which depend on no number. One run of every
kernel, with every kind of batch, therefore covers all inputs. docs/proofs.md has the argument.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from stiffgen.emit.build import kernel_sources
from stiffgen.opened import GeneratedRobot
from stiffgen.prove import harness
from stiffgen.prove.tools import ProgramOutput, run
from stiffgen.prove.verdict import Outcome, Verdict
from stiffgen.symbolic.kernel import Kernel
from stiffgen.verify.folder.widths import WIDTHS, Width

_SANITIZERS = ("address,undefined", "memory,undefined")
_CLAIMS = "every lane in bounds, no uninitialised value used, no undefined behaviour, symmetric, arguments not written"


def width_verdicts(
    robot: GeneratedRobot,
    kernels: Sequence[Kernel],
    folder: Path,
    timeout: float,
    progress: Callable[[str], None],
) -> list[Verdict]:
    """Run the kernels in every vector width under the sanitizers; one verdict per width."""
    clang = shutil.which("clang")
    verdicts = []
    for width in WIDTHS:
        what = f"all kernels, {width.lanes} lanes ({width.name})"
        progress(f"sanitizers: {what}")
        if clang is None or not width.is_available:
            why = "clang is not installed" if clang is None else f"this machine has no {width.name}"
            verdicts.append(Verdict(what, _CLAIMS, "sanitizers", "no answer", 0.0, why))
            continue
        outcome, seconds, detail = _run_width(robot, kernels, folder, clang, width, timeout)
        verdicts.append(Verdict(what, _CLAIMS, "sanitizers", outcome, seconds, detail))
    return verdicts


def _run_width(
    robot: GeneratedRobot,
    kernels: Sequence[Kernel],
    folder: Path,
    clang: str,
    width: Width,
    timeout: float,
) -> tuple[Outcome, float, str]:
    """Return outcome, seconds and detail of one build under each of the sanitizers, in turn.

    The program prints a number at its end; anything else is a sanitizer's report.
    """
    driver, program = folder / "widths.c", folder / "widths"
    driver.write_text(harness.widths(robot, kernels, 2 * width.lanes + 1))
    seconds = 0.0
    for sanitizer in _SANITIZERS:
        command = [
            clang,
            "-std=c99",
            "-O1",
            "-g1",
            *width.flags,
            f"-fsanitize={sanitizer},float-cast-overflow",
            "-fno-sanitize-recover=all",
        ]
        command += [f"-I{robot.folder.resolve()}", str(driver)]
        command += map(str, kernel_sources(robot.folder.resolve(), robot.name))
        built = run([*command, "-lm", "-o", str(program)], folder, timeout)
        seconds += built.seconds
        if "error:" in built.text or built.timed_out or not program.exists():
            return "no answer", seconds, f"clang -fsanitize={sanitizer}: {_first(built)}"
        ran = run([str(program)], folder, timeout, limited=False)
        seconds += ran.seconds
        program.unlink()
        if ran.timed_out:
            return "no answer", seconds, f"none within {timeout:.0f} s"
        if not ran.text.strip().isdigit():
            return "refuted", seconds, _first(ran)
    return "proved", seconds, ""


def _first(result: ProgramOutput) -> str:
    """Return the first lines of a failed run that name the fault."""
    lines = [line.strip() for line in result.text.splitlines() if line.strip()]
    telling = [line for line in lines if "rror" in line or "WARNING" in line or line.startswith("#")]
    return "; ".join((telling or lines)[:3])[:400]
