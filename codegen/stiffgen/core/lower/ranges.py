# SPDX-License-Identifier: MIT
"""Arguments for which rounding bounds are stated, and how one is stated. The family ``rounding`` finds the bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stiffgen.core.errors import ChainError
from stiffgen.core.given import is_number, plain_record, shown
from stiffgen.core.lower.scalar import Scalar


@dataclass(frozen=True)
class Ranges:
    """Largest arguments, entry by entry, for which the bounds hold.

    Joint positions stay within the limits of the URDF; without limits a turning joint goes up to
    :attr:`Scalar.largest_angle` and a sliding one up to ``slide``. Blocks of a stiffness that couple translation and
    rotation are at most the geometric mean of the two others: no positive definite matrix has more. The equilibrium's
    origin lies within the robot's reach.

    Attributes:
        force, moment: of a wrench [N], [N m].
        translation_stiffness, rotation_stiffness: [N/m], [N m/rad].
        distance: of a floating base from the world's origin [m].
        tool: distance of a tool's frame from the tip link's [m].
        slide: position of a sliding joint without limits [m].
        rate: of a joint without a velocity limit [rad/s, m/s].
        gravity: acceleration of free fall [m/s^2].

    """

    force: float = 200.0
    moment: float = 50.0
    translation_stiffness: float = 5000.0
    rotation_stiffness: float = 500.0
    distance: float = 10.0
    tool: float = 1.0
    slide: float = 10.0
    rate: float = 30.0
    gravity: float = 10.0

    def __post_init__(self) -> None:
        """Refuse bounds that are not positive numbers."""
        plain_record(self)
        for name, largest in vars(self).items():
            if not is_number(largest) or not 0 < largest < math.inf:
                raise ChainError(f"range {name}={shown(largest)}: must be a positive number")

    @property
    def coupling(self) -> float:
        """Largest entry of a block that couples translation and rotation [N]."""
        return math.sqrt(self.translation_stiffness * self.rotation_stiffness)

    def lines(self, scalar: Scalar) -> list[str]:
        """Return the ranges in words, for a comment."""
        return [
            f"joint positions within the limits (up to {scalar.largest_angle:g} rad or {self.slide:g} m where there "
            "are none), every",
            f"force up to {self.force:g} N and moment up to {self.moment:g} N m, entries of stiffnesses up to",
            f"{self.translation_stiffness:g} N/m, {self.rotation_stiffness:g} N m/rad and, where they couple the two, "
            f"{self.coupling:.0f} N, gravity up to",
            f"{self.gravity:g} m/s^2, equilibria within the robot's reach, joint rates up to their limits "
            f"({self.rate:g} rad/s or m/s where there are none)",
        ]


@dataclass(frozen=True)
class Stated:
    """Bound for a report: of the entries ``what`` of ``result``, in ``unit``."""

    result: str
    what: str
    unit: str
    bound: float

    @property
    def text(self) -> str:
        """Return the bound in words."""
        size = (
            f"within {self.bound:.1e}{f' {self.unit}' if self.unit else ''}"
            if self.bound
            else "exact but for underflow"
        )
        return f"{self.what} {size}"
