# SPDX-License-Identifier: MIT
"""Steps that occur in reverse programs alone; ``lowering`` translates them into loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from stiffgen.core.symbolic.program import Array, Operand, Over, Unrolling
from stiffgen.core.symbolic.steps import OnOperands, OnSource


@dataclass(frozen=True)
class Weights(OnSource):
    """Gradients with respect to the results of a map over pairs: ``output[i, j] = source[i, j]`` over ``over``, else 0.

    With ``mirror``, source[j, i] is added where i is not j. ``transposed`` holds output[i, j] at [j, i]. With
    ``without_base``, pairs of base joints are zero, because a later map overwrites them. The step is separate from
    :class:`Gather`, since two of those share one, and one of the two may not be needed.
    """

    source: Array
    output: Array
    transposed: Array
    over: Over
    mirror: bool
    without_base: bool = False

    @property
    def writes(self) -> tuple[Array, ...]:
        """Weights and their transpose."""
        return (self.output, self.transposed)

    @property
    def reads_whole(self) -> tuple[Array, ...]:
        """Arrays that the step passes to a helper function in C."""
        return (self.source,)

    def _evaluate(self, run: Unrolling) -> None:
        source, m = run.entries[self.source.name], len(run.chain.joints)
        depth = self.source.size // (m * m)
        output, transposed = [ca.SX(0)] * self.output.size, [ca.SX(0)] * self.output.size
        for i, j in self.over.indices(run.chain, without_base=self.without_base):
            for k in range(depth):
                here, there = (m * i + j) * depth + k, (m * j + i) * depth + k
                output[here] = transposed[there] = source[here] + (source[there] if self.mirror and i != j else 0)
        run.entries[self.output.name], run.entries[self.transposed.name] = output, transposed


@dataclass(frozen=True)
class Gather(OnOperands):
    """Sums ``output[:, j]`` of ``expression(*operands)`` over all joints i with (i, j) in ``over``.

    The operand at "ij" is an array of :class:`Weights`, which is zero outside ``over``; ``without_base`` is the same as
    there.
    """

    comment: str
    over: Over
    output: Array
    operands: tuple[Operand, ...]
    expression: Callable[..., ca.SX]
    without_base: bool = False

    def _evaluate(self, run: Unrolling) -> None:
        output, m = [ca.SX(0)] * self.output.size, len(run.chain.joints)
        for i, j in self.over.indices(run.chain, without_base=self.without_base):
            for k, value in enumerate(run.apply(self.expression, self.operands, i, j)):
                output[m * k + j] += value
        run.entries[self.output.name] = output


@dataclass(frozen=True)
class Reduce(OnOperands):
    """Sums of ``expression(*operands)`` over joints or coordinates j; the stacked entries fill the outputs in turn."""

    comment: str
    outputs: tuple[Array, ...]
    operands: tuple[Operand, ...]
    expression: Callable[..., ca.SX]
    over: Over = Over.JOINTS

    @property
    def writes(self) -> tuple[Array, ...]:
        """Arrays that the step writes."""
        return self.outputs

    def _evaluate(self, run: Unrolling) -> None:
        total = [ca.SX(0)] * sum(output.size for output in self.outputs)
        for _, j in self.over.indices(run.chain):
            values = run.apply(self.expression, self.operands, 0, j)
            total = [a + b for a, b in zip(total, values, strict=True)]
        for output in self.outputs:
            run.entries[output.name], total = total[: output.size], total[output.size :]


@dataclass(frozen=True)
class Scan(OnSource):
    """Running sums of columns: ``output[:, j]`` = sum of ``source[:, i]`` over i <= j, or (``beyond``) over i > j.

    The first ``base`` joints belong to a floating base. The base and all columns move as one body, so that these joints
    receive the sum over all i with ``beyond``, and zero without.
    """

    comment: str
    source: Array
    output: Array
    beyond: bool
    base: int = 0

    def _evaluate(self, run: Unrolling) -> None:
        # Row by row: the sum over the joints up to each one, or over those beyond it.
        m, output = self.source.shape[1], []
        source = run.entries[self.source.name]
        for row in (source[start : start + m] for start in range(0, len(source), m)):
            summands = [row[j + 1 :] if self.beyond else row[: j + 1] for j in range(m)]
            summands[: self.base] = self.base * [row if self.beyond else []]
            # The order of the running sums in C, which continue from one joint to the next.
            output += [sum(reversed(each) if self.beyond else each, ca.SX(0)) for each in summands]
        run.entries[self.output.name] = output
