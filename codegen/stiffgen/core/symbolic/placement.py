# SPDX-License-Identifier: MIT
"""Axes and centre of the stiffnesses of springs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from stiffgen.core.errors import PotentialError, listed, printable
from stiffgen.core.given import are_numbers, plain_record

Axes = Literal["base", "tip", "equilibrium"]
AXES: tuple[Axes, ...] = ("base", "tip", "equilibrium")
"""Axes of a stiffness: base axes, tip axes (which rotate with the tip), or the tip's axes at the equilibrium."""


@dataclass(frozen=True)
class Placement:
    """Axes and centre of the stiffnesses of springs.

    ``centre`` is the centre of stiffness in the tip's frame [m]: the translational stiffness acts on the displacement
    of this point. With ``translation_axes`` None, the axes are the base's, or for a coupled stiffness the
    equilibrium's.
    """

    translation_axes: Axes | None = None
    rotation_axes: Axes = "equilibrium"
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse unknown axes, and a centre that is not finite."""
        plain_record(self)
        for name in ("translation_axes", "rotation_axes"):
            axes = getattr(self, name)
            if axes not in AXES and (axes, name) != (None, "translation_axes"):
                raise PotentialError(f"placement {name}={printable(str(axes))}: axes are {listed(list(AXES))}")
        if not are_numbers(self.centre, 3) or not all(abs(x) < math.inf for x in self.centre):
            raise PotentialError("placement centre: must be three finite numbers [m]")
