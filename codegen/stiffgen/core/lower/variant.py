# SPDX-License-Identifier: MIT
"""Variants: the ways in which kernels are printed, one record each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from stiffgen.core.lower.scalar import DOUBLE, Scalar


@dataclass(frozen=True)
class Variant:
    """Way to print the kernels.

    Attributes:
        scalar: type of a number.
        lanes: what the lanes of a vector hold: "" for no vectors, "joints" for rows over joints, "configurations" for
            every entry of arguments and results.
        batches: whether only the kernels that have a batch are printed.
        suffix: suffix of the names of internal functions.
        qualifier: text before the definitions of internal functions.
        helper: text before the definitions of small helpers, which are to be inlined.
        table: text before the definitions of constant tables.
        aligned: text before the declarations of arrays over pairs of joints.

    """

    scalar: Scalar = DOUBLE
    lanes: Literal["", "joints", "configurations"] = ""
    batches: bool = False
    suffix: str = ""
    qualifier: str = "static"
    helper: str = "static inline"
    table: str = "static const"
    aligned: str = ""

    @property
    def joint_lanes(self) -> bool:
        """Whether rows over joints are vectors of joints."""
        return self.lanes == "joints"

    @property
    def number(self) -> str:
        """C type of an entry of arguments and results: a number, or a vector with one configuration per lane."""
        return "lanes" if self.lanes == "configurations" else self.scalar.name

    @property
    def row(self) -> str:
        """C type of an element of a row over joints."""
        return "lanes" if self.lanes else self.scalar.name

    @property
    def guard(self) -> str:
        """C function that gives NaN for infinity, on ``number``."""
        return "finite_lanes" if self.lanes == "configurations" else "finite_or_nan"

    @property
    def spread(self) -> str:
        """C function that makes ``row`` of a scalar; "" where they are the same."""
        return "same" if self.lanes else ""

    @property
    def zero(self) -> str:
        """C text of a ``number`` that is 0."""
        return self.row_zero if self.number == "lanes" else self.scalar.constant(0.0)

    @property
    def row_zero(self) -> str:
        """C text of a ``row`` that is 0."""
        zero = self.scalar.constant(0.0)
        return f"{self.spread}({zero})" if self.spread else zero


# gcc 12 stores to large arrays with an alignment that it does not give them itself.
SINGLE = Variant(lanes="joints", aligned="ALIGNED ")
"""One configuration; loops over joints run over vectors of joints (templates/lanes.c)."""

BATCH = Variant(lanes="configurations", batches=True, suffix="_lanes", aligned="ALIGNED ")
"""LANES configurations at a time, one in each lane."""

CUDA = Variant(batches=True, qualifier="DEVICE", helper="DEVICE", table="TABLE")
"""One configuration per thread. CUDA with ``scalar=FLOAT`` is the same in single precision."""
