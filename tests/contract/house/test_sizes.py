# SPDX-License-Identifier: MIT
"""Functions of the package have at most 60 lines, classes 20 methods and files 500 lines."""

from __future__ import annotations

import ast

from support.project import ROOT

FILES = sorted((ROOT / "codegen" / "stiffgen").rglob("*.py"))


def test_sizes() -> None:
    assert len(FILES) > 150
    long = []
    for file in FILES:
        text = file.read_text()
        if text.count("\n") > 500:
            long.append(f"{file.name}: {text.count(chr(10))} lines")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno and node.end_lineno - node.lineno >= 60:
                long.append(f"{file.name}: {node.name}() has {node.end_lineno - node.lineno + 1} lines")
            if isinstance(node, ast.ClassDef):
                methods = sum(isinstance(each, ast.FunctionDef) for each in node.body)
                long += [f"{file.name}: {node.name} has {methods} methods"] if methods > 20 else []
    assert long == []
