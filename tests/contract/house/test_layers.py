# SPDX-License-Identifier: MIT
"""The rooms of the package: a module imports its own room and those above it in this list, and nothing in a circle."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import stiffgen
from stiffgen.rooms import OPTIONAL
from support.project import ROOT

PACKAGE = Path(stiffgen.__file__).parent
LAYERS = (
    ("errors", "_version", "rooms", "described", "signals"),
    ("names", "folder", "page", "style", "rendering", "drive"),
    ("robot",),
    ("symbolic",),
    ("loading", "series"),
    ("lower",),
    ("options",),
    ("emit",),
    ("generate",),
    ("opened", "loads"),
    ("cache", "postures", "loaded"),
    ("softness",),
    ("verify",),
    ("controller",),
    ("bench",),
    ("cli",),
    ("prove",),
    ("analyze",),
    ("calibrate",),
    ("passport",),
    ("play",),
    ("new",),
    ("__main__",),
)
HEIGHT = {room: height for height, rooms in enumerate(LAYERS) for room in rooms}


def imports() -> dict[str, set[str]]:
    """Module -> the modules of this package that it imports, anywhere in its text."""
    files = {
        ".".join(("stiffgen", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): file
        for file in PACKAGE.rglob("*.py")
    }
    found: dict[str, set[str]] = {}
    for module, file in files.items():
        found[module] = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                named = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                named = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            else:
                continue
            found[module] |= {name for name in named if name in files and name != module}
    return found


def test_imports_run_downwards() -> None:
    modules = {module: others for module, others in imports().items() if module != "stiffgen"}
    rooms = {module.split(".")[1] for module in modules}
    assert rooms == set(HEIGHT), "a room that the list lacks, or one that is gone"
    wrong = [
        f"{module} imports {other}"
        for module, others in modules.items()
        for other in others
        if other != "stiffgen" and HEIGHT[other.split(".")[1]] > HEIGHT[module.split(".")[1]]
    ]
    assert not wrong


def test_no_module_imports_a_room_that_can_be_taken_out() -> None:
    found = [
        f"{module} imports {other}"
        for module, others in imports().items()
        for other in others
        if other.split(".")[1:2] != module.split(".")[1:2] and set(other.split(".")[1:2]) & set(OPTIONAL)
    ]
    # the package names the types of its functions to type checkers alone
    assert {each for each in found if not each.startswith("stiffgen imports ")} == set()


def test_no_module_imports_itself_through_others() -> None:
    graph = {module: others - {"stiffgen"} for module, others in imports().items() if module != "stiffgen"}
    while leaves := [module for module, others in graph.items() if not others & set(graph)]:
        for module in leaves:
            del graph[module]
    assert not graph, f"a circle among {sorted(graph)}"


def test_no_test_imports_a_test_and_each_lies_in_a_room() -> None:
    tests = ROOT / "tests"
    files = list(tests.rglob("test_*.py"))
    names = {file.stem for file in files}
    for file in files:
        nodes = list(ast.walk(ast.parse(file.read_text())))
        taken = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
        taken |= {
            alias.name for node in nodes if isinstance(node, (ast.Import, ast.ImportFrom)) for alias in node.names
        }
        assert not {part for module in taken for part in module.split(".")} & names, file.name
        assert file.relative_to(tests).parts[0] in ("unit", "contract", "oracle", "campaigns"), file


def test_only_tests_of_examples_import_examples() -> None:
    """Every other test says what the package does by itself."""
    text = re.compile(r"^ *(?:from|import) examples\b", re.MULTILINE)
    found = [file for file in (ROOT / "tests").rglob("*.py") if text.search(file.read_text())]
    assert {file.parent for file in found} == {ROOT / "tests" / "oracle" / "examples"}
