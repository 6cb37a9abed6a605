# SPDX-License-Identifier: MIT
"""Names of types in the package: one word has one meaning (the glossary of docs/design.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import stiffgen

PACKAGE = Path(stiffgen.__file__).parent
ALIAS = re.compile(r"_?[A-Z][a-z]\w*")


def definitions() -> Iterator[tuple[str, str]]:
    """Yield the name of every class with its file, and of every alias of a type with its text."""
    for file in PACKAGE.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                yield node.name.lstrip("_"), str(file.relative_to(PACKAGE))
        for node in tree.body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id
                if ALIAS.fullmatch(name):
                    yield name.lstrip("_"), ast.unparse(node.value)


def test_no_two_types_share_a_name() -> None:
    found: dict[str, set[str]] = {}
    for name, definition in definitions():
        found.setdefault(name, set()).add(definition)
    assert len(found) > 200
    assert not {name: places for name, places in found.items() if len(places) > 1}
