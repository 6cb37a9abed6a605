# SPDX-License-Identifier: MIT
"""Licences of the robot's files that a project copies: their maker's, whatever the project's own is."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from stiffgen.core.errors import listed, printable

_NAME = re.compile(r"(licen[cs]e|copying|notice)([-._][\w.-]{1,40})?", re.ASCII | re.IGNORECASE)
_STATED = re.compile(r"<license\b[^>]*>\s*([^<]*\S)\s*</license>")
_TOPS = ("package.xml", ".git")
_MOST_FOLDERS, _MOST_BYTES = 6, 2**20


@dataclass(frozen=True)
class Licences:
    """Licences of copied files.

    Attributes:
        files: texts of licences, by the name of their copy in the folder ``urdf``.
        stated: licences that package.xml of the files' packages names.

    """

    files: dict[str, Path]
    stated: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """Return what a page says about the copies."""
        said = "The files in `urdf/` are their maker's"
        parts = [f"licence: {listed([f'`urdf/{name}`' for name in self.files])}"] if self.files else []
        parts += [f"package.xml names {listed(list(self.stated))}"] if self.stated else []
        if not parts:
            return f"{said}. No licence was found beside the original: ask its maker before you pass them on."
        return f"{said}, and keep their licence ({'; '.join(parts)})."


def licences_of(files: Iterable[Path]) -> Licences:
    """Find the licences of files: texts beside them, or in the nearest folder above, up to that of their package."""
    texts: dict[str, Path] = {}
    stated: dict[str, None] = {}
    for file in files:
        for folder in _folders(file):
            manifest = folder / "package.xml"
            if manifest.is_file() and manifest.stat().st_size <= _MOST_BYTES:
                named = _STATED.findall(manifest.read_text(encoding="utf-8", errors="replace"))
                stated |= dict.fromkeys(printable(each, 60) for each in named)
            found = [path for path in sorted(folder.iterdir()) if _is_licence(path, file)]
            for path in found:
                texts[_free_name(path, texts)] = path
            if found:
                break
    return Licences(texts, tuple(stated))


def _folders(file: Path) -> Iterator[Path]:
    """Yield the file's folder and those above it, up to the package's or the repository's top; else its own alone."""
    above = list(file.resolve().parents)[:_MOST_FOLDERS]
    top = next((k for k, folder in enumerate(above) if any((folder / name).exists() for name in _TOPS)), 0)
    repository = next((k for k, folder in enumerate(above) if (folder / ".git").exists()), top)
    yield from above[: max(top, repository) + 1]


def _is_licence(path: Path, file: Path) -> bool:
    """Return whether a path is the text of a licence: of its folder, or of this file (NAME.LICENSE, FILE.license)."""
    name = path.name.removeprefix(f"{file.name}.").removeprefix(f"{file.name.partition('.')[0]}.")
    return _NAME.fullmatch(name) is not None and path.is_file() and path.stat().st_size <= _MOST_BYTES


def _free_name(path: Path, taken: dict[str, Path]) -> str:
    """Return the name of a copy: the file's own, with a number where another file has it."""
    names = [path.name, *(f"{path.name}.{number}" for number in range(2, 1000))]
    return next(name for name in names if taken.get(name, path) == path)
