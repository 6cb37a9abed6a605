# SPDX-License-Identifier: MIT
"""Arguments and results of kernels: one record has all that headers, bounds and checks know of a quantity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from stiffgen.core.errors import StiffgenError, listed
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import quantities
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.program import Array
from stiffgen.core.symbolic.quantities import (
    RANGES,
    Blocks,
    Draw,
    Magnitude,
    Normal,
    pose_within,
    random_poses,
    within_limits,
)

Extent = int | str
"""Extent of an array: an integer, or one of three names.

"n": number of velocity coordinates; "q": number of joint positions (fewer on a floating base). With closed loops, "a":
number of velocity coordinates of the motors, "actuated": number of motors' positions, "equations": number of
independent equations of the loops. "triangle", "a_triangle": entries in the upper triangle of an n x n or a x a matrix.
"""


@dataclass(frozen=True)
class Argument:
    """Argument or result of a kernel: name, row-major shape (a number has none), unit and meaning.

    Attributes:
        name: name in C and Python.
        shape: extents; empty for a number.
        unit: SI unit.
        meaning: phrase for headers and docstrings.
        floating_meaning: meaning for a robot with a floating base; empty where ``meaning`` holds for both.
        symmetric: whether a result is a symmetric matrix, to the last bit.
        symbol: letter of the argument in formulas.
        plural: name of the argument where it holds one value per tip.
        per_configuration: whether CUDA always takes one per configuration (cotangents, vectors of all tips). Of other
            arguments, CUDA takes one vector per configuration; all configurations share a matrix unless it is
            ``varying`` or the launch function's name ends in ``_each_cuda``.
        of_configuration: whether the argument belongs to the configuration and is shared by all tips.
        varying: whether every launch function of CUDA takes one matrix per configuration.
        symmetric_part: whether kernels use only the symmetric part of the matrix, 0.5 (K + K^T).
        draw: random values for checks; every argument of a kernel has one, a result has none.
        largest: range of the entries' magnitudes, for rounding bounds; "none" if no range is known.
        blocks: kinds of entries with ranges of their own, in place of ``largest``; in reports, also of results.
        turns: whether entries are angles or rotations.
        is_q: whether the argument is the joint positions on which the kinematics depend.
        is_base_pose: whether the argument is the pose of a floating base; its derivative belongs to the base's twist.
        each: argument of one tip, if this one holds one value per tip.

    """

    # More than twelve fields: what is known of a quantity stands in this record alone.

    name: str
    shape: tuple[Extent, ...]
    unit: str
    meaning: str
    symmetric: bool = False
    symbol: str = ""
    plural: str = ""
    per_configuration: bool = False
    of_configuration: bool = False
    varying: bool = False
    symmetric_part: bool = False
    floating_meaning: str = ""
    draw: Draw | None = None
    largest: Magnitude | None = None
    blocks: Blocks | None = None
    turns: bool = False
    is_q: bool = False
    is_base_pose: bool = False
    each: Argument | None = None

    def check_complete(self, kernel: str) -> None:
        """Raise StiffgenError, which names the line to write, if an argument of a kernel lacks draw or range."""
        ranges = [self.largest] if self.blocks is None else [block.largest for block in self.blocks.kinds]
        remedy = ""
        if self.draw is None:
            remedy = "has no random values for verify; write draw=Normal(SCALE) or another draw of quantities.py"
        elif ranges == [None]:
            remedy = 'has no range for rounding bounds; write largest=NUMBER, largest="none" or blocks=...'
        elif any(isinstance(each, str) and each not in RANGES for each in ranges):
            remedy = f"has an unknown range; ranges are numbers and {listed(list(RANGES))}"
        if remedy:
            raise StiffgenError(f"kernel {kernel}: Argument({self.name!r}, ...) {remedy}")

    @classmethod
    def referred(cls, name: str, shape: tuple[Extent, ...], unit: str, meaning: str, **options: Any) -> Argument:
        """Return an argument whose ``meaning`` has "{reference}" for "base" or, on a floating base, "world"."""
        fixed, floating = (meaning.format(reference=reference) for reference in ("base", "world"))
        return cls(name, shape, unit, fixed, floating_meaning=floating, **options)

    def on_floating_base(self) -> Argument:
        """Return the argument with its meaning for a floating base."""
        return replace(self, meaning=self.floating_meaning or self.meaning, floating_meaning="")

    def of_all_tips(self, names: list[str]) -> Argument:
        """Return the argument that holds one value of this per tip, in the order of ``names``."""
        order = "one per tip, in the order " + ", ".join(names)
        return replace(
            self,
            name=self.plural,
            shape=(len(names), *self.shape),
            meaning=f"{order}: {self.meaning}",
            floating_meaning=self.floating_meaning and f"{order}: {self.floating_meaning}",
            per_configuration=self.per_configuration or len(self.shape) == 1,  # CUDA takes one vector per configuration
            each=self,
        )

    def packed(self) -> Argument:
        """Return the result as packed batches and CUDA store it: a symmetric matrix as its upper triangle, by rows."""
        if not self.symmetric:
            return self
        rows = self.shape[0]
        triangles = {"n": "triangle", "a": "a_triangle"}
        extent = triangles[rows] if isinstance(rows, str) else rows * (rows + 1) // 2
        meaning = f"{self.meaning}: its upper triangle, row by row"
        return replace(self, shape=(extent,), symmetric=False, blocks=None, meaning=meaning)

    def array(self, chain: Chain) -> Array:
        """Return the argument as an array of the chain's sizes."""
        n, a = chain.dof, len(chain.motors)
        sizes = {"n": n, "q": len(chain.coordinates), "triangle": n * (n + 1) // 2}
        sizes |= {"a": a, "actuated": len(chain.actuated), "a_triangle": a * (a + 1) // 2}
        sizes |= {"equations": sum(len(loop.rows) for loop in chain.loops)}
        shape = tuple(sizes[e] if isinstance(e, str) else e for e in self.shape)
        return Array(
            self.name, shape, self.symbol, self.symmetric, self.is_q, self.is_base_pose, self.symmetric_part
        )  # fmt: skip


Q = Argument(
    "q", ("q",), "rad or m", "joint positions, base to tip", symbol="q", of_configuration=True,
    draw=within_limits, largest="positions", turns=True, is_q=True,
)  # fmt: skip
BASE_POSE = Argument(
    "base_pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the base link in the world; R must be a rotation",
    symbol="B", of_configuration=True, varying=True, draw=random_poses, blocks=pose_within("distance"), turns=True,
    is_base_pose=True,
)  # fmt: skip
TOOL_POSE = Argument(
    "tool_pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the tool in the tip's frame; R must be a rotation",
    symbol="T", plural="tool_poses", draw=random_poses, blocks=pose_within("tool"), turns=True,
)  # fmt: skip
VELOCITY = Argument(
    "velocity", ("n",), "rad/s or m/s", "rates of the joint positions", symbol="dq", draw=Normal(), largest="rates",
    floating_meaning="twist of the base link (linear, angular) in its own axes, then rates of the joints",
)  # fmt: skip
GRAVITY = Argument.referred(
    "gravity", (3,), "m/s^2", "acceleration of free fall in {reference} axes, (0, 0, -9.81) where z points up",
    symbol="g", draw=Normal(6.0), largest="gravity",
)  # fmt: skip
_WRENCH_FRAME = {
    "body": "in tip axes, moment about the tip's origin",
    "spatial": "in {reference} axes, moment about the {reference}'s origin",
    "hybrid": "in {reference} axes, moment about the tip's origin",
}
_STIFFNESS_FRAME = {
    "body": "tip axes at the tip's origin",
    "spatial": "{reference} axes at the {reference}'s origin",
    "hybrid": "{reference} axes at the tip's origin",
}

SYMMETRIC_PART = "symmetric part 0.5 (K + K^T) is used"
_MEASURED = {
    "body": "subtract Gamma F from a matrix measured under the wrench",
    "spatial": "subtract Gamma F from a matrix measured under the wrench",
    "hybrid": "a matrix measured under the wrench is right as it is",
}


def wrench(representation: Representation) -> Argument:
    """Return the wrench on the tip."""
    return Argument.referred(
        "wrench",
        (6,),
        "N, N m",
        f"(force, moment) that the environment applies to the robot, {_WRENCH_FRAME[representation]}",
        symbol="F",
        plural="wrenches",
        draw=Normal((30.0, 30.0, 30.0, 10.0, 10.0, 10.0)),
        blocks=quantities.WRENCH,
    )


def task_stiffness(representation: Representation, *, symmetric_part: bool) -> Argument:
    """Return the task stiffness; the kernel uses its ``symmetric_part``, or all entries."""
    reading = f"{SYMMETRIC_PART}; {_MEASURED[representation]}" if symmetric_part else "all 36 entries are read"
    return Argument.referred(
        "task_stiffness",
        (6, 6),
        "N/m, N, N m",
        f"stiffness on twists (linear, angular), {_STIFFNESS_FRAME[representation]}; {reading}",
        symbol="K",
        plural="task_stiffnesses",
        symmetric_part=symmetric_part,
        draw=quantities.TaskStiffness(symmetric=symmetric_part),
        blocks=quantities.STIFFNESS,
    )


POSE = Argument.referred(
    "pose", (4, 4), "m", "homogeneous pose [R p; 0 1] of the tip in the {reference} frame", blocks=pose_within("reach")
)


def configuration_arguments(*, runtime_tool: bool, floating: bool = False) -> tuple[Argument, ...]:
    """Return the configuration arguments: base pose (floating base), q, and tool pose (tool at run time)."""
    return (*((BASE_POSE,) if floating else ()), Q, *((TOOL_POSE,) if runtime_tool else ()))
