# SPDX-License-Identifier: MIT
"""Read the kernels' C of a folder, as files and as one text."""

from __future__ import annotations

from pathlib import Path

from stiffgen.core.opened import joined_kernels


def kernel_files(folder: Path, name: str) -> list[Path]:
    """Return the shared header, single calls, and batches where there are any."""
    return [file for end in ("_lanes.h", ".c", "_batch.c") if (file := folder / f"{name}{end}").exists()]


def kernel_text(folder: Path, name: str) -> str:
    """Return the text of all kernels, as one C file."""
    return joined_kernels(name, {file.name: file.read_text() for file in kernel_files(folder, name)})


def merged(texts: dict[str, str], name: str) -> dict[str, str]:
    """Return printed files with all kernels in NAME.c, and without the files of Python."""
    joined = {f"{name}.c": joined_kernels(name, texts)}
    return {file: text for file, text in texts.items() if "/" not in file and file != f"{name}_batch.c"} | joined
