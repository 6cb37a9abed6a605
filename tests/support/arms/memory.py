# SPDX-License-Identifier: MIT
"""Build and run memory.c: steps of a controller whose memory holds anything."""

from __future__ import annotations

import subprocess
from pathlib import Path

from support.arms.arms import HERE, MAKERS

SANITIZERS = ("-g1", "-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")


class MemoryProgram:
    """The program of one arm, and its controller as a shared library.

    Args:
        name: of the arm, in MAKERS.
        folder: where it is compiled; what another process left there is used again.
        robot: folder of the generated robot.
        controller: file in place of the folder's controller.
        flags: of gcc, for the controller and the program.

    """

    def __init__(self, name: str, folder: Path, robot: Path, controller: Path | None = None,
                 flags: tuple[str, ...] = SANITIZERS) -> None:  # fmt: skip
        """Compile the program that damages the controller's memory, with sanitizers, and the plain library."""
        self.program, self.library = folder / f"{name}_memory", folder / f"{name}_memory.so"
        if self.program.exists():
            return
        kernels, source = folder / f"{name}_kernels.o", controller or robot / f"{name}_impedance.c"
        posture = ", ".join(map(str, MAKERS[name].posture))
        names = (f"-DROBOT={name}", f"-DUPPER={name.upper()}", f"-DPOSTURE={posture}", f"-I{robot}", "-include", source)
        _gcc("-O0", "-fPIC", "-c", robot / f"{name}.c", "-o", kernels)
        _gcc("-O1", "-shared", "-fPIC", f"-I{robot}", source, kernels, "-lm", "-o", self.library)
        _gcc(*flags, *names, HERE / "memory.c", kernels, "-lm", "-o", self.program)

    def run(self, trials: int, seed: int) -> subprocess.CompletedProcess[str]:
        """Run the program."""
        command = [str(self.program), str(trials), str(seed)]
        return subprocess.run(command, capture_output=True, text=True, check=False)


def _gcc(*arguments: str | Path) -> None:
    subprocess.run(["gcc", "-std=c99", *map(str, arguments)], check=True)
