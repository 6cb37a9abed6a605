# SPDX-License-Identifier: MIT
"""Print loops over joints and pairs of joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from stiffgen.core.emit.c.elements import Elements
from stiffgen.core.lower.form import Function, Loop, LoopForm
from stiffgen.core.lower.variant import Variant
from stiffgen.core.symbolic.program import Over

UNROLLED_ROWS = 8
"""Rows of a symmetric matrix up to which its loop is unrolled, which makes the first vector of each row a constant."""


class Loops:
    """Texts of loops and of helpers' calls in one function; ``calls`` collects the helpers."""

    def __init__(self, function: Function, variant: Variant) -> None:
        self.function = function
        self.variant = variant
        self.scope = function.scope
        self.elements = Elements(function.scope, variant)
        self.calls: set[str] = set()

    def map(self, item: Loop, lines: list[str]) -> list[str]:
        """Return the loop around the lines of a map's body."""
        return _LOOPS[item.form](self, item, lines)

    def called(self, helper: str, *arguments: object) -> str:
        """Return the C text of a call of a helper (templates/macros.j2), and note what the call needs."""
        name = helper + self.variant.suffix
        self.calls.add(name)
        if helper == "copy_finite":
            self.calls.add(self.variant.guard)
        if helper in ("sum_columns", "sum_pairs") and self.variant.lanes == "configurations":
            self.calls.add(self.variant.spread)
        return f"{name}({', '.join(map(str, arguments))});"

    def vector(self, item: Loop, lines: list[str]) -> list[str]:
        """Print a loop that fills one number per joint."""
        size = self.count(item.over)
        return [
            "{",
            f"    lanes row[{self.scope.padded}];",
            f"    for (int j = 0; j < {self.scope.blocks}; ++j) {{",
            *indented(lines, 2),
            "    }",
            f"    put_entries({item.output.array.name}, {size}, 0, row, 0, {size});",
            "}",
        ]

    def rows(self, item: Loop, lines: list[str]) -> list[str]:
        """Print a loop over rows i and vectors of joints j."""
        name, size = item.output.array.name, self.scope.size
        first, last, _ = self.columns_of(item.over)
        triangle = item.mirror and item.over.upper and len(self.scope.chain.joints) <= UNROLLED_ROWS
        block, unrolled = ("FIRST_BLOCK(i)", ["UNROLLED_ROWS"]) if triangle else ("0", [])
        # The first map over pairs stores whole rows: what it does not cover is overwritten.
        put = f"put_entries({name}, {size}, i, row, {first}, {last});"
        if item.first:
            put = f"put_row({name}, {size}, i, row, {block}, {self.scope.blocks});"
        return [
            *unrolled,
            f"for (int i = 0; i < {self.rows_of(item.over)}; ++i) {{",
            f"    lanes row[{self.scope.padded}];",
            *indented(unrolled, 1),
            f"    for (int j = {block}; j < {self.scope.blocks}; ++j) {{",
            *indented(lines, 2),
            "    }",
            f"    {put}",
            "}",
            *self._mirrored(item),
        ]

    def joints(self, item: Loop, lines: list[str]) -> list[str]:
        """Print a loop over joints or coordinates."""
        return [*self.rolled, f"for (int j = 0; j < {self.steps_of(item.over)}; ++j) {{", *indented(lines, 1), "}"]

    def branch(self, item: Loop, lines: list[str]) -> list[str]:
        """Print a loop over joints, and from each towards the base."""
        self.calls.add(f"{self.scope.prefix}parent_of")
        if item.mirror:
            array = item.output.array
            lines = [*lines, f"{self.elements.pair(array, 'j', 'i')} = {self.elements.pair(array, 'i', 'j')};"]
        outer, inner, start = "j", "i", "j"
        if item.over is Over.BEYOND:
            outer, inner, start = "i", "j", f"{self.scope.prefix}parent_of[i]"
        return [
            f"for (int {outer} = 0; {outer} < {self.scope.size}; ++{outer}) {{",
            f"    for (int {inner} = {start}; {inner} >= 0; {inner} = {self.scope.prefix}parent_of[{inner}]) {{",
            *indented(lines, 2),
            "    }",
            "}",
        ]

    def pairs(self, item: Loop, lines: list[str]) -> list[str]:
        """Print a loop over joints i and joints j."""
        first, _, condition = self.columns_of(item.over)
        if item.operand.count > 1 and item.output.is_result:
            position = f"{item.output.array.name}[{item.operand.count} * ({self.scope.size} * i + j)]"
            lines = [f"{self.variant.number} *const entry = &{position};", *lines]
        return [
            *self.rolled,
            f"for (int i = 0; i < {self.rows_of(item.over)}; ++i) {{",
            *indented(self.rolled, 1),
            f"    for (int j = {first}; {condition}; ++j) {{",
            *indented(lines, 2),
            "    }",
            "}",
            *self._mirrored(item),
        ]

    def columns_of(self, over: Over) -> tuple[str, str, str]:
        """Return the first j of row i, one past the last, and the condition for the last."""
        if over is Over.BASE:
            base = self.scope.chain.base_joints
            return "0", str(base), f"j < {base}"
        if over.upper:
            return "i" if over.diagonal else "i + 1", self.scope.size, f"j < {self.scope.size}"
        return ("0", "i + 1", "j <= i") if over.diagonal else ("0", "i", "j < i")

    def rows_above(self, over: Over) -> tuple[str, str]:
        """Return the first i of column j and one past the last; all where weights are zero elsewhere."""
        size = self.scope.size
        if self.variant.joint_lanes or over is Over.ALL or over.is_paths:
            return "0", self.rows_of(over)
        if over.upper:
            return "0", "j + 1" if over.diagonal else "j"
        return "j" if over.diagonal else "j + 1", size

    def rows_of(self, over: Over) -> str:
        """Return the number of rows i of a loop over pairs."""
        return str(self.scope.chain.base_joints) if over is Over.BASE else self.scope.size

    def _mirrored(self, item: Loop) -> list[str]:
        """Return the call that copies the computed half of a matrix to the other one; none where nothing is copied."""
        half = "upper" if item.over.upper else "lower"
        return [self.called(f"mirror_{half}", item.output.array.name, self.scope.size)] if item.mirror else []

    def count(self, over: Over) -> str:
        """Return the number of joints or coordinates of a loop."""
        if over is not Over.COORDINATES:
            return self.scope.size
        return str(len(self.scope.chain.coordinates)) if self.scope.chain.floating else "N"

    def steps_of(self, over: Over) -> str:
        """Return the number of cycles of a loop over joints or coordinates, or over their vectors."""
        return self.scope.blocks if self.variant.joint_lanes else self.count(over)

    @property
    def rolled(self) -> list[str]:
        """The line before a loop over joints in a batch."""
        return ["ROLLED"] if self.variant.lanes == "configurations" else []


_LOOPS: dict[LoopForm, Callable[[Loops, Loop, list[str]], list[str]]] = {
    LoopForm.ONCE: lambda loops, loop, lines: lines,
    LoopForm.VECTOR: Loops.vector,
    LoopForm.ROWS: Loops.rows,
    LoopForm.JOINTS: Loops.joints,
    LoopForm.BRANCH: Loops.branch,
    LoopForm.PAIRS: Loops.pairs,
}


def indented(lines: Sequence[str], depth: int) -> list[str]:
    """Return lines with a number of indents."""
    return ["    " * depth + line if line else line for line in lines]
