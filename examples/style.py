# SPDX-License-Identifier: MIT
"""How every figure of the examples looks: as those of ``stiffgen analyze``."""

from stiffgen.style import AXES, CONVENTIONAL, CORRECTED, INK, POTENTIAL, SHADES, STYLE, themed_svg

__all__ = ["AXES", "CONVENTIONAL", "CORRECTED", "INK", "POTENTIAL", "SHADES", "STYLE", "themed_svg"]
