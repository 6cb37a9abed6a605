# SPDX-License-Identifier: MIT
"""Look through an MJCF file for what would block or fill MuJoCo's parser: special files, counts of copies, sizes.

MuJoCo allocates a height field while it parses, before anything can be removed from the model.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from stiffgen.core.robot.files import FileError, read_regular

MAX_COPIES = 500
"""Copies of a body that a file may ask for; MuJoCo takes 6 s for 1000 of them, and 150 s for 4000."""
_COPYING = {"replicate": MAX_COPIES, "composite": MAX_COPIES, "flexcomp": 20 * MAX_COPIES}
_CELLS = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}
MAX_CELLS = 1 << 24
"""Cells of a height field or texture that a file may ask for, which stiffgen does not use: 64 MiB of numbers."""
_ENTRIES = {"size": re.compile(r"n(user\w*|key)"), "mesh": re.compile("params")}
_ENTRIES |= dict.fromkeys(("motor", "general", "position", "velocity"), re.compile("nsample"))
_NONE = re.compile("(?!)")
MAX_ENTRIES = 10_000
"""Largest size of another kind: user data, keyframes, samples of a delay, resolution of a built-in mesh."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_MAX_BYTES = 64 * 2**20


def check_parts(file: Path, most_files: int) -> None:
    """Refuse a file that names a pipe, a device or a folder, or that asks for many copies.

    Raises:
        FileError: with a sentence for the user.

    """
    pending, seen = [(file, 1.0)], {file}  # files with how many copies of them are asked for
    while pending and len(seen) < most_files:
        current, copies = pending.pop()
        try:
            root = ElementTree.fromstring(read_regular(current, _MAX_BYTES))
        except (ElementTree.ParseError, OSError):
            continue  # MuJoCo says what is wrong with it
        folders = [current.parent, file.parent]
        folders += [file.parent / each.get(key, "") for each in root.iter("compiler") for key in _FOLDERS]
        for element, count in _copied(root, copies):
            _check_size(element)
            for place in _named_files(element, folders):
                if element.tag in ("include", "model") and place not in seen:
                    seen.add(place)
                    pending.append((place, count))


def _named_files(element: ElementTree.Element, folders: list[Path]) -> Iterator[Path]:
    """Yield the files that an element names, in each of the folders where one is; refuse what is no regular file."""
    name = element.get("file")
    for place in [folder / name for folder in folders] if name else []:
        if not place.exists():
            continue
        if not place.is_file():
            raise FileError(f"<{element.tag}> names '{os.path.normpath(place)}', which is not a regular file")
        yield place


def _check_size(element: ElementTree.Element) -> None:
    """Refuse an element that states a size for which MuJoCo would take gigabytes."""
    keys = _CELLS.get(element.tag, ())
    cells = math.prod(max(_numbers(element, key), default=1.0) for key in keys)  # 1 for another element
    if cells > MAX_CELLS:
        stated = " ".join(f"{key}='{element.get(key, '')[:20]}'" for key in keys)
        raise FileError(
            f"<{element.tag} {stated}> has more than {MAX_CELLS} cells, and stiffgen uses none; "
            f"remove the <{element.tag}>, or lower the numbers"
        )
    pattern = _ENTRIES.get(element.tag, _NONE)
    for key in element.attrib:
        if pattern.fullmatch(key) and max(_numbers(element, key), default=0.0) > MAX_ENTRIES:
            raise FileError(f"<{element.tag} {key}='{element.get(key, '')[:40]}'> is above {MAX_ENTRIES}; lower it")


def _numbers(element: ElementTree.Element, key: str) -> list[float]:
    """Return the numbers of an attribute; MuJoCo refuses what is none."""
    try:
        return [float(word) for word in element.get(key, "").split()]
    except ValueError:
        return []


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
