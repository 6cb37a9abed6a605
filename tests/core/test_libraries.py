# SPDX-License-Identifier: MIT
"""C of the Python module and of the wrappers: each file compiles by itself, and tools open it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from stiffgen.core.emit.c.backend import SENSOR
from stiffgen.core.emit.casadi.backend import CALLS
from stiffgen.core.emit.python.backend import MODULE
from stiffgen.core.library import Library
from support.c_library import check_compiles, check_contained, check_order, check_sizes, check_tool
from support.project import ROOT

LIBRARIES = {"module": MODULE, "wrappers": CALLS, "sensor": SENSOR}


@pytest.mark.parametrize("which", LIBRARIES)
@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.wide)])
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


def test_a_library_takes_what_it_uses_of_a_shared_one(tmp_path: Path) -> None:
    """Take functions from a shared library: also what these use in turn; nothing for a word in a comment."""
    shared, own = tmp_path / "shared", tmp_path / "own"
    texts = {
        shared / "shared.h": "#ifndef SHARED_H\n#define SHARED_H\n\n#include <math.h>\n\n"
        "static const double FAR = 1.0;\n\nstatic const double NEAR = 2.0;\n\n"
        "/* ---- functions, by file ---- */\nint one(int x);\n#endif\n",
        shared / "shared.c": '/* One. */\n#include "shared.h"\n\nint one(int x) { return x; }\n\n'
        "static const int TWO = 2;\n\n/* Return twice. */\nint twice(int x)\n{\n    return TWO * one(x);\n}\n\n"
        "int far(int x) { return FAR > 0.0 ? x : 0; }\n",
        own / "own.h": '#ifndef OWN_H\n#define OWN_H\n\n#include "../shared/shared.h"\n\nenum { A = 1 };\n\n'
        "/* ---- functions, by file ---- */\n#endif\n",
        own / "own.c": '/* far is a word */\n#include "own.h"\n\nint four(void) { return twice(A); }\n',
    }
    for path, text in texts.items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    library = Library(own, "own.h", ("own.c",), shared=Library(shared, "shared.h", ("shared.c",)))
    text = library.functions("arm")
    assert all(each in text for each in ("static int one(", "TWO = 2", "static int twice(")) and "far(" not in text
    assert "FAR" not in library.interface("arm") and "A = 1" in library.interface("arm")
    assert "static int far(" in library.functions("arm", callers="far(1)")
    assert library.interface("arm", "far(1)").startswith("static const double FAR = 1.0;\n")
