# SPDX-License-Identifier: MIT
"""Number types of generated code."""

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
        name: C name.
        suffix: suffix of constants, and of libm's functions.
        bits: bits of the significand.
        bytes: size of a number [bytes].
        limits: prefix of the macros in float.h.
        pattern: integer type of the same size.
        group: macro that puts ``widest`` numbers into a vector (templates/lanes.c).

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
        """Return the smallest multiple of ``widest`` that holds ``count`` numbers."""
        return -(-count // self.widest) * self.widest

    @property
    def unit(self) -> float:
        """Largest relative error of an operation, half the distance from 1 to the next number."""
        return 2.0**-self.bits

    def constant(self, value: float) -> str:
        """Return the shortest C constant of this type that reads back as the number nearest to ``value``.

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
"""Number types by name."""


def scalar_of(values: Any) -> Scalar:
    """Return the type of an array's numbers."""
    return FLOAT if np.asarray(values).dtype == FLOAT.dtype else DOUBLE
