# SPDX-License-Identifier: MIT
"""The generated C on other machines, in QEMU: golden values, and as many instructions for every input."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffgen
from campaigns.targets import filled, size_rows
from stiffgen.core.emit import render
from stiffgen.core.lower.scalar import FLOAT
from stiffgen.core.symbolic.kernels import chain_kernels
from support.golden_calls import golden_calls
from support.project import ROOT, URDF, assert_close, require_program
from support.targets import MACHINES, Footprint, built, counts, footprint, run, step_count
from support.targets.call_graph import CallGraph

OTHER = {machine.name: machine for machine in MACHINES if not machine.name.startswith("x86-64")}
BY_NAME = {machine.name: machine for machine in MACHINES}


def some(names: Iterable[str], *in_ci: str) -> list[Any]:
    """Return machines as parameters; those that CI does not run are wide."""
    return [pytest.param(name, marks=() if name in in_ci else pytest.mark.wide) for name in names]


def tools(machine):
    require_program(machine.compiler[0], machine.packages[0])
    require_program(machine.emulator[0], machine.packages[-1])
    return machine


@pytest.mark.slow
@pytest.mark.parametrize("name", some(OTHER, "aarch64", "Cortex-M7, FPU for double"))
def test_golden_values(name, robot_folder, chain, tmp_path):
    """Run the double-precision functions on other machines: golden values, up to rounding."""
    machine = tools(OTHER[name])
    calls = golden_calls(3)
    program = built(machine, robot_folder, chain, [(kernel, given) for kernel, given, _ in calls], tmp_path)
    results = run(machine, program)
    for (kernel, _, expected), found in zip(calls, results, strict=True):
        assert_close(found.reshape(kernel.result.array(chain).shape), expected)


@pytest.fixture(scope="module")
def floats(tmp_path_factory):
    return stiffgen.generate(URDF, output=tmp_path_factory.mktemp("floats"), name="arm", scalar="float", build=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", some(OTHER, "Cortex-M7, FPU for float"))
def test_golden_values_of_floats(name, floats, chain, tmp_path):
    """Run the single-precision functions on another machine: golden values within 2e-6 of the largest."""
    machine = tools(OTHER[name])
    calls = golden_calls(3)
    plain = [(kernel, given) for kernel, given, _ in calls]
    results = run(machine, built(machine, floats, chain, plain, tmp_path, scalar=FLOAT), FLOAT)
    for (_, _, expected), found in zip(calls, results, strict=True):
        assert found.dtype == np.float32
        assert 0 < np.abs(found - np.ravel(expected)).max() <= 2e-6 * np.abs(expected).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", some(["Cortex-M7, FPU for float", "aarch64", "x86-64 clang"], "Cortex-M7, FPU for float")
)
def test_the_same_instructions_for_every_float(name, floats, chain, tmp_path):
    """Count instructions on a single-precision FPU: constant for floats; doubles take ten to forty times as many."""
    machine = tools(BY_NAME[name])
    kernels = chain_kernels(chain)
    found = counts(machine, built(machine, floats, chain, [], tmp_path, kernels, 160, FLOAT), tmp_path)
    for kernel, count in zip(kernels, found, strict=True):
        assert count.states == 160
        assert 0 < count.fewest == count.most < 10_000, kernel.qualified_name


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    some(
        [name for name in BY_NAME if name != "Cortex-M7, FPU for float"],
        "x86-64 gcc",
        "Cortex-M7, FPU for double",
    ),
)
def test_the_same_instructions_for_every_input(name, robot_folder, chain, tmp_path):
    """Denormals, limits, zeros, and NaN, infinity and 1e300 in what is no angle. Software double precision branches."""
    machine = tools(BY_NAME[name])
    kernels = chain_kernels(chain)
    program = built(machine, robot_folder, chain, [], tmp_path, kernels, 160)
    found = counts(machine, program, tmp_path)
    assert len(found) == len(kernels)
    for kernel, count in zip(kernels, found, strict=True):
        assert count.states == 160
        assert 0 < count.fewest == count.most, kernel.qualified_name


@pytest.mark.slow
def test_a_branch_is_seen(robot_folder, chain, tmp_path):
    """Put a branch into a generated function: fewest and most instructions must differ."""
    machine = tools(BY_NAME["aarch64"])
    (kernel,) = (kernel for kernel in chain_kernels(chain) if kernel.qualified_name == "spring_wrench")
    folder = tmp_path / "iiwa14"
    folder.mkdir()
    source = (robot_folder / "iiwa14.c").read_text()
    guarded = re.search(r"static double finite_or_nan\(double x\)\n\{\n", source)
    assert guarded is not None
    branch = '    if (x > 0.5) {\n        __asm__ volatile("nop");\n    }\n'
    (folder / "iiwa14.c").write_text(source[: guarded.end()] + branch + source[guarded.end() :])
    for header in ("iiwa14.h", "iiwa14_lanes.h"):
        (folder / header).write_text((robot_folder / header).read_text())
    (count,) = counts(machine, built(machine, folder, chain, [], tmp_path, [kernel], 80), tmp_path)
    assert count.fewest < count.most


@pytest.mark.slow
def test_the_step_is_bounded_and_small(robot_folder, tmp_path):
    """Count instructions and sizes of one controller step: 200 000 instructions and 16 KB of stack are the bounds."""
    machine = tools(BY_NAME["aarch64"])
    count = step_count(machine, robot_folder, tmp_path, 400)
    assert count.states == 400
    assert 0 < count.fewest < count.most < 200_000
    longest = step_count(machine, robot_folder, tmp_path, 40, longest=True)
    assert count.most < longest.most < 200_000
    size = footprint(machine, robot_folder, tmp_path)
    assert 0 < size.stack < 16384 and size.flash < 200_000 and size.ram < 1000


LOOP = re.compile(r"\b(?:for \(([^;]*);([^;]*);([^)]*(?:\([^)]*\))?[^)]*)\)|while \(([^{]*)\) \{)")
COUNTED = re.compile(r"\w+ (?:<|<=|>=) [\w .*/+\->\[\]]+"), re.compile(r"\s*(?:\+\+\w+|--\w+|\w+ \+= \w+)")
"""Condition and step of a loop that counts to a size that does not change in it."""
OTHER_LOOPS = {
    # condition of the loop: why it ends
    "last < N - 1 && e[last] > negligible": "last grows up to N - 1",
    "words[k] != '\\0' && w->length + 1u < w->size": "length grows up to size",
    "place <= DECIMALS || left > 0": "left, at most 1e15, loses a digit each time",
    "round < ROUNDS": "round grows, and the step is halved beside it",
}


def test_every_loop_of_the_controller_has_a_bound():
    """Loops count up or down to a size, perhaps not all the way; the others are listed above, with what ends them."""
    library = Path(render.__file__).parents[2] / "control" / "core" / "library"
    seen = set()
    for file in library.glob("*.c"):
        for start, condition, step, during in LOOP.findall(file.read_text()):
            told = (condition or during).strip()
            counts_to = any(COUNTED[0].fullmatch(part) for part in told.split(" && "))
            if not (counts_to and COUNTED[1].fullmatch(step)):
                assert told in OTHER_LOOPS, f"for ({start}; {told}; {step})"
                seen.add(told)
        assert "do {" not in file.read_text()
    assert seen == set(OTHER_LOOPS)


def test_the_golden_values_are_those_of_the_file(golden):
    calls = golden_calls(1)
    assert len(calls) == 10
    np.testing.assert_array_equal(calls[0][1][0], golden[0].q)


@pytest.mark.slow
def test_the_page_states_memory_and_stack_of_a_cortex_m7(robot_folder, tmp_path):
    """Permanent memory with the self-check's constants, and the deepest path of a whole step: as measured."""
    found = footprint(tools(BY_NAME["Cortex-M7, FPU for double"]), robot_folder, tmp_path)
    table = (ROOT / "docs" / "guarantees.md").read_text().partition("FPU for float |")[2]
    rows = {
        line.split("|")[1].strip(): line.split("|")[5].strip() for line in table.splitlines() if line.count("|") == 7
    }
    assert int(rows["RAM that stays [bytes]"]) == found.ram > 0
    assert int(rows["stack of the step as a whole [bytes]"]) == pytest.approx(found.step_stack, rel=0.05)
    assert int(rows["deepest stack of a function [bytes]"]) == pytest.approx(found.stack, rel=0.05)
    assert found.step_stack > 3000
    assert int(rows["RAM that stays, controller, in addition [bytes]"]) == found.controller_ram > 0
    flash = 1000 * int(rows["flash of the controller, in addition [kB]"])
    assert flash == pytest.approx(found.controller_flash, rel=0.05)
    for name in ("impedance_init", "impedance_self_check"):
        stated = int(rows[f"stack of `{name}` [bytes]"])
        assert stated == pytest.approx(found.controller_stacks[name], rel=0.05), name
    unstated = {name for name in found.controller_stacks if f"stack of `{name}` [bytes]" not in rows}
    assert all(found.controller_stacks[name] <= found.step_stack for name in unstated)


def test_the_campaign_makes_the_pages_numbers():
    """Compare the page's rows with the campaign's; filling replaces only the cells of its machines."""
    footprints = [Footprint(1, 2, 3, 4, 5000, 6, {"impedance_init": 8, "impedance_self_check": 9})]
    made = size_rows(footprints)
    page = (ROOT / "docs" / "guarantees.md").read_text()
    names = re.findall(r"^\| ([^|]*\[(?:kB|bytes)\]) \|", page, re.MULTILINE)
    assert len(names) > 10 and set(names) <= set(made)
    table = "| | one | other |\n| --- | ---: | ---: |\n| RAM that stays [bytes] | 5 | 5 |\n| else | 5 | 5 |\n"
    assert filled(table, ["other"], made) == table.replace("[bytes] | 5 | 5 |", "[bytes] | 5 | 2 |")
    assert filled(table, ["third"], made) == table


def test_the_deepest_path_of_calls_is_found(tmp_path):
    """Find the deepest stack of three functions, two of them on its path; a recursion has no bound."""
    graph = CallGraph()
    frame = 'node: {{ title: "{0}" label: "{0}\\nx.c:1:2\\n{1} bytes (static)" }}\n'
    call = 'edge: {{ sourcename: "{0}" targetname: "{1}" label: "x.c:1:2" }}\n'
    frames = [frame.format(name, size) for name, size in (("f", 10), ("x.c:g", 200), ("h", 30))]
    graph.add("".join([*frames, call.format("f", "x.c:g"), call.format("f", "h"), call.format("h", "sin")]))
    assert graph.depth("f") == 210
    graph.add(call.format("x.c:g", "f"))
    with pytest.raises(ValueError, match="no bound on the stack: f calls"):
        graph.depth("f")
