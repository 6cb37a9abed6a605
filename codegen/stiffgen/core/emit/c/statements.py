# SPDX-License-Identifier: MIT
"""Print the statements of a body as C.

Nodes that are used more than once or named by a section become ``const double`` locals; every other node is nested into
the expression that uses it. The order of statements follows the graph, which follows the Python code that built
it: no hash, address or platform enters, so the same chain prints the same bytes everywhere.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from stiffgen.core.lower.form import Body, Entry, LoweredSection
from stiffgen.core.lower.graph import CONDITIONAL, LIBM, LIBM_OF_TWO, OWN, Graph, Operations
from stiffgen.core.lower.scalar import Scalar
from stiffgen.core.lower.variant import Variant

_WIDTH = 100
_SUM, _PRODUCT, _UNARY, _ATOM = range(4)
_SIGNS = {
    "mul": ("*", _PRODUCT, _UNARY), "div": ("/", _PRODUCT, _UNARY),
    "add": ("+", _SUM, _PRODUCT), "sub": ("-", _SUM, _PRODUCT),
}  # fmt: skip
"""Sign of an operation, its precedence, and the least precedence of its right operand without brackets.

The right operand of a sum keeps its brackets: floating-point addition is not associative.
"""


def print_body(
    body: Body, variant: Variant, text: Callable[[Entry], str], temporaries: int = 0, sine_calls: int = 0
) -> PrintedStatements:
    """Print the statements of a body, without indentation.

    Args:
        body: operations on entries.
        variant: way of printing.
        text: C text of an entry.
        temporaries: number of the first unnamed local.
        sine_calls: number of the first call that computes sines and cosines.

    """
    writer = PrintedStatements(body, variant, [text(access) for access in body.inputs])
    writer.temporaries = temporaries
    writer.sine_calls = sine_calls
    # The order is that of the C: the poison, sines of the inputs, sections, outputs; each uses names of those before.
    # A choice by a comparison with NaN is a number: what depends on choices is NaN wherever an input is.
    if body.poison:
        total = " + ".join(writer.inputs[k] for k in sorted(body.reads))
        writer.poison_line(f"{variant.scalar.constant(0.0)} * ({total})", wide=any(a.wide for a in body.inputs))
    writer.sines_and_cosines(of_level=0)
    for section in body.sections:
        writer.section(section)
    if body.heading:
        writer.lines += ["", f"/* {body.heading} */"] if writer.lines else [f"/* {body.heading} */"]
    for index, output in enumerate(body.outputs):
        lvalue = " = ".join(text(place) for place in reversed(output.places))
        if index < body.define:
            writer.values.append(writer.value(lvalue, output.number))
        else:
            sign = "+=" if body.accumulate else "="
            writer.assign(lvalue, output.number, wide=body.wide_outputs, sign=sign)
    return writer


class PrintedStatements:
    """C statements of a body, one per line (long ones wrapped), with the operations that they cost."""

    def __init__(self, body: Body, variant: Variant, inputs: Sequence[str]) -> None:
        self.graph = body.graph
        self.variant = variant
        self.inputs = inputs
        self.poison = body.poison
        self.wide = self.graph.above(
            number
            for number, (kind, index, _) in enumerate(self.graph.keys)
            if kind == "input" and body.inputs[int(index)].wide
        )
        """Nodes whose value is a vector with a lane per configuration."""
        self.lines: list[str] = []
        self.operations = Operations()
        self.values: list[str] = []
        """C texts of the outputs that were defined rather than assigned."""
        self.text: dict[int, str] = {}  # nodes that have a C name
        self.inline: set[int] = set()  # nodes that were printed where they are used
        self.results: dict[int, str] = {}  # sines and cosines: where the call left them
        self.temporaries = 0
        """One past the last number of an unnamed local, t0, t1, ..."""
        self.sine_calls = 0
        """One past the number of the last call that computes sines and cosines."""
        self.computed_levels = 0
        self.levels = self.graph.sine_levels()
        self.spent: dict[int, int] = {}  # uses of angles by sines and cosines that have been computed
        self.choices = self.graph.above(number for number, key in enumerate(self.graph.keys) if key[0] in CONDITIONAL)
        self.calls: set[str] = set()
        """C functions that the statements call."""
        self.uses = body.graph.uses([output.number for output in body.outputs])

    def sines_and_cosines(self, *, of_level: int) -> None:
        """Compute the sines and cosines of a level's angles in one call; the nodes get the names of its results."""
        self.computed_levels = of_level + 1
        used = [
            number
            for number in sorted(self.uses)
            if self.graph.keys[number][0] in ("sin", "cos") and self.levels[number] == of_level + 1
        ]
        # the joints' order, so that the angles of a chain stand in it as in q
        angles = sorted({int(self.graph.keys[number][1]) for number in used}, key=partial(_first_input, self.graph))
        if not angles:
            return
        self._comment("sine and cosine of each joint angle" if of_level == 0 else "sines and cosines of what has sines")
        for angle in angles:
            self._prepare(angle)
        kinds = {self.graph.keys[number][0] for number in used}
        names = self._call_sine_cosine(angles, kinds)
        for number in used:
            kind, argument, _ = self.graph.keys[number]
            self.operations.sincos += 1
            self.results[number] = f"{names[kind]}[{angles.index(int(argument))}]"
            inner = self.graph.without_sign(int(argument))
            self.spent[inner] = self.spent.get(inner, 0) + 1

    def _call_sine_cosine(self, angles: Sequence[int], kinds: set[str]) -> dict[str, str]:
        """Write the call for some angles; return the name of the array of each kind, one entry per angle.

        In a batch each angle is a vector, with a lane per configuration, and the arrays of the call are the result::

            const lanes angle[7] = { q[0], q[1], ..., q[6], };
            lanes sine[7], cosine[7];
            sine_cosine(angle, sine, cosine, 7);

        In a single call the lanes of a vector hold several angles. The vectors are padded for the widest ones, those
        that hold angles are computed, and the numbers of each kind that is needed are read through a pointer::

            const lanes angle[8 / LANES] = { EIGHT(q[0], q[1], ..., q[6], 0.0), };
            lanes sine[8 / LANES], cosine[8 / LANES];
            sine_cosine(angle, sine, cosine, (7 + LANES - 1) / LANES);
            const double *const s = (const double *)sine;
        """
        call = str(self.sine_calls or "")  # the first call has no number
        self.sine_calls += 1
        self.calls.add("sine_cosine")
        array, sine, cosine = f"angle{call}", f"sine{call}", f"cosine{call}"
        values = [self._expression(angle)[0] for angle in angles]
        scalar = self.variant.scalar
        are_vectors = all(angle in self.wide for angle in angles)
        if are_vectors:
            declared = computed = str(len(values))
            initialisers = [", ".join(values)]
        else:
            declared, initialisers = f"{scalar.filled(len(values))} / LANES", grouped(values, scalar)
            computed = f"({len(values)} + LANES - 1) / LANES"
        self.lines += [
            f"const {self.variant.row} {array}[{declared}] = {{",
            *(f"    {line}" for entry in initialisers for line in wrap_list(f"{entry},")),
            "};",
            f"{self.variant.row} {sine}[{declared}], {cosine}[{declared}];",
            f"sine_cosine({array}, {sine}, {cosine}, {computed});",
        ]
        rows = {"sin": sine, "cos": cosine}
        if are_vectors:
            return rows
        # "s1" and "c1" are the names of a joint's own sine and cosine.
        names = {"sin": f"sines{call}" if call else "s", "cos": f"cosines{call}" if call else "c"}
        self.lines += [
            f"const {scalar.name} *const {names[kind]} = (const {scalar.name} *){rows[kind]};"
            for kind in ("sin", "cos")
            if kind in kinds
        ]
        return names

    def poison_line(self, text: str, *, wide: bool) -> None:
        """Define what is 0, or NaN if an input is NaN."""
        self._write(f"const {self.variant.row if wide else self.variant.scalar.name} {self.poison} = {text};")

    def _comment(self, text: str) -> None:
        self.lines += ["", f"/* {text} */"] if self.lines else [f"/* {text} */"]

    def section(self, section: LoweredSection) -> None:
        """Define the named values of a section that are computed here, below its comment.

        Values that the outputs do not need, constants and inputs get no name, nor does what is printed already: under
        another name, within an expression, or as an angle that only the call of sines used.
        """
        has_comment = all(self.graph.keys[n][0] in ("sin", "cos") for _, n in section.members)  # the call has one
        for name, number in section.members:
            if section.shared:
                if self.graph.keys[number][0] == "neg":
                    name, number = f"minus_{name}", self.graph.without_sign(number)
                if self.uses.get(number, 0) < 2:
                    continue
            # A negated value goes without a name of its own: its sign is written where it is used.
            if number not in self.uses or self.graph.keys[number][0] in ("const", "input", "neg"):
                continue
            is_inline = number in self.inline and self.uses[number] == 1
            if number in self.text or is_inline or self.spent.get(number) == self.uses[number]:
                continue
            if not has_comment:
                self._comment(section.comment)
                has_comment = True
            self._define(name, number)

    def assign(self, lvalue: str, number: int, *, wide: bool, sign: str = "=") -> None:
        """Store an operation's value; ``wide``: in every lane. A value that others use gets a name first."""
        inner = self.graph.without_sign(number)
        if self.uses[inner] > 1 and not self._is_leaf(inner) and inner not in self.text:
            self._define(self._next_temporary(), inner)
        self._prepare(number)
        text = self._expression(number)[0]
        if self.poison and self.graph.keys[inner][0] != "const":
            text = f"{text} + {self.poison}"
        self.operations.add += sign == "+="
        self._write(f"{lvalue} {sign} {self._spread(text) if wide and number not in self.wide else text};")

    def value(self, name: str, number: int) -> str:
        """Return the C text of a node, which is defined under ``name`` unless it is short already."""
        inner = self.graph.without_sign(number)
        if self.poison and number in self.choices:
            self._prepare(number)
            self.operations.add += 1
            self._write(f"{self._type(number)} {name} = {self._expression(number)[0]} + {self.poison};")
            return name
        if not (self._is_leaf(number) or inner in self.text):
            self._define(name, number)
        return self._expression(number)[0]

    def _type(self, number: int) -> str:
        return f"const {self.variant.row if number in self.wide else self.variant.scalar.name}"

    def _is_leaf(self, number: int) -> bool:
        """Return whether a node is a constant or an input, maybe with a sign."""
        kind, a, _ = self.graph.keys[number]
        return kind in ("const", "input") or (kind == "neg" and self._is_leaf(int(a)))

    def _define(self, name: str, number: int) -> None:
        """Write a local with a node's value; from now on its name is the node's text."""
        self._prepare(number)
        self._write(f"{self._type(number)} {name} = {self._expression(number)[0]};")
        self.text[number] = name

    def _prepare(self, number: int) -> None:
        """Define the shared operands below a node, deepest first."""
        while self.computed_levels < self.levels[number]:
            self.sines_and_cosines(of_level=self.computed_levels)
        # Depth first: a node is left, and maybe written, when all operands below it are.
        stack: list[tuple[int, Iterator[int]]] = [(number, iter(self._operands(number)))]
        visited = {number}
        while stack:
            current, operands = stack[-1]
            below = next((o for o in operands if o not in visited and o not in self.text), None)
            if below is not None:
                visited.add(below)
                stack.append((below, iter(self._operands(below))))
                continue
            stack.pop()
            shared = self.uses[current] > 1 and self.graph.keys[current][0] != "neg"
            if current != number and shared and not self._is_leaf(current):
                name = self._next_temporary()
                self._write(f"{self._type(current)} {name} = {self._expression(current)[0]};")
                self.text[current] = name

    def _next_temporary(self) -> str:
        self.temporaries += 1
        return f"t{self.temporaries - 1}"

    def _operands(self, number: int) -> tuple[int, ...]:
        """Return the operands that are still to be computed: the call has used the angles of sines and cosines."""
        return () if number in self.results else self.graph.operands(number)

    def _expression(self, number: int) -> tuple[str, int]:
        """Return the C text of a node whose shared operands have names (:meth:`_prepare`), and its precedence."""
        if number in self.text:
            return self.text[number], _ATOM
        self.inline.add(number)  # used once: printed where it is needed
        kind, a, b = self.graph.keys[number]
        if kind == "const":
            return self.variant.scalar.constant(float(a)), _ATOM
        if kind == "input":
            return self.inputs[int(a)], _ATOM
        if kind in ("sin", "cos"):
            return self.results[number], _ATOM
        if kind == "neg":
            return f"-{self._nested(int(a), _UNARY)}", _UNARY
        if kind not in _SIGNS:
            return self._function_call(number), _ATOM
        sign, precedence, right = _SIGNS[kind]
        if precedence == _PRODUCT:
            self.operations.multiply += 1
        else:
            self.operations.add += 1
        return f"{self._nested(int(a), precedence)} {sign} {self._nested(b, right)}", precedence

    def _function_call(self, number: int) -> str:
        """Return the C text of a call of libm's function or of our own, which may work on all lanes of a vector."""
        kind = self.graph.keys[number][0]
        self.operations.call += 1
        wide = number in self.wide and bool(self.variant.lanes)
        arguments = ", ".join(self._argument(operand, wide=wide) for operand in self.graph.operands(number))
        libm = self.variant.scalar.suffix if kind in LIBM + LIBM_OF_TWO else ""
        function = f"{kind}_lanes" if wide else f"{kind}{libm}"
        self.calls |= {function, "masked", self.variant.spread} if wide and kind in OWN else {function}
        return f"{function}({arguments})"

    def _argument(self, number: int, *, wide: bool) -> str:
        text = self._expression(number)[0]
        return self._spread(text) if wide and number not in self.wide else text

    def _spread(self, text: str) -> str:
        """Return an entry of a row made of a scalar."""
        if not self.variant.spread:
            return text
        self.calls.add(self.variant.spread)
        return f"{self.variant.spread}({text})"

    def _nested(self, number: int, at_least: int) -> str:
        """Return the C text of an operand, in brackets unless it binds at least so tightly."""
        text, precedence = self._expression(number)
        return text if precedence >= at_least else f"({text})"

    def _write(self, statement: str) -> None:
        self.lines += wrap(statement)


def _first_input(graph: Graph, number: int) -> tuple[float, int]:
    """Return a key that sorts angles as the coordinates that they depend on; constants come last."""
    pending, first = [number], math.inf
    while pending:
        kind, index, _ = graph.keys[current := pending.pop()]
        first = min(first, index) if kind == "input" else first
        pending.extend(graph.operands(current))
    return first, number


def grouped(values: Sequence[str], scalar: Scalar) -> list[str]:
    """Return values in groups for the initialiser of an array of lanes, the last group filled with zeros."""
    widest = scalar.widest
    filled = [*values, *[scalar.constant(0.0)] * (scalar.filled(len(values)) - len(values))]
    return [f"{scalar.group}({', '.join(filled[k : k + widest])})" for k in range(0, len(filled), widest)]


def wrap_list(text: str) -> list[str]:
    """Break a list after commas so that it fits the page; continuations are indented by four."""
    lines = _filled(text, re.compile(r"(?<=,) "))
    return [lines[0], *("    " + line for line in lines[1:])]


def wrap(statement: str) -> list[str]:
    """Break a statement before operators so that it fits the page; continuations are indented by four."""
    lines = _filled(statement, _CHAIN if statement.count(" = ") > 1 else _SUMS)
    if any(len(line) > _WIDTH for line in lines):
        lines = _filled(statement, _OPERATORS)
    return [lines[0], *("    " + line for line in lines[1:])]


# An operator outside brackets: no closing bracket follows before an opening one.
_SUMS = re.compile(r" (?=[-+] (?![^\[]*\]))")
_CHAIN = re.compile(r"(?<= =) ")  # of several assignments
_OPERATORS = re.compile(r" (?=[-+*] (?![^\[]*\]))")


def _filled(statement: str, breaks: re.Pattern[str]) -> list[str]:
    """Break a statement at ``breaks`` into lines of at most ``_WIDTH`` characters with the indent of continuations."""
    pieces = breaks.split(statement)
    lines = [pieces[0]]
    for piece in pieces[1:]:
        joined = f"{lines[-1]} {piece}"
        if len(joined) <= _WIDTH - (4 if len(lines) > 1 else 0):
            lines[-1] = joined
        else:
            lines.append(piece)
    return lines
