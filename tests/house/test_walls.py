# SPDX-License-Identifier: MIT
"""Walls between the rooms of the package: imports run one way, families meet in adapters, names stand in tables.

import-linter states the order of the rooms in as many lines as the test here. It knows no circle among modules, only
among packages, and no table of families; what it would replace is shorter than its configuration and its packages.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import stiffgen
from campaigns.rooms import WITHOUT_KERNELS
from stiffgen.cli import COMMANDS
from stiffgen.core.family import FAMILIES
from support.project import ROOT

PACKAGE = Path(stiffgen.__file__).parent
ROOMS = ("core", "families", "files", "control", "cli", "lab")
"""Rooms in the order of imports: a module imports its own room and those before it."""
TOP = {"__init__.py", "__main__.py", "_version.py", "rooms.py", "py.typed", "errors.py", "style.py", *ROOMS}
"""All that lies at the top; errors and style are names of users' filters and scripts."""
TABLES = ("stiffgen", "stiffgen.rooms", "stiffgen.core.family", "stiffgen.core.emit.registry", "stiffgen.cli")
"""Modules with tables of names."""


def modules() -> dict[str, Path]:
    """Return the modules of the package, without texts of generated folders."""
    return {
        ".".join(("stiffgen", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): file
        for file in PACKAGE.rglob("*.py")
        if "wrappers" not in file.parts and "python" not in file.relative_to(PACKAGE).parts[1:2]
    }


@cache  # nine of ten seconds of this file would go into reading the package again
def imported(file: Path) -> frozenset[str]:
    """Return the names of modules that a file may import, anywhere in its text."""
    found = set[str]()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(found)


def imports() -> dict[str, set[str]]:
    """Return the modules of this package that each module imports."""
    files = modules()
    return {module: (imported(file) & files.keys()) - {module} for module, file in files.items()}


def room(module: str) -> str:
    """Return the room of a module, or its own name at the top."""
    return module.partition(".")[2].partition(".")[0]


def test_nothing_else_lies_at_the_top() -> None:
    assert {each.name for each in PACKAGE.iterdir() if each.name != "__pycache__"} == TOP


def test_imports_run_towards_the_core() -> None:
    """Check the imports between rooms: none away from the core."""
    wrong = [
        f"{module} imports {other}"
        for module, others in imports().items()
        for other in others
        if room(module) in ROOMS and room(other) in ROOMS and ROOMS.index(room(other)) > ROOMS.index(room(module))
    ]
    assert not wrong


def test_no_module_imports_itself_through_others() -> None:
    graph = {module: others - {"stiffgen"} for module, others in imports().items() if module != "stiffgen"}
    while leaves := [module for module, others in graph.items() if not others & set(graph)]:
        for module in leaves:
            del graph[module]
    assert not graph, f"a circle among {sorted(graph)}"


def needs(name: str) -> set[str]:
    """Return the folders that a family or adapter may import: its own, and those that the table names."""
    folders = {name.partition(".")[0]}
    for other in FAMILIES.get(name, ()):
        folders |= needs(other)
    return folders


def test_families_import_only_what_the_table_declares() -> None:
    """Check the imports between families against the table FAMILIES."""
    wrong = []
    for module, others in imports().items():
        if room(module) != "families" or module.count(".") < 3:
            continue
        _, _, folder, name = module.split(".")[:4]
        adapter = f"{folder}.{name.removeprefix('oracles_')}"
        allowed = needs(adapter if adapter in FAMILIES else folder)
        wrong += [
            f"{module} imports {other}"
            for other in others
            if room(other) == "families" and other.count(".") > 2 and other.split(".")[2] not in allowed
        ]
    assert not wrong


def test_every_family_is_registered() -> None:
    folders = {each.name for each in (PACKAGE / "families").iterdir() if (each / "__init__.py").exists()}
    assert folders == {name for name in FAMILIES if "." not in name} | set(WITHOUT_KERNELS)


def test_rooms_are_named_only_in_tables() -> None:
    """Look for modules named in text: only in tables, or in ``optional``, ``part`` and ``needed``."""
    calls = "optional|part|needed|is_there|_format|environment|files|map|import_module"
    called = re.compile(rf'(?:{calls})\([^"\n]*"[^"\n]*$')
    for module, file in modules().items():
        if module in TABLES:
            continue
        for found in re.finditer(rf'"(?:stiffgen\.)?(?:{"|".join(ROOMS)})\.[a-z_.]+"', file.read_text()):
            before = file.read_text()[: found.start()].rpartition("\n")[2]
            assert called.search(before + '"') or '"""' in before, f"{module}: {found[0]}"


DOTTED = re.compile(r"(?<![\w./-])stiffgen((?:\.[a-z]\w*)+(?:\.[A-Z]\w*)*)")


def is_there(name: str, known: Mapping[str, Path]) -> bool:
    """Return whether a dotted name is a module or folder of the package, or what a module has."""
    if name in known or (PACKAGE.parent / name.replace(".", "/")).is_dir():
        return True
    module, _, attribute = name.rpartition(".")
    return is_there(module, known) and (module not in known or hasattr(import_module(module), attribute))


def test_dotted_names_in_texts_exist() -> None:
    """Look up dotted names in docstrings, messages and pages: a moved module leaves none behind."""
    known = modules()
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), *PACKAGE.rglob("*.md")]
    wrong = [
        f"{file.relative_to(ROOT)}: stiffgen{found[1]}"
        for file in (*known.values(), *pages)
        for found in DOTTED.finditer(file.read_text())
        if not is_there(f"stiffgen{found[1]}", known) and ".loads." not in found[1]  # a page's example
    ]
    assert not wrong


def test_equations_that_programs_derive_have_their_number() -> None:
    """A program names the equation of docs/theory.md that it derives."""
    numbers = set(re.findall(r"\\qquad \((\d+)\) \$\$", (ROOT / "docs" / "theory.md").read_text()))
    texts = [file.read_text() for file in PACKAGE.rglob("*.py")]
    named = {number for text in texts for number in re.findall(r"theory\.md \((\d+)\)", text)}
    assert named == numbers == set("12345")


def test_commands_lie_in_cli_and_lab() -> None:
    assert {module.partition(".")[0] for module, _ in COMMANDS.values()} <= {"cli", "lab"}


def test_no_test_imports_a_test_and_each_lies_in_a_room() -> None:
    """Check imports and folders of the tests: shared code belongs to tests/support."""
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
        assert file.relative_to(tests).parts[0] in (*ROOMS, "house", "examples", "campaigns"), file


def test_a_conftest_imports_its_room_and_the_core_alone() -> None:
    """Check the imports of each conftest: its room and the core."""
    tests = ROOT / "tests"
    files = list(tests.rglob("conftest.py"))
    named = re.compile(rf"^ *(?:from|import) stiffgen\.({'|'.join(ROOMS)})\b", re.MULTILINE)
    assert len(files) > 5
    for file in files:
        assert {*named.findall(file.read_text())} <= {"core", file.relative_to(tests).parts[0]}, file


def test_only_tests_of_examples_import_examples() -> None:
    """Every other test says what the package does by itself."""
    text = re.compile(r"^ *(?:from|import) examples\b", re.MULTILINE)
    found = [file for file in (ROOT / "tests").rglob("*.py") if text.search(file.read_text())]
    assert {file.parent for file in found} == {ROOT / "tests" / "examples"}


@pytest.mark.slow
@pytest.mark.parametrize("line", ["from stiffgen.lab import style", "import stiffgen.cli.console"])
def test_a_wrong_import_is_seen(line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Put a forbidden import into a module: the test of the walls must fail."""
    file = tmp_path / "chain.py"
    file.write_text(f"{line}\n")
    wrong = modules() | {"stiffgen.core.robot.chain": file}
    monkeypatch.setitem(globals(), "modules", lambda: wrong)
    with pytest.raises(AssertionError, match=r"core\.robot\.chain imports"):
        test_imports_run_towards_the_core()
