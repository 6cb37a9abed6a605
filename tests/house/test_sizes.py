# SPDX-License-Identifier: MIT
"""Sizes of functions, classes and files, branches of functions; records of many fields have a reason."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from support.project import ROOT

REASON = "# More than twelve fields: "


BRANCHES = (ast.If, ast.IfExp, ast.For, ast.While, ast.ExceptHandler, ast.comprehension)


def own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a function without those of functions and classes in it."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, (ast.FunctionDef, ast.ClassDef)):
            yield child
            yield from own_nodes(child)


def cyclomatic_number(function: ast.FunctionDef) -> int:
    """Return one more than the branches, as lizard counts them."""
    number = 1
    for node in own_nodes(function):
        number += isinstance(node, BRANCHES)
        number += len(node.ifs) if isinstance(node, ast.comprehension) else 0
        number += len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0
    return number


def too_long(file: Path) -> Iterator[str]:
    """Yield what of a Python file is beyond the sizes of CONTRIBUTING.md."""
    text = file.read_text()
    lines = text.split("\n")
    if len(lines) > 501:
        yield f"{len(lines) - 1} lines"
    for node in ast.walk(ast.parse(text)):
        end = getattr(node, "end_lineno", None) or 0
        if isinstance(node, ast.FunctionDef) and end - node.lineno >= 60:
            yield f"{node.name}() has {end - node.lineno + 1} lines"
        if isinstance(node, ast.FunctionDef) and (number := cyclomatic_number(node)) > 15:
            yield f"{node.name}() has the cyclomatic number {number}"
        if isinstance(node, ast.ClassDef):
            methods = sum(isinstance(each, ast.FunctionDef) for each in node.body)
            if methods > 20:
                yield f"{node.name} has {methods} methods"
            fields = sum(isinstance(each, ast.AnnAssign) for each in node.body)
            if fields > 12 and REASON not in "\n".join(lines[node.lineno : end]):
                yield f"{node.name} has {fields} fields and no reason beside them"


def test_sizes() -> None:
    files = sorted((ROOT / "codegen" / "stiffgen").rglob("*.py"))
    assert len(files) > 150
    assert [f"{file.name}: {what}" for file in files for what in too_long(file)] == []


def test_the_core_stays_small() -> None:
    """Count the core's lines: what is added to them takes the place of others, or belongs to a family."""
    files = (ROOT / "codegen" / "stiffgen" / "core").rglob("*.py")
    assert sum(file.read_text().count("\n") for file in files) <= 15500


TOKENS = re.compile(r"//[^\n]*|/\*.*?\*/|\"(?:\\.|[^\"\\])*\"|`|\$\{|[{}]|\\.", re.DOTALL)
STATEMENT = re.compile(r"\b(if|for|while|switch|catch)\s*\([^\n]*\)$")


def is_body(head: str) -> bool:
    """Whether a brace behind this text opens a function: behind an arrow, or behind a list of parameters."""
    return head.endswith("=>") or (head.endswith(")") and not STATEMENT.search(head))


def functions(text: str) -> Iterator[tuple[int, int]]:
    """First line and number of lines of each function of JavaScript."""
    opened: list[tuple[str, int]] = []  # what a brace or backtick opened, and where
    for found in TOKENS.finditer(text):
        token, in_template = found[0], bool(opened) and opened[-1][0] == "template"
        if token == "`" and in_template:
            opened.pop()
        elif in_template:
            opened += [("inserted", found.start())] if token == "${" else []
        elif token in ("`", "{"):
            kind = "function" if is_body(text[: found.start()].rstrip()) else "block"
            opened.append(("template" if token == "`" else kind, found.start()))
        elif token == "}":
            kind, start = opened.pop()
            if kind == "function":
                yield text.count("\n", 0, start) + 1, text.count("\n", start, found.start()) + 1
    assert not opened


def test_sizes_of_javascript() -> None:
    page = ROOT / "codegen" / "stiffgen" / "lab" / "play" / "page"
    lengths = {(file.name, line): length for file in page.glob("*.js") for line, length in functions(file.read_text())}
    assert len(lengths) > 100
    assert {where: length for where, length in lengths.items() if length > 60} == {}
