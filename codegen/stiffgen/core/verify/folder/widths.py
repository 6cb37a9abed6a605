# SPDX-License-Identifier: MIT
"""Compile a folder's kernels for every vector width of this machine's processor."""

from __future__ import annotations

import ctypes
import platform
from dataclasses import dataclass
from pathlib import Path

from stiffgen.core.emit.build import build_library
from stiffgen.core.opened import GeneratedRobot


@dataclass(frozen=True)
class Width:
    """Vector width of a build: doubles per vector, name, compiler flags, name of its instructions in /proc/cpuinfo."""

    lanes: int
    name: str
    flags: tuple[str, ...]
    instructions: str

    @property
    def is_available(self) -> bool:
        """Whether this machine's processor has the instructions."""
        return not self.instructions or self.instructions in _processor()


WIDTHS = (
    Width(1, "no vectors", ("-DSTIFFGEN_NO_VECTORS",), ""),
    Width(2, "SSE2", ("-msse2", "-mno-avx"), "sse2"),
    Width(4, "AVX2", ("-mavx2", "-mfma", "-mno-avx512f"), "avx2"),
    Width(8, "AVX-512", ("-mavx512f", "-mfma"), "avx512f"),
)


def build_widths(robot: GeneratedRobot, build: Path) -> dict[str, ctypes.CDLL]:
    """Compile the kernels for every width of the processor, by the width's name.

    The build without vectors is left out: single calls are compared with oracles in any case. Processors that are
    not x86 have one width, the compiler's own.

    Raises:
        BuildError: no compiler, or it failed; with its last lines.

    """
    widths = [width for width in WIDTHS if width.instructions and width.is_available]
    libraries: dict[str, ctypes.CDLL] = {}
    for name, flags in [(width.name, width.flags) for width in widths] or [("the compiler's width", ())]:
        folder = build / f"width_{len(libraries)}"
        folder.mkdir(exist_ok=True)  # a build that fails is tried by several steps
        libraries[name] = ctypes.CDLL(str(build_library(robot.folder, robot.name, folder, flags)))
    return libraries


def _processor() -> set[str]:
    """Return the processor's instruction sets in Linux's words; x86-64 without a list has SSE2."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return {"sse2"} if platform.machine() in ("x86_64", "AMD64") else set()
    return {word for line in text.splitlines() if line.startswith("flags") for word in line.split()}
