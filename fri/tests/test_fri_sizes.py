# SPDX-License-Identifier: MIT
"""Functions of the C++ and C in fri/: at most 60 lines and 12 branches; files: 500 lines; includes form no circle."""

from __future__ import annotations

import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

from support.project import ROOT

FILES = sorted(file for file in (ROOT / "fri").rglob("*") if file.suffix in (".c", ".cpp", ".h"))
NO_CODE = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])'", re.DOTALL)
BRANCH = re.compile(r"\b(?:if|for|while|case|catch)\b|&&|\|\||\?")
HEAD = re.compile(r"(?P<before>\w+|\])\s*\([^{};]*\)[\s\w:(),.<>*&-]*$")
"""End of the text before a function's body: name, parameters, and a constructor's initializers."""
STATEMENTS = ("if", "for", "while", "switch", "catch", "]")


def code(text: str) -> str:
    """Return the text without comments and strings, of as many lines."""
    return NO_CODE.sub(lambda found: "\n" * found[0].count("\n"), text)


def functions(text: str) -> Iterator[tuple[int, int, int]]:
    """First line, number of lines, and cyclomatic number of each function; a lambda belongs to the one around it."""
    depth, start, opened = 0, 0, None
    for found in re.finditer(r"[{};]", text):
        if opened is None and found[0] == "{":
            head = HEAD.search(text[start : found.start()])
            if head and head["before"] not in STATEMENTS:
                opened = found.start(), depth
        depth += {"{": 1, "}": -1, ";": 0}[found[0]]
        if opened is not None and depth == opened[1]:
            body = text[opened[0] : found.end()]
            yield text.count("\n", 0, opened[0]) + 1, body.count("\n") + 1, 1 + len(BRANCH.findall(body))
            opened = None
        start = found.end()


def test_functions_are_small() -> None:
    """Before, 22 functions had 13 to 32 branches, and one had 111 lines."""
    found = [(file, *size) for file in FILES for size in functions(code(file.read_text()))]
    assert len(found) > 350
    assert [f"{file.name}:{line}: {length} lines, {branches} branches"
            for file, line, length, branches in found if length > 60 or branches > 12] == []  # fmt: skip
    assert [file.name for file in FILES if len(file.read_text().split("\n")) > 501] == []


def test_a_large_function_is_found() -> None:
    text = "struct A {\n    A() : b_(1) {}\n    int f(int x) const\n    {\n"
    text += "        if (x && x) { return x ? 1 : 2; }\n" * 5
    sizes = list(functions(code(text + '        return 0; /* if */\n    }\n    const char *c = "if";\n};\n')))
    assert [(length, branches) for _, length, branches in sizes] == [(1, 1), (8, 16)]


def test_includes_form_no_circle() -> None:
    """Follow the includes, header and source as one: no circle, and the options know neither client nor wrench."""
    client = [file for file in FILES if file.parent == ROOT / "fri" / "client"]
    graph: dict[str, set[str]] = {}
    for file in client:
        named = {Path(name).stem for name in re.findall(r'#include "([\w.]+)"', file.read_text())}
        graph.setdefault(file.stem, set()).update(named - {file.stem})
    order = list(TopologicalSorter(graph).static_order())
    assert {"options", "settings", "calibration", "wrench"} <= set(order)
    reached, waiting = set[str](), ["options"]
    while waiting:
        name = waiting.pop()
        waiting += graph.get(name, set()) - reached
        reached |= graph.get(name, set())
    assert not reached & {"wrench", "wiping_client", "connection", "session"}
