# SPDX-License-Identifier: MIT
"""Look through an MJCF file for what would block or fill MuJoCo's parser: special files, and counts of copies."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from stiffgen.core.robot.files import FileError, read_regular

MAX_COPIES = 500
"""Copies of a body that a file may ask for; MuJoCo takes 6 s for 1000 of them, and 150 s for 4000."""
_COPYING = {"replicate": MAX_COPIES, "composite": MAX_COPIES, "flexcomp": 20 * MAX_COPIES}
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_MAX_BYTES = 64 * 2**20


def check_parts(file: Path, most_files: int) -> None:
    """Refuse a file that names a pipe, a device or a folder, or that asks for many copies.

    Raises:
        FileError: with a sentence for the user.

    """
    pending, seen = [(file, 1.0)], {file}
    while pending and len(seen) < most_files:
        current, copies = pending.pop()
        try:
            root = ElementTree.fromstring(read_regular(current, _MAX_BYTES))
        except (ElementTree.ParseError, OSError):
            continue  # MuJoCo says what is wrong with it
        folders = [current.parent, file.parent]
        folders += [file.parent / each.get(key, "") for each in root.iter("compiler") for key in _FOLDERS]
        for element, count in _copied(root, copies):
            name = element.get("file")
            for place in [folder / name for folder in folders] if name else []:
                if not place.exists() or place in seen:
                    continue
                if not place.is_file():
                    raise FileError(f"<{element.tag}> names '{os.path.normpath(place)}', which is not a regular file")
                if element.tag in ("include", "model"):
                    seen.add(place)
                    pending.append((place, count))


def _copied(root: ElementTree.Element, copies: float) -> Iterator[tuple[ElementTree.Element, float]]:
    """Yield the elements and how many copies of each the file asks for."""
    pending = [(root, copies)]
    while pending:
        element, count = pending.pop()
        if element.tag in _COPYING:
            text, most = element.get("count", "1"), _COPYING[element.tag]
            with contextlib.suppress(ValueError):  # MuJoCo refuses what is no number
                count *= max(1.0, math.prod(map(float, text.split())))
            if count > most:
                raise FileError(f"<{element.tag} count='{text[:40]}'> asks for more than {most} copies")
        yield element, count
        pending += [(child, count) for child in element]
