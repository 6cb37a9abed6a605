# SPDX-License-Identifier: MIT
"""Evaluate the expressions of xacro templates: Python's syntax, without a way to anything else of Python.

The text is parsed and never compiled. A walk over the syntax tree computes literals, names, arithmetic, comparisons,
conditions, indices, comprehensions and calls of the functions that xacro documents. There are two kinds of attributes:
entries of dictionaries and namespaces, and the methods in ``_METHODS``. Everything else is refused. All sizes are
bounded, so that no expression takes much time or memory.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

_MAX_TEXT, _MAX_DEPTH, _MAX_STEPS = 10_000, 60, 1_000_000
_MAX_BITS = 4096
MAX_SIZE = 1_000_000
"""Largest size of a value, in characters and entries, those of its entries included."""
_WIDE_FORMAT = re.compile(r"%(\([^)]*\))?[^a-zA-Z%(]*(\*|\d{4})")
"""Format of a text with a width that is an argument, or has four digits."""

_METHODS: Mapping[type, frozenset[str]] = {
    str: frozenset(
        (
            *("capitalize", "count", "endswith", "find", "index", "isalnum", "isalpha", "isdigit", "join", "lower"),
            *("lstrip", "partition", "removeprefix", "removesuffix", "replace", "rfind", "rsplit", "rstrip", "split"),
            *("startswith", "strip", "title", "upper"),
        )
    ),
    dict: frozenset(("get", "items", "keys", "values")),
    list: frozenset(("count", "index")),
    tuple: frozenset(("count", "index")),
}
_BINARY: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
_UNARY: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Invert: operator.invert,
}
_COMPARE: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda left, right: left in right,
    ast.NotIn: lambda left, right: left not in right,
}


class ExpressionError(Exception):
    """An expression that is refused; the text is a sentence for the user."""


class Evaluator:
    """Evaluation of the expressions of one template.

    Attributes:
        functions: functions that an expression may call, with those in ``FUNCTIONS`` and ``MATH``.
        namespace: class of the dictionaries whose entries are attributes, ``math.pi``.
        steps: number of steps that the template may still take.

    """

    def __init__(self, functions: list[Callable[..., Any]], namespace: type, entries: type) -> None:
        known = (*functions, *FUNCTIONS.values(), *MATH.values())
        self.functions: dict[int, Callable[..., Any]] = {id(each): each for each in known if callable(each)}
        self.namespace, self.entries = namespace, entries
        self.steps = _MAX_STEPS

    def spend(self) -> None:
        """Count a step."""
        self.steps -= 1
        if self.steps < 0:
            raise ExpressionError(f"its expressions take more than {_MAX_STEPS} steps; correct what repeats in it")

    def evaluate(self, text: str, symbols: Mapping[str, Any]) -> Any:
        """Return the value of an expression.

        Raises:
            ExpressionError: the expression is refused.
            NameError: a name has no value.

        """
        text = text.strip()
        if len(text) > _MAX_TEXT:
            raise ExpressionError(f"the expression '{text[:40]}...' is longer than {_MAX_TEXT} characters; shorten it")
        try:
            tree = ast.parse(text, "<expression>", "eval")
        except (MemoryError, RecursionError, ValueError) as error:  # nesting; a NUL character
            raise ExpressionError(f"the expression '{text[:40]}' cannot be parsed; simplify it") from error
        return _Walk(self, text, symbols).value(tree.body, 0)


class _Walk:
    """Walk over the syntax tree of one expression."""

    def __init__(self, evaluator: Evaluator, text: str, symbols: Mapping[str, Any]) -> None:
        self.evaluator, self.text = evaluator, text
        self.scopes: list[Any] = [symbols]

    def refusal(self, what: str) -> ExpressionError:
        """Return the error for a part of the expression."""
        shown = self.text if len(self.text) <= 80 else f"{self.text[:80]}..."
        return ExpressionError(
            f"the expression '{shown}' has {what}, which stiffgen does not evaluate; "
            "write names, numbers, arithmetic, indices and the functions of xacro"
        )

    def value(self, node: ast.expr, depth: int) -> Any:
        """Return the value of a node."""
        self.evaluator.spend()
        if depth > _MAX_DEPTH:
            raise self.refusal(f"more than {_MAX_DEPTH} levels")
        rule = _RULES.get(type(node))
        if rule is None:
            raise self.refusal(f"a part of the kind {type(node).__name__}")
        return rule(self, node, depth + 1)

    def name(self, node: ast.Name, _: int) -> Any:
        """Return the value of a name; those of comprehensions come first."""
        if node.id.startswith("__"):
            raise self.refusal(f"the invalid name '{node.id}'")
        for scope in reversed(self.scopes):
            try:
                return scope[node.id]
            except KeyError:
                continue
        raise NameError(f"name '{node.id}' is not defined")

    def attribute(self, node: ast.Attribute, depth: int) -> Any:
        """Return the value of an attribute."""
        return self.entry(self.value(node.value, depth), node.attr)

    def entry(self, owner: Any, name: str) -> Any:
        """Return an entry of a namespace or of a dictionary of YAML."""
        has_entries = isinstance(owner, (self.evaluator.namespace, self.evaluator.entries))
        if name.startswith("_") or not has_entries:
            raise self.refusal(f"the attribute '.{name}'")
        try:
            return owner[name]
        except KeyError as error:
            raise NameError(f"name '{name}' is not defined") from error

    def call(self, node: ast.Call, depth: int) -> Any:
        """Return the result of a function, or of a method in ``_METHODS``."""
        function = self.function(node.func, depth)
        arguments: list[Any] = []
        for each in node.args:
            if isinstance(each, ast.Starred):
                arguments += self.items(self.value(each.value, depth))
            else:
                arguments.append(self.value(each, depth))
        if any(each.arg is None for each in node.keywords):
            raise self.refusal("'**' in a call")
        named = {str(each.arg): self.value(each.value, depth) for each in node.keywords}
        return self.bounded(function(*arguments, **named))

    def function(self, node: ast.expr, depth: int) -> Callable[..., Any]:
        """Return the function that a call names."""
        if isinstance(node, ast.Attribute):
            owner = self.value(node.value, depth)
            if not isinstance(owner, self.evaluator.namespace):
                for kind, names in _METHODS.items():
                    if isinstance(owner, kind) and node.attr in names:
                        return _method(kind, owner, node.attr)
            found: Any = self.entry(owner, node.attr)
        else:
            found = self.value(node, depth)
        if found is map:
            return self.mapped
        function = self.evaluator.functions.get(id(found))
        if function is None:
            raise self.refusal("a call of something that is no function of xacro")
        return function

    def mapped(self, function: Callable[..., Any], *lists: Any) -> list[Any]:
        """Return the results of a function for the entries of lists, at once."""
        if id(function) not in self.evaluator.functions or function is map:
            raise self.refusal("map() of something that is no function of xacro")
        return self.collected(function(*each) for each in self.items(zip(*lists, strict=False)))

    def collected(self, values: Iterable[Any]) -> list[Any]:
        """Return values as a list; refuse a large one before it is whole."""
        found, total = [], 0
        for each in values:
            found.append(each)
            total += size(each) + 1
            if total > MAX_SIZE:
                raise self.excess()
        return found

    def excess(self) -> ExpressionError:
        """Return the error for a large value."""
        return ExpressionError(f"the expression '{self.text[:80]}' has a value that is too large; correct it")

    def bounded(self, value: Any) -> Any:
        """Return a value; refuse a large one."""
        if size(value) > MAX_SIZE:
            raise self.excess()
        return value

    def items(self, value: Any) -> Iterator[Any]:
        """Yield the entries of a value."""
        for each in value:
            self.evaluator.spend()
            yield each

    def binary(self, node: ast.BinOp, depth: int) -> Any:
        """Return the result of an arithmetic operator."""
        rule = _BINARY.get(type(node.op))
        if rule is None:
            raise self.refusal(f"the operator {type(node.op).__name__}")
        left, right = self.value(node.left, depth), self.value(node.right, depth)
        if _is_large(node.op, left, right):
            raise self.excess()
        return self.bounded(rule(left, right))

    def compare(self, node: ast.Compare, depth: int) -> Any:
        """Return the result of a chain of comparisons."""
        left, result = self.value(node.left, depth), True
        for kind, right_node in zip(node.ops, node.comparators, strict=True):
            right = self.value(right_node, depth)
            result = _COMPARE[type(kind)](left, right)
            if not result:
                break
            left = right
        return result

    def either(self, node: ast.BoolOp, depth: int) -> Any:
        """Return the result of ``and`` and ``or``: the first value that decides."""
        decides = isinstance(node.op, ast.Or)
        value: Any = None
        for each in node.values:
            value = self.value(each, depth)
            if bool(value) == decides:
                break
        return value

    def comprehension(self, node: ast.ListComp | ast.GeneratorExp | ast.SetComp, depth: int) -> list[Any]:
        """Return the values of a comprehension, at once also for a generator."""
        self.scopes.append({})
        try:
            return self.collected(self.value(node.elt, depth) for _ in self.loop(node.generators, depth))
        finally:
            self.scopes.pop()

    def loop(self, generators: list[ast.comprehension], depth: int) -> Iterator[None]:
        """Set the names of a comprehension to each of their values in turn."""
        if not generators:
            yield
            return
        first, *others = generators
        for item in self.items(self.value(first.iter, depth)):
            self.assign(first.target, item)
            if all(self.value(condition, depth) for condition in first.ifs):
                yield from self.loop(others, depth)

    def assign(self, target: ast.expr, item: Any) -> None:
        """Set the names of a comprehension."""
        if isinstance(target, ast.Name):
            self.scopes[-1][target.id] = item
            return
        if not isinstance(target, ast.Tuple):
            raise self.refusal("such a loop")
        for each, part in zip(target.elts, item, strict=True):
            self.assign(each, part)


def _constant(walk: _Walk, node: ast.Constant, _: int) -> Any:
    if not isinstance(node.value, (int, float, complex, str, bool, type(None))):
        raise walk.refusal(f"a literal of the kind {type(node.value).__name__}")
    return walk.bounded(node.value)


def _subscript(walk: _Walk, node: ast.Subscript, depth: int) -> Any:
    return walk.value(node.value, depth)[walk.value(node.slice, depth)]


def _entries(walk: _Walk, node: ast.List | ast.Tuple | ast.Set, depth: int) -> list[Any]:
    return [walk.value(each, depth) for each in node.elts]


def _slice(walk: _Walk, node: ast.Slice, depth: int) -> slice:
    return slice(*(None if part is None else walk.value(part, depth) for part in (node.lower, node.upper, node.step)))


def _dictionary(walk: _Walk, node: ast.Dict, depth: int) -> Any:
    if None in node.keys:
        raise walk.refusal("'**' in a dictionary")
    return {walk.value(key, depth): walk.value(item, depth) for key, item in zip(node.keys, node.values, strict=True)
            if key is not None}  # fmt: skip


_RULES: Mapping[type, Callable[[_Walk, Any, int], Any]] = {
    ast.Constant: _constant,
    ast.Name: _Walk.name,
    ast.Attribute: _Walk.attribute,
    ast.Call: _Walk.call,
    ast.BinOp: _Walk.binary,
    ast.UnaryOp: lambda walk, node, depth: _UNARY[type(node.op)](walk.value(node.operand, depth)),
    ast.BoolOp: _Walk.either,
    ast.Compare: _Walk.compare,
    ast.IfExp: lambda walk, node, depth: walk.value(node.body if walk.value(node.test, depth) else node.orelse, depth),
    ast.Subscript: _subscript,
    ast.Slice: _slice,
    ast.List: lambda walk, node, depth: walk.bounded(_entries(walk, node, depth)),
    ast.Tuple: lambda walk, node, depth: walk.bounded(tuple(_entries(walk, node, depth))),
    ast.Set: lambda walk, node, depth: walk.bounded(set(_entries(walk, node, depth))),
    ast.Dict: lambda walk, node, depth: walk.bounded(_dictionary(walk, node, depth)),
    ast.ListComp: _Walk.comprehension,
    ast.GeneratorExp: _Walk.comprehension,
    ast.SetComp: lambda walk, node, depth: set(walk.comprehension(node, depth)),
}


def size(value: Any, known: dict[int, int] | None = None) -> int:
    """Return the size of a value: characters and entries, each as often as text of the value would show it.

    Raises:
        ExpressionError: the value holds itself.

    """
    if isinstance(value, str):
        return len(value)
    if isinstance(value, int):
        return 1 if value.bit_length() <= _MAX_BITS else MAX_SIZE + 1
    if isinstance(value, range):
        return len(value)
    if not isinstance(value, (dict, list, tuple, set, frozenset)):
        return 1
    known = {} if known is None else known
    if id(value) in known:
        if known[id(value)] < 0:
            raise ExpressionError("a list or dictionary holds itself; correct the YAML file")
        return known[id(value)]
    known[id(value)] = -1
    parts = [*dict.keys(value), *dict.values(value)] if isinstance(value, dict) else _plain_items(value)
    known[id(value)] = 1 + sum(size(each, known) for each in parts)
    return known[id(value)]


def _plain_items(value: Any) -> Iterator[Any]:
    """Yield the entries of a list or set; those of xacro's lists as they are stored."""
    return list.__iter__(value) if isinstance(value, list) else iter(value)


def _is_large(kind: ast.operator, left: Any, right: Any) -> bool:
    """Return whether an operator would make a large value, or take long to make it."""
    if isinstance(kind, ast.Mod):
        return isinstance(left, str) and _WIDE_FORMAT.search(left) is not None
    if isinstance(kind, ast.Mult):
        count, repeated = (left, right) if isinstance(left, int) else (right, left)
        is_number = isinstance(repeated, (int, float))
        return isinstance(count, int) and not is_number and count * size(repeated) > MAX_SIZE
    if not isinstance(left, int) or not isinstance(right, int) or right <= 0:
        return False  # floats have one size, and a negative power or shift makes no large integer
    if isinstance(kind, ast.LShift):
        return right > _MAX_BITS
    return isinstance(kind, ast.Pow) and abs(left) > 1 and left.bit_length() * right > _MAX_BITS


def _method(kind: type, owner: Any, name: str) -> Callable[..., Any]:
    """Return a bound method that makes no large value."""
    if name == "replace":

        def replace(old: str, new: str, count: int = -1) -> str:
            if (len(owner) // max(len(old), 1) + 1) * len(new) > MAX_SIZE:
                raise ExpressionError("replace() would make a text that is too large; correct it")
            return str(owner).replace(old, new, count)

        return replace
    if name == "join":

        def join(parts: Any) -> str:
            listed = list(parts)
            if len(owner) * len(listed) + size(listed) > MAX_SIZE:
                raise ExpressionError("join() would make a text that is too large; correct it")
            return str(owner).join(listed)

        return join
    bound: Callable[..., Any] = getattr(kind, name).__get__(owner)
    return bound


def _range(*bounds: int) -> range:
    """Return a range of bounded length."""
    found = range(*bounds)
    if len(found) > MAX_SIZE // 10:
        raise ExpressionError(f"a range has more than {MAX_SIZE // 10} numbers; correct it")
    return found


def _round(number: Any, digits: int | None = None) -> Any:
    """Return a rounded number; the builtin computes 10**digits."""
    return round(number, None if digits is None else max(-400, min(digits, 400)))


def _type(value: Any) -> type:
    """Return the type of a value; the builtin also makes types."""
    return type(value)


def _small(function: Callable[..., int]) -> Callable[..., int]:
    """Return a function of integers that refuses large ones; their factorials take for ever."""

    def bounded(*numbers: int) -> int:
        if any(isinstance(each, int) and abs(each) > 1000 for each in numbers):
            raise ExpressionError(f"{function.__name__}() takes numbers up to 1000 here; correct it")
        return function(*numbers)

    return bounded


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    """Return the parts of a text between any of some characters, as xacro.tokenize."""
    parts = re.split("|".join(map(re.escape, sep)), text) if sep else [text]
    return [part for part in parts if part] if skip_empty else parts


FUNCTIONS: Mapping[str, Any] = {
    **{each.__name__: each for each in (list, dict, map, len, str, float, int, bool, min, max, abs, all, any, complex)},
    **{each.__name__: each for each in (divmod, enumerate, filter, frozenset, isinstance, issubclass, ord, repr)},
    **{each.__name__: each for each in (reversed, set, slice, sorted, sum, tuple, zip, hash)},
    **{"range": _range, "round": _round, "type": _type, "tokenize": _tokenize, "True": True, "False": False},
}
"""Functions of Python that an expression may call, and xacro's ``tokenize``."""
MATH: Mapping[str, Any] = {
    name: _small(value) if name in ("factorial", "comb", "perm") else value
    for name, value in vars(math).items()
    if not name.startswith("_")
}
"""Constants and functions of the module math."""
