# SPDX-License-Identifier: MIT
"""Steps: the records that make up programs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.connection import Representation
from stiffgen.core.symbolic.kinematics import Expressions, Section
from stiffgen.core.symbolic.program import (
    Array,
    Operand,
    Over,
    Program,
    Step,
    Unrolling,
    as_operand,
    entries_of,
    evaluate,
)
from stiffgen.core.symbolic.stiffness import symmetric_from_upper


class OnOperands(Step):
    """Step whose expression reads operands."""

    over: Over
    operands: tuple[Operand, ...]

    @property
    def reads(self) -> tuple[Array, ...]:
        """Arrays of the operands."""
        return tuple(operand.array for operand in self.operands)


class OnSource(Step):
    """Step that reads one array."""

    source: Array

    @property
    def reads(self) -> tuple[Array, ...]:
        """Source."""
        return (self.source,)


@dataclass(frozen=True)
class StraightLine(Step):
    """Straight-line code: the entries of ``expressions(chain, *arguments)`` fill the outputs one after the other.

    Attributes:
        outputs: arrays to fill.
        expressions: CasADi expressions of the outputs, stacked.
        arguments: arguments of the kernel, or arrays that earlier steps write.
        name: name of a function in C, for a step that several kernels share (its arguments are then those of the
            kernel); empty for statements within the kernel.
        heading: comment above the statements that fill the outputs.
        meaning: comment above the function.
        columns: number of outputs, counted from the first, with one column per joint: shape (6, m) or (3, m).
        moves: representation, if the outputs are Jacobian columns, the tip's pose or both; their derivatives with
            respect to q then follow from the columns.
        apart: steps that together fill the same outputs; reverse mode differentiates them in place of this step.
        is_linear: the arguments of the kernel enter by sums and products alone, and only sums over pairs, which are
            guarded against infinity, read the outputs: the arguments then need no guard of their own.

    """

    outputs: tuple[Array, ...]
    expressions: Callable[..., Expressions]
    arguments: tuple[Array, ...]
    name: str = ""
    heading: str = "result"
    meaning: str = ""
    columns: int = 0
    moves: Representation | None = None
    apart: tuple[StraightLine, ...] = ()
    is_linear: bool = False

    @property
    def reads(self) -> tuple[Array, ...]:
        """Arguments."""
        return self.arguments

    @property
    def writes(self) -> tuple[Array, ...]:
        """Arrays that the step writes."""
        return self.outputs

    @property
    def reads_whole(self) -> tuple[Array, ...]:
        """Arrays that the step passes to a helper function in C."""
        return self.arguments if self.name else ()

    def _evaluate(self, run: Unrolling) -> None:
        arguments = [as_operand(a.shape, run.entries[a.name]) for a in self.arguments]
        entries = entries_of(self.expressions(run.chain, *arguments).result)
        for output in self.outputs:
            run.entries[output.name], entries = entries[: output.size], entries[output.size :]

    def without_unread(self, needed: set[str]) -> Step:
        """Return the step without outputs that are not ``needed``; a step with a name keeps all outputs."""
        if self.name or all(output.name in needed for output in self.outputs):
            return self
        outputs: list[Array] = []
        kept: list[int] = []  # their places among the stacked entries of all outputs
        start = 0
        for output in self.outputs:
            if output.name in needed:
                outputs.append(output)
                kept += range(start, start + output.size)
            start += output.size

        def expressions(chain: Chain, *values: ca.SX) -> Expressions:
            whole = self.expressions(chain, *values)
            return Expressions(ca.vertcat(*entries_of(whole.result))[kept], whole.sections)

        columns = sum(output in outputs for output in self.outputs[: self.columns])
        return replace(self, outputs=tuple(outputs), expressions=expressions, columns=columns)


@dataclass(frozen=True)
class CloseLoops(StraightLine):
    """Joint positions that close the loops: arguments are the positions of the motors and a configuration.

    The output depends on the motors alone; its derivative is that of the closed loops, not of the statements.
    """


@dataclass(frozen=True)
class Congruence(StraightLine):
    """Product ``J A^-1 J^T`` of the arguments J (k, n) and A (n, n), a packed symmetric matrix.

    ``factors`` fills an array with L and D^-1 of A = L D L^T: the rows of L, each with its entry of D^-1 in place of 1.
    """

    factors: StraightLine = field(kw_only=True)


@dataclass(frozen=True)
class Map(OnOperands):
    """Map ``output = expression(*operands)`` over an index set; ``mirror`` copies each output [i, j] to [j, i]."""

    comment: str
    over: Over
    output: Operand
    operands: tuple[Operand, ...]
    expression: Callable[..., ca.SX]
    mirror: bool = False

    @property
    def writes(self) -> tuple[Array, ...]:
        """Array of the output."""
        return (self.output.array,)

    def _evaluate(self, run: Unrolling) -> None:
        output = run.entries.setdefault(self.output.array.name, [ca.SX(0)] * self.output.array.size)
        for i, j in self.over.indices(run.chain):
            for k, value in enumerate(run.apply(self.expression, self.operands, i, j)):
                output[self.output.entry(k, i, j)] = value
                if self.mirror:
                    output[self.output.entry(k, j, i)] = value


@dataclass(frozen=True)
class SparseSum(Step):
    """Sum ``output = start + expression(*operands)`` of square matrices; most entries of the expression are zero.

    ``start`` is symmetric and read from its upper triangle; None means zero. Unless the output is a result, C code
    stores only the entries that change and reads the others from ``start``. Without a start, one statement sets
    several neighbouring zeros.
    """

    comment: str
    output: Array
    start: Array | None
    operands: tuple[Array, ...]
    expression: Callable[..., ca.SX]
    sections: Callable[..., tuple[Section, ...]] = lambda *_: ()
    """Sections of the expression's computation, from the same operands."""

    @property
    def reads(self) -> tuple[Array, ...]:
        """Start, if any, and operands."""
        return (*((self.start,) if self.start else ()), *self.operands)

    def whole(self) -> Map:
        """Return the step as a map that writes every entry."""

        def total(*values: ca.SX) -> ca.SX:
            if self.start is None:
                return self.expression(*values)
            return symmetric_from_upper(values[0]) + self.expression(*values[1:])

        operands = tuple(Operand(array, "") for array in self.reads)
        return Map(self.comment, Over.ONCE, Operand(self.output, ""), operands, total)

    def _evaluate(self, run: Unrolling) -> None:
        self.whole()._evaluate(run)


@dataclass(frozen=True)
class SumJoints(OnSource):
    """Sums over the joints of each coordinate, weighted with their ``multiplier``, in every joint index.

    The source has the shape (m), (6, m) (``columns``), (m, m) or (m, m, depth). With ``mirror``, the upper triangle of
    the (n, n) result is copied to the lower one, since sums in a different order may differ in the last bit. With
    ``spread`` the step is the transpose: each joint receives the value of its coordinate, times ``multiplier``.
    """

    source: Array
    output: Array
    columns: bool = False
    mirror: bool = False
    spread: bool = False

    @property
    def reads_whole(self) -> tuple[Array, ...]:
        """Arrays that the step passes to a helper function in C."""
        return (self.source,)

    @property
    def of_pairs(self) -> bool:
        """Whether two indices of the arrays run over joints."""
        return not self.columns and len(self.source.shape) > 1

    def _evaluate(self, run: Unrolling) -> None:
        source, output = run.entries[self.source.name], [ca.SX(0)] * self.output.size
        for of_joints, of_coordinates, multiplier in self._entries(run.chain):
            to, from_ = (of_joints, of_coordinates) if self.spread else (of_coordinates, of_joints)
            output[to] += multiplier * source[from_]
        if self.mirror:
            n = run.chain.dof
            for i, j in itertools.combinations(range(n), 2):
                output[j * n + i] = output[i * n + j]
        run.entries[self.output.name] = output

    def _entries(self, chain: Chain) -> Iterator[tuple[int, int, float]]:
        """Yield each entry of the array over joints, the entry over coordinates that it belongs to, and its factor."""
        joints, m, n = tuple(enumerate(chain.joints)), len(chain.joints), chain.dof
        size = (self.output if self.spread else self.source).size  # of the array over joints
        if not self.of_pairs:
            for row, (i, joint) in itertools.product(range(size // m), joints):
                yield row * m + i, row * n + joint.coordinate, joint.multiplier
            return
        depth = size // (m * m)
        for (i, first), (j, second), k in itertools.product(joints, joints, range(depth)):
            pair_of_coordinates = first.coordinate * n + second.coordinate
            yield (i * m + j) * depth + k, pair_of_coordinates * depth + k, first.multiplier * second.multiplier


@dataclass(frozen=True)
class ArgumentSlice:
    """Entries of an argument for tip ``index``; the whole argument if the index is None, zeros if the array is None."""

    array: Array | None
    index: int | None = None

    def entries(self, run: Unrolling, size: int) -> list[ca.SX]:
        """Return the entries, as many as ``size``."""
        if self.array is None:
            return size * [ca.SX(0)]
        start = (self.index or 0) * size
        return run.entries[self.array.name][start : start + size]


@dataclass(frozen=True)
class Term:
    """Kernel of another chain (a branch): function name, program, and one slice per parameter of the kernel."""

    function: str
    chain: Chain
    program: Program
    arguments: tuple[tuple[Array, ArgumentSlice], ...]


@dataclass(frozen=True)
class Sum(Step):
    """Sums of the results of several kernels, the terms: ``outputs`` are the sums of the arrays named ``results``.

    For the outputs named in ``apart``, each term fills its own slice instead of adding to a sum.
    """

    outputs: tuple[Array, ...]
    results: tuple[str, ...]
    terms: tuple[Term, ...]
    apart: frozenset[str] = frozenset()

    @property
    def reads(self) -> tuple[Array, ...]:
        """Arguments of the terms."""
        return tuple(part.array for term in self.terms for _, part in term.arguments if part.array)

    @property
    def writes(self) -> tuple[Array, ...]:
        """Arrays that the step writes."""
        return self.outputs

    @property
    def reads_whole(self) -> tuple[Array, ...]:
        """Arrays that the step passes to a helper function in C."""
        return self.reads

    def _evaluate(self, run: Unrolling) -> None:
        """Evaluate the program of each term, and add the results, except those kept apart."""
        totals = {o.name: [] if o.name in self.apart else [ca.SX(0)] * o.size for o in self.outputs}
        for term in self.terms:
            arguments = {
                array.name: as_operand(array.shape, part.entries(run, array.size)) for array, part in term.arguments
            }
            results = evaluate(term.chain, term.program, arguments, run.replace)
            for output, name in zip(self.outputs, self.results, strict=True):
                if output.name in self.apart:
                    totals[output.name] += results[name]
                else:
                    totals[output.name] = [a + b for a, b in zip(totals[output.name], results[name], strict=True)]
        run.entries.update(totals)


@dataclass(frozen=True)
class Shared(Step):
    """Steps that several kernels share; they become the C function ``name``.

    The steps read the ``parameters`` and write the ``result``. A kernel passes ``arguments`` of the same shapes and
    receives the ``output``. ``columns`` are the parameters with one column per joint. ``meaning`` is the comment above
    the function.
    """

    name: str
    meaning: str
    parameters: tuple[Array, ...]
    result: Array
    steps: Program
    arguments: tuple[Array, ...]
    output: Array
    columns: tuple[Array, ...]
    arguments_are_guarded: bool = False
    """Whether no argument is infinite, because earlier steps have written all."""

    @staticmethod
    def of(
        name: str, meaning: str, steps: Program, arguments: tuple[Array, ...], output: Array, *columns: Array
    ) -> Shared:
        """Return steps whose parameters have the names of the arguments; reverse mode differentiates the steps."""
        return Shared(name, meaning, arguments, output, steps, arguments, output, columns, arguments_are_guarded=True)

    @property
    def apart(self) -> Program:
        """Steps that fill the output in place of this step; none where names differ from those of the function."""
        return self.steps if (self.parameters, self.result) == (self.arguments, self.output) else ()

    @property
    def reads(self) -> tuple[Array, ...]:
        """Arguments."""
        return self.arguments

    @property
    def reads_whole(self) -> tuple[Array, ...]:
        """Arrays that the step passes to a helper function in C."""
        return self.arguments

    def _evaluate(self, run: Unrolling) -> None:
        pairs = zip(self.parameters, self.arguments, strict=True)
        values = {inner.name: as_operand(inner.shape, run.entries[outer.name]) for inner, outer in pairs}
        run.entries[self.output.name] = evaluate(run.chain, self.steps, values, run.replace)[self.result.name]
