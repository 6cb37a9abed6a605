# SPDX-License-Identifier: MIT
"""Programs: a kernel as a short list of steps over joints and pairs of joints.

The part of a kernel whose cost is quadratic is one small expression, repeated over pairs of joints. A step records the
repetition instead of unrolling it, and two consumers share that definition: :func:`evaluate` unrolls a program into a
flat CasADi expression (the ``casadi.Function`` of :class:`stiffgen.StiffnessModel`), and :mod:`stiffgen.core.lower`
translates it into loops. Arrays are row-major; ``m`` is the number of moving joints, ``n`` the number of coordinates
(they differ where joints mimic).

A step (:mod:`stiffgen.core.symbolic.steps`) is a record of the arrays that it reads and writes, with a method that
evaluates it. Its reverse rule is one line of the table in :mod:`stiffgen.families.derivatives.rules`, its lowering one
line of the table in :mod:`stiffgen.core.lower.steps`. Rounding bounds follow from the lowered form.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, cast

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kinematics import dense


class Over(Enum):
    """Index set of a step: one evaluation, joints j, coordinates j of q, or pairs (i, j) of joints.

    The value is the text for comments. ``ON_THE_WAY``: i is j or a joint between the base and j. ``BEYOND``: j is a
    joint between the base and i. ``BASE``: i and j are joints of a floating base.
    """

    ONCE = ""
    JOINTS = "j"
    COORDINATES = "coordinate"
    UPPER = "i<=j"
    LOWER = "i>=j"
    STRICTLY_UPPER = "i<j"
    STRICTLY_LOWER = "i>j"
    ON_THE_WAY = "i on the way to j"
    BEYOND = "i beyond j"
    BASE = "i and j of the base"
    ALL = "all"

    def __str__(self) -> str:
        """Return the text for comments."""
        return self.value

    @property
    def is_pairs(self) -> bool:
        """Whether the set consists of pairs of joints."""
        return self not in (Over.ONCE, Over.JOINTS, Over.COORDINATES)

    @property
    def is_rows(self) -> bool:
        """Whether the set consists of single joints or coordinates."""
        return self in (Over.JOINTS, Over.COORDINATES)

    @property
    def is_paths(self) -> bool:
        """Whether the set consists of pairs of joints of which one is on the way to the other."""
        return self in (Over.ON_THE_WAY, Over.BEYOND)

    @property
    def upper(self) -> bool:
        """Whether the set is a triangle with the pairs i < j."""
        return self in (Over.UPPER, Over.STRICTLY_UPPER)

    @property
    def diagonal(self) -> bool:
        """Whether the set is a triangle with the pairs i = j."""
        return self in (Over.UPPER, Over.LOWER)

    @property
    def flipped(self) -> Over:
        """Set of the pairs (j, i); all pairs if that set has no name (the step's operand is zero elsewhere)."""
        return _FLIPPED.get(self, self)

    def indices(self, chain: Chain, *, without_base: bool = False) -> Iterator[tuple[int, int]]:
        """Yield the pairs (i, j) in the order of the printed loops; ``without_base`` skips pairs of base joints."""
        if without_base:
            yield from ((i, j) for i, j in self.indices(chain) if max(i, j) >= chain.base_joints)
            return
        m = len(chain.joints)
        if not self.is_pairs:
            count = {Over.ONCE: 1, Over.JOINTS: m, Over.COORDINATES: len(chain.coordinates)}[self]
            yield from ((0, j) for j in range(count))
        elif self.is_paths:
            yield from self._paths(chain)
        elif self is Over.BASE:
            yield from itertools.product(range(chain.base_joints), repeat=2)
        else:
            yield from ((i, j) for i in range(m) for j in range(m) if self is Over.ALL or self._holds(i, j))

    def _paths(self, chain: Chain) -> Iterator[tuple[int, int]]:
        """Yield pairs of a joint and one on the way to it: from the joint itself, or from its parent, to the base."""
        for outer, joint in enumerate(chain.joints):
            inner = outer if self is Over.ON_THE_WAY else joint.parent
            while inner >= 0:
                yield (inner, outer) if self is Over.ON_THE_WAY else (outer, inner)
                inner = chain.joints[inner].parent

    def _holds(self, i: int, j: int) -> bool:
        if i == j:
            return self.diagonal
        return i < j if self.upper else i > j


_FLIPPED = {
    Over.UPPER: Over.LOWER, Over.LOWER: Over.UPPER,
    Over.STRICTLY_UPPER: Over.STRICTLY_LOWER, Over.STRICTLY_LOWER: Over.STRICTLY_UPPER,
    Over.ON_THE_WAY: Over.ALL, Over.BEYOND: Over.ALL,
}  # fmt: skip


@dataclass(frozen=True)
class Array:
    """Named row-major array of numbers with up to three dimensions; a number has the shape ()."""

    name: str
    shape: tuple[int, ...]
    symbol: str = field(default="", compare=False)
    """Letter of the array in formulas."""
    symmetric: bool = field(default=False, compare=False)
    """Whether the array is a symmetric matrix, to the last bit."""
    is_q: bool = field(default=False, compare=False)
    """Whether the array is the kernel's joint positions."""
    is_base_pose: bool = field(default=False, compare=False)
    """Whether the array is the pose of a floating base."""
    symmetric_part: bool = field(default=False, compare=False)
    """Whether kernels use only the symmetric part of the array's matrices."""

    @property
    def size(self) -> int:
        """Number of entries."""
        size = 1
        for extent in self.shape:
            size *= extent
        return size


@dataclass(frozen=True)
class Operand:
    """Part of an array that an expression reads or writes: all (""), column i or j, or the element(s) [i, j]."""

    array: Array
    at: Literal["", "i", "j", "ij"]

    @property
    def count(self) -> int:
        """Number of entries that one evaluation of the expression reads or writes."""
        if self.at == "":
            return self.array.size
        if self.at == "ij":
            return self.array.size // (self.array.shape[0] * self.array.shape[1])
        return self.array.size // self.array.shape[-1]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the operand in an expression: the array's shape, or a column."""
        return self.array.shape if self.at == "" else (self.count,)

    @property
    def flipped(self) -> Operand:
        """Operand with column i in place of column j, and the reverse."""
        return Operand(self.array, "i" if self.at == "j" else "j")

    def entry(self, k: int, i: int, j: int) -> int:
        """Return the position in the array of the operand's k-th entry."""
        if self.at == "":
            return k
        if self.at == "ij":
            return (i * self.array.shape[1] + j) * self.count + k
        return k * self.array.shape[-1] + (i if self.at == "i" else j)


Replace = Callable[[list[ca.SX]], list[ca.SX]]
"""Function that replaces the outputs of a step before later steps read them."""


@dataclass(frozen=True)
class Unrolling:
    """State of an evaluation: the entries of every array so far, by name."""

    chain: Chain
    entries: dict[str, list[ca.SX]]
    replace: Replace = list

    def operand(self, operand: Operand, i: int, j: int) -> ca.SX:
        """Return the value of an operand at (i, j)."""
        entries = self.entries[operand.array.name]
        return as_operand(operand.shape, [entries[operand.entry(k, i, j)] for k in range(operand.count)])

    def apply(self, expression: Callable[..., ca.SX], operands: Sequence[Operand], i: int, j: int) -> list[ca.SX]:
        """Return the entries of an expression at (i, j)."""
        return entries_of(expression(*(self.operand(operand, i, j) for operand in operands)))


class Step(ABC):
    """Element of a program."""

    output: Any
    """Array or operand that the step writes."""

    @property
    @abstractmethod
    def reads(self) -> tuple[Array, ...]:
        """Arrays that the step reads."""

    @property
    def writes(self) -> tuple[Array, ...]:
        """Arrays that the step writes."""
        return (self.output,)

    @property
    def reads_whole(self) -> tuple[Array, ...]:
        """Arrays that the step passes to a helper function in C, including entries that are always zero."""
        return ()

    def evaluate(self, run: Unrolling) -> None:
        """Add the entries of the step's outputs to the evaluation."""
        self._evaluate(run)
        for array in self.writes:
            run.entries[array.name] = run.replace(run.entries[array.name])

    @abstractmethod
    def _evaluate(self, run: Unrolling) -> None: ...

    def without_unread(self, needed: set[str]) -> Step:
        """Return the step without outputs that are not ``needed``."""
        return self


Program = tuple[Step, ...]


def evaluate(
    chain: Chain, program: Program, arguments: dict[str, ca.SX], replace_entries: Replace = list
) -> dict[str, list[ca.SX]]:
    """Unroll a program into scalar expressions.

    Args:
        chain: chain of the program.
        program: steps.
        arguments: one SX per argument array, vectors (k) or matrices.
        replace_entries: function that replaces the outputs of a step before later steps read them (default: none).

    Returns:
        Row-major entries of every array that the program writes, by name.

    """
    run = Unrolling(chain, {name: entries_of(value) for name, value in arguments.items()}, replace_entries)
    for step in program:
        step.evaluate(run)
    return run.entries


def entries_of(value: ca.SX) -> list[ca.SX]:
    """Return the row-major entries of a matrix."""
    return cast(list[ca.SX], dense(value).T.nonzeros())


def as_operand(shape: tuple[int, ...], entries: Sequence[ca.SX]) -> ca.SX:
    """Return entries in CasADi's form: a matrix for two dimensions, otherwise a column."""
    column = ca.vertcat(*entries)
    return ca.reshape(column, shape[1], shape[0]).T if len(shape) == 2 else column


def pruned(
    operands: Sequence[tuple[Operand, ca.SX]], expression: ca.SX
) -> tuple[tuple[Operand, ...], Callable[..., ca.SX]]:
    """Return the operands on which an expression of their symbols depends, and the expression as their function."""
    dependent = [(o, s) for o, s in operands if ca.depends_on(expression, ca.vec(s))]
    stacked = ca.vertcat(*(ca.vec(symbol) for _, symbol in dependent))

    def body(*values: ca.SX) -> ca.SX:
        return ca.densify(ca.substitute(expression, stacked, ca.vertcat(*(ca.vec(ca.densify(v)) for v in values))))

    return tuple(operand for operand, _ in dependent), body
