# SPDX-License-Identifier: MIT
"""Arguments and results of kernels: name, shape, unit and meaning, as printed in headers, docstrings and manifests."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.program import Array

Extent = int | str
"""Extent: a number, "n", the number of velocity coordinates, "q", of joint positions (fewer on a floating base), or
"triangle", of the entries that the upper triangle of n rows has."""


@dataclass(frozen=True)
class Argument:
    """Argument or result of a kernel: name, row-major shape (a number has none), unit and meaning.

    ``symmetric`` says of a result that it is a symmetric matrix, to the last bit. ``symbol`` is the letter that
    formulas have for an argument, ``plural`` its name where it holds one value per tip. ``of_configuration`` marks the
    part of the configuration that all tips share. CUDA takes one vector per configuration, and one matrix if the
    matrix is ``varying``; an ``own`` argument (a cotangent, vectors of all tips) always has one per configuration. Of a
    symmetric matrix with ``triangle`` only the upper triangle is read.
    """

    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    symmetric: bool = False
    symbol: str = ""
    plural: str = ""
    own: bool = False
    of_configuration: bool = False
    varying: bool = False
    triangle: bool = False

    def of_all_tips(self, names: list[str]) -> Argument:
        """Return the argument that holds one block of this a tip, in the order of ``names``."""
        order = "one a tip, in the order " + ", ".join(names)
        return replace(
            self,
            name=self.plural,
            shape=(len(names), *self.shape),
            meaning=f"{order}: {self.meaning}",
            own=self.own or len(self.shape) == 1,  # as a vector is each configuration's
        )

    def packed(self) -> Argument:
        """Return the result as packed batches and CUDA store it: of a symmetric matrix the upper triangle by rows."""
        if not self.symmetric:
            return self
        rows = self.shape[0]
        extent = "triangle" if isinstance(rows, str) else rows * (rows + 1) // 2
        meaning = f"{self.meaning}: its upper triangle, row by row"
        return replace(self, shape=(extent,), symmetric=False, meaning=meaning)

    def array(self, chain: Chain) -> Array:
        """Return the argument as an array of the chain's sizes."""
        n = chain.dof
        sizes = {"n": n, "q": len(chain.coordinates), "triangle": n * (n + 1) // 2}
        return Array(self.name, tuple(sizes[e] if isinstance(e, str) else e for e in self.shape), self.symbol)


Q = Argument("q", ("q",), "rad or m", "joint positions, base to tip", symbol="q", of_configuration=True)
BASE_POSE = Argument(
    "base_pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the base link in the world; R must be a rotation",
    symbol="B", of_configuration=True, varying=True,
)  # fmt: skip
TOOL_POSE = Argument(
    "tool_pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the tool in the tip's frame; R must be a rotation",
    symbol="T", plural="tool_poses",
)  # fmt: skip
VELOCITY = Argument("velocity", ("n",), "rad/s or m/s", "rates of the joint positions", symbol="dq")
GRAVITY = Argument(
    "gravity", (3,), "m/s^2", "acceleration of free fall in base axes, (0, 0, -9.81) where z points up", symbol="g"
)  # fmt: skip
_WRENCH_FRAME = {
    "body": "in tip axes, moment about the tip's origin",
    "spatial": "in base axes, moment about the base's origin",
    "hybrid": "in base axes, moment about the tip's origin",
}
_STIFFNESS_FRAME = {
    "body": "tip axes at the tip's origin",
    "spatial": "base axes at the base's origin",
    "hybrid": "base axes at the tip's origin",
}


def wrench(representation: Representation) -> Argument:
    """Return the wrench on the tip."""
    return Argument(
        "wrench",
        (6,),
        "N, N m",
        f"(force, moment) that the environment applies to the robot, {_WRENCH_FRAME[representation]}",
        symbol="F",
        plural="wrenches",
    )


def task_stiffness(representation: Representation, *, triangle: bool) -> Argument:
    """Return the task stiffness, of which all entries are read or the upper ``triangle``."""
    reading = "symmetric, only the upper triangle is read" if triangle else "all 36 entries are read"
    return Argument(
        "task_stiffness",
        (6, 6),
        "N/m, N, N m",
        f"stiffness on twists (linear, angular), {_STIFFNESS_FRAME[representation]}; {reading}",
        symbol="K",
        plural="task_stiffnesses",
        triangle=triangle,
    )


POSE = Argument("pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the tip in the base frame")


def configuration_arguments(*, runtime_tool: bool, floating: bool = False) -> tuple[Argument, ...]:
    """Return the configuration arguments: q, before it the base pose, after it the tool pose at run time."""
    return (*((BASE_POSE,) if floating else ()), Q, *((TOOL_POSE,) if runtime_tool else ()))


_IN_THE_WORLD = (
    ("in base axes", "in world axes"),
    ("base axes at the", "world axes at the"),
    ("the base's origin", "the world's origin"),
    ("the base's height", "the world's origin's height"),
    ("in the base frame", "in the world"),
    (
        "rates of the joint positions",
        "twist of the base link (linear, angular) in its own axes, then rates of the joints",
    ),
)


def in_the_world(text: str) -> str:
    """Rewrite the text of a fixed base for a floating one: the world takes the place of the base."""
    for standing, floating in _IN_THE_WORLD:
        text = text.replace(standing, floating)
    return text
