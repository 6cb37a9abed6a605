# SPDX-License-Identifier: MIT
"""Seeded faults for ``stiffgen prove``: each does harm, and each is caught. Some ten minutes.

python tests/campaigns/seeded_faults.py [TITLE ...] prints a table; exit code 1 if one is harmless or not caught. That a
fault does harm is shown without the provers: by clang's sanitizers, a run without end, or other bits than the unspoilt
C has.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stiffgen.core.emit.build import kernel_sources
from stiffgen.core.opened import open_robot
from stiffgen.lab.prove import harness
from stiffgen.lab.prove.run import prove
from support.seeded_faults import CONTROLLER, FAULTS, FOLDER, Fault, faulty

SANITIZERS = ("address,undefined,float-cast-overflow", "memory,undefined,float-cast-overflow")


def said(fault: Fault, folder: Path, work: Path, sanitizer: str) -> str:
    """Run a program that calls the fault's kernel, or the controller; return a digest, or what is wrong."""
    driver, sources = work / "driver.c", kernel_sources(folder, "iiwa14")
    if fault.part == "memory":
        robot = open_robot(FOLDER)
        chosen = [each for each in robot.table if each.qualified_name == fault.only]
        driver.write_text(harness.widths(robot, chosen, 3))
    else:
        driver.write_text((Path(__file__).parent / "seeded_faults.c").read_text())
        sources.append(folder / CONTROLLER)
    command = ["clang", "-std=c99", "-w", "-O0", "-g1", f"-fsanitize={sanitizer}", "-fno-sanitize-recover=all"]
    command += ["-DSTIFFGEN_NO_VECTORS", f"-I{folder}", str(driver), *map(str, sources), "-lm", "-o", str(work / "run")]
    subprocess.run(command, check=True, capture_output=True)
    try:
        done = subprocess.run([work / "run"], capture_output=True, text=True, timeout=20, errors="replace", check=False)
    except subprocess.TimeoutExpired:
        return "no end"
    lines = (done.stdout + done.stderr).splitlines()
    telling = [line for line in lines if "rror:" in line or "WARNING" in line]
    return (telling or lines or [f"exit {done.returncode}"])[0].split("/")[-1][:70]


def main(titles: list[str]) -> int:
    """Prove code with seeded faults; return 1 if a fault does no harm or no tool catches it."""
    open_ones = 0
    good: dict[tuple[str, str], list[str]] = {}
    for fault in FAULTS:
        if titles and fault.title not in titles:
            continue
        with tempfile.TemporaryDirectory() as temporary:
            work = Path(temporary)
            folder = faulty(fault, work)
            key = fault.part if fault.part == "memory" else "controller", fault.only
            if key not in good:
                good[key] = [said(fault, FOLDER, work, each) for each in SANITIZERS]
            harm = [
                now
                for each, was in zip(SANITIZERS, good[key], strict=True)
                if (now := said(fault, folder, work, each)) != was
            ]
            harm = [f"{each} (digest)" if each.isdigit() else each for each in harm]
            start = time.monotonic()
            parts = ("memory", "bits", "widths") if fault.part == "memory" else (fault.part,)
            verdicts = prove(folder, parts=parts, only=(fault.only,) if fault.only else (), timeout=120.0)
        failed = [each for each in verdicts if each.outcome in ("refuted", "alarm")]
        open_ones += not (harm and failed)
        by = ", ".join(sorted({each.tool for each in failed})) or "NOT CAUGHT"
        detail = failed[0].detail[:100] if failed else ""
        took = time.monotonic() - start
        print(f"{fault.title} | {harm[0] if harm else 'HARMLESS'} | {by} | {took:.0f} s | {detail}", flush=True)
    return 1 if open_ones else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
