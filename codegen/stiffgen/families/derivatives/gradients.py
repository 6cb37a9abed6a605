# SPDX-License-Identifier: MIT
"""Gradients that a backward pass through a program collects, for :mod:`stiffgen.families.derivatives.adjoint`."""

from __future__ import annotations

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.program import Array, Operand, Over, Program, Step
from stiffgen.core.symbolic.steps import Map, SparseSum, StraightLine
from stiffgen.families.derivatives.steps import Gather


def cotangent_name(result: str, count: int) -> str:
    """Return the name of the cotangent of a result, for a function with ``count`` results."""
    return "cotangent" if count == 1 else f"{result}_cotangent"


def bar_name(argument: str) -> str:
    """Return the name of the gradient with respect to an argument."""
    return f"{argument}_bar"


def gradient_shape(argument: Array) -> tuple[int, ...]:
    """Return the shape of the gradient: the shape of the argument, or (6,) for the pose of a floating base."""
    return (6,) if argument.is_base_pose else argument.shape


class Gradients:
    """Gradients of one backward pass through ``program``.

    ``bars`` holds for each array the arrays whose sum is the gradient with respect to it, ``steps`` the reverse steps
    so far. ``names`` are the ``final`` names of the pass before this one; a new array has such a name from the start.
    """

    def __init__(self, chain: Chain, program: Program, names: dict[str, str]) -> None:
        """Prepare the gradient of a program: what it writes, which entries are zero, and what later maps overwrite."""
        self.chain = chain
        self.written = {array.name for step in program for array in step.writes}  # all but the kernel's arguments
        self.names = names
        self.final: dict[str, str] = {}
        self.bars: dict[str, list[Array]] = {}
        self.steps: list[Step] = []
        self.count = 0
        self.zeros: dict[str, set[int]] = {}  # entries of columns of joints that are always zero
        for step in program:
            if isinstance(step, Map) and step.over is Over.JOINTS:
                self.zeros[step.output.array.name] = _zeros(step, self.zeros)
        self.sparse = {step.output.name: step for step in program if isinstance(step, SparseSum)}
        self.columns = {a.name for step in program if not _writes_pairs(step) for a in _columns_of(step)}
        self.mirrored = {step.output.array.name for step in program if isinstance(step, Map) and step.mirror}
        self.of_base: set[str] = set()  # arrays in which a later map overwrites the pairs of base joints
        self.motions: list[Array] = []  # covectors of a floating base's twist and the joints' rates

    def new(self, of: Array) -> Array:
        """Add a contribution to the gradient with respect to an array."""
        self.count += 1
        name = f"bar{self.count}_{of.name}"
        array = Array(self.names.get(name, name), of.shape)
        self.bars.setdefault(of.name, []).append(array)
        self.final[name] = name
        return array

    def only(self, array: Array) -> Array:
        """Return the gradient with respect to an array that has exactly one contribution."""
        (bar,) = self.bars[array.name]
        return bar

    def local(self, name: str, shape: tuple[int, ...]) -> Array:
        """Return an array with a unique name."""
        self.count += 1
        return Array(f"{name}{self.count}", shape)

    def one(self, columns: Array) -> Array:
        """Return the gradient with respect to columns of joints as one array that a step writes column by column."""
        bars = self.bars[columns.name]
        by_columns = {array.name for step in self.steps for array in _columns_of(step)}
        if len(bars) == 1 and bars[0].name in by_columns:
            return bars[0]
        total = self.local(bar_name(columns.name), columns.shape)
        operands = tuple(Operand(bar, "j") for bar in bars)
        comment = f"gradient with respect to {shown(columns)}"
        self.steps.append(Map(comment, Over.JOINTS, Operand(total, "j"), operands, _sum))
        return total

    def known(self, step: Map, values: list[ca.SX]) -> list[ca.SX]:
        """Return the operands with structural zeros for entries that are always zero; their gradient is not needed."""
        return [_cleared(value, self.zeros.get(o.array.name)) for o, value in zip(step.operands, values, strict=True)]


def _columns_of(step: Step) -> tuple[Array, ...]:
    """Return the arrays that a step writes column by column."""
    if isinstance(step, StraightLine):
        return step.outputs[: step.columns]
    return step.writes if isinstance(step, (Map, Gather)) else ()


def _writes_pairs(step: Step) -> bool:
    """Return whether a step writes no columns (6) of joints: numbers of joints or of pairs of joints."""
    return isinstance(step, Gather) or (isinstance(step, Map) and (step.output.at != "j" or step.output.count == 1))


def _sum(*values: ca.SX) -> ca.SX:
    return sum(values, ca.SX(0))


def _zeros(step: Map, of_earlier: dict[str, set[int]]) -> set[int]:
    """Return the entries of a map's output that are zero for all operands, given those of the maps before it."""
    values = [
        _cleared(symbols(operand, f"x{k}_"), of_earlier.get(operand.array.name) if operand.at else None)
        for k, operand in enumerate(step.operands)
    ]
    result = column(step.expression(*values))
    return {k for k in range(result.numel()) if result[k].is_zero()}


def _cleared(value: ca.SX, zeros: set[int] | None) -> ca.SX:
    """Return a column with structural zeros in some entries."""
    if not zeros:
        return value
    return ca.vertcat(*(ca.SX(0) if k in zeros else value[k] for k in range(value.numel())))


def shown(array: Array) -> str:
    """Return the name of an array for comments."""
    return array.symbol or array.name


def extents(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return a shape in CasADi's form: two extents, or one for vectors and higher dimensions."""
    return shape if len(shape) == 2 else (Array("", shape).size,)


def symbols(operand: Operand, name: str) -> ca.SX:
    """Return symbols in the shape of an operand."""
    return ca.SX.sym(name, *extents(operand.shape))


def column(value: ca.SX) -> ca.SX:
    """Return the row-major entries as a column."""
    return ca.vec(ca.densify(value).T)
