# SPDX-License-Identifier: MIT
"""Expressions of xacro: values equal those of Python, and nothing leads to Python's own objects or takes long."""

from __future__ import annotations

import math
import time

import pytest

from stiffgen.files.expressions import FUNCTIONS, MATH, Evaluator, ExpressionError, size


class Namespace(dict):
    """Stand-in for xacro's namespaces."""


class Entries(dict):
    """Stand-in for xacro's dictionaries of YAML, with entries as attributes."""


SYMBOLS = {
    **FUNCTIONS, **MATH, "x": 3, "name": "left_arm", "xyz": "0.1 0.2 0.3", "limits": [1.5, -2.5],
    "math": Namespace(MATH), "python": Namespace(FUNCTIONS), "data": Entries(a=Entries(z=0.5), items=7),
    "print": print, "secret": type("Secret", (), {"word": "open"})(),
}  # fmt: skip


def evaluate(text: str) -> object:
    return Evaluator([], Namespace, Entries).evaluate(text, SYMBOLS)


@pytest.mark.parametrize(
    "text",
    [
        "-x**2 + 7 // 2 - 7 % 4 * 1.5 / 2", "x == 3 and name != 'a' or 0", "not x", "1 < x <= 3 != 4", "x in [1, 3]",
        "'yes' if x > 2 else 'no'", "limits[-1]", "name[1:-1:2]", "(1, 'a', None, True)", "{'a': 1}['a']", "{1, 2}",
        "radians(90) + sin(pi/4) + sqrt(2)", "atan2(1, -1)", "max(*limits)", "sorted(limits, reverse=True)",
        "[float(i) * 2 for i in xyz.split() if i != '0.2']", "[(a, b) for a in [1, 2] for b in [a, 3]]",
        "sum(i * i for i in range(5))", "list(map(float, xyz.split(' ')))", "name.find('left_') != -1",
        "name.replace('left', 'right').upper()", "', '.join(['a', 'b'])", "'%s_%03d' % (name, x)", "dict(a=1, b=2)",
        "round(2.567, 2)", "str(len(xyz)) * 2", "[0] * 3 + [1]", "factorial(20)", "2 ** 100 >> 3", "0x1f & ~3",
        "[i for i, j in zip([1, 2], 'ab')]", "dict(a=1).get('b', 4)", "() or []", "x is None",
    ],
)  # fmt: skip
def test_values_are_those_of_python(text):
    """Evaluate expressions of templates: the values of Python's eval."""
    assert evaluate(text) == eval(text, dict(SYMBOLS))


def test_entries_are_attributes():
    """Read entries of a dictionary as attributes: an entry comes before a method of its name."""
    assert evaluate("data.a.z + data['a']['z']") == 1.0
    assert evaluate("math.degrees(math.pi) + python.abs(-1)") == 181.0
    assert evaluate("data.items") == 7  # an entry comes before the method
    assert list(evaluate("data.keys()")) == ["a", "items"]
    for text in ("data.b", "math.no", "nothing"):
        with pytest.raises((KeyError, NameError), match=r"b|name '(no|nothing)' is not defined"):
            evaluate(text)


ESCAPES = {
    "frame of a generator": "[g.gi_frame.f_back.f_back.f_builtins for g in [(1 for i in [1])]]",
    "the issue's": "[L.append((L[0].gi_frame.f_back for _ in [1])) or list(L[0])[0] for L in [[]]][0]",
    "class": "().__class__.__base__.__subclasses__()",
    "class by its function": "type(1).mro()",
    "three arguments of type": "type('T', (), dict(a=1))",
    "globals of a function": "sin.__self__.__loader__",
    "globals of ours": "round.__globals__",
    "format": "'{0.__class__.__init__.__globals__}'.format(secret)",
    "format_map": "'{x.__class__}'.format_map(dict(x=secret))",
    "formatted text": "f'{secret.word}'",
    "lambda": "(lambda: print)()",
    "walrus": "[y := print, y(1)]",
    "attribute of an object": "secret.word",
    "function that is not xacro's": "print('out')",
    "by the map": "list(map(print, [1]))",
    "by the key of a sort": "sorted(['a'], key=print2)",
    "names with underscores": "__import__('os')",
    "inside of a namespace": "math.__init__.__globals__",
    "methods of a namespace": "python.update(a=1)",
    "changes of a list": "limits.append(1)",
    "changes of a dictionary": "data.update(b=1)",
    "method of a class": "str.mro()",
    "call of a class of ours": "type(data)(a=1)",
    "await": "await x",
    "unpacking": "dict(**data)",
    "bytes": "b'a'",
    "encode": "'a'.encode('rot13')",
    "getattr": "getattr(x, 'real')",
    "vars": "python.vars(secret)",
}


@pytest.mark.parametrize("escape", ESCAPES)
def test_escapes_are_refused(escape, capsys):
    """Evaluate expressions that try to leave the evaluator: refused, with no side effect."""
    with pytest.raises((ExpressionError, NameError, TypeError, SyntaxError)) as refusal:
        evaluate(ESCAPES[escape])
    assert capsys.readouterr().out == ""
    assert SYMBOLS["limits"] == [1.5, -2.5] and set(SYMBOLS["data"]) == {"a", "items"}
    if escape in ("format", "lambda", "formatted text", "frame of a generator"):
        assert "does not evaluate" in str(refusal.value)


BOMBS = {
    "power": "9**9**9",
    "power of a negative number": "(-9)**99999",
    "shift": "1 << 10**12",
    "long text": "'a' * 10**10",
    "long list": "[0] * 10**10",
    "list in lists": "[[[0] * 1000] * 1000] * 1000",
    "range": "list(range(10**10))",
    "ranges by the map": "list(map(list, map(range, [100000] * 10000)))",
    "lists in a loop": "[list(range(100000)) for i in range(100000)]",
    "loops in loops": " + ".join(["0"]) + " + sum(1 for a in range(9999) for b in range(9999) for c in range(9999))",
    "factorial": "factorial(10**8)",
    "choices": "comb(10**9, 10**8)",
    "width of a format": "'%1000000000d' % 1",
    "width of a named format": "'%(a)1000000000d' % dict(a=1)",
    "width by argument": "'%*d' % (10**9, 1)",
    "replace": "('a' * 999999).replace('a', 'b' * 999999)",
    "join": "('a' * 999999).join(['b'] * 9999)",
    "product of numbers": " * ".join(["9**1000"] * 50),
    "nesting": "-" * 5000 + "1",
    "long expression": "1 + " * 5000 + "1",
    "literal": "0x" + "f" * 9000 + " + 0",
}


@pytest.mark.slow
@pytest.mark.parametrize("bomb", BOMBS)
def test_large_values_are_refused_at_once(bomb):
    start = time.process_time()
    with pytest.raises((ExpressionError, SyntaxError, ValueError)):
        print(str(evaluate(BOMBS[bomb]))[:80])
    assert time.process_time() - start < 5


def test_steps_add_up_over_expressions():
    evaluator = Evaluator([], Namespace, Entries)
    with pytest.raises(ExpressionError, match="more than 1000000 steps"):
        for _ in range(100):
            evaluator.evaluate("sum(a for a in range(9999))", SYMBOLS)


def test_sizes_count_what_text_would_show():
    """Count the size of nested lists: shared parts count each time, and a circle is refused."""
    shared = ["ab"] * 3
    assert size([shared, shared]) == 1 + 2 * (1 + 3 * 2)
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(ExpressionError, match="holds itself"):
        size(endless)
    assert size(math.pi) == 1


def test_rounding_to_many_digits_is_quick():
    assert evaluate("round(5, -10**9)") == 0  # Python's own computes 10**(10**9)
