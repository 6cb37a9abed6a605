"""Backends: a target is one record, of how numbers are spelt and what runs side by side. See README.md."""

from __future__ import annotations

from dataclasses import dataclass

SCALAR = "double"
"""C type of a number that all configurations and joints share, on every target: constants are printed to its digits."""


@dataclass(frozen=True)
class Target:
    """One way to print the kernels.

    Attributes:
        number: C type of an entry of arguments and results: of one configuration, or of several side by side.
        row: C type of what rows over joints are made of; the ``number`` where nothing runs side by side over joints.
        joint_lanes: rows over joints are lanes of joints; else loops run joint by joint.
        batches: only the kernels that have a batch are printed.
        guard: C function that gives NaN for infinity, on ``number``.
        spread: C function that makes ``row`` of a scalar; "" where they are the same.
        suffix: of the names of internal functions.
        qualifier: before the definitions of internal functions.
        helper: before those of small helpers, which are to be inlined.
        table: before the definitions of constant tables.
        aligned: before the declarations of arrays over pairs of joints.

    """

    number: str
    row: str
    joint_lanes: bool
    batches: bool
    guard: str
    spread: str
    suffix: str = ""
    qualifier: str = "static"
    helper: str = "static inline"
    table: str = "static const"
    aligned: str = ""

    @property
    def row_zero(self) -> str:
        """C text of an entry of a row that is 0."""
        return "0.0" if self.row == SCALAR else f"{self.spread}(0.0)"

    @property
    def zero(self) -> str:
        """C text of a number that is 0."""
        return "0.0" if self.number == SCALAR else f"{self.spread}(0.0)"


# gcc 12 stores to large arrays with an alignment that it does not give them itself.
SINGLE = Target(
    number="double",
    row="lanes",
    joint_lanes=True,
    batches=False,
    guard="finite_or_nan",
    spread="same",
    aligned="ALIGNED ",
)
"""One configuration; what runs over joints runs over lanes of joints (templates/lanes.c)."""

BATCH = Target(
    number="lanes",
    row="lanes",
    joint_lanes=False,
    batches=True,
    guard="finite_lanes",
    spread="same",
    suffix="_lanes",
    aligned="ALIGNED ",
)
"""LANES configurations at a time, one in each lane."""

CUDA = Target(
    number="double",
    row="double",
    joint_lanes=False,
    batches=True,
    guard="finite_or_nan",
    spread="",
    qualifier="DEVICE",
    helper="DEVICE",
    table="TABLE",
)
"""One configuration a thread."""
