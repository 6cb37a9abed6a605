# SPDX-License-Identifier: MIT
"""Record of what the comparisons of languages share: the folder, its functions, states, a library of its kernels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from stiffgen.core.opened import GeneratedRobot
from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.verify.folder.files import is_printed
from stiffgen.core.verify.result import Check, Kernels, left_out, not_compared

COUNT = 3
"""Number of states: a wrong call, sign or order is wrong in every state."""


@dataclass(frozen=True)
class Material:
    """What a comparison of a language takes.

    Attributes:
        robot: the folder.
        single: functions of its NumPy module, one configuration per call.
        pool: at least ``COUNT`` values of every argument.
        library: shared library of the kernels, compiled from the folder.
        build: a folder to compile in, which does not exist yet.
        texts: the folder's files as this generator prints them.
        other_version: whether the user accepts that the text of another version is not compared.

    """

    robot: GeneratedRobot
    single: Kernels
    pool: Mapping[Argument, FloatArray]
    library: Path
    build: Path
    texts: Mapping[str, str]
    other_version: bool

    def has(self, file: str) -> bool:
        """Return whether the folder has a file of this name."""
        return file in self.robot.manifest["files"]

    def states(self, kernel: Kernel) -> list[FloatArray]:
        """Return a stack of ``COUNT`` values for every argument of a kernel."""
        return [self.pool[argument][:COUNT] for argument in kernel.arguments]

    def without_tool(self, file: str, reason: str) -> Check:
        """Return the row of a file that could not be run: its text is enough if this generator prints the same."""
        printed = self.texts.get(file)
        if printed is not None and is_printed(self.robot, file, printed):
            return left_out(file, f"{reason}; the text is this generator's")
        return not_compared(file, "C", reason, is_accepted=self.other_version)
