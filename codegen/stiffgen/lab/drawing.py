# SPDX-License-Identifier: MIT
"""Draw a page's figure as SVG with matplotlib, which nothing else needs."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from stiffgen.core.errors import MissingExtraError, install_command


def draw_svg(what: str, size: tuple[float, float], draw: Callable[[Any, Any], None]) -> str:
    """Return a figure as SVG text, in the colours of the page.

    Args:
        what: picture to name in the message, as the subject of "needs matplotlib".
        size: width and height [inch].
        draw: function of the empty figure and of :mod:`stiffgen.style`.

    Raises:
        MissingExtraError: matplotlib is not installed.

    """
    try:
        drawing: Any = import_module("matplotlib.figure")
    except ImportError as error:
        raise MissingExtraError(
            f"{what} needs matplotlib, which is not installed; " + install_command("analyze")
        ) from error
    style: Any = import_module("stiffgen.lab.style")
    with import_module("matplotlib").rc_context(style.STYLE):
        figure = drawing.Figure(figsize=size, layout="constrained")
        draw(figure, style)
        text: str = style.themed_svg(figure)
    return text
