# SPDX-License-Identifier: MIT
"""Symmetric parts of stiffnesses: a kernel that takes a stiffness uses 0.5 (K_ij + K_ji).

A symmetric matrix keeps its bits: the sum of two equal numbers is exact, and so is its half.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.core.symbolic.program import Array, Program, Step, Unrolling
from stiffgen.core.symbolic.steps import Sum


@dataclass(frozen=True)
class SymmetricPart(Step):
    """Symmetric part 0.5 (K + K^T) of each matrix of an argument; later steps read it in place of the argument.

    They read its upper triangle. In C, only a kernel for one configuration computes it: the callers of all others pass
    symmetric matrices, so that configurations that share a matrix share its symmetric part.
    """

    argument: Array

    @property
    def reads(self) -> tuple[Array, ...]:
        """Argument."""
        return (self.argument,)

    @property
    def writes(self) -> tuple[Array, ...]:
        """Argument, which has other values from here on."""
        return (self.argument,)

    def _evaluate(self, run: Unrolling) -> None:
        run.entries[self.argument.name] = symmetric_entries(self.argument, run.entries[self.argument.name])


def symmetric_entries(array: Array, entries: Sequence[ca.SX]) -> list[ca.SX]:
    """Return the row-major entries of the symmetric parts of an array's matrices, given those of the matrices."""
    rows = array.shape[-1]
    result = list(entries)
    for start in range(0, array.size, rows * rows):
        for i, j in itertools.combinations(range(rows), 2):
            upper, lower = start + rows * i + j, start + rows * j + i
            result[upper] = result[lower] = 0.5 * (entries[upper] + entries[lower])
    return result


def with_symmetric_parts(program: Program, arguments: Sequence[Array]) -> Program:
    """Return a program with the symmetric parts of its arguments, each right before the step that reads it first.

    Sums call kernels, which take the symmetric parts themselves.
    """
    steps = list(program)
    for argument in arguments:
        readers = [k for k, step in enumerate(steps) if argument.name in {array.name for array in step.reads}]
        if argument.symmetric_part and readers and not isinstance(steps[readers[0]], (Sum, SymmetricPart)):
            steps.insert(readers[0], SymmetricPart(argument))
    return tuple(steps)
