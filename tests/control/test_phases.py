# SPDX-License-Identifier: MIT
"""Phases of the controller's C: who writes which record, by clang's syntax tree; sizes of its functions."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.project import ROOT, require_program

GOLDEN = ROOT / "generated" / "iiwa14"
PURSE = ("tank", "supplied", "springs", "zones", "history", "gap", "gap_change", "gap_total", "gap_torque", "hold")
"""Members of the account that its functions alone write; torque_t has a hold of its own."""
ASSEMBLY = (
    "note", "end_fault", "settle", "follow_command", "take_sample", "take_input", "step_with_sample",
    "step_without_sample", "add_offset", "may_use", "do_step", "step", "step_without_memory",
    "initialise", "request_reset", "prepare_check",
)  # fmt: skip
"""Functions of step.c and init.c that put the phases' results into the memory, and the start of the self-check."""
SMALL, MOST_BRANCHES = 30, 12
"""Lines of nine functions of ten, and branches of any."""

Node = dict[str, Any]


def parse(source: Path) -> Node:
    """Return clang's syntax tree of a C file."""
    require_program("clang", "clang")
    command = ["clang", "-std=c99", "-fsyntax-only", "-Xclang", "-ast-dump=json", f"-I{source.parent}", str(source)]
    tree: Node = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return tree


def walk(node: Node) -> Iterator[Node]:
    yield node
    for child in node.get("inner", ()):
        yield from walk(child) if "kind" in child else ()


def functions_of(tree: Node) -> dict[str, Node]:
    """Return the static functions that a syntax tree defines, by name."""
    found = {}
    for node in tree["inner"]:
        defined = any(child["kind"] == "CompoundStmt" for child in node.get("inner", ()))
        if node["kind"] == "FunctionDecl" and defined and node.get("storageClass") == "static":
            found[node["name"]] = node
    assert len(found) > 100
    return found


@pytest.fixture(scope="module")
def functions() -> dict[str, Node]:
    """Functions of the golden controller."""
    return functions_of(parse(GOLDEN / "iiwa14_impedance.c"))


def changeable_records(function: Node) -> list[str]:
    """Return the parameters that point to a record which the function may change."""
    types = {each["name"]: each["type"]["qualType"] for each in function["inner"] if each["kind"] == "ParmVarDecl"}
    return [name for name, type_ in types.items() if re.fullmatch(r"\w+_t \*(const)?", type_)]


def members(node: Node) -> Iterator[tuple[str, str]]:
    """Yield member and type of the record for each member expression on the way to what an expression stores to."""
    while node["kind"] in ("MemberExpr", "ArraySubscriptExpr", "ImplicitCastExpr", "ParenExpr", "UnaryOperator"):
        inner = node["inner"][0]
        if node["kind"] == "MemberExpr":
            yield node["name"], inner["type"]["qualType"]
        node = inner


WRITING = {"memcpy", "memset", "memmove"}


def targets(function: Node) -> Iterator[Node]:
    """Yield what a function stores to: by assignments, increments, and as first arguments of memcpy and its like."""
    for node in walk(function):
        kind = node["kind"]
        assigns = kind == "CompoundAssignOperator" or (kind == "BinaryOperator" and node["opcode"] == "=")
        if assigns or (kind == "UnaryOperator" and node["opcode"] in ("++", "--")):
            yield node["inner"][0]
        elif kind == "CallExpr":
            callee = next((each for each in walk(node["inner"][0]) if each["kind"] == "DeclRefExpr"), None)
            if callee and callee["referencedDecl"]["name"] in WRITING:
                yield node["inner"][1]


def writers_of_the_purse(functions: dict[str, Node]) -> set[str]:
    """Return the functions that write a member of an account, or an account as a whole."""
    found = set()
    for name, function in functions.items():
        for target in targets(function):
            for member, record in members(target):
                if (member in PURSE and "account" in record) or member == "account":
                    found.add(name)
    return found


def test_account_functions_alone_write_the_purse(functions: dict[str, Node]) -> None:
    writers = writers_of_the_purse(functions)
    assert {"account_pay", "account_interval", "account_move", "account_time"} <= writers
    assert {name for name in writers if not name.startswith("account_")} == set()


def test_functions_change_their_result_alone(functions: dict[str, Node]) -> None:
    """A phase takes records that are const, and at most one pointer to a record: its result."""
    many = {name: changeable_records(each) for name, each in functions.items() if name not in ASSEMBLY}
    assert sum(map(len, many.values())) > 20
    assert {name: records for name, records in many.items() if len(records) > 1} == {}
    changing = {name for name, each in functions.items() if "memory_t *" in map(str.strip, types_of(each))}
    assert changing - set(ASSEMBLY) == set()


def types_of(function: Node) -> list[str]:
    return [each["type"]["qualType"] for each in function["inner"] if each["kind"] == "ParmVarDecl"]


BRANCHING = ("IfStmt", "ForStmt", "WhileStmt", "ConditionalOperator", "CaseStmt")


def branches(function: Node) -> int:
    """Return the number of branches: statements, and operators that may leave out an operand."""
    logical = sum(node["kind"] == "BinaryOperator" and node["opcode"] in ("&&", "||") for node in walk(function))
    return logical + sum(node["kind"] in BRANCHING for node in walk(function))


def lines(function: Node) -> int:
    span = function["range"]
    end = span["end"].get("line", span["end"].get("expansionLoc", {}).get("line", 0))
    begin = function["loc"].get("line", end)
    return int(end) - int(begin) + 1


TABLES = ("check_fields", "fits_memory", "report_memory", "meaning_of_reason", "seen_of_reason", "meaning_of_refusal")
"""Functions that a table of fields or words expands to."""


def test_functions_are_small(functions: dict[str, Node]) -> None:
    own = {name: each for name, each in functions.items() if name not in TABLES}
    lengths = sorted(lines(each) for each in own.values())
    assert lengths[len(lengths) * 9 // 10] < SMALL
    assert {name: branches(each) for name, each in own.items() if branches(each) > MOST_BRANCHES} == {}


def test_a_phase_that_writes_the_purse_is_seen(tmp_path: Path) -> None:
    """Break the code: the guard takes from the tank, and the reference is moved by the law."""
    for file in GOLDEN.glob("*.h"):
        (tmp_path / file.name).write_text(file.read_text())
    text = (GOLDEN / "iiwa14_impedance.c").read_text()
    old = "static void guard(const memory_t *m, const law_t *w, torque_t *t)\n{\n"
    assert text.count(old) == 1
    broken = old.replace("const memory_t", "memory_t") + "    m->account.tank -= 1.0;\n"
    (tmp_path / "iiwa14_impedance.c").write_text(text.replace(old, broken))
    found = functions_of(parse(tmp_path / "iiwa14_impedance.c"))
    assert {name for name in writers_of_the_purse(found) if not name.startswith("account_")} == {"guard"}
    assert len(changeable_records(found["guard"])) == 2


def test_lines_of_core_and_makers() -> None:
    """At most 2 200 lines of C and 1 200, without the functions that both share."""
    control = ROOT / "codegen" / "stiffgen" / "control"
    makers = [file for folder in ("follow", "policy", "posture", "gains") for file in (control / folder).glob("*.[ch]")]
    for files, most in ((list((control / "core" / "library").glob("*.c")), 2200), (makers, 1200)):
        assert 0.8 * most < sum(len(file.read_text().splitlines()) for file in files) <= most
