# SPDX-License-Identifier: MIT
"""Seed a fault per row of docs/hazards.csv and see the row's test fail.

python tests/campaigns/hazards.py [--only TEST ...] prints a row per hazard; exit code 1 if a test passes
with its fault. Each takes up to a minute.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import stiffgen
from stiffgen.core.emit import build
from support.hazard_faults import HAZARD_FAULTS, HazardFault, spoilt
from support.kept_objects import KeptObjects
from support.project import ROOT, URDF, files_of_tests

CONTROLLER = "iiwa14_impedance.c"


def found_in(test: str) -> Path:
    """Return the file that defines a test."""
    files = [file for file in files_of_tests() if f"def {test}(" in file.read_text()]
    (file,) = files
    return file


def outcome(test: str, folder: Path) -> tuple[int, str]:
    """Run a test on another folder of the robot; return how many of its cases failed, and the last lines."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-n", "0", "-k", test]
    environment = os.environ | {"STIFFGEN_ROBOT_FOLDER": str(folder)}
    done = subprocess.run(
        [*command, str(found_in(test))], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    failed = re.search(r"(\d+) failed", done.stdout)
    return int(failed[1]) if failed else 0, done.stdout[-1500:]


def caught(fault: HazardFault, good: Path, work: Path) -> tuple[bool, str]:
    """Build the folder with the fault and run the test; return whether it failed, and the last lines."""
    folder = work / "spoilt" / good.name
    shutil.rmtree(folder.parent, ignore_errors=True)
    shutil.copytree(good, folder)
    source = folder / CONTROLLER
    source.write_text(spoilt(source.read_text(), fault))
    build.build_module(folder, good.name)
    failed, said = outcome(fault.test, folder)
    return failed > 0, said


def main(only: list[str]) -> int:
    """Run every fault, or those of the tests in ``only``; return the exit code."""
    missed = 0
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        os.environ.setdefault("CFLAGS", "-O0")
        build.run_all = KeptObjects(work / "objects").run
        good = stiffgen.generate(URDF, output=work / "good")
        for fault in HAZARD_FAULTS:
            if only and fault.test not in only:
                continue
            start = time.monotonic()
            found, said = caught(fault, good, work)
            missed += not found
            verdict = "fails, as it should" if found else f"NOT CAUGHT\n{said}"
            print(f"{fault.hazard} | {fault.test} | {verdict} | {time.monotonic() - start:.0f} s", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--only", action="append", default=[], metavar="TEST", help="test to run; repeatable")
    sys.exit(main(arguments.parse_args().only))
