"""The rooms of the package: a module imports its own room and those above it in this list, and nothing in a circle."""

from __future__ import annotations

import ast
from pathlib import Path

import stiffgen

PACKAGE = Path(stiffgen.__file__).parent
LAYERS = (
    ("errors", "_version"),
    ("names", "folder"),
    ("robot",),
    ("symbolic",),
    ("emit",),
    ("generate",),
    ("check",),
    ("analyze",),
    ("cli",),
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


def test_no_module_imports_itself_through_others() -> None:
    graph = {module: others - {"stiffgen"} for module, others in imports().items() if module != "stiffgen"}
    while leaves := [module for module, others in graph.items() if not others & set(graph)]:
        for module in leaves:
            del graph[module]
    assert not graph, f"a circle among {sorted(graph)}"
