# SPDX-License-Identifier: MIT
"""Fold figures for phones: panels that stand side by side in an SVG of matplotlib go below one another."""

from __future__ import annotations

import re
from itertools import pairwise
from xml.etree import ElementTree

_SVG = "{http://www.w3.org/2000/svg}"
_SPACE, _GAP = 7.0, 3.0
"""Room right of a panel for its last tick's label, and part of it that the next panel's label does not reach [pt]."""
_BAR = 0.15
"""Width of a panel over the widest one's, below which it is a colour bar."""
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
Box = tuple[float, float, float, float]


def _panels(figure: ElementTree.Element) -> list[tuple[ElementTree.Element, Box]]:
    """Return the axes with the boxes of their backgrounds: left, top, right, bottom [pt]."""
    found = []
    for group in figure.iter(f"{_SVG}g"):
        if not re.fullmatch(r"axes_\d+", group.get("id", "")):
            continue
        patch = group.find(f"{_SVG}g/{_SVG}path")
        if patch is None:
            continue
        numbers = [float(number) for number in _NUMBER.findall(patch.get("d", ""))]
        x, y = numbers[::2], numbers[1::2]
        found.append((group, (min(x), min(y), max(x), max(y))))
    return found


def narrow(svg: str) -> str | None:
    """Return the figure with its panels in one column; None unless it is one row of panels, without a common legend."""
    ElementTree.register_namespace("", _SVG[1:-1])
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(svg)
    figure = root.find(f"{_SVG}g[@id='figure_1']")
    size = [float(number) for number in root.get("viewBox", "").split()]
    panels = _panels(figure) if figure is not None else []
    boxes = [box for _, box in panels]
    if figure is None or len(panels) < 2 or any(after[0] < before[2] for before, after in pairwise(boxes)):
        return None
    widths = [right - left for left, _, right, _ in boxes]
    if min(widths) < _BAR * max(widths) or any(each.get("id", "").startswith("legend") for each in figure):
        return None
    starts = [0.0, *(box[2] + _GAP for box in boxes[:-1])]
    ends = [*(box[2] + _SPACE for box in boxes[:-1]), size[2]]
    width = max(right - left for left, right in zip(starts, ends, strict=True))
    for number, ((group, _), left) in enumerate(zip(panels, starts, strict=True)):
        group.set("transform", f"translate({-left:g} {number * size[3]:g})")
    root.set("viewBox", f"0 0 {width:g} {len(panels) * size[3]:g}")
    root.set("width", f"{width:g}pt")
    root.set("height", f"{len(panels) * size[3]:g}pt")
    return ElementTree.tostring(root, encoding="unicode")
