# SPDX-License-Identifier: MIT
"""Run the vector builds of a folder's kernels in arrays of exact size under clang's sanitizers.

The proofs cover one lane. More lanes change only the accessed entries, which depend on no number. One run of every
kernel, with every kind of batch, therefore covers all inputs. docs/guarantees.md has the argument.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from stiffgen.core.emit.build import kernel_sources
from stiffgen.core.errors import MissingExtraError
from stiffgen.core.folder import temporary_folder
from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.verify.folder.widths import WIDTHS, Width
from stiffgen.lab.prove import harness
from stiffgen.lab.prove.tools import ProgramOutput, run
from stiffgen.lab.prove.verdict import Outcome, Verdict

_SANITIZERS = ("address,undefined", "memory,undefined")
_WITHOUT = ", or name other parts than widths"
_PROBE = 120.0
"""Time limit of a probe [s]."""
_CLAIMS = "every lane in bounds, no uninitialised value used, no undefined behaviour, symmetric, arguments not written"


def find_sanitizers() -> str:
    """Return clang, after a program under each of the sanitizers has been compiled and run.

    Raises:
        MissingExtraError: clang or its sanitizers' runtime library is not installed, or their programs do not run.

    """
    clang = shutil.which("clang")
    if clang is None:
        raise MissingExtraError(f"'stiffgen prove' needs clang; install it (Debian: apt-get install clang){_WITHOUT}")
    with temporary_folder("sanitizers") as folder:
        source, program = folder / "probe.c", folder / "probe"
        source.write_text('#include <stdio.h>\n\nint main(void) { return puts("1") < 0; }\n')
        for sanitizer in _SANITIZERS:
            command = [clang, *_flags(sanitizer), str(source), "-lm", "-o", str(program)]
            built = run(command, folder, _PROBE)
            if not program.exists():
                raise MissingExtraError(
                    "'stiffgen prove' needs the runtime library of clang's sanitizers; install it (Debian: apt-get "
                    f"install libclang-rt-dev){_WITHOUT}. clang -fsanitize={sanitizer} said: {_first(built)}"
                )
            said = _said(program, folder)
            program.unlink()
            if said != "1":
                raise MissingExtraError(
                    f"'stiffgen prove' cannot run a program of clang -fsanitize={sanitizer} here ({said}); repair "
                    f"that{_WITHOUT}"
                )
    return clang


def _said(program: Path, folder: Path) -> str:
    """Return what a program prints, or why it does not."""
    try:
        ran = run([str(program)], folder, _PROBE, limited=False)
    except OSError as error:
        return f"{error.strerror}; on a mount with noexec set TMPDIR to another folder"
    return ran.text.strip() if ran.text.strip() == "1" else _first(ran) or "no output"


def _flags(sanitizer: str) -> list[str]:
    """Return clang's options for a program under a sanitizer."""
    return [
        *("-std=c99", "-O1", "-g1"),
        *(f"-fsanitize={sanitizer},float-cast-overflow", "-fno-sanitize-recover=all"),
    ]


def width_verdicts(
    robot: GeneratedRobot,
    kernels: Sequence[Kernel],
    folder: Path,
    timeout: float,
    progress: Callable[[str], None],
    clang: str,
) -> list[Verdict]:
    """Run the kernels in every vector width under the sanitizers of ``clang``; one verdict per width."""
    verdicts = []
    for width in WIDTHS:
        what = f"all kernels, {width.lanes} lanes ({width.name})"
        progress(f"sanitizers: {what}")
        if not width.is_available:
            why = f"this machine has no {width.name}"
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
        command = [clang, *_flags(sanitizer), *width.flags, f"-I{robot.folder.resolve()}", str(driver)]
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
