# SPDX-License-Identifier: MIT
"""Pictures of the pages against those that their programs draw now: words, shapes and places, or pixels."""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree

import numpy as np
from matplotlib.image import imread
from numpy.typing import NDArray

BLOCK = 10
"""Pixels of a block's side: edges of letters, which differ from one renderer to the next, are evened out."""
SEEN = 0.06
"""Difference of two blocks' mean colour that counts, of 1."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_PLACES = ("d", "points", "x", "y", "x1", "x2", "y1", "y2", "cx", "cy", "transform")


def _parts(svg: str) -> tuple[list[str], list[str], list[np.ndarray]]:
    """Return the texts, the kinds of the elements, and the numbers that place each of them."""
    root = ElementTree.fromstring(svg)
    texts = ["".join(each.itertext()) for each in root.iter("{http://www.w3.org/2000/svg}text")]
    kinds = [each.tag.rpartition("}")[2] for each in root.iter()]
    places = [
        np.array([float(n) for key in _PLACES for n in _NUMBER.findall(each.get(key, ""))]) for each in root.iter()
    ]
    return texts, kinds, places


def texts_of(svg: str) -> list[str]:
    """Return the texts of a picture."""
    return _parts(svg)[0]


def difference(drawn: str, committed: str, within: float) -> str:
    """Return how two pictures differ, in words; nothing if they are alike.

    Args:
        drawn: picture that a program draws now.
        committed: picture of a page.
        within: largest distance of a coordinate in the picture's own units, for numbers that differ in their last
            digits from machine to machine.

    """
    (texts, kinds, places), (old_texts, old_kinds, old_places) = _parts(drawn), _parts(committed)
    if texts != old_texts:
        return f"texts {sorted({*texts} - {*old_texts})}, not {sorted({*old_texts} - {*texts})}"
    if kinds != old_kinds:
        return f"{len(kinds)} elements, not {len(old_kinds)}"
    for kind, new, old in zip(kinds, places, old_places, strict=True):
        if new.shape != old.shape:
            return f"a {kind} of {len(new)} numbers, not {len(old)}"
        if new.size and np.abs(new - old).max() > within:
            return f"a {kind} is {np.abs(new - old).max():.3g} away from its place"
    return ""


def pixels(png: bytes) -> NDArray[np.float64]:
    """Return the colours of a PNG and its opacity where it has one: (height, width, 3 or 4), of 1."""
    return np.asarray(imread(io.BytesIO(png), format="png"), dtype=float)


def share_of_pixels(first: bytes, second: bytes) -> float:
    """Return the share of blocks in which two PNGs differ, 1 if their sizes do."""
    a, b = pixels(first), pixels(second)
    if a.shape != b.shape:
        return 1.0
    rows, columns, channels = a.shape[0] // BLOCK, a.shape[1] // BLOCK, a.shape[2]
    blocks = (a - b)[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK, channels)
    return float((np.abs(blocks.mean(axis=(1, 3))).max(axis=2) > SEEN).mean())
