"""Kernel table -> the bodies of the C functions."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from stiffgen.chain import Chain
from stiffgen.emit.expressions import Named, Operations, Printed, print_statements
from stiffgen.kernels import Kernel, chain_kernels
from stiffgen.names import c_comment
from stiffgen.program import Array, Gather, Map, Operand, Recursion, Step, Sum, as_operand, operand_shape


@dataclass(frozen=True)
class Function:
    """A C function: its name without prefix, parameters (arrays), body lines, and operation count."""

    name: str
    inputs: tuple[Array, ...]
    output: Array
    lines: tuple[str, ...]
    operations: Operations


@dataclass(frozen=True)
class Scope:
    """The chain that functions are about, and the prefix of what is internal to it."""

    chain: Chain
    prefix: str

    @property
    def size(self) -> str:
        """C name of the number of moving joints."""
        return f"{self.prefix}M" if self.chain.coupled else "N"


@dataclass(frozen=True)
class Code:
    """The functions of one robot: internal pose recursions, and one public function a kernel."""

    scopes: tuple[Scope, ...]
    recursions: tuple[tuple[Scope, Function], ...]
    kernels: tuple[tuple[Kernel, Function], ...]


def print_chain(chain: Chain, name: str) -> Code:
    """Print every kernel of a chain; ``name`` is the prefix of public functions."""
    printer = _ChainPrinter(chain, name)
    kernels = tuple((kernel, printer.kernel(kernel)) for kernel in chain_kernels(chain))
    return Code(tuple(printer.scopes.values()), tuple(printer.recursions.values()), kernels)


class _ChainPrinter:
    def __init__(self, chain: Chain, name: str) -> None:
        self.chain = chain
        self.name = name
        self.scopes: dict[str, Scope] = {}
        self.recursions: dict[str, tuple[Scope, Function]] = {}
        self.finished: dict[str, Operations] = {}  # public functions printed so far

    def kernel(self, kernel: Kernel) -> Function:
        prefix = f"{kernel.tip.name}_" if kernel.tip else ""
        scope = self.scopes.setdefault(prefix, Scope(kernel.scope(self.chain), prefix))
        body = _Body(self, scope, kernel)
        for step in kernel.steps(self.chain):
            body.step(step)
        function = body.function()
        self.finished[function.name] = function.operations
        return function

    def recursion(self, scope: Scope, step: Recursion) -> Function:
        """The internal function of a shared recursion, printed once however many kernels call it."""
        name = scope.prefix + step.name
        if name not in self.recursions:
            (target,) = step.targets
            lines, operations = recursion_body(scope.chain, step, element)
            self.recursions[name] = scope, Function(name, step.arguments, target, tuple(lines), operations)
        return self.recursions[name][1]


def recursion_body(chain: Chain, step: Recursion, lvalue: Callable[[Array, int], str]) -> tuple[list[str], Operations]:
    """Statements of a recursion, writing entry k of a target to ``lvalue(target, k)``."""
    # What enters linearly is guarded: a sliding joint's coordinate, a tool's pose. Sines turn infinity into NaN.
    sliding = {joint.coordinate for joint in chain.joints if joint.prismatic}
    given, inputs, guards = [], [], {}
    for array in step.arguments:
        symbols = []
        for k in range(array.size):
            symbol = ca.SX.sym(f"{array.name}{k}")
            symbols.append(symbol)
            text = f"{array.name}[{k}]"
            if array.name != "q" or k in sliding:
                local = f"q{k}" if array.name == "q" else "T{}{}".format(*divmod(k, array.shape[1]))
                guards[local] = text
                text = local
            inputs.append((symbol, text))
        given.append(as_operand(array.shape, symbols))
    expressions = step.expressions(chain, *given)
    dense = ca.densify(expressions.result)
    entries = [dense[r, c] for r in range(dense.shape[0]) for c in range(dense.shape[1])]
    places = [lvalue(target, k) for target in step.targets for k in range(target.size)]
    named = [Named(c_comment(section.title), _scalars(section.values)) for section in expressions.sections]
    printed = print_statements(inputs, list(zip(places, entries, strict=True)), named, heading=step.heading)
    text = "\n".join(printed.lines)
    used = {local: source for local, source in guards.items() if re.search(rf"\b{local}\b", text)}
    lines = [f"const double {local} = finite_or_nan({source});" for local, source in used.items()]
    unused = [
        f"(void){array.name};" for array in step.arguments if not re.search(rf"\b{array.name}\[", text + str(used))
    ]
    return [*lines, *unused, *printed.lines], printed.operations


def element(array: Array, k: int) -> str:
    """C text of the k-th entry of a local array."""
    indices = []
    for extent in reversed(array.shape):
        k, index = divmod(k, extent)
        indices.append(f"[{index}]")
    return array.name + "".join(reversed(indices))


def _scalars(values: dict[str, ca.SX]) -> list[tuple[str, ca.SX]]:
    result = []
    for name, value in values.items():
        rows, columns = value.shape
        for r in range(rows):
            for c in range(columns):
                tag = "" if rows == columns == 1 else f"{r}" if columns == 1 else f"{r}{c}"
                result.append((name + tag, value[r, c]))
    return result


_NOTATION = {"wrench": "F", "task_stiffness": "K"}
"""The paper's letters for the local copies of arguments."""


class _Body:
    """Collects the declarations and statements of one kernel."""

    def __init__(self, printer: _ChainPrinter, scope: Scope, kernel: Kernel) -> None:
        self.printer = printer
        self.scope = scope
        self.kernel = kernel
        self.inputs = tuple(argument.array(printer.chain) for argument in kernel.arguments)
        self.result = kernel.result.array(printer.chain)
        self.declarations: list[str] = []
        self.lines: list[str] = []
        self.operations = Operations()
        self.zero_rows: dict[str, set[int]] = {}
        self.copies: dict[str, Array] = {}
        steps = kernel.steps(printer.chain)
        read = {operand.array.name for step in steps if isinstance(step, Map) for operand in step.operands}
        for array in self.inputs:
            if array.name in read:
                self._copy_guarded(array)

    def _copy_guarded(self, array: Array) -> None:
        # What enters linearly would let an infinity through as an infinity, or as a NaN, or not at all.
        copy = Array(_NOTATION[array.name], array.shape)
        self.copies[array.name] = copy
        self._declare(copy)
        self.operations = self.operations + Operations(add=array.size, multiply=array.size)
        if len(array.shape) == 1:
            self.lines += [
                f"for (int k = 0; k < {array.size}; ++k) {{",
                f"    {copy.name}[k] = finite_or_nan({array.name}[k]);",
                "}",
            ]
            return
        rows, columns = array.shape
        self.lines += [
            f"for (int k = 0; k < {rows}; ++k) {{",
            f"    for (int l = 0; l < {columns}; ++l) {{",
            f"        {copy.name}[k][l] = finite_or_nan({array.name}[{columns} * k + l]);",
            "    }",
            "}",
        ]

    def function(self) -> Function:
        lines = (*self.declarations, *([""] if self.declarations else []), *self.lines)
        return Function(self.kernel.qualified_name, self.inputs, self.result, lines, self.operations)

    def step(self, step: Step) -> None:
        """Print one step of the kernel's program."""
        if isinstance(step, Recursion):
            self._recursion(step)
        elif isinstance(step, Sum):
            self._sum(step)
        elif isinstance(step, Gather):
            self._gather(step)
        else:
            self._map(step)

    def _recursion(self, step: Recursion) -> None:
        for target in step.targets:
            if not self._public(target):
                self._declare(target)
        if step.name:
            (target,) = step.targets
            function = self.printer.recursion(self.scope, step)
            operations = function.operations
            # The public array is flat; the recursion fills it by rows of the same length.
            into = f"(double (*)[{target.shape[1]}]){target.name}" if self._public(target) else target.name
            given = ", ".join(array.name for array in step.arguments)
            self.lines.append(f"{function.name}({given}, {into});")
        else:
            lines, operations = recursion_body(
                self.scope.chain,
                step,
                lambda array, k: f"{array.name}[{k}]" if self._public(array) else element(array, k),
            )
            self.lines += lines
        self.operations = self.operations + operations

    def _public(self, array: Array) -> bool:
        return array.name == self.result.name

    def _declare(self, array: Array) -> None:
        extents = "".join(f"[{extent}]" for extent in array.shape)
        declaration = f"double {array.name}{extents};"
        if declaration not in self.declarations:
            self.declarations.append(declaration)

    def _map(self, step: Map) -> None:
        inputs: list[tuple[ca.SX, str]] = []
        taken = []
        for operand in step.operands:
            entries = []
            for k in range(operand.count):
                if k in self.zero_rows.get(operand.array.name, ()):
                    entries.append(ca.SX(0))
                    continue
                symbol = ca.SX.sym(f"{operand.array.name}_{operand.at}{k}")
                inputs.append((symbol, self._text(operand, k)))
                entries.append(symbol)
            taken.append(as_operand(operand_shape(operand), entries))
        dense = ca.densify(step.body(*taken))
        results = [dense[r, c] for r in range(dense.shape[0]) for c in range(dense.shape[1])]
        target = step.target
        zeros: set[int] = set()
        if not self._public(target.array) and target.at == "j":
            # Rows that are zero for every joint are neither stored nor read.
            zeros = {k for k, value in enumerate(results) if value.is_zero()}
            self.zero_rows[target.array.name] = zeros
            if len(zeros) == len(results):
                return
        if not self._public(target.array):
            self._declare(target.array)
        outputs = [(self._text(target, k), value) for k, value in enumerate(results) if k not in zeros]
        printed = print_statements(inputs, outputs)
        self.operations = self.operations + printed.operations.times(sum(1 for _ in step.indices(self.scope.chain)))
        self.lines += ["", f"/* {step.comment} */"] if self.lines else [f"/* {step.comment} */"]
        self.lines += self._loops(step, printed)

    def _loops(self, step: Map, printed: Printed) -> list[str]:
        size = self.scope.size
        if step.over == "":
            return printed.lines
        if step.over == "j":
            return [f"for (int j = 0; j < {size}; ++j) {{", *_indented(printed.lines, 1), "}"]
        if step.over == "i on the way to j":
            mirrored = [f"{self._pair(step.target.array, 'j', 'i')} = {self._pair(step.target.array, 'i', 'j')};"]
            return [
                f"for (int j = 0; j < {size}; ++j) {{",
                f"    for (int i = j; i >= 0; i = {self.scope.prefix}parent_of[i]) {{",
                *_indented([*printed.lines, *(mirrored if step.mirror else [])], 2),
                "    }",
                "}",
            ]
        ranges = {
            "i<=j": f"for (int j = i; j < {size}; ++j) {{",
            "i<j": f"for (int j = i + 1; j < {size}; ++j) {{",
            "i>=j": "for (int j = 0; j <= i; ++j) {",
            "i>j": "for (int j = 0; j < i; ++j) {",
        }
        target, body = step.target, printed.lines
        if target.count > 1 and self._public(target.array):
            position = f"{target.array.name}[{target.count} * ({size} * i + j)]"
            body = [f"double *const entry = &{position};", *body]
        lines = [f"for (int i = 0; i < {size}; ++i) {{", f"    {ranges[step.over]}", *_indented(body, 2), "    }"]
        if step.mirror:
            strict = {"i<=j": "i<j", "i>=j": "i>j"}[step.over]
            copied, kept = (self._pair(target.array, first, second) for first, second in ("ji", "ij"))
            lines += [f"    {ranges[strict]}", f"        {copied} = {kept};", "    }"]
        return [*lines, "}"]

    def _pair(self, array: Array, first: str, second: str) -> str:
        if self._public(array):
            return f"{array.name}[{self.scope.size} * {first} + {second}]"
        return f"{array.name}[{first}][{second}]"

    def _text(self, operand: Operand, k: int) -> str:
        array = self.copies.get(operand.array.name, operand.array)
        if operand.at == "":
            return f"{array.name}[{k}]" if self._public(array) else element(array, k)
        if operand.at != "ij":
            return f"{array.name}[{k}][{operand.at}]"
        if operand.count == 1:
            return self._pair(array, "i", "j")
        return f"entry[{k}]" if self._public(array) else f"{array.name}[i][j][{k}]"

    def _gather(self, step: Gather) -> None:
        source, target = step.source, step.target
        chain = self.scope.chain
        m, M, prefix = len(chain.joints), self.scope.size, self.scope.prefix
        self.lines += [
            "",
            "/* joints that move together share a coordinate */",
            f"for (int k = 0; k < {target.size}; ++k) {{",
            f"    {target.name}[k] = 0.0;",
            "}",
        ]
        if step.columns:
            self.operations = self.operations + Operations(add=source.size, multiply=source.size)
            self.lines += [
                f"for (int k = 0; k < {source.shape[0]}; ++k) {{",
                f"    for (int j = 0; j < {M}; ++j) {{",
                f"        {target.name}[N * k + {prefix}coordinate_of[j]] += "
                f"{prefix}multiplier_of[j] * {source.name}[k][j];",
                "    }",
                "}",
            ]
            return
        depth = source.size // (m * m)
        self.operations = self.operations + Operations(add=source.size, multiply=source.size + m * m)
        into = f"N * {prefix}coordinate_of[i] + {prefix}coordinate_of[j]"
        if depth == 1:
            sums = [f"        {target.name}[{into}] += factor * {source.name}[i][j];"]
        else:
            sums = [
                f"        double *const entry = &{target.name}[{depth} * ({into})];",
                f"        for (int k = 0; k < {depth}; ++k) {{",
                f"            entry[k] += factor * {source.name}[i][j][k];",
                "        }",
            ]
        self.lines += [
            f"for (int i = 0; i < {M}; ++i) {{",
            f"    for (int j = 0; j < {M}; ++j) {{",
            f"        const double factor = {prefix}multiplier_of[i] * {prefix}multiplier_of[j];",
            *sums,
            "    }",
            "}",
        ]
        if step.mirror:
            self.lines += [
                "for (int i = 0; i < N; ++i) {",
                "    for (int j = 0; j < i; ++j) {",
                f"        {target.name}[N * i + j] = {target.name}[N * j + i];",
                "    }",
                "}",
            ]

    def _sum(self, step: Sum) -> None:
        target = step.target
        part = Array("part", (target.size,))
        self._declare(part)
        for index, term in enumerate(step.terms):
            given = []
            for array, source in term.arguments:
                offset = 0 if source.index is None else source.index * array.size
                given.append(f"&{source.array.name}[{offset}]" if source.index is not None else source.array.name)
            into = target.name if index == 0 else part.name
            self.lines.append(f"{self.printer.name}_{term.function}({', '.join(given)}, {into});")
            self.operations = self.operations + self.printer.finished[term.function]
            if index > 0:
                self.operations = self.operations + Operations(add=target.size)
                self.lines += [
                    f"for (int k = 0; k < {target.size}; ++k) {{",
                    f"    {target.name}[k] += {part.name}[k];",
                    "}",
                ]


def _indented(lines: list[str], depth: int) -> list[str]:
    return ["    " * depth + line if line else line for line in lines]
