# SPDX-License-Identifier: MIT
"""Every message that stiffgen, and what it generates, can raise: collected from the sources."""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

from support.project import ROOT

PACKAGE = ROOT / "codegen" / "stiffgen"
_CALLS = {"Problem", "Fault", "OutputError", "StiffgenError", "BuildError", "ChainError"}
_PASSED_ON = {"DescriptionWarning", "_Terminated", "NoBound"}
"""Texts of others; a signal; caught, and told as a missing bound."""
_OWN_FAULTS = {"NotImplementedError", "ArithmeticError"}
"""Faults of stiffgen's own, which no input reaches."""


def _texts(node: ast.AST, function: ast.AST) -> Iterator[str]:
    """The texts that an expression can give, ``...`` for what is filled in."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        parts = [list(_texts(part, function)) or ["..."] for part in node.values]
        yield from map("".join, itertools.product(*parts))
    elif isinstance(node, ast.FormattedValue):
        yield from _texts(node.value, function)
    elif isinstance(node, ast.BinOp):
        lefts, rights = (list(_texts(side, function)) or ["..."] for side in (node.left, node.right))
        yield from (left + right for left in lefts for right in rights)
    elif isinstance(node, ast.IfExp):
        yield from (*_texts(node.body, function), *_texts(node.orelse, function))
    elif isinstance(node, ast.List):
        for element in node.elts:
            yield from _texts(element, function)
    elif isinstance(node, ast.Name):  # what it was set to
        for each in ast.walk(function):
            if isinstance(each, ast.Assign) and any(isinstance(t, ast.Name) and t.id == node.id for t in each.targets):
                yield from _texts(each.value, function)


def _of_python(file: Path) -> Iterator[str]:
    tree = ast.parse(file.read_text())
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    inside = {id(node): function for function in functions for node in ast.walk(function)}  # the innermost one
    functions_of = {function.name: function for function in functions}
    raised = {id(node.exc) for node in ast.walk(tree) if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            if (name in _CALLS or id(node) in raised) and name not in _PASSED_ON | _OWN_FAULTS:
                for argument in node.args:
                    told = functions_of.get(ast.unparse(argument.func)) if isinstance(argument, ast.Call) else None
                    if told is None:
                        yield from _texts(argument, inside.get(id(node), tree))
                    else:  # a function that words it
                        for each in ast.walk(told):
                            if isinstance(each, ast.JoinedStr):
                                yield from _texts(each, told)
        elif isinstance(node, ast.Yield) and isinstance(node.value, ast.JoinedStr):
            yield from _texts(node.value, tree)


def _of_generated(file: Path) -> Iterator[str]:
    """Templates in Python, C and C++: the literals within a statement that refuses."""
    text = file.read_text()
    for start in re.finditer(r"\braise \w+\(|PyErr_(?:Format|SetString)\(|static_assert\(", text):
        depth, end = 1, start.end()
        while depth:  # brackets in literals come in pairs
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        literals = re.findall(r'"((?:[^"\\]|\\.)*)"', text[start.end() : end])
        yield re.sub(r"\{\{.*?\}\}|\{[^{}]*\}|%[sU]", "...", "".join(literals))
    yield from re.findall(r'^#error "(.*)"$', text, re.MULTILINE)


def messages() -> dict[str, str]:
    """Message and file."""
    found: dict[str, str] = {}
    for file in sorted(PACKAGE.rglob("*")):
        if file.suffix == ".py":
            texts = _of_python(file)
        elif file.suffix in (".j2", ".c", ".h") and not file.name.endswith(".md.j2"):
            texts = _of_generated(file)
        else:
            continue
        for text in texts:
            if re.search(r"[a-z]{2}.* ", text.replace("...", "")):  # more than a word
                found.setdefault(" ".join(text.split()), str(file.relative_to(PACKAGE)))
    return found
