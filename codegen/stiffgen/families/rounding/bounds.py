# SPDX-License-Identifier: MIT
"""Certified bounds on the rounding errors of a chain's functions.

The bounds are computed from the lowered form that is printed (:mod:`stiffgen.core.lower.form`), item by item, by the
rules of :mod:`stiffgen.families.rounding.analysis`. Three facts keep them close to the actual errors:

- With the cosine c and the sine s of one angle, c X + s Y is at most sqrt(X^2 + Y^2), and so is the sum of its errors.
- Entries of rotations are at most 1, independent of the number of factors. Points of a serial chain are not farther
  away than the chain is long. The derivation marks such quantities (:class:`~stiffgen.core.symbolic.kinematics.Kind`).
- Entries that are zero for all arguments have no error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from decimal import ROUND_UP, Context
from typing import Any

import casadi as ca

from stiffgen.core.lower.form import (
    Body,
    ColumnSums,
    Entry,
    Function,
    Helpers,
    Invoke,
    InvokeKernel,
    Loop,
    SparseChange,
    Statements,
    TotalSums,
    Unused,
)
from stiffgen.core.lower.graph import build_graph
from stiffgen.core.lower.lowering import LoweredKernels
from stiffgen.core.lower.ranges import Ranges, Stated
from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.lower.statements import upper_entry
from stiffgen.core.lower.steps import lowered
from stiffgen.core.lower.variant import SINGLE
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import Argument
from stiffgen.core.symbolic.kernels import Kernel
from stiffgen.core.symbolic.kinematics import Kind
from stiffgen.core.symbolic.program import Array, Step, as_operand, evaluate
from stiffgen.core.symbolic.quantities import Magnitude
from stiffgen.families.rounding.analysis import ENLARGED, ZERO, Bound, BoundAnalysis, NoBound, added

__all__ = [
    "ErrorBounds", "NoBound",
    "argument_sizes", "chain_reach", "kinds", "rounded_up",
]  # fmt: skip

Bounds = dict[str, list[Bound]]
"""Bounds of the entries of arrays, row-major, by name."""


class ErrorBounds:
    """Bounds of a chain's functions."""

    def __init__(
        self, chain: Chain, ranges: Ranges | None = None, scalar: Scalar = DOUBLE, code: LoweredKernels | None = None
    ) -> None:
        """Set up bounds for arguments within ``ranges`` and numbers of the type ``scalar``.

        ``code`` is the lowered form that is printed; without one the functions are lowered here, in the same way.
        """
        self.chain, self.ranges, self.scalar = chain, ranges or Ranges(), scalar
        self.code = code or lowered(chain, replace(SINGLE, scalar=scalar))
        self._called: dict[str, tuple[list[list[Bound]], list[list[Bound]]]] = {}
        """Internal functions that were analysed: bounds of the arguments and of the outputs."""

    def of(self, kernel: Kernel) -> dict[str, list[float]]:
        """Return a bound of |computed - exact| for every entry of a kernel's results, row-major, by the result's name.

        Exact is what the printed formulas give in real arithmetic, with the constants that double precision prints and
        the arguments as they are passed.

        Raises:
            NoBound: the kernel divides, chooses, overflows, or has an argument without a range.

        """
        reach = chain_reach(kernel.scope(self.chain), self.ranges, self.scalar)
        arrays = {
            argument.array(self.chain).name: [
                Bound(size) for size in argument_sizes(self.chain, argument, self.ranges, reach, self.scalar)
            ]
            for argument in kernel.arguments
        }
        self._run(self.code.kernel(kernel), arrays)
        errors = {result.name: [bound.error for bound in arrays[result.name]] for result in kernel.results}
        if not all(bound < self.scalar.largest for bounds in errors.values() for bound in bounds):
            raise NoBound("numbers beyond the largest one")
        return errors

    def stated(self, kernel: Kernel) -> tuple[Stated, ...]:
        """Return the largest bound of the entries of each kind, rounded up to two digits; () without bounds."""
        try:
            bounds = self.of(kernel)
        except NoBound:
            return ()
        return tuple(
            Stated(result.name, what, unit, rounded_up(max(bounds[result.name][k] for k in entries), self.scalar))
            for result in kernel.results
            for what, unit, entries in kinds(result, result.array(self.chain))
        )

    def hindrance(self, kernel: Kernel) -> str:
        """Return why a kernel has no bounds; "" if it has."""
        try:
            self.of(kernel)
        except NoBound as error:
            return str(error)
        return ""

    def _run(self, function: Function, arrays: Bounds) -> None:
        """Add the bounds of what a function writes to those of its arguments."""
        for item in function.items:
            _RULES[type(item)](self, function, item, arrays)

    def _analysis(self, function: Function, body: Body) -> BoundAnalysis:
        """Return the analysis of a body; marked quantities have the bounds of their kinds, too."""
        reach = chain_reach(function.scope.chain, self.ranges, self.scalar) if body.kinds else 0.0
        sizes = {Kind.ROTATION: self.scalar.rotation, Kind.POINT: reach, Kind.ZERO: 0.0, Kind.ONE: 1.0}
        known: dict[int, float] = {}
        for number, kind in body.kinds:
            known[number] = min(sizes[kind], known.get(number, math.inf))
        return BoundAnalysis(body.graph, [output.number for output in body.outputs], self.scalar, known)

    def _statements(self, function: Function, item: Statements, arrays: Bounds) -> None:
        arrays |= {array.name: [ZERO] * array.size for array in item.step_outputs}  # entries without a place are zero
        bounds = self._analysis(function, item.body).bounds(_inputs(item.body, arrays))
        for output, bound in zip(item.body.outputs, bounds, strict=True):
            for place in output.places:
                _store(arrays, place, bound)

    def _loop(self, function: Function, item: Loop, arrays: Bounds) -> None:
        """Analyse the body for every element of the index set; entries that no loop stores are zero.

        The operands at i and at j are symbols of their own also where i is j: the printed loop does not know that.
        """
        array, analysis = item.operand.array, self._analysis(function, item.body)
        arrays.setdefault(array.name, [ZERO] * array.size)
        for i, j in item.over.indices(function.scope.chain):
            bounds = analysis.bounds(_inputs(item.body, arrays, i, j))
            for output, bound in zip(item.body.outputs, bounds, strict=True):
                _store(arrays, output.places[0], bound, i, j)
                if item.mirror:
                    _store(arrays, output.places[0], bound, j, i)

    def _sparse_change(self, function: Function, item: SparseChange, arrays: Bounds) -> None:
        """Analyse the entries that change; the others have the bounds of the start's upper triangle, or are zero."""
        bounds = self._analysis(function, item.body).bounds(_inputs(item.body, arrays))
        n = item.output.array.shape[0]
        entries = [ZERO] * (n * n)
        if item.start:
            start = arrays[item.start.array.name]
            entries = [start[upper_entry(k, n)] for k in range(n * n)]
        arrays[item.output.array.name] = entries
        for output, bound in zip(item.body.outputs, bounds, strict=True):
            for place in output.places:
                _store(arrays, place, bound)

    def _helpers(self, function: Function, item: Helpers, arrays: Bounds) -> None:
        if not item.ordered:
            raise NoBound("sums in another order on every vector width")
        if item.step:
            self._linear(function.scope.chain, item.step, arrays)

    def _linear(self, chain: Chain, step: Step, arrays: Bounds) -> None:
        """Unroll a step that adds and scales. Its sums have one order on every vector width."""
        inputs, bounds = list[ca.SX](), list[Bound]()  # entries that are not always zero
        operands: dict[str, ca.SX] = {}
        for array in {array.name: array for array in step.reads}.values():  # each array once
            symbols = [ca.SX.sym("x") if bound != ZERO else ca.SX(0) for bound in arrays[array.name]]
            inputs += [symbol for symbol in symbols if symbol.is_symbolic()]
            bounds += [bound for bound in arrays[array.name] if bound != ZERO]
            operands[array.name] = as_operand(array.shape if len(array.shape) == 2 else (array.size,), symbols)
        result = evaluate(chain, (step,), operands)
        stacked = ca.vertcat(*inputs) if inputs else ca.SX(0, 1)
        for array in step.writes:
            entries = ca.densify(ca.vertcat(*result[array.name]))
            graph, numbers = build_graph(ca.Function("f", [stacked], [entries]))
            arrays[array.name] = BoundAnalysis(graph, numbers, self.scalar).bounds(bounds)

    def _invoke(self, function: Function, item: Invoke, arrays: Bounds) -> None:
        """Analyse the internal function, unless the last call of it had the same bounds of the arguments."""
        called, inputs = item.function, [arrays[storage.array.name] for storage in item.arguments]
        last_inputs, outputs = self._called.get(called.name, (None, []))
        if inputs != last_inputs:
            inner = {array.name: list(bounds) for array, bounds in zip(called.inputs, inputs, strict=True)}
            self._run(called, inner)
            outputs = [inner[array.name] for array in called.outputs]
            self._called[called.name] = inputs, outputs
        arrays |= {array.name: list(bounds) for array, bounds in zip(item.arrays, outputs, strict=True)}

    def _invoke_kernel(self, function: Function, item: InvokeKernel, arrays: Bounds) -> None:
        """Analyse the kernel of a term; its results are added to sums, or appended as the next slices of an array."""
        inner: Bounds = {}
        for array, source, first in item.arguments:
            if source is None:
                raise NoBound("a product of more than is asked for")
            start = first or 0
            inner[array.name] = arrays[source.array.name][start : start + array.size]
        self._run(item.function, inner)
        for (output, first), total, result in zip(item.outputs, item.added, item.function.outputs, strict=True):
            bounds = inner[result.name]
            if total:
                pairs = zip(arrays[total.array.name], bounds, strict=True)
                arrays[total.array.name] = [added(x, y, self.scalar) for x, y in pairs]
            else:
                arrays[output.array.name] = [*(arrays[output.array.name] if first else []), *bounds]

    def _sums(self, function: Function, item: ColumnSums | TotalSums, arrays: Bounds) -> None:
        raise NoBound("sums in another order on every vector width")

    def _nothing(self, function: Function, item: Unused, arrays: Bounds) -> None:
        """Pass: nothing is computed."""


_RULES: dict[type, Callable[[ErrorBounds, Function, Any, Bounds], None]] = {
    Unused: ErrorBounds._nothing,
    Helpers: ErrorBounds._helpers,
    Statements: ErrorBounds._statements,
    Loop: ErrorBounds._loop,
    SparseChange: ErrorBounds._sparse_change,
    ColumnSums: ErrorBounds._sums,
    TotalSums: ErrorBounds._sums,
    Invoke: ErrorBounds._invoke,
    InvokeKernel: ErrorBounds._invoke_kernel,
}
"""Rule of each kind of item."""


def _inputs(body: Body, arrays: Bounds, i: int = 0, j: int = 0) -> list[Bound]:
    """Return the bounds of what a body reads at (i, j)."""
    return [arrays[each.operand.array.name][each.operand.entry(each.entry, i, j)] for each in body.inputs]


def _store(arrays: Bounds, place: Entry, bound: Bound, i: int = 0, j: int = 0) -> None:
    """Note the bound of what a body writes at (i, j); locals without an operand belong to no array."""
    if place.operand:
        arrays[place.operand.array.name][place.operand.entry(place.entry, i, j)] = bound


def rounded_up(value: float, scalar: Scalar = DOUBLE) -> float:
    """Round up to two digits; return 0 where only underflow makes errors."""
    if value < 2.0**50 * scalar.smallest:
        return 0.0
    return float(Context(prec=2, rounding=ROUND_UP).create_decimal_from_float(value))


def kinds(result: Argument, array: Array) -> list[tuple[str, str, list[int]]]:
    """Return the kinds of entries of a result: name, unit, and numbers of the entries."""
    if result.blocks:
        blocks = result.blocks.entries(array.shape)
        return [(block.name, block.unit, entries) for block, entries in blocks if block.name]
    name = f"every entry of {result.name}" if array.size > 1 else result.name
    return [(name, result.unit, list(range(array.size)))]


def chain_reach(chain: Chain, ranges: Ranges, scalar: Scalar) -> float:
    """Return the largest distance of a point of a tip's frame from the base [m]: the sum of a chain's lengths."""
    joints = chain.joints[chain.base_joints :]
    translations = [*(joint.translation for joint in joints), *(tip.translation for tip in chain.tips)]
    lengths = [math.sqrt(sum(x * x for x in translation)) for translation in translations]
    strokes = [
        abs(joint.multiplier) * _largest(chain, joint.coordinate - chain.base_coordinates, ranges, scalar)
        + abs(joint.offset)
        for joint in joints
        if joint.prismatic
    ]
    base = ranges.distance * math.sqrt(3.0) if chain.base_joints else 0.0
    tool = ranges.tool * math.sqrt(3.0) if chain.runtime_tool else 0.0
    total = 0.0
    for length in (*lengths, *strokes, base, tool):
        total = (total + length) * ENLARGED
    return total * scalar.rotation


def _largest(chain: Chain, k: int, ranges: Ranges, scalar: Scalar) -> float:
    """Return the largest distance of the k-th joint position from zero [rad or m]."""
    coordinate = chain.coordinates[k]
    size = max(abs(coordinate.lower), abs(coordinate.upper))
    without_limits = ranges.slide if coordinate.type == "prismatic" else scalar.largest_angle
    return size if math.isfinite(size) else without_limits


def argument_sizes(chain: Chain, argument: Argument, ranges: Ranges, reach: float, scalar: Scalar) -> list[float]:
    """Return the largest magnitude of each entry of a kernel's argument, row-major.

    Raises:
        NoBound: of this argument no range is known.

    """
    if argument.each:
        return argument_sizes(chain, argument.each, ranges, reach, scalar) * argument.array(chain).shape[0]
    array = argument.array(chain)

    def sizes(largest: Magnitude | None, count: int) -> list[float]:
        """Return the sizes of ``count`` entries with a range: a number, or a word of ``quantities.Named``."""
        if largest is None or largest == "none":  # of results, and of arguments whose record says so
            raise NoBound(f"no range is known of the argument {argument.name}")
        if largest == "positions":
            return [_largest(chain, k, ranges, scalar) for k in range(count)]
        if largest == "rates":
            limits = [coordinate.velocity for coordinate in chain.coordinates]
            of_joints = [limit if math.isfinite(limit) else ranges.rate for limit in limits]
            return [ranges.rate] * chain.base_coordinates + of_joints
        if not isinstance(largest, str):
            return [largest] * count
        of_robot = {"reach": reach, "rotation": scalar.rotation}
        return [of_robot[largest] if largest in of_robot else float(getattr(ranges, largest))] * count

    if argument.blocks is None:
        return sizes(argument.largest, array.size)
    largest_of_entries = [0.0] * array.size
    for block, entries in argument.blocks.entries(array.shape):
        for k, largest in zip(entries, sizes(block.largest, len(entries)), strict=True):
            largest_of_entries[k] = largest
    return largest_of_entries
