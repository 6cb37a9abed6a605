# SPDX-License-Identifier: MIT
"""Collect a compiler's warnings about the C of a random robot, at every level of optimisation."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

import stiffgen
from stiffgen.core.emit.render import render
from stiffgen.core.errors import ChainError
from stiffgen.core.manifest import MANIFEST
from stiffgen.core.options import GenerationOptions
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from support.c_program import STRICT
from support.random_urdf import Plain, random_robot

LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")
VECTORS: tuple[tuple[str, ...], ...] = (
    ((), ("-mavx2", "-mfma"), ("-march=x86-64-v4",), ("-DSTIFFGEN_NO_VECTORS",))
    if platform.machine() in ("x86_64", "AMD64")
    else ((), ("-march=native",), ("-DSTIFFGEN_NO_VECTORS",))
)
"""Flags for every vector width. Nothing is run: the machine need not have the instructions."""


def sources_of_random_robot(
    seed: int, most_moving: int, folder: Path, *, floating: bool = False, options: KernelOptions | None = None
) -> list[Path]:
    """Write kernels and controller of a random robot; return the C files.

    With ``floating`` the root link floats. ChainError if a joint before the tip is not a coordinate.
    """
    robot = random_robot(Plain(seed), most_moving)
    urdf = folder / "random.urdf"
    urdf.write_text(robot.text, encoding="utf-8")
    base = None if floating else robot.base
    chain = stiffgen.load_chain(urdf, base=base, tip=robot.tip, floating_base=floating)
    texts = render(chain, "arm", GenerationOptions(**vars(options or KernelOptions())))
    for file, text in texts.items():
        if file.endswith((".h", ".c")) or file == MANIFEST:
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text(text, encoding="utf-8")
    return [folder / file for file in ("arm.c", "arm_batch.c", "arm_impedance.c") if file in texts]


def sources_of_varied_robot(seed: int, most_moving: int, folder: Path) -> tuple[str, list[Path]]:
    """Write a robot whose options depend on the seed; return the name of the options and the C files."""
    kind = ("plain", "derivatives", "plain", "springs", "plain", "floating")[seed % 6]
    options = KernelOptions(springs=tuple(KINDS) if kind == "springs" else (), derivatives=kind == "derivatives")
    try:
        return kind, sources_of_random_robot(seed, most_moving, folder, floating=kind == "floating", options=options)
    except ChainError:
        if kind != "floating":
            raise
        return "plain", sources_of_random_robot(seed, most_moving, folder)


def complaints(compiler: str, flags: Sequence[str], sources: Sequence[Path]) -> str:
    """Return the compiler's messages with every strict warning as an error; "" if there are none."""
    command = [compiler, "-std=c99", *flags, *STRICT, "-S", "-o", "/dev/null"]
    runs = [subprocess.run([*command, str(s)], capture_output=True, text=True, check=False) for s in sources]
    return "".join(run.stderr or f"exit code {run.returncode}" for run in runs if run.returncode or run.stderr)


def preprocessed(compiler: str, flags: Sequence[str], source: Path) -> str:
    """Return the preprocessed text of a source: without comments, with its headers."""
    command = [compiler, "-std=c99", *flags, "-E", "-P", str(source)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout
