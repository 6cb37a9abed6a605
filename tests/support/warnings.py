"""What a compiler says about the C of a random robot, at every level of optimisation."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import stiffgen
from stiffgen.emit.render import render
from support.c_program import STRICT
from support.random_urdf import Plain, random_robot

LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")


def sources_of_random_robot(seed: int, most_moving: int, folder: Path) -> list[Path]:
    """Write kernels and controller of a random robot; returns the C files."""
    robot = random_robot(Plain(seed), most_moving)
    urdf = folder / "random.urdf"
    urdf.write_text(robot.text, encoding="utf-8")
    texts = render(stiffgen.load_chain(urdf, base=robot.base, tip=robot.tip), "arm")
    for file, text in texts.items():
        if file.endswith((".h", ".c")):
            (folder / file).write_text(text, encoding="utf-8")
    return [folder / "arm.c", folder / "arm_impedance.c"]


def complaints(compiler: str, flags: Sequence[str], sources: Sequence[Path]) -> str:
    """What the compiler says with every strict warning an error; "" if nothing."""
    command = [compiler, "-std=c99", *flags, *STRICT, "-S", "-o", "/dev/null"]
    runs = [subprocess.run([*command, str(s)], capture_output=True, text=True, check=False) for s in sources]
    return "".join(run.stderr or f"exit code {run.returncode}" for run in runs if run.returncode or run.stderr)
