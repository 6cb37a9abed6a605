# SPDX-License-Identifier: MIT
"""Compile a C or CUDA file once per session: robots of many tests, and copies of one, have the same files.

Stands in for ``stiffgen.core.emit.build``'s way of running the compiler. An object or library is kept under a digest of
its preprocessed source, the compiler and its flags. What fails to compile is compiled again by every test. The digest
is noted under one of the files as they are, which spares a copy the preprocessor.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sysconfig
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stiffgen.core.emit import build

SOURCES = (".c", ".cu")
_INCLUDE = re.compile(rb"""^[ \t]*#[ \t]*include[ \t]*["<]([^">\n]+)""", re.MULTILINE)
_OF_PACKAGES = (sysconfig.get_path("include"), np.get_include())
"""Folders whose headers stay as they are."""
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
                partial = _beside(kept)
                shutil.copyfile(_output(command), partial)
                partial.replace(kept)

    def _place(self, command: Sequence[str]) -> Path | None:
        """Return the file for a command's result; None for a command that links objects, or fails."""
        flags = [word for word in command if not word.endswith(SOURCES) and word != _output(command)]
        if any(word.endswith(".o") for word in flags) or len(flags) + 1 == len(command):
            return None
        words = [word for word in command if word not in ("-shared", "-o", _output(command))]
        chosen = "\0".join(word for word in flags if not word.startswith("-I")).encode()
        note = self.folder / f"{hashlib.sha256(chosen + _texts(words)).hexdigest()}.note"
        if note.exists():
            return self.folder / note.read_text()
        text = subprocess.run([*words, "-E", "-P"], capture_output=True, stdin=subprocess.DEVNULL, check=False)
        if text.returncode != 0:
            return None
        kept = self.folder / hashlib.sha256(chosen + b"\0" + text.stdout).hexdigest()
        partial = _beside(note)
        partial.write_text(kept.name)
        partial.replace(note)
        return kept


def _texts(words: Sequence[str]) -> bytes:
    """Return a command's sources and the headers that they include, but for those of compiler, Python and NumPy."""
    folders = [Path(word[2:]) for word in words if word.startswith("-I") and word[2:] not in _OF_PACKAGES]
    files = [Path(word) for word in words if word.endswith(SOURCES)]
    texts: dict[Path, bytes] = {}
    while files:
        file = files.pop()
        texts[file] = file.read_bytes()
        for name in map(os.fsdecode, _INCLUDE.findall(texts[file])):
            places = (folder / name for folder in (file.parent, *folders))
            header = next((place for place in places if place.is_file()), None)
            if header is not None and header not in texts and header not in files:
                files.append(header)
    return b"".join(b"\0%s\0%d\0%s" % (os.fsencode(file.name), len(text), text) for file, text in texts.items())


def _beside(file: Path) -> Path:
    """Return this process's name for a file that is moved to its place when it is whole."""
    return file.with_suffix(f".{os.getpid()}")


def _output(command: Sequence[str]) -> str:
    return command[command.index("-o") + 1]
