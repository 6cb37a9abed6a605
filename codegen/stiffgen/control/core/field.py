# SPDX-License-Identifier: MIT
"""Field of a struct of the controller or of the paper's law, and the shapes that several fields share."""

from __future__ import annotations

import math
from dataclasses import dataclass

MAX_DOF = 40
"""Most coordinates of a robot with a controller."""

Extent = int | str
"""Extent of a field: a number, "n" for the coordinates, "joints", or one that is left out if it is 1: "tips"; "springs"
(tips, pairs, absolute springs of pairs); "twists" (tips, pairs)."""


@dataclass(frozen=True)
class Field:
    """Member of a struct.

    ``shape`` is row-major; () is a scalar. ``choices`` are the words that Python accepts for an int, each a C constant
    NAME_<FIELD>_<CHOICE>. Configuration only: ``default`` is a C expression ("{name}" is the robot's prefix, i the
    index, "{i}" that in q), ``reason`` says why this is the default, or why a field without one must be stated, and
    every entry must lie between ``least`` and ``most`` (both allowed).
    """

    # More than twelve fields: one table row describes a member in C, in Python and on the page.
    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    default: str = ""
    least: float = math.nan
    most: float = math.nan
    type: str = "double"
    choices: tuple[str, ...] = ()
    when: str = ""
    """Condition for the field: "tool", a tool pose; "loops", a robot with closed loops; "bounded", bounded springs;
    "several", several tips."""
    memory: str = ""
    """Member of the state's memory that an output reports, with its record: "account.tank"."""
    reason: str = ""

    @property
    def rule(self) -> str:
        """Condition on every entry, in words."""
        if self.choices:
            words = [*self.choices[:-2], " or ".join(self.choices[-2:])]
            return "must be " + ", ".join(words)
        each = "every entry must" if self.shape else "must"
        if math.isinf(self.most) and math.isinf(self.least):
            return "must be a number, or infinite"
        if math.isinf(self.most):
            return f"{each} be at least {self.least:g}, or infinite"
        return f"{each} lie between {self.least:g} and {self.most:g}"


SCALAR: tuple[Extent, ...] = ()
N, NN = ("n",), ("n", "n")
POSE, WRENCH, TASK, SPRING = ("tips", 4, 4), ("tips", 6), ("tips", 6, 6), ("tips", 3, 3)
"""Shapes, at the tips, of poses, wrenches, task stiffnesses, and stiffnesses of a spring's translation or rotation."""
SPRINGS, WRENCHES = ("springs", 3, 3), ("twists", 6)
"""Shapes of the stiffnesses of all springs, and of the wrenches of tips and pairs."""
