# SPDX-License-Identifier: MIT
"""Certified bounds of rounding errors: a running error analysis of the statements that are printed.

Every number of a function has a bound of its size (what it is at most, in real arithmetic) and of its error (how far
the computed number is at most from that). Both follow operation by operation from those of its operands, over the
graph that the printer prints. Each operation is taken to be rounded once. A compiler that contracts a product and a sum
to one operation (fused multiply-add) rounds less often, so that the bounds hold with and without it.

Three things keep the bounds close to what happens:
- c X + s Y with the cosine and the sine of one angle is at most sqrt(X^2 + Y^2), and so is what its errors add up to;
- entries of rotations are at most 1, however many factors they have, and points of a serial chain are not farther away
  than the chain is long: :class:`ErrorBounds` knows which statements are those;
- what is zero whatever the arguments costs nothing.

The bounds themselves are computed with doubles, each step enlarged by far more than it can lose to rounding, with
additions, products and square roots alone, so that they are the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import ROUND_UP, Context
from typing import NamedTuple

import casadi as ca

from stiffgen.lower.graph import Graph, build_graph
from stiffgen.lower.scalar import DOUBLE, Scalar
from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kernels import Kernel
from stiffgen.symbolic.program import Array, Operand, Program, Step, as_operand, evaluate
from stiffgen.symbolic.steps import Gather, Map, Reduce, SparseSum, StraightLine, Sum

_ENLARGED = 1.0 + 2.0**-46
"""After a few operations on doubles that are not negative, more than these can have lost."""


@dataclass(frozen=True)
class Precision:
    """What is known of the arithmetic of a type of number.

    Attributes:
        unit: largest relative error of an operation, half the distance from 1 to the next number.
        smallest: largest error of an operation whose result is too small for that.
        largest: number.
        far: largest angle of the fast path of sine and cosine [rad] (templates/sine_cosine.c).
        sine: largest error of a sine or cosine of an exact angle up to ``far``.
        digits: of which rotations in arguments are rotations.
        rotation: what an entry of a product of at most 128 of these, or of the chain's, is at most.

    """

    unit: float
    smallest: float
    largest: float
    far: float
    sine: float
    digits: int
    rotation: float


PRECISIONS = {
    # Proved of templates/sine_cosine.c: 1.22 units (tests/support/sine_cosine_proof.py); CUDA documents two ulps.
    "double": Precision(2.0**-53, 2.0**-1074, 2.0**1023, 1e4, 2.0**-52, 11, 1.0 + 2.0**-36),
    # 0.96 units, of all floats up to far (tests/campaigns/float_sines.py); CUDA documents two ulps.
    "float": Precision(2.0**-24, 2.0**-149, 2.0**127, 6e3, 2.0**-23, 6, 1.0 + 2.0**-19),
}
"""By the name of the type."""


@dataclass(frozen=True)
class Ranges:
    """What arguments are at most, entry by entry, for the bounds to hold.

    Joint positions stay inside the limits of the URDF: :attr:`Precision.far` where a joint turns without end, ``slide``
    where one slides without. Blocks of a stiffness that couple translation and rotation are at most the geometric mean
    of the two others: no positive definite matrix has more. The equilibrium's origin lies no farther away than the
    robot reaches.

    Attributes:
        force, moment: of a wrench [N], [N m].
        translation_stiffness, rotation_stiffness: [N/m], [N m/rad].
        distance: of a floating base from the world's origin [m].
        tool: distance of a tool's frame from the tip link's [m].
        slide: position of a sliding joint without limits [m].
        rate: of a joint without a velocity limit [rad/s, m/s].
        gravity: acceleration of free fall [m/s^2].

    """

    force: float = 200.0
    moment: float = 50.0
    translation_stiffness: float = 5000.0
    rotation_stiffness: float = 500.0
    distance: float = 10.0
    tool: float = 1.0
    slide: float = 10.0
    rate: float = 10.0
    gravity: float = 10.0

    def lines(self, precision: Precision) -> list[str]:
        """In words, for a comment."""
        coupling = math.sqrt(self.translation_stiffness * self.rotation_stiffness)
        return [
            f"joint positions within the limits (up to {precision.far:g} rad or {self.slide:g} m where there are none)"
            ", every",
            f"force up to {self.force:g} N and moment up to {self.moment:g} N m, entries of stiffnesses up to",
            f"{self.translation_stiffness:g} N/m, {self.rotation_stiffness:g} N m/rad and, where they couple the two, "
            f"{coupling:.0f} N, gravity up to",
            f"{self.gravity:g} m/s^2, equilibria within the robot's reach, joint rates up to their limits",
        ]


class NoBound(Exception):  # noqa: N818 - an answer, not a failure
    """A function has an operation or an argument of which nothing is known here."""


class Bound(NamedTuple):
    """Of a number: of its size in real arithmetic, and of the error of what is computed in its place."""

    size: float
    error: float = 0.0


ZERO = Bound(0.0)


@dataclass
class _Analysis:
    """The bounds of a graph's operations, given those of its inputs."""

    graph: Graph
    inputs: Sequence[Bound]
    precision: Precision
    known: Mapping[int, float] = field(default_factory=dict)
    """What operations are at most for reasons that their operands do not show."""
    found: dict[int, Bound] = field(default_factory=dict)

    def bounds(self, numbers: Sequence[int]) -> list[Bound]:
        """The bounds of some of the operations."""
        needed, pending = set(numbers), list(numbers)
        while pending:
            new = set(self.graph.operands(pending.pop())) - needed
            needed |= new
            pending += new
        for number in sorted(needed):  # operands come before what uses them
            bound = self._bound(number)
            size = min(bound.size, self.known.get(number, math.inf))
            self.found[number] = Bound(size, bound.error)
            if not size + bound.error < self.precision.largest:
                raise NoBound("numbers beyond the largest one")
        return [self.found[number] for number in numbers]

    def _bound(self, number: int) -> Bound:
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
            if angle.size > self.precision.far:
                raise NoBound(f"angles beyond {self.precision.far:g} rad")
            return Bound(1.0, (self.precision.sine + angle.error) * _ENLARGED)
        raise NoBound(f"the operation {kind}")

    def _constant(self, value: float) -> Bound:
        unit = self.precision.unit
        exact = unit == PRECISIONS["double"].unit or math.frexp(value)[0] / unit % 1 == 0
        return Bound(abs(value), 0.0 if exact else abs(value) * unit * _ENLARGED + self.precision.smallest)

    def _is_power(self, number: int) -> bool:
        kind, a, _ = self.graph.keys[number]
        return kind == "const" and math.frexp(float(a))[0] == 0.5

    def _product(self, a: int, b: int) -> Bound:
        x, y = self.found[a], self.found[b]
        if ZERO in (x, y):
            return ZERO
        size = x.size * y.size * _ENLARGED
        error = x.size * y.error + y.size * x.error + x.error * y.error
        if self._is_power(a) or self._is_power(b):
            return Bound(size, error * _ENLARGED + self.precision.smallest)
        return Bound(size, (error + self.precision.unit * (size + error)) * _ENLARGED + self.precision.smallest)

    def _sum(self, a: int, b: int) -> Bound:
        x, y = self.found[a], self.found[b]
        if x == ZERO:
            return y
        if y == ZERO:
            return x
        turned = self._turned(a, b)
        size, error = turned or (x.size + y.size, x.error + y.error)
        return Bound(size * _ENLARGED, (error + self.precision.unit * (size + error)) * _ENLARGED)

    def _turned(self, a: int, b: int) -> Bound | None:
        """Of c X + s Y, with the cosine and the sine of one angle, before the sum is rounded."""
        for turn, x in self._with_turn(a):
            for other, y in self._with_turn(b):
                (kind, angle, _), (another, same, _) = self.graph.keys[turn], self.graph.keys[other]
                if kind != another and angle == same:
                    return self._of_turn((turn, x), (other, y))
        return None

    def _with_turn(self, number: int) -> list[tuple[int, int]]:
        """The factors of a product that has a sine or a cosine: that one, and the other."""
        kind, a, b = self.graph.keys[number]
        if kind == "neg":
            return self._with_turn(int(a))
        pairs = ((int(a), b), (b, int(a))) if kind == "mul" else ()
        return [(turn, other) for turn, other in pairs if self.graph.keys[turn][0] in ("sin", "cos")]

    def _of_turn(self, *products: tuple[int, int]) -> Bound:
        # |c X + s Y|, |c e_X + s e_Y| and |d_1 c X + d_2 s Y| <= unit sqrt(X^2 + Y^2): Cauchy and Schwarz; c and s are
        # those of one angle, what they are off counts with the sizes of X and Y.
        x, y = (self.found[other] for _, other in products)
        size = math.sqrt(x.size * x.size + y.size * y.size) * _ENLARGED
        error = math.sqrt(x.error * x.error + y.error * y.error) * _ENLARGED
        for turn, other in products:
            error += self.found[turn].error * (self.found[other].size + self.found[other].error)
        rounded = self.precision.unit * (size + error) + 2 * self.precision.smallest
        return Bound(size, (error + rounded) * _ENLARGED)


@dataclass(frozen=True)
class _Body:
    """The graph of an expression, with the entries of its operands as inputs."""

    graph: Graph
    numbers: list[int]

    @staticmethod
    def of(shapes: Sequence[tuple[int, ...]], expression: Callable[..., ca.SX]) -> _Body:
        symbols = [[ca.SX.sym("x") for _ in range(math.prod(shape))] for shape in shapes]
        result = ca.densify(expression(*(as_operand(s, e) for s, e in zip(shapes, symbols, strict=True))))
        entries = [result[r, c] for r in range(result.shape[0]) for c in range(result.shape[1])]
        given = [symbol for each in symbols for symbol in each]
        inputs = ca.vertcat(*given) if given else ca.SX(0, 1)
        return _Body(*build_graph(ca.Function("f", [inputs], [ca.densify(ca.vertcat(*entries))])))

    def bounds(self, inputs: Sequence[Bound], precision: Precision) -> list[Bound]:
        return _Analysis(self.graph, inputs, precision).bounds(self.numbers)


class ErrorBounds:
    """The bounds of a chain's functions."""

    def __init__(self, chain: Chain, ranges: Ranges | None = None, scalar: Scalar = DOUBLE) -> None:
        """For arguments within ``ranges`` and numbers of the type ``scalar``."""
        self.chain, self.ranges, self.precision = chain, ranges or Ranges(), PRECISIONS[scalar.name]
        self._shared: dict[tuple[str, str], list[list[Bound]]] = {}  # blocks that several kernels share

    def of(self, kernel: Kernel) -> dict[str, list[float]]:
        """A bound of |computed - exact| for every entry of a kernel's results, row-major, by the result's name.

        Exact is what the printed formulas give in real arithmetic, with the constants that double precision prints and
        the arguments as they are handed over.

        Raises:
            NoBound: the kernel divides, chooses, overflows, or has an argument of which no range is known.

        """
        own = kernel.scope(self.chain)
        reach = chain_reach(own, self.ranges, self.precision)
        arrays = {
            argument.array(self.chain).name: [
                Bound(size) for size in argument_sizes(self.chain, argument, self.ranges, reach, self.precision)
            ]
            for argument in kernel.arguments
        }
        self._run(own, kernel.steps(self.chain), arrays, kernel.tip.name if kernel.tip else "")
        found = {result.name: [bound.error for bound in arrays[result.name]] for result in kernel.results}
        if not all(bound < self.precision.largest for bounds in found.values() for bound in bounds):
            raise NoBound("numbers beyond the largest one")
        return found

    def stated(self, kernel: Kernel) -> tuple[Stated, ...]:
        """The largest bounds of the entries of one kind, rounded up to two digits; none where there are none."""
        try:
            bounds = self.of(kernel)
        except NoBound:
            return ()
        return tuple(
            Stated(result.name, what, unit, rounded_up(max(bounds[result.name][k] for k in entries), self.precision))
            for result in kernel.results
            for what, unit, entries in kinds(result, result.array(self.chain))
        )

    def _run(self, chain: Chain, program: Program, arrays: dict[str, list[Bound]], tip: str) -> None:
        """The bounds of what a program writes, step by step, added to those of what it takes."""
        for step in program:
            if isinstance(step, StraightLine):
                key = tip, step.name
                if not step.name or key not in self._shared:
                    reach = chain_reach(chain, self.ranges, self.precision)
                    self._shared[key] = _block(chain, step, arrays, reach, self.precision)
                arrays |= dict(zip((output.name for output in step.outputs), self._shared[key], strict=True))
            elif isinstance(step, Sum):
                self._sum(step, arrays)
            elif isinstance(step, (Map, SparseSum)):
                _map(chain, step.whole() if isinstance(step, SparseSum) else step, arrays, self.precision)
            elif isinstance(step, (Gather, Reduce)):
                raise NoBound("sums in another order on every vector width")
            else:
                _linear(chain, step, arrays, self.precision)

    def _sum(self, step: Sum, arrays: dict[str, list[Bound]]) -> None:
        totals: dict[str, list[Bound]] = {}
        for term in step.terms:
            given = {}
            for array, part in term.arguments:
                if part.array is None:
                    raise NoBound("a product of more than is asked for")
                start = 0 if part.index is None else part.index * array.size
                given[array.name] = arrays[part.array.name][start : start + array.size]
            self._run(term.chain, term.program, given, term.chain.tips[0].name)
            for output, name in zip(step.outputs, step.results, strict=True):
                before = totals.get(output.name)
                if before is None or output.name in step.apart:
                    totals[output.name] = [*(before or []), *given[name]]
                else:
                    pairs = zip(before, given[name], strict=True)
                    totals[output.name] = [_added(x, y, self.precision) for x, y in pairs]
        arrays |= totals


@dataclass(frozen=True)
class Stated:
    """A bound as it is told: of the entries of ``result`` that are ``what``, in ``unit``."""

    result: str
    what: str
    unit: str
    bound: float

    @property
    def text(self) -> str:
        """In words."""
        size = f"within {self.bound:.1e}{f' {self.unit}' if self.unit else ''}" if self.bound else "exact"
        return f"{self.what} {size}"


def rounded_up(value: float, precision: Precision = PRECISIONS["double"]) -> float:
    """To two digits; what only underflow can cause is 0."""
    if value < 2.0**50 * precision.smallest:
        return 0.0
    return float(Context(prec=2, rounding=ROUND_UP).create_decimal_from_float(value))


def kinds(result: Argument, array: Array) -> list[tuple[str, str, list[int]]]:
    """The kinds of entries that a result has: what they are, their unit, and their numbers."""
    every = range(array.size)
    if result.name == "pose":
        return [("rotation", "", [0, 1, 2, 4, 5, 6, 8, 9, 10]), ("position", "m", [3, 7, 11])]
    if result.name == "wrench":
        return [("force", "N", [0, 1, 2]), ("moment", "N m", [3, 4, 5])]
    if result.name == "jacobian":
        half, per = array.size // 2, "per rad or m"
        return [
            ("linear rows", f"m {per}", list(every[:half])),
            ("angular rows", f"rad {per}", list(every[half:])),
        ]
    if result.name in ("task_stiffness", "connection_correction"):
        blocks = [(k // 6 >= 3) + (k % 6 >= 3) for k in every]
        names = (("translation block", "N/m"), ("coupling", "N"), ("rotation block", "N m"))
        return [(*name, [k for k in every if blocks[k] == index]) for index, name in enumerate(names)]
    return [(f"every entry of {result.name}" if array.size > 1 else result.name, result.unit, list(every))]


def chain_reach(chain: Chain, ranges: Ranges, precision: Precision) -> float:
    """How far a point of a tip's frame is from the base at most [m]: all lengths of a chain one after the other."""
    joints = chain.joints[chain.base_joints :]
    ways = [math.sqrt(sum(x * x for x in place)) for place in (*(j.translation for j in joints), *_tips(chain))]
    slides = [
        abs(joint.multiplier) * _largest(chain, joint.coordinate - chain.base_joints, ranges, precision)
        + abs(joint.offset)
        for joint in joints
        if joint.prismatic
    ]
    base = ranges.distance * math.sqrt(3.0) if chain.floating else 0.0
    tool = ranges.tool * math.sqrt(3.0) if chain.runtime_tool else 0.0
    total = 0.0
    for way in (*ways, *slides, base, tool):
        total = (total + way) * _ENLARGED
    return total * precision.rotation


def _tips(chain: Chain) -> Iterator[tuple[float, float, float]]:
    return (tip.translation for tip in chain.tips)


def _largest(chain: Chain, coordinate: int, ranges: Ranges, precision: Precision) -> float:
    """How far from zero a joint position gets [rad or m]."""
    own = chain.coordinates[coordinate]
    size = max(abs(own.lower), abs(own.upper))
    return size if math.isfinite(size) else (ranges.slide if own.type == "prismatic" else precision.far)


def argument_sizes(chain: Chain, argument: Argument, ranges: Ranges, reach: float, precision: Precision) -> list[float]:
    """What the entries of a kernel's argument are at most, row-major.

    Raises:
        NoBound: of this argument no range is known.

    """
    both = math.sqrt(ranges.translation_stiffness * ranges.rotation_stiffness)
    linear, coupled, angular = ranges.translation_stiffness, both, ranges.rotation_stiffness
    pose = {"equilibrium": reach, "base_pose": ranges.distance, "tool_pose": ranges.tool}
    name, size = argument.name, argument.array(chain).size
    if name == "q":
        return [_largest(chain, k, ranges, precision) for k in range(size)]
    if name == "velocity":
        of_joints = [own.velocity if math.isfinite(own.velocity) else ranges.rate for own in chain.coordinates]
        return [ranges.rate] * chain.base_joints + of_joints
    if name in pose:
        return [*([precision.rotation] * 3 + [pose[name]]) * 3, 0.0, 0.0, 0.0, 1.0]
    blocks = {
        "wrench": [ranges.force] * 3 + [ranges.moment] * 3,
        "task_stiffness": ([linear] * 3 + [coupled] * 3) * 3 + ([coupled] * 3 + [angular] * 3) * 3,
        "translation_stiffness": [linear] * 9,
        "rotation_stiffness": [angular] * 9,
        "gravity": [ranges.gravity] * 3,
    }
    blocks |= {"wrenches": blocks["wrench"], "task_stiffnesses": blocks["task_stiffness"]}
    block = blocks.get(name)
    if block is None or size % len(block):
        raise NoBound(f"the argument {name}")
    return block * (size // len(block))


def _block(
    chain: Chain, step: StraightLine, arrays: Mapping[str, list[Bound]], reach: float, precision: Precision
) -> list[list[Bound]]:
    given, inputs, bounds = [], [], []
    for array in step.arguments:
        entries = [ca.SX(0) if bound == ZERO else ca.SX.sym("x") for bound in arrays[array.name]]
        inputs += [entry for entry in entries if not entry.is_zero()]
        bounds += [bound for bound in arrays[array.name] if bound != ZERO]
        given.append(as_operand(array.shape, entries))
    expressions = step.expressions(chain, *given)
    result = ca.densify(expressions.result)
    entries = [result[r, c] for r in range(result.shape[0]) for c in range(result.shape[1])]
    named = [
        (entry, precision.rotation if name.startswith("R") else reach)
        for section in expressions.sections
        for name, value in section.values.items()
        for entry in ca.vertsplit(ca.vec(ca.densify(value)))
        if step.moves and name[0] in "Rp"  # entries of rotations R, and points p
    ]
    sizes = _columns_and_pose(chain, step, reach, precision)
    outputs = ca.densify(ca.vertcat(*entries, *(entry for entry, _ in named)))
    graph, numbers = build_graph(ca.Function("f", [ca.vertcat(*inputs)], [outputs]))
    known: dict[int, float] = {}
    for number, size in zip(numbers, (*(sizes or [math.inf] * len(entries)), *(s for _, s in named)), strict=True):
        known[number] = min(size, known.get(number, math.inf))
    found = _Analysis(graph, bounds, precision, known).bounds(numbers[: len(entries)])
    written = []
    for output in step.outputs:
        written.append(found[: output.size])
        found = found[output.size :]
    return written


def _columns_and_pose(chain: Chain, step: StraightLine, reach: float, precision: Precision) -> list[float]:
    """What the entries of Jacobian columns and of a pose are at most; none where a block has neither."""
    if not step.moves:
        return []
    sliding = [joint.prismatic for joint in chain.joints]
    linear = [precision.rotation if slides else reach for slides in sliding]
    columns = linear * 3 + [precision.rotation] * len(sliding) * 3
    pose = [*([precision.rotation] * 3 + [reach]) * 3, 0.0, 0.0, 0.0, 1.0]
    return [
        size for k, output in enumerate(step.outputs) for size in (columns if k < step.columns else pose)[: output.size]
    ]


def _taken(operand: Operand, arrays: Mapping[str, list[Bound]], i: int, j: int) -> list[Bound]:
    return [arrays[operand.array.name][operand.entry(k, i, j)] for k in range(operand.count)]


def _map(chain: Chain, step: Map, arrays: dict[str, list[Bound]], precision: Precision) -> None:
    # The operands at i and at j are symbols of their own also where i is j: the printed loop does not know that.
    body = _Body.of([operand.shape for operand in step.operands], step.expression)
    written = arrays.setdefault(step.output.array.name, [ZERO] * step.output.array.size)
    for i, j in step.over.indices(chain):
        inputs = [bound for operand in step.operands for bound in _taken(operand, arrays, i, j)]
        for k, bound in enumerate(body.bounds(inputs, precision)):
            written[step.output.entry(k, i, j)] = bound
            if step.mirror:
                written[step.output.entry(k, j, i)] = bound


def _linear(chain: Chain, step: Step, arrays: dict[str, list[Bound]], precision: Precision) -> None:
    """Steps that add and scale what is there: unrolled. Their sums have one order on every vector width."""
    symbols = {
        array.name: [ca.SX.sym("x") if bound != ZERO else ca.SX(0) for bound in arrays[array.name]]
        for array in step.reads
    }
    shapes = {array.name: array.shape for array in step.reads}
    result = evaluate(chain, (step,), {name: _shaped(shapes[name], entries) for name, entries in symbols.items()})
    pairs = [
        (symbol, bound)
        for name, entries in symbols.items()
        for symbol, bound in zip(entries, arrays[name], strict=True)
        if bound != ZERO
    ]
    for array in step.writes:
        entries = ca.densify(ca.vertcat(*result[array.name]))
        inputs = ca.vertcat(*(symbol for symbol, _ in pairs)) if pairs else ca.SX(0, 1)
        body = _Body(*build_graph(ca.Function("f", [inputs], [entries])))
        arrays[array.name] = body.bounds([bound for _, bound in pairs], precision)


def _shaped(shape: tuple[int, ...], entries: list[ca.SX]) -> ca.SX:
    """Entries of an array, row-major, as :func:`stiffgen.symbolic.program.evaluate` takes them."""
    return as_operand(shape if len(shape) == 2 else (len(entries),), entries)


def _added(x: Bound, y: Bound, precision: Precision) -> Bound:
    size, error = x.size + y.size, x.error + y.error
    return Bound(size * _ENLARGED, (error + precision.unit * (size + error)) * _ENLARGED)
