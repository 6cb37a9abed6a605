# SPDX-License-Identifier: MIT
"""Graphs of scalar operations, read from CasADi functions, and counts of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

Key = tuple[str, int | float, int]
"""(kind, first, second): node numbers, a constant's value or an input's number."""


@dataclass
class Operations:
    """Arithmetic operations by kind."""

    add: int = 0
    multiply: int = 0
    sincos: int = 0
    call: int = 0
    """Square roots, arc tangents, comparisons, choices and other functions."""

    def __add__(self, other: Operations) -> Operations:
        return Operations(
            self.add + other.add,
            self.multiply + other.multiply,
            self.sincos + other.sincos,
            self.call + other.call,
        )

    def times(self, count: int) -> Operations:
        """Return these operations ``count`` times."""
        return Operations(self.add * count, self.multiply * count, self.sincos * count, self.call * count)

    @property
    def total(self) -> int:
        """Number of operations; a sine and a cosine count one each."""
        return self.add + self.multiply + self.sincos + self.call


@dataclass
class Graph:
    """Operations numbered in order of first use; equal operations share a number."""

    keys: list[Key] = field(default_factory=list)
    numbers: dict[Key, int] = field(default_factory=dict)

    def add(self, kind: str, a: int | float = 0, b: int = 0) -> int:
        """Return the number of an operation, a new one if there is none like it."""
        key = self._canonical(kind, a, b)
        if isinstance(key, int):
            return key
        if key not in self.numbers:
            self.numbers[key] = len(self.keys)
            self.keys.append(key)
        return self.numbers[key]

    def _canonical(self, kind: str, a: int | float, b: int) -> Key | int:
        """Return the key of an equal operation in one form, or the number of an operation that exists already.

        Signs move out of products and into differences, which is exact in floating point.
        """
        form = _FORMS.get(kind)
        return form(self, a, b) if form else (kind, a, b)

    def _const(self, value: int | float, _: int) -> Key | int:
        return ("neg", self.add("const", -value), 0) if value < 0 else ("const", value, 0)

    def _neg(self, a: int | float, _: int) -> Key | int:
        kind, first, second = self.keys[int(a)]
        if kind == "neg":
            return int(first)
        return self.add("sub", second, int(first)) if kind == "sub" else ("neg", a, 0)

    def _mul(self, a: int | float, b: int) -> Key | int:
        """Return the product of two nodes: signs are drawn out, and equal comparisons (0 or 1) are their own square."""
        for factor, other in ((int(a), b), (b, int(a))):
            if self.keys[factor][0] == "neg":
                return self.add("neg", self.add("mul", int(self.keys[factor][1]), other))
        if a == b and self.keys[b][0] in ("less", "at_most"):  # 0 or 1
            return b
        first, second = sorted((int(a), b), key=self._constants_first)
        return "mul", first, second

    def _add(self, a: int | float, b: int) -> Key | int:
        if self.keys[b][0] == "neg":
            return self.add("sub", a, int(self.keys[b][1]))
        if self.keys[int(a)][0] == "neg":
            return self.add("sub", b, int(self.keys[int(a)][1]))
        return "add", a, b

    def _sub(self, a: int | float, b: int) -> Key | int:
        if self.keys[b][0] == "neg":
            return self.add("add", a, int(self.keys[b][1]))
        if self.keys[int(a)][0] == "neg":
            return self.add("neg", self.add("add", int(self.keys[int(a)][1]), b))
        return "sub", a, b

    def _constants_first(self, number: int) -> tuple[bool, int]:
        return self.keys[number][0] != "const", number

    def operands(self, number: int) -> tuple[int, ...]:
        """Return the numbers of an operation's operands."""
        kind, a, b = self.keys[number]
        if kind in ("const", "input"):
            return ()
        return (int(a), b) if kind in _TWO_OPERANDS else (int(a),)

    def without_sign(self, number: int) -> int:
        """Return the operand of a negation, any other operation as it is; printers write a sign where it is used."""
        kind, operand, _ = self.keys[number]
        return int(operand) if kind == "neg" else number

    def above(self, starts: Iterable[int]) -> set[int]:
        """Return the operations that depend on some operations, and these."""
        above = set(starts)
        for number in range(len(self.keys)):  # operands come before what uses them
            if any(operand in above for operand in self.operands(number)):
                above.add(number)
        return above

    def chooses(self, results: Iterable[int]) -> bool:
        """Return whether a comparison or a choice can make a number of a NaN that the results depend on.

        A comparison that divides by itself cannot: with a NaN it is 0, and the results are 0/0.
        """
        results = list(results)
        conditional = {number for number, (kind, _, _) in enumerate(self.keys) if kind in CONDITIONAL}
        used = conditional.intersection(self.uses(results)) if conditional else ()
        return any(not self._is_mask(number, results) for number in used)

    def _is_mask(self, comparison: int, results: Iterable[int]) -> bool:
        """Return whether all results that depend on a comparison are NaN where it is 0."""
        if self.keys[comparison][0] not in ("less", "at_most"):
            return False
        above = self.above([comparison])
        zeros, nans = {comparison}, set[int]()  # where the comparison is 0
        for number in sorted(above - {comparison}):  # operands come before what uses them
            kind, operands = self.keys[number][0], self.operands(number)
            inherits = kind not in CONDITIONAL and not nans.isdisjoint(operands)
            if inherits or (kind == "div" and zeros.issuperset(operands)):
                nans.add(number)
            elif kind in ("mul", "neg") and not zeros.isdisjoint(operands):
                zeros.add(number)  # or NaN
        return all(result in nans for result in results if result in above)

    def sine_levels(self) -> list[int]:
        """Return how deep sines and cosines are nested in each operation: 1 in sin(q), 2 in sin(3 cos(q)), 0 in q."""
        levels: list[int] = []
        for number, (kind, _, _) in enumerate(self.keys):  # operands come before what uses them
            below = max((levels[operand] for operand in self.operands(number)), default=0)
            levels.append(below + (kind in ("sin", "cos")))
        return levels

    def uses(self, outputs: Sequence[int]) -> dict[int, int]:
        """Count how often each operation that ``outputs`` depend on is used; a sign is transparent."""
        uses: dict[int, int] = {}
        pending = list(outputs)
        while pending:
            number = pending.pop()
            uses[number] = uses.get(number, 0) + 1
            if uses[number] == 1 or self.keys[number][0] == "neg":
                pending.extend(self.operands(number))
        return uses


_FORMS: Mapping[str, Callable[[Graph, int | float, int], Key | int]] = {
    "const": Graph._const, "neg": Graph._neg, "mul": Graph._mul, "add": Graph._add, "sub": Graph._sub,
}  # fmt: skip
"""Rule of each kind of operation that has a form of its own."""
_BINARY = {
    ca.OP_ADD: "add", ca.OP_SUB: "sub", ca.OP_MUL: "mul", ca.OP_DIV: "div",
    ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_ATAN2: "atan2", ca.OP_HYPOT: "hypot",
    ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax",
    ca.OP_LT: "less", ca.OP_LE: "at_most", ca.OP_EQ: "equal", ca.OP_NE: "unequal",
    ca.OP_AND: "both", ca.OP_OR: "either", ca.OP_IF_ELSE_ZERO: "where",
}  # fmt: skip
_UNARY_OPS = {
    ca.OP_NEG: "neg", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp", ca.OP_LOG: "log",
    ca.OP_TAN: "tan", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_TANH: "tanh", ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh", ca.OP_LOG1P: "log1p", ca.OP_EXPM1: "expm1", ca.OP_ERF: "erf", ca.OP_FABS: "fabs",
    ca.OP_SIGN: "sign", ca.OP_NOT: "negation",
}  # fmt: skip
_TWO_OPERANDS = frozenset(_BINARY.values())
CONDITIONAL = frozenset(
    ("fmin", "fmax", "less", "at_most", "equal", "unequal", "both", "either", "where", "sign", "negation")
)
LIBM = (
    "sqrt", "exp", "log", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "log1p",
    "expm1", "erf", "fabs",
)  # fmt: skip
"""Functions of one number from libm."""
LIBM_OF_TWO = ("pow", "atan2", "hypot", "fmin", "fmax")
"""Functions of two numbers from libm."""
OWN = ("less", "at_most", "equal", "unequal", "both", "either", "where", "sign", "negation")
"""Functions that templates/choices.c defines: comparisons (1 or 0), and choices by them."""


def build_graph(function: ca.Function) -> tuple[Graph, list[int]]:
    """Return the operations of a function of one vector, and the numbers of those that give its outputs."""
    graph = Graph()
    registers: dict[int, int] = {}  # number of the node in each of CasADi's registers, which it uses again
    outputs = [graph.add("const", 0.0)] * function.nnz_out(0)
    for k in range(function.n_instructions()):
        operation, into = function.instruction_id(k), function.instruction_output(k)
        from_ = function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            outputs[into[1]] = registers[from_[0]]
        elif operation == ca.OP_INPUT:
            registers[into[0]] = graph.add("input", from_[1])
        elif operation == ca.OP_CONST:
            registers[into[0]] = graph.add("const", float(function.instruction_constant(k)))
        elif operation in _BINARY:
            registers[into[0]] = graph.add(_BINARY[operation], registers[from_[0]], registers[from_[1]])
        elif operation in _UNARY_OPS:
            registers[into[0]] = graph.add(_UNARY_OPS[operation], registers[from_[0]])
        elif operation == ca.OP_SQ:
            registers[into[0]] = graph.add("mul", registers[from_[0]], registers[from_[0]])
        elif operation == ca.OP_TWICE:
            registers[into[0]] = graph.add("mul", graph.add("const", 2.0), registers[from_[0]])
        elif operation == ca.OP_INV:
            registers[into[0]] = graph.add("div", graph.add("const", 1.0), registers[from_[0]])
        else:
            raise NotImplementedError(
                f"CasADi operation {operation} has no C printing; add it to _BINARY or _UNARY_OPS"
            )
    return graph, outputs
