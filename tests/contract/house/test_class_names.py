# SPDX-License-Identifier: MIT
"""Names of the package: one word has one meaning (the glossary of docs/design.md)."""

from __future__ import annotations

import ast
from pathlib import Path

import stiffgen

PACKAGE = Path(stiffgen.__file__).parent


def test_no_two_classes_share_a_name() -> None:
    places: dict[str, list[str]] = {}
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name.lstrip("_"), []).append(str(file.relative_to(PACKAGE)))
    assert len(places) > 100
    assert not {name: files for name, files in places.items() if len(files) > 1}
