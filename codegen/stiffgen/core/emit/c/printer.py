# SPDX-License-Identifier: MIT
"""Print a lowered function as the lines of a C function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from stiffgen.core.emit.c.loops import Loops, indented
from stiffgen.core.emit.c.statements import PrintedStatements, grouped, print_body, wrap_list
from stiffgen.core.lower.form import (
    Body,
    Call,
    ColumnSums,
    Function,
    Helpers,
    Invoke,
    InvokeKernel,
    Loop,
    LoopForm,
    Pointer,
    SparseChange,
    Statements,
    Storage,
    TotalSums,
    Unused,
)
from stiffgen.core.lower.graph import Operations
from stiffgen.core.lower.variant import Variant
from stiffgen.core.symbolic.program import Over

Cost = Callable[[Function], Operations]
"""Operations of a function that was printed before."""


class Printer(Loops):
    """Lines, operations and called helpers of one function, collected item by item."""

    def __init__(self, function: Function, variant: Variant, cost: Cost, prefix: str) -> None:
        super().__init__(function, variant)
        self.cost = cost
        self.prefix = prefix
        """Prefix of the names of public functions."""
        self.lines: list[str] = []
        self.operations = Operations()
        self.temporaries = 0
        self.sine_calls = 0
        self.has_zeros = False
        """Whether the array of zeros was cleared by an item before."""

    def print(self) -> list[str]:
        """Return the lines between the function's braces."""
        for item in self.function.items:
            _PRINTERS[type(item)](self, item)
        declarations = [
            line for each in self.function.declarations for line in wrap_list(self.elements.declaration(each))
        ]
        return [*declarations, *([""] if declarations else []), *self.lines]

    def _comment(self, text: str) -> None:
        self.lines += ["", f"/* {text} */"] if self.lines else [f"/* {text} */"]

    def _body(self, body: Body, times: int = 1) -> PrintedStatements:
        """Print the statements of a body that runs so many times."""
        printed = print_body(body, self.variant, self.elements.entry, self.temporaries)
        self.calls |= printed.calls
        self.operations = self.operations + printed.operations.times(times)
        return printed

    def _call(self, call: Call) -> str:
        """Return the C text of a helper's call; its last argument is what it writes."""
        last = len(call.arguments) - 1
        texts = [self.elements.argument(each, written=k == last) for k, each in enumerate(call.arguments)]
        if call.helper == "weigh_branches":
            self.calls.add(f"{self.scope.prefix}parent_of")
        return self.called(call.helper, *texts)

    def helpers(self, item: Helpers) -> None:
        """Print the calls of helpers."""
        self.operations = self.operations + item.cost
        if item.comment:
            self._comment(item.comment)
        self.lines += map(self._call, item.calls)

    def unused(self, item: Unused) -> None:
        """Print that an argument is not read."""
        self.lines.append(f"(void){item.storage.array.name};")

    def statements(self, item: Statements) -> None:
        """Print straight-line code: guarded copies of arguments first."""
        number, guard, text = self.variant.number, self.variant.guard, self.elements.entry
        lines = [f"const {number} {a.guard} = {guard}({text(replace(a, guard=''))});" for a in item.guards]
        lines += [f"(void){self.elements.base(entry)};" for entry in item.unused]
        printed = print_body(item.body, self.variant, text, self.temporaries, 0 if item.braces else self.sine_calls)
        lines += printed.lines
        values = printed.values
        for storage in item.rows:
            lines += self._rows(storage, values[: storage.array.size])
            values = values[storage.array.size :]
        self.operations = self.operations + printed.operations
        self.operations = self.operations + Operations(add=len(item.guards), multiply=len(item.guards))
        self.calls |= printed.calls | ({guard} if item.guards else set()) | ({"put_rows"} if item.rows else set())
        self.temporaries, self.sine_calls = printed.temporaries, printed.sine_calls
        lines = ["{", *indented(lines, 1), "}"] if item.braces else lines
        self.lines += ["", *lines] if self.lines else lines

    def _rows(self, storage: Storage, texts: Sequence[str]) -> list[str]:
        """Put numbers into an array of vectors, row by row; a compiler gathers them in registers."""
        (count, m), name, padded = storage.array.shape, storage.array.name, self.scope.padded
        lines = ["", f"const lanes rows_of_{name}[{count}][{padded}] = {{"]
        for k in range(count):
            row = ", ".join(grouped(texts[m * k : m * (k + 1)], self.scope.scalar))
            lines += indented(wrap_list("{" + row + "},"), 1)
        return [*lines, "};", f"put_rows(rows_of_{name}[0], {count}, {padded}, {name}[0]);"]

    def loop(self, item: Loop) -> None:
        """Print a map."""
        printed = self._body(item.body, sum(1 for _ in item.over.indices(self.scope.chain)))
        if item.form is LoopForm.ONCE:
            self.temporaries = printed.temporaries
        self._comment(item.comment)
        self.lines += self.map(item, printed.lines)

    def sparse_change(self, item: SparseChange) -> None:
        """Print a square matrix of which few entries change."""
        self._comment(item.comment)
        if item.copies and item.start:
            start, output = (self.elements.pointer(Pointer(each, as_read=True)) for each in (item.start, item.output))
            self.lines.append(self.called("copy_symmetric", start, item.output.array.shape[0], output))
        printed = self._body(item.body)
        self.temporaries = printed.temporaries
        self.lines += printed.lines

    def _sums(self, count: int) -> list[str]:
        """Return the declaration of the sums, which start at zero."""
        if not self.variant.lanes:
            return [f"{self.variant.row} sum[{count}] = {{{self.variant.scalar.constant(0.0)}}};"]
        return [f"{self.variant.row} sum[{count}];", "memset(sum, 0, sizeof sum);"]

    def column_sums(self, item: ColumnSums) -> None:
        """Print sums over i for every joint j."""
        printed, name = self._body(item.body, item.pairs), item.output.array.name
        first, last = self.rows_above(item.over)
        stores = [f"{name}[{k}][j] = sum[{index}];" for index, k in enumerate(item.rows)]
        if len(item.rows) == item.output.array.shape[0]:
            stores = [f"for (int k = 0; k < {len(item.rows)}; ++k) {{", f"    {name}[k][j] = sum[k];", "}"]
        stores += [f"{name}[{k}][j] = {self.variant.row_zero};" for k in item.zeros]
        self._comment(item.comment)
        self.lines += [
            *self.rolled,
            f"for (int j = 0; j < {self.steps_of(Over.JOINTS)}; ++j) {{",
            *indented(self._sums(len(item.body.outputs)), 1),
            *indented(self.rolled, 1),
            f"    for (int i = {first}; i < {last}; ++i) {{",
            *indented(printed.lines, 2),
            "    }",
            *indented(stores, 1),
            "}",
        ]

    def total_sums(self, item: TotalSums) -> None:
        """Print sums over joints or coordinates; where lanes hold joints, a helper adds them up behind the loop."""
        count, scalar = len(item.body.outputs), self.variant.scalar
        printed = self._body(item.body, sum(1 for _ in item.over.indices(self.scope.chain)))
        lines = [
            *self._sums(scalar.filled(count) if self.variant.joint_lanes else count),
            *self.rolled,
            f"for (int j = 0; j < {self.steps_of(item.over)}; ++j) {{",
            *indented(printed.lines, 1),
            "}",
        ]
        source = "sum"  # the C array from which the results are copied
        if self.variant.joint_lanes:
            source = "total"
            lines += [
                f"lanes total_of[{scalar.filled(count)} / LANES];",
                self.called("add_lanes", "sum", count, "total_of"),
                f"const {scalar.name} *const total = (const {scalar.name} *)total_of;",
            ]
        first = 0
        for storage, entries, zeros in item.parts:
            lines += self._distributed(storage, entries, zeros, source, first)
            first += len(entries)
        self._comment(item.comment)
        self.lines += ["{", *indented(lines, 1), "}"]

    def _distributed(
        self, storage: Storage, entries: tuple[int, ...], zeros: tuple[int, ...], source: str, first: int
    ) -> list[str]:
        """Return statements that give the sums from number ``first`` on to an array."""
        name, shape, size = storage.array.name, storage.array.shape, storage.array.size
        n = shape[0] if len(shape) == 2 and shape[0] == shape[1] else 0
        upper = tuple(n * i + j for i in range(n) for j in range(i, n))  # entries of a symmetric result
        if entries == upper and n > 2:
            return [self.called("put_upper", f"&{source}[{first}]", n, name)]
        if len(entries) == size == 1:
            return [f"{name}[0] = {source}[{first}];"]
        if len(entries) == size:
            place = f"{source}[{first} + k]" if first else f"{source}[k]"
            return [f"for (int k = 0; k < {size}; ++k) {{", f"    {name}[k] = {place};", "}"]
        sums = [f"{name}[{k}] = {source}[{first + index}];" for index, k in enumerate(entries)]
        return [*sums, *(f"{name}[{k}] = {self.variant.zero};" for k in zeros)]

    def invoke(self, item: Invoke) -> None:
        """Print the call of an internal function."""
        function = item.function
        texts = [
            self.elements.passed(storage, columns=parameter.name in function.columns, written=written)
            for arrays, parameters, written in (
                (item.arguments, function.inputs, False),
                (item.outputs, function.outputs, True),
            )
            for storage, parameter in zip(arrays, parameters, strict=True)
        ]
        self.operations = self.operations + self.cost(function)
        self.lines += [""] if item.blank else []
        self.lines.append(f"{function.name}{self.variant.suffix}({', '.join(texts)});")

    def invoke_kernel(self, item: InvokeKernel) -> None:
        """Print the call of another kernel, and the sum of its results."""
        if item.zeros and self.variant.lanes and not self.has_zeros:
            self.lines.append("memset(nothing, 0, sizeof nothing);")
            self.has_zeros = True
        texts = [
            f"&{name}[{first}]" if first is not None else name
            for name, first in (
                *((source.array.name if source else "nothing", first) for _, source, first in item.arguments),
                *((output.array.name, first) for output, first in item.outputs),
            )
        ]
        prefix = "" if self.variant.batches else f"{self.prefix}_"
        self.lines.append(f"{prefix}{item.name}{kernel_suffix(self.variant)}({', '.join(texts)});")
        self.operations = self.operations + self.cost(item.function)
        for (part, _), total in zip(item.outputs, item.added, strict=True):
            if total:
                size = total.array.size
                self.operations = self.operations + Operations(add=size)
                self.lines.append(self.called("add_numbers", part.array.name, size, total.array.name))


_PRINTERS: dict[type, Callable[[Printer, Any], None]] = {
    Helpers: Printer.helpers,
    Unused: Printer.unused,
    Statements: Printer.statements,
    Loop: Printer.loop,
    SparseChange: Printer.sparse_change,
    ColumnSums: Printer.column_sums,
    TotalSums: Printer.total_sums,
    Invoke: Printer.invoke,
    InvokeKernel: Printer.invoke_kernel,
}


def kernel_suffix(variant: Variant) -> str:
    """Return what the name of a kernel's function ends in: nothing where it is public."""
    return (variant.suffix or "_thread") if variant.batches else ""
