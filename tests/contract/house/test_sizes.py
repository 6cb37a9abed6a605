# SPDX-License-Identifier: MIT
"""Functions have at most 60 lines, classes 20 methods and files 500 lines; records of many fields have a reason."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from support.project import ROOT

REASON = "# More than twelve fields: "


def too_long(file: Path) -> Iterator[str]:
    text = file.read_text()
    lines = text.split("\n")
    if len(lines) > 501:
        yield f"{len(lines) - 1} lines"
    for node in ast.walk(ast.parse(text)):
        end = getattr(node, "end_lineno", None) or 0
        if isinstance(node, ast.FunctionDef) and end - node.lineno >= 60:
            yield f"{node.name}() has {end - node.lineno + 1} lines"
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
