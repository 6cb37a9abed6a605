# SPDX-License-Identifier: MIT
"""Compile a C or CUDA file once per session: robots of many tests, and copies of one, have the same files.

Stands in for ``stiffgen.core.emit.build``'s way of running the compiler. An object or library is kept under a digest of
its preprocessed source, the compiler and its flags. What fails to compile is compiled again by every test.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from stiffgen.core.emit import build

SOURCES = (".c", ".cu")
_run = build.run_all


class KeptObjects:
    """Replacement of ``build.run_all`` that copies what an earlier call has compiled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(exist_ok=True)

    def run(self, commands: Sequence[Sequence[str]], compiler: str, temporary: Path) -> None:
        """Run the commands whose results are not kept; keep theirs."""
        missing: list[tuple[Sequence[str], Path | None]] = []
        for command in commands:
            kept = self._place(command)
            if kept is not None and kept.exists():
                shutil.copyfile(kept, _output(command))
            else:
                missing.append((command, kept))
        _run([command for command, _ in missing], compiler, temporary)
        for command, kept in missing:
            if kept is not None:
                partial = kept.with_suffix(f".{os.getpid()}")
                shutil.copyfile(_output(command), partial)
                partial.replace(kept)

    def _place(self, command: Sequence[str]) -> Path | None:
        """Return the file for a command's result; None for a command that links objects, or fails."""
        flags = [word for word in command if not word.endswith(SOURCES) and word != _output(command)]
        if any(word.endswith(".o") for word in flags) or len(flags) + 1 == len(command):
            return None
        words = [word for word in command if word not in ("-shared", "-o", _output(command))]
        text = subprocess.run([*words, "-E", "-P"], capture_output=True, stdin=subprocess.DEVNULL, check=False)
        if text.returncode != 0:
            return None
        chosen = [word for word in flags if not word.startswith("-I")]
        return self.folder / hashlib.sha256("\0".join(chosen).encode() + b"\0" + text.stdout).hexdigest()


def _output(command: Sequence[str]) -> str:
    return command[command.index("-o") + 1]
