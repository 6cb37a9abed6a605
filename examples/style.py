# SPDX-License-Identifier: MIT
"""Define the style of the examples' figures, the same as in ``stiffgen analyze``."""

from stiffgen.style import AXES, CONVENTIONAL, CORRECTED, INK, POTENTIAL, SHADES, STYLE, themed_svg

__all__ = ["AXES", "CONVENTIONAL", "CORRECTED", "INK", "POTENTIAL", "SHADES", "STYLE", "themed_svg"]
