# SPDX-License-Identifier: MIT
"""Quantities of arguments and results: kinds of entries, ranges of their magnitudes, and random values.

A draw takes a :class:`Sampling` and returns one value per state. ``stiffgen verify`` and the tests take all arguments
from these draws; rounding bounds hold for the ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from stiffgen.core.robot.chain import Chain
from stiffgen.core.robot.geometry import FloatArray

Named = Literal[
    "positions", "rates", "force", "moment", "translation_stiffness", "coupling", "rotation_stiffness", "gravity",
    "distance", "tool", "reach", "rotation", "none",
]  # fmt: skip
"""Ranges of :class:`stiffgen.core.lower.ranges.Ranges`, of the chain ("positions", "rates", "reach") or of rotations.

"none": no range is known; functions with such an argument have no certified bound.
"""
Magnitude = Named | float
"""Largest size of an entry: a name, or a number in the unit of the argument."""
RANGES = get_args(Named)


@dataclass(frozen=True)
class BlockKind:
    """Entries of one kind: name and unit in reports (those without a name are constants), largest magnitude."""

    name: str
    unit: str
    largest: Magnitude = "none"


@dataclass(frozen=True)
class Blocks:
    """Kinds of the entries of a vector or matrix; ``number(*indices)`` is the kind of an entry."""

    kinds: tuple[BlockKind, ...]
    number: Callable[..., int]

    def entries(self, shape: tuple[int, ...]) -> list[tuple[BlockKind, list[int]]]:
        """Return each kind with its row-major entries."""
        numbers = [self.number(*index) for index in np.ndindex(shape)]
        return [(block, [k for k, of in enumerate(numbers) if of == j]) for j, block in enumerate(self.kinds)]


def _half(row: int, *_: int) -> int:
    return row // 3


def _quarter(row: int, column: int) -> int:
    return row // 3 + column // 3


def _part_of_pose(row: int, column: int) -> int:
    return int(column == 3) + 2 * int(row == 3)


WRENCH = Blocks((BlockKind("force", "N", "force"), BlockKind("moment", "N m", "moment")), _half)
TWISTS = Blocks((BlockKind("linear rows", "m per rad or m"), BlockKind("angular rows", "rad per rad or m")), _half)
STIFFNESS = Blocks(
    (
        BlockKind("translation block", "N/m", "translation_stiffness"),
        BlockKind("coupling", "N", "coupling"),
        BlockKind("rotation block", "N m", "rotation_stiffness"),
    ),
    _quarter,
)


def pose_within(distance: Named) -> Blocks:
    """Return the kinds of a homogeneous pose whose origin lies within a distance."""
    constants = BlockKind("", "", 0.0), BlockKind("", "", 1.0)
    kinds = BlockKind("rotation", "", "rotation"), BlockKind("position", "m", distance), *constants
    return Blocks(kinds, _part_of_pose)


@dataclass(frozen=True)
class Sampling:
    """Values of one argument to draw.

    Attributes:
        random: generator of this argument.
        count: number of states.
        shape: shape of the argument.
        chain: the robot.
        values: function that returns the values of another argument in the same states.

    """

    random: np.random.Generator
    count: int
    shape: tuple[int, ...]
    chain: Chain
    values: Callable[[Any], FloatArray]

    @property
    def size(self) -> tuple[int, ...]:
        """Shape of all values."""
        return (self.count, *self.shape)


Draw = Callable[[Sampling], FloatArray]


@dataclass(frozen=True)
class Normal:
    """Normally distributed entries of both signs with a standard deviation, or with one per entry of the last axis."""

    deviation: float | tuple[float, ...] = 1.0

    def __call__(self, to: Sampling) -> FloatArray:
        """Return values."""
        return np.asarray(to.random.normal(size=to.size) * np.array(self.deviation))


@dataclass(frozen=True)
class Uniform:
    """Entries between two numbers."""

    lower: float
    upper: float

    def __call__(self, to: Sampling) -> FloatArray:
        """Return values."""
        return to.random.uniform(self.lower, self.upper, to.size)


@dataclass(frozen=True)
class PositiveDefinite:
    """Full symmetric positive definite matrices with entries of about ``scale`` times the size, never near singular."""

    scale: float

    def __call__(self, to: Sampling) -> FloatArray:
        """Return values."""
        roots = to.random.normal(size=to.size)
        return np.asarray(self.scale * (roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(to.shape[0])))


@dataclass(frozen=True)
class TaskStiffness:
    """Stiffnesses on twists, with a diagonal that an impedance controller would have."""

    symmetric: bool

    def __call__(self, to: Sampling) -> FloatArray:
        """Return values."""
        general = to.random.normal(size=to.size) * 100 + np.diag([700.0, 700, 800, 30, 30, 30])
        return (general + general.transpose(0, 2, 1)) / 2 if self.symmetric else general


def symmetric(to: Sampling) -> FloatArray:
    """Draw symmetric matrices with entries of both signs."""
    general = to.random.normal(size=to.size)
    return np.asarray((general + general.transpose(0, 2, 1)) / 2)


def random_poses(to: Sampling) -> FloatArray:
    """Draw orientations from random quaternions, and positions of some decimetres."""
    quaternions = to.random.normal(size=(4, to.count))
    w, x, y, z = quaternions / np.linalg.norm(quaternions, axis=0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    poses = np.zeros(to.size)
    poses[:, :3, :3] = np.array(rows).transpose(2, 0, 1)
    poses[:, :3, 3] = to.random.normal(size=(to.count, 3)) * 0.2  # [m]
    poses[:, 3, 3] = 1
    return poses


NEAR = 0.15
"""Largest distance of drawn joints from a closed configuration [rad or m]."""


def within_limits(to: Sampling) -> FloatArray:
    """Draw joint positions within the limits (unbounded joints: one turn, one metre), near a closed configuration."""
    if to.chain.loops:  # the loops' functions have singularities; near the closed configuration there are none
        return np.array(to.chain.start) + to.random.uniform(-NEAR, NEAR, to.size)
    reach = [math.pi if c.type != "prismatic" else 1.0 for c in to.chain.coordinates]
    ranges = np.array([c.range_within(r) for c, r in zip(to.chain.coordinates, reach, strict=True)])
    return to.random.uniform(ranges[:, 0], ranges[:, 1], to.size)
