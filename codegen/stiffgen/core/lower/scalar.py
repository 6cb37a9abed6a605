# SPDX-License-Identifier: MIT
"""Number types of generated code."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from stiffgen.core.errors import ChainError


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
        largest_angle: of the fast path of sine and cosine [rad] (templates/sine_cosine.c).
        sine_error: largest error of a sine or cosine of an exact angle up to ``largest_angle``.
        digits: decimal digits to which rotations in arguments are orthogonal.
        rotation: largest entry of a product of at most 128 such rotations or rotations of the chain.

    """

    name: Literal["double", "float"]
    suffix: str
    bits: int
    bytes: int
    limits: str
    pattern: str
    group: str
    largest_angle: float
    sine_error: float
    digits: int
    rotation: float

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

    @cached_property
    def smallest(self) -> float:
        """Largest error of an operation whose result is subnormal."""
        return float(np.finfo(self.dtype).smallest_subnormal)

    @cached_property
    def largest(self) -> float:
        """Power of two below the largest number."""
        return 2.0 ** (np.finfo(self.dtype).maxexp - 1)

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


# Sines proved of templates/sine_cosine.c: 1.22 units (tests/core/sine_cosine_proof.py); CUDA documents two ulps.
DOUBLE = Scalar(
    "double", "", 53, 8, "DBL", "unsigned long long", "EIGHT",
    largest_angle=1e4, sine_error=2.0**-52, digits=11, rotation=1.0 + 2.0**-36,
)  # fmt: skip
# 0.96 units over all floats up to 6e3 rad (tests/campaigns/float_sines.py); CUDA documents two ulps.
FLOAT = Scalar(
    "float", "f", 24, 4, "FLT", "unsigned", "SIXTEEN",
    largest_angle=6e3, sine_error=2.0**-23, digits=6, rotation=1.0 + 2.0**-19,
)  # fmt: skip
SCALARS = {scalar.name: scalar for scalar in (DOUBLE, FLOAT)}
"""Number types by name."""


def scalar_of(values: Any) -> Scalar:
    """Return the type of an array's numbers."""
    return FLOAT if np.asarray(values).dtype == FLOAT.dtype else DOUBLE
