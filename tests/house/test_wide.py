# SPDX-License-Identifier: MIT
"""A test that CI leaves to ``make test-wide`` names one that CI runs; a case of a test has other cases in CI."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from support.project import ROOT, files_of_tests

WIDE = "pytest.mark.wide"


def functions(file: Path) -> dict[str, ast.FunctionDef]:
    return {node.name: node for node in ast.parse(file.read_text()).body if isinstance(node, ast.FunctionDef)}


def marks(file: Path) -> Iterator[tuple[str, ast.expr]]:
    """Yield the marks of whole tests, and of a whole file, with the name of the test."""
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            yield from ((node.name, mark) for mark in node.decorator_list)
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark":
            yield "every test", node.value


def replaced(file: Path) -> dict[str, str]:
    """Return the wide tests of a file, each with the test named instead."""
    found: dict[str, str] = {}
    if WIDE not in file.read_text():
        return found
    for name, mark in marks(file):
        assert ast.unparse(mark) != WIDE, f"{file.name}: {name} names no test that CI runs instead"
        if isinstance(mark, ast.Call) and ast.unparse(mark.func) == WIDE:
            (keyword,) = mark.keywords
            found[name] = str(ast.literal_eval(keyword.value))
    return found


def test_ci_runs_another_of_the_kind() -> None:
    """Look up the test that each wide one names in its place: it exists and CI runs it."""
    files = [*files_of_tests(), ROOT / "tests" / "campaigns" / "jax_wrapper.py"]
    wide = {file: replaced(file) for file in files}
    assert sum(map(len, wide.values())) > 10
    for file, tests in wide.items():
        for name, instead in tests.items():
            place, _, other = instead.rpartition("::")
            at = ROOT / place if place else file
            assert other in functions(at), f"{file.name}: {name} names {instead}, which does not exist"
            assert not {other, "every test"} & wide[at].keys(), (
                f"{file.name}: {name} names {instead}, which is wide too"
            )
