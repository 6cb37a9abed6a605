# SPDX-License-Identifier: MIT
"""A kernel as a short program of CasADi expressions over joints and pairs of joints.

The quadratic part of every kernel is one small expression repeated over joints. Keeping the repetition as a
:class:`Map` lets two readers share one definition: :func:`evaluate` unrolls it into a flat CasADi expression (the
``casadi.Function`` of :class:`stiffgen.StiffnessModel`), the C printer makes it a loop. Arrays are row-major;
``m`` is the number of moving joints, ``n`` that of coordinates (they differ where joints mimic).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.kinematics import Expressions
from stiffgen.symbolic.stiffness import symmetric_from_upper

Over = Literal["", "j", "coordinate", "i<=j", "i>=j", "i<j", "i>j", "i on the way to j", "i and j of the base", "all"]
"""What a map runs over: nothing (once), every joint j, every coordinate j of q, or the pairs (i, j) of joints that
satisfy the relation (of their numbers; "on the way": i is j or a joint between the base and j; "of the base": a
floating base's own joints)."""


@dataclass(frozen=True)
class Array:
    """A named array of doubles, row-major. ``shape`` has none (a number) to three dimensions."""

    name: str
    shape: tuple[int, ...]
    symbol: str = field(default="", compare=False)
    """The letter that formulas have for it."""

    @property
    def size(self) -> int:
        """Number of entries."""
        size = 1
        for extent in self.shape:
            size *= extent
        return size


@dataclass(frozen=True)
class Operand:
    """What a map's expression reads or writes of an array: all of it (""), column i or j, or the element(s) [i, j]."""

    array: Array
    at: Literal["", "i", "j", "ij"]

    @property
    def count(self) -> int:
        """Entries that one evaluation of the expression touches."""
        if self.at == "":
            return self.array.size
        if self.at == "ij":
            return self.array.size // (self.array.shape[0] * self.array.shape[1])
        return self.array.size // self.array.shape[-1]

    def entry(self, k: int, i: int, j: int) -> int:
        """Flat position in the array of the k-th entry touched."""
        if self.at == "":
            return k
        if self.at == "ij":
            return (i * self.array.shape[1] + j) * self.count + k
        return k * self.array.shape[-1] + (i if self.at == "i" else j)


@dataclass(frozen=True)
class StraightLine:
    """Straight-line code: the rows of ``expressions(chain, *arguments)`` fill the ``outputs`` one after the other.

    The arguments are those of the kernel or arrays that earlier steps wrote. The first ``columns`` outputs have the
    shape (6, m): a column a joint. A block that several kernels use has a ``name``, under which C code holds it as a
    function of its own (its arguments are then those of the kernel); without a name it is part of its kernel.
    ``heading`` is the comment over the statements that fill the outputs, ``meaning`` the one over the function.
    ``moves`` says that the outputs are Jacobian columns of this representation, the tip's pose, or both: how they
    change with q is then known from the columns.
    """

    outputs: tuple[Array, ...]
    expressions: Callable[..., Expressions]
    arguments: tuple[Array, ...]
    name: str = ""
    heading: str = "result"
    meaning: str = ""
    columns: int = 0
    moves: Representation | None = None


def indices(chain: Chain, over: Over, *, but_of_base: bool = False) -> Iterator[tuple[int, int]]:
    """The (i, j) that satisfy a relation, in the order of the printed loops; those of the base's joints left out."""
    if but_of_base:
        yield from ((i, j) for i, j in indices(chain, over) if max(i, j) >= chain.base_joints)
        return
    m = len(chain.joints)
    if over in ("", "j", "coordinate"):
        yield from ((0, j) for j in range({"": 1, "j": m, "coordinate": chain.dof - chain.base_joints}[over]))
    elif over == "i on the way to j":
        for j in range(m):
            i = j
            while i >= 0:
                yield i, j
                i = chain.joints[i].parent
    elif over == "i and j of the base":
        yield from itertools.product(range(chain.base_joints), repeat=2)
    else:
        holds = {"i<=j": int.__le__, "i>=j": int.__ge__, "i<j": int.__lt__, "i>j": int.__gt__}
        yield from ((i, j) for i in range(m) for j in range(m) if over == "all" or holds[over](i, j))


@dataclass(frozen=True)
class Map:
    """``output = expression(*operands)`` for all of ``over``; with ``mirror``, [j, i] gets what [i, j] got."""

    comment: str
    over: Over
    output: Operand
    operands: tuple[Operand, ...]
    expression: Callable[..., ca.SX]
    mirror: bool = False

    def indices(self, chain: Chain) -> Iterator[tuple[int, int]]:
        """The (i, j) that the map runs over, in the order of the printed loops."""
        return indices(chain, self.over)


@dataclass(frozen=True)
class SparseSum:
    """``output = start + expression(*operands)``, square, where most of the expression's entries are zero whatever the
    operands.

    Of ``start`` the upper triangle is read and taken for both; None is zero. C code stores the entries that change, and
    reads the others where the start has them, unless the output is a result. Without a start, neighbouring zeros share
    a statement.
    """

    comment: str
    output: Array
    start: Array | None
    operands: tuple[Array, ...]
    expression: Callable[..., ca.SX]

    @property
    def reads(self) -> tuple[Array, ...]:
        """The start, if there is one, and the operands."""
        return (*((self.start,) if self.start else ()), *self.operands)

    def whole(self) -> Map:
        """The same as a map that writes every entry."""

        def total(*values: ca.SX) -> ca.SX:
            if self.start is None:
                return self.expression(*values)
            return symmetric_from_upper(values[0]) + self.expression(*values[1:])

        return Map(self.comment, "", Operand(self.output, ""), tuple(Operand(a, "") for a in self.reads), total)


@dataclass(frozen=True)
class SumJoints:
    """Sum joints into coordinates: joint k counts ``multiplier`` times for its coordinate, in every joint index.

    The source is (m), (6, m) (``columns``), (m, m) or (m, m, depth); with ``mirror``, the upper triangle of the (n, n)
    result is copied to the lower one, since sums in another order need not agree to the last bit.
    """

    source: Array
    output: Array
    columns: bool = False
    mirror: bool = False


@dataclass(frozen=True)
class Spread:
    """The transpose of :class:`SumJoints`: what belongs to a coordinate is given to its joints, times ``multiplier``.

    The source is (n), (6, n) (``columns``), (n, n) or (n, n, depth).
    """

    source: Array
    output: Array
    columns: bool = False


@dataclass(frozen=True)
class Weights:
    """What a map over pairs hands back of every pair: ``output[i, j] = source[i, j]`` over ``over``, else 0.

    With ``mirror``, source[j, i] is added to it where i is not j. ``transposed`` has the same at [j, i]. With
    ``but_of_base``, pairs of a floating base's own joints hand nothing back: a later map has overwritten them.
    """

    source: Array
    output: Array
    transposed: Array
    over: Over
    mirror: bool
    but_of_base: bool = False


@dataclass(frozen=True)
class Gather:
    """``output[:, j]`` = sum of ``expression(*operands)`` over all joints i with (i, j) in ``over``.

    What is read at "ij" is an array of :class:`Weights`, zero outside of ``over``, and ``but_of_base`` as there.
    """

    comment: str
    over: Over
    output: Array
    operands: tuple[Operand, ...]
    expression: Callable[..., ca.SX]
    but_of_base: bool = False


@dataclass(frozen=True)
class Reduce:
    """``outputs`` = sums of ``expression(*operands)`` over joints or coordinates j: their entries below each other."""

    comment: str
    outputs: tuple[Array, ...]
    operands: tuple[Operand, ...]
    expression: Callable[..., ca.SX]
    over: Over = "j"


@dataclass(frozen=True)
class Scan:
    """Running sums of columns: ``output[:, j]`` = sum of ``source[:, i]`` over i <= j, or (``beyond``) over i > j.

    The first ``base`` joints are those of a floating base, which moves as one, all columns with it: its joints get the
    sum over all i, or (not ``beyond``) nothing.
    """

    comment: str
    source: Array
    output: Array
    beyond: bool
    base: int = 0


@dataclass(frozen=True)
class ArgumentSlice:
    """Entries of an argument that belong to tip ``index``, or (None) the whole argument; zeros without an array."""

    array: Array | None
    index: int | None = None


@dataclass(frozen=True)
class Sum:
    """``outputs`` = sums of the arrays ``results`` that other kernels give, each with its parts of the arguments.

    The outputs named in ``apart`` are not summed: they get one block a term.
    """

    outputs: tuple[Array, ...]
    results: tuple[str, ...]
    terms: tuple[Term, ...]
    apart: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Term:
    """A kernel of another chain (a branch), its program, and the parts of the arguments that it takes, by name."""

    function: str
    chain: Chain
    program: Program
    arguments: tuple[tuple[Array, ArgumentSlice], ...]


@dataclass(frozen=True)
class Shared:
    """Steps that several kernels have in common: C code holds them as a function of its own, ``name``.

    They read the ``arguments`` and write the ``result``, whatever a kernel has in their places: ``given`` and
    ``output``, of the same shapes. Arguments of the shape (6, m) are columns of joints. ``meaning`` is the comment over
    the function.
    """

    name: str
    meaning: str
    arguments: tuple[Array, ...]
    result: Array
    steps: Program
    given: tuple[Array, ...]
    output: Array


Step = StraightLine | Map | SparseSum | SumJoints | Sum | Spread | Weights | Gather | Reduce | Scan | Shared
Program = tuple[Step, ...]


Held = Callable[[list[ca.SX]], list[ca.SX]]
"""Puts something else in the place of entries, between the step that writes and those that read them."""


def evaluate(chain: Chain, program: Program, arguments: dict[str, ca.SX], held: Held = list) -> dict[str, list[ca.SX]]:
    """Unroll a program into scalar expressions.

    Args:
        chain: the robot.
        program: the steps.
        arguments: one SX per argument array, vectors (k) or matrices.
        held: what the entries that a step writes become before other steps read them; by default themselves.

    Returns:
        The row-major entries of every array that the program wrote, by name.

    """
    arrays = {name: _entries(value) for name, value in arguments.items()}
    for step in program:
        if isinstance(step, StraightLine):
            given = [
                as_operand(a.shape, arrays[a.name]) if a.name in arrays else arguments[a.name] for a in step.arguments
            ]
            entries = _entries(step.expressions(chain, *given).result)
            for output in step.outputs:
                arrays[output.name], entries = entries[: output.size], entries[output.size :]
        elif isinstance(step, SumJoints):
            arrays[step.output.name] = _sum_joints(chain, step, arrays[step.source.name])
        elif isinstance(step, Sum):
            _run_sum(step, arguments, arrays, held)
        elif isinstance(step, Shared):
            own = zip(step.arguments, step.given, strict=True)
            taken = {inner.name: as_operand(inner.shape, arrays[outer.name]) for inner, outer in own}
            arrays[step.output.name] = evaluate(chain, step.steps, taken, held)[step.result.name]
        elif isinstance(step, Spread):
            arrays[step.output.name] = _spread(chain, step, arrays[step.source.name])
        elif isinstance(step, Weights):
            _weigh(chain, step, arrays)
        elif isinstance(step, Gather):
            _gather(chain, step, arrays)
        elif isinstance(step, Reduce):
            _reduce(chain, step, arrays)
        elif isinstance(step, Scan):
            arrays[step.output.name] = _scan(step, arrays[step.source.name])
        else:
            _run_map(step.whole() if isinstance(step, SparseSum) else step, chain, arrays)
        arrays |= {array.name: held(arrays[array.name]) for array in writes(step)}
    return arrays


def _entries(value: ca.SX) -> list[ca.SX]:
    dense = ca.densify(value)
    return [dense[r, c] for r in range(dense.shape[0]) for c in range(dense.shape[1])]


def as_operand(shape: tuple[int, ...], entries: list[ca.SX]) -> ca.SX:
    """Entries as the column vector or (for two dimensions) matrix that a map's expression takes."""
    if len(shape) != 2:
        return ca.vertcat(*entries)
    rows = [ca.horzcat(*entries[r * shape[1] : (r + 1) * shape[1]]) for r in range(shape[0])]
    return ca.vertcat(*rows)


def operand_shape(operand: Operand) -> tuple[int, ...]:
    """Shape in which an expression takes an operand: the array's own, or a column."""
    return operand.array.shape if operand.at == "" else (operand.count,)


def pruned(
    given: Sequence[tuple[Operand, ca.SX]], expression: ca.SX
) -> tuple[tuple[Operand, ...], Callable[..., ca.SX]]:
    """The operands that an expression of their symbols depends on, and the body that takes these."""
    dependent = [(o, s) for o, s in given if ca.depends_on(expression, ca.vec(s))]
    place = ca.vertcat(*(ca.vec(symbol) for _, symbol in dependent))

    def body(*values: ca.SX) -> ca.SX:
        return ca.densify(ca.substitute(expression, place, ca.vertcat(*(ca.vec(ca.densify(v)) for v in values))))

    return tuple(operand for operand, _ in dependent), body


def _run_sum(step: Sum, arguments: dict[str, ca.SX], arrays: dict[str, list[ca.SX]], held: Held) -> None:
    for output in step.outputs:
        arrays[output.name] = [] if output.name in step.apart else [ca.SX(0)] * output.size
    for term in step.terms:
        given = {}
        for array, part in term.arguments:
            start = 0 if part.index is None else part.index * array.size
            entries = array.size * [ca.SX(0)]
            if part.array:
                entries = _entries(arguments[part.array.name])[start : start + array.size]
            given[array.name] = as_operand(array.shape, entries)
        results = evaluate(term.chain, term.program, given, held)
        for output, name in zip(step.outputs, step.results, strict=True):
            if output.name in step.apart:
                arrays[output.name] = [*arrays[output.name], *results[name]]
            else:
                arrays[output.name] = [a + b for a, b in zip(arrays[output.name], results[name], strict=True)]


def _run_map(step: Map, chain: Chain, arrays: dict[str, list[ca.SX]]) -> None:
    written = arrays.setdefault(step.output.array.name, [ca.SX(0)] * step.output.array.size)
    for i, j in step.indices(chain):
        result = _entries(step.expression(*_taken(step.operands, arrays, i, j)))
        for k in range(step.output.count):
            written[step.output.entry(k, i, j)] = result[k]
            if step.mirror:
                written[step.output.entry(k, j, i)] = result[k]


def reads(step: Step) -> tuple[Array, ...]:
    """The arrays that a step reads."""
    if isinstance(step, StraightLine):
        return step.arguments
    if isinstance(step, SparseSum):
        return step.reads
    if isinstance(step, Shared):
        return step.given
    if isinstance(step, (Map, Gather, Reduce)):
        return tuple(operand.array for operand in step.operands)
    if isinstance(step, Sum):
        return tuple(part.array for term in step.terms for _, part in term.arguments if part.array)
    return (step.source,)


def writes(step: Step) -> tuple[Array, ...]:
    """The arrays that a step writes."""
    if isinstance(step, (StraightLine, Sum, Reduce)):
        return step.outputs
    if isinstance(step, Map):
        return (step.output.array,)
    return (step.output, step.transposed) if isinstance(step, Weights) else (step.output,)


def _taken(operands: tuple[Operand, ...], arrays: dict[str, list[ca.SX]], i: int, j: int) -> list[ca.SX]:
    return [
        as_operand(operand_shape(o), [arrays[o.array.name][o.entry(k, i, j)] for k in range(o.count)]) for o in operands
    ]


def _weigh(chain: Chain, step: Weights, arrays: dict[str, list[ca.SX]]) -> None:
    source, m = arrays[step.source.name], len(chain.joints)
    depth = step.source.size // (m * m)
    output, transposed = [ca.SX(0)] * step.output.size, [ca.SX(0)] * step.output.size
    for i, j in indices(chain, step.over, but_of_base=step.but_of_base):
        for k in range(depth):
            here, there = (m * i + j) * depth + k, (m * j + i) * depth + k
            output[here] = transposed[there] = source[here] + (source[there] if step.mirror and i != j else 0)
    arrays[step.output.name], arrays[step.transposed.name] = output, transposed


def _gather(chain: Chain, step: Gather, arrays: dict[str, list[ca.SX]]) -> None:
    written, m = [ca.SX(0)] * step.output.size, len(chain.joints)
    for i, j in indices(chain, step.over, but_of_base=step.but_of_base):
        for k, value in enumerate(_entries(step.expression(*_taken(step.operands, arrays, i, j)))):
            written[m * k + j] += value
    arrays[step.output.name] = written


def _reduce(chain: Chain, step: Reduce, arrays: dict[str, list[ca.SX]]) -> None:
    for output in step.outputs:
        arrays[output.name] = [ca.SX(0)] * output.size
    for _, j in indices(chain, step.over):
        entries = _entries(step.expression(*_taken(step.operands, arrays, 0, j)))
        for output in step.outputs:
            own, entries = entries[: output.size], entries[output.size :]
            arrays[output.name] = [a + b for a, b in zip(arrays[output.name], own, strict=True)]


def _scan(step: Scan, source: list[ca.SX]) -> list[ca.SX]:
    m = step.source.shape[1]
    output = []
    for row in range(step.source.shape[0]):
        own = source[m * row : m * (row + 1)]
        ranges = [own[j + 1 :] if step.beyond else own[: j + 1] for j in range(m)]
        ranges[: step.base] = step.base * [own if step.beyond else []]
        output += [sum(reversed(each), ca.SX(0)) if step.beyond else sum(each, ca.SX(0)) for each in ranges]
    return output


def _spread(chain: Chain, step: Spread, source: list[ca.SX]) -> list[ca.SX]:
    n, joints = chain.dof, chain.joints
    if step.columns or len(step.source.shape) == 1:
        rows = step.source.size // n
        return [joint.multiplier * source[n * row + joint.coordinate] for row in range(rows) for joint in joints]
    depth = step.source.size // (n * n)
    return [
        a.multiplier * b.multiplier * source[(n * a.coordinate + b.coordinate) * depth + k]
        for a in joints for b in joints for k in range(depth)
    ]  # fmt: skip


def _sum_joints(chain: Chain, step: SumJoints, source: list[ca.SX]) -> list[ca.SX]:
    m, n = len(chain.joints), chain.dof
    output = [ca.SX(0)] * step.output.size
    if step.columns or len(step.source.shape) == 1:
        for row in range(step.source.size // m):
            for a, joint in enumerate(chain.joints):
                output[row * n + joint.coordinate] += joint.multiplier * source[row * m + a]
        return output
    depth = step.source.size // (m * m)
    for a, outer in enumerate(chain.joints):
        for b, inner in enumerate(chain.joints):
            for k in range(depth):
                into = (outer.coordinate * n + inner.coordinate) * depth + k
                output[into] += outer.multiplier * inner.multiplier * source[(a * m + b) * depth + k]
    if step.mirror:
        for i in range(n):
            for j in range(i):
                output[i * n + j] = output[j * n + i]
    return output
