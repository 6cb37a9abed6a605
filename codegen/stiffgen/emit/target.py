# SPDX-License-Identifier: MIT
"""Backends: a target is one record, of how numbers are spelt and what runs side by side. See README.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from stiffgen.errors import ChainError


@dataclass(frozen=True)
class Scalar:
    """A floating-point type of C.

    Attributes:
        name: of the type.
        suffix: of its constants, and of libm's functions of it.
        bits: of its significand.
        bytes: of its size.
        limits: prefix of its macros in float.h.
        pattern: the integer type of its size.
        group: macro that puts ``widest`` of its numbers into lanes (templates/lanes.c).

    """

    name: Literal["double", "float"]
    suffix: str
    bits: int
    bytes: int
    limits: str
    pattern: str
    group: str

    @property
    def widest(self) -> int:
        """Numbers in the widest vector of the generated code; rows are padded to multiples of it."""
        return 64 // self.bytes

    @property
    def dtype(self) -> np.dtype[Any]:
        """NumPy's type of these numbers."""
        return np.dtype(f"f{self.bytes}")

    def filled(self, count: int) -> int:
        """``count`` numbers, padded."""
        return -(-count // self.widest) * self.widest

    @property
    def unit(self) -> float:
        """Largest relative error of an operation, half the distance from 1 to the next number."""
        return 2.0**-self.bits

    def constant(self, value: float) -> str:
        """The shortest C constant of this type that reads back as the number nearest to ``value``.

        Raises:
            ChainError: the type has no number so large.

        """
        if math.isinf(value):
            return "INFINITY" if value > 0 else "-INFINITY"
        if self.name == "double":
            return repr(value)
        with np.errstate(over="ignore"):
            nearest = np.float32(value)
        if math.isinf(nearest):
            raise ChainError(
                f"--scalar {self.name}: {value:g} is beyond its largest number; leave --scalar out, or change the value"
            )
        return f"{nearest!s}{self.suffix}"


DOUBLE = Scalar("double", "", 53, 8, "DBL", "unsigned long long", "EIGHT")
FLOAT = Scalar("float", "f", 24, 4, "FLT", "unsigned", "SIXTEEN")
SCALARS = {scalar.name: scalar for scalar in (DOUBLE, FLOAT)}
"""By name."""


def scalar_of(values: Any) -> Scalar:
    """The type of an array's numbers."""
    return FLOAT if np.asarray(values).dtype == FLOAT.dtype else DOUBLE


@dataclass(frozen=True)
class Target:
    """One way to print the kernels.

    Attributes:
        scalar: type of a number.
        lanes: what runs side by side, in the lanes of vectors; else loops run one by one. Lanes of joints are entries
            of rows over joints, lanes of configurations every entry of arguments and results.
        batches: only the kernels that have a batch are printed.
        suffix: of the names of internal functions.
        qualifier: before the definitions of internal functions.
        helper: before those of small helpers, which are to be inlined.
        table: before the definitions of constant tables.
        aligned: before the declarations of arrays over pairs of joints.

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
        """Whether rows over joints are lanes of joints."""
        return self.lanes == "joints"

    @property
    def number(self) -> str:
        """C type of an entry of arguments and results: of one configuration, or of several side by side."""
        return "lanes" if self.lanes == "configurations" else self.scalar.name

    @property
    def row(self) -> str:
        """C type of what rows over joints are made of; the ``number`` where nothing runs side by side over joints."""
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
SINGLE = Target(lanes="joints", aligned="ALIGNED ")
"""One configuration; what runs over joints runs over lanes of joints (templates/lanes.c)."""

BATCH = Target(lanes="configurations", batches=True, suffix="_lanes", aligned="ALIGNED ")
"""LANES configurations at a time, one in each lane."""

CUDA = Target(batches=True, qualifier="DEVICE", helper="DEVICE", table="TABLE")
"""One configuration a thread. CUDA with ``scalar=FLOAT`` is the same in single precision."""
