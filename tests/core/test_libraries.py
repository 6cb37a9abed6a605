# SPDX-License-Identifier: MIT
"""C of the Python module and of the wrappers: each file compiles by itself, and tools open it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from stiffgen.core.emit.c.backend import SENSOR
from stiffgen.core.emit.casadi.backend import CALLS
from stiffgen.core.emit.python.backend import MODULE
from support.c_library import check_compiles, check_contained, check_order, check_sizes, check_tool
from support.project import ROOT

LIBRARIES = {"module": MODULE, "wrappers": CALLS, "sensor": SENSOR}


@pytest.mark.parametrize("which", LIBRARIES)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_every_file_compiles_by_itself(compiler: str, which: str, tmp_path: Path) -> None:
    check_compiles(LIBRARIES[which], compiler, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("which", LIBRARIES)
@pytest.mark.parametrize("tool", ["clang-tidy", pytest.param("clangd", marks=pytest.mark.wide)])
def test_editors_open_every_file(tool: str, which: str) -> None:
    if shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    check_tool(LIBRARIES[which], tool)


def test_the_generated_module_contains_the_library() -> None:
    check_contained(MODULE, (ROOT / "generated" / "iiwa14" / "python" / "iiwa14_python.c").read_text())


@pytest.mark.parametrize(("which", "public"), [("module", 12), ("wrappers", 0), ("sensor", 0)])
def test_no_file_calls_one_behind_it(which: str, public: int) -> None:
    check_order(LIBRARIES[which], public)


@pytest.mark.parametrize("which", LIBRARIES)
def test_functions_fit_on_a_page(which: str) -> None:
    check_sizes(LIBRARIES[which])
