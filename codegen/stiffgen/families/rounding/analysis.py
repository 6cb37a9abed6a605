# SPDX-License-Identifier: MIT
"""Running error analysis of a graph of operations: a bound on each number's size and on its rounding error.

Both bounds follow operation by operation from those of the operands. Each operation is taken to be rounded once. A
compiler that contracts a product and a sum to one operation (fused multiply-add) rounds less often, so that the bounds
hold with and without it. The bounds are computed with doubles, each step enlarged by far more than it can lose to
rounding, with additions, products and square roots alone, so that they are the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from stiffgen.core.lower.graph import Graph
from stiffgen.core.lower.scalar import DOUBLE, Scalar

ENLARGED = 1.0 + 2.0**-46
"""After a few operations on doubles that are not negative, more than these can have lost."""


class NoBound(Exception):  # noqa: N818 - an answer, not a failure
    """A function has an operation or an argument of which nothing is known here."""


class Bound(NamedTuple):
    """Bounds on the magnitude of a number in real arithmetic and on its rounding error."""

    size: float
    error: float = 0.0


ZERO = Bound(0.0)


@dataclass
class BoundAnalysis:
    """The bounds of a graph's operations, given those of its inputs: a loop's body is analysed for each element."""

    graph: Graph
    outputs: Sequence[int]
    """Numbers of the operations whose bounds are asked for."""
    scalar: Scalar
    known: Mapping[int, float] = field(default_factory=dict)
    """Sizes of operations that follow from what they are, not from their operands."""
    inputs: Sequence[Bound] = field(init=False, default=())
    found: dict[int, Bound] = field(init=False, default_factory=dict)
    """Bounds of the operations for the inputs at hand."""

    @cached_property
    def needed(self) -> list[int]:
        """Numbers of the outputs and of all operations that they depend on, operands before what uses them."""
        return sorted(self.graph.uses(self.outputs))

    def bounds(self, inputs: Sequence[Bound]) -> list[Bound]:
        """Return the bounds of the outputs, given those of the inputs."""
        self.inputs, self.found, largest = inputs, {}, self.scalar.largest
        for number in self.needed:
            bound = self._bound(number)
            if number in self.known:
                bound = Bound(min(bound.size, self.known[number]), bound.error)
            if not bound.size + bound.error < largest:
                raise NoBound("numbers beyond the largest one")
            self.found[number] = bound
        return [self.found[number] for number in self.outputs]

    def _bound(self, number: int) -> Bound:
        """Return the bound of an operation, from those in ``found``: operands have smaller numbers.

        ``a`` is the number of an input, the value of a constant, or the number of the first operand, ``b`` that of the
        second.
        """
        kind, a, b = self.graph.keys[number]
        if kind == "input":
            return self.inputs[int(a)]
        if kind == "const":
            return self._constant(float(a))
        if kind == "neg":
            return self.found[int(a)]
        if kind == "mul":
            return self._product(int(a), b)
        if kind in ("add", "sub"):
            return self._sum(int(a), b)
        if kind in ("sin", "cos"):
            angle = self.found[int(a)]
            if angle.size > self.scalar.largest_angle:
                raise NoBound(f"angles beyond {self.scalar.largest_angle:g} rad")
            return Bound(1.0, (self.scalar.sine_error + angle.error) * ENLARGED)
        raise NoBound(f"the operation {kind}")

    def _constant(self, value: float) -> Bound:
        """Return the bound of a constant, which is a double: its type may not have so many bits."""
        unit = self.scalar.unit
        significand = math.frexp(value)[0]
        is_exact = unit == DOUBLE.unit or (significand / unit).is_integer()
        return Bound(abs(value), 0.0 if is_exact else abs(value) * unit * ENLARGED + self.scalar.smallest)

    def _is_power_of_two(self, number: int) -> bool:
        kind, value, _ = self.graph.keys[number]
        return kind == "const" and math.frexp(float(value))[0] == 0.5

    def _product(self, a: int, b: int) -> Bound:
        """Return the bound of a product; the last term is the error of a subnormal one."""
        x, y = self.found[a], self.found[b]
        if ZERO in (x, y):
            return ZERO
        size = x.size * y.size * ENLARGED
        error = x.size * y.error + y.size * x.error + x.error * y.error
        if self._is_power_of_two(a) or self._is_power_of_two(b):  # not rounded, unless the product is subnormal
            return Bound(size, error * ENLARGED + self.scalar.smallest)
        return Bound(size, (error + self.scalar.unit * (size + error)) * ENLARGED + self.scalar.smallest)

    def _sum(self, a: int, b: int) -> Bound:
        """Return the bound of a sum or difference; a subnormal one is exact."""
        x, y = self.found[a], self.found[b]
        if x == ZERO:
            return y
        if y == ZERO:
            return x
        size, error = self._turned(a, b) or (x.size + y.size, x.error + y.error)
        return Bound(size * ENLARGED, (error + self.scalar.unit * (size + error)) * ENLARGED)

    def _turned(self, a: int, b: int) -> Bound | None:
        """Return the bound of c X + s Y before rounding, c and s of one angle (cosine, sine); None for other sums."""
        for first, x in self._with_turn(a):
            for second, y in self._with_turn(b):
                (kind, angle, _), (other_kind, other_angle, _) = self.graph.keys[first], self.graph.keys[second]
                if kind != other_kind and angle == other_angle:
                    return self._of_turn((first, x), (second, y))
        return None

    def _with_turn(self, number: int) -> list[tuple[int, int]]:
        """Return (sine or cosine, other factor) for each factor of a product that is a sine or a cosine."""
        kind, a, b = self.graph.keys[number]
        if kind == "neg":
            return self._with_turn(int(a))
        pairs = ((int(a), b), (b, int(a))) if kind == "mul" else ()
        return [(turn, other) for turn, other in pairs if self.graph.keys[turn][0] in ("sin", "cos")]

    def _of_turn(self, *products: tuple[int, int]) -> Bound:
        """Return the bound of the sum of two products (number of sine or cosine, number of the other factor).

        Cauchy and Schwarz bound c X + s Y, its error c e_X + s e_Y, and the rounding d_1 c X + d_2 s Y of the products
        (|d| <= unit), since c and s are those of one angle. Their own errors count with the sizes of X and Y.
        """
        x, y = (self.found[other] for _, other in products)
        size = math.sqrt(x.size * x.size + y.size * y.size) * ENLARGED
        error = math.sqrt(x.error * x.error + y.error * y.error) * ENLARGED
        for turn, other in products:
            error += self.found[turn].error * (self.found[other].size + self.found[other].error)
        rounded = self.scalar.unit * (size + error) + 2 * self.scalar.smallest
        return Bound(size, (error + rounded) * ENLARGED)


def added(x: Bound, y: Bound, scalar: Scalar) -> Bound:
    """Return the bound of a rounded sum of two numbers."""
    size, error = x.size + y.size, x.error + y.error
    return Bound(size * ENLARGED, (error + scalar.unit * (size + error)) * ENLARGED)
