# SPDX-License-Identifier: MIT
"""Check the C libraries of which generated files contain the text: each file compiles by itself, and tools open it."""

from __future__ import annotations

import os
import re
import subprocess
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stiffgen.core.library import Library
from support.project import require_compiler

_FUNCTION = re.compile(r"^(?:static )?(?:const )?\w+ \*?(\w+)\([^;{]*\)\n\{", re.MULTILINE)
_PUBLIC = re.compile(r"^(?!static )\w[\w *]*?\b(\w+)\([^;{}]*\)\n\{", re.MULTILINE)
_HEADERS = {"C_INCLUDE_PATH": os.pathsep.join((sysconfig.get_path("include"), np.get_include()))}
"""Where tools find Python and NumPy, whose place no file of flags can know."""

_CHECKS = "--checks=clang-diagnostic-*,clang-analyzer-*,-clang-analyzer-optin.*,-clang-analyzer-security.ArrayBound"
"""Checks of every release: new ones also look at the layout of the robot's structs, and take sizes for unbounded."""
_DEPTH = ("-Xclang", "-analyzer-config", "-Xclang", "max-nodes=80000")
"""States that the analyzer visits in a function, of 225 000: finds the same seeded faults in a third of the time."""


def text_of(library: Library, file: str) -> str:
    return (library.folder / file).read_text()


def check_compiles(library: Library, compiler: str, folder: Path) -> None:
    """Compile each file with the flags of compile_flags.txt."""
    require_compiler(compiler)
    flags = text_of(library, "compile_flags.txt").split()
    for source in library.sources:
        made = (
            ["-fsyntax-only"] if compiler == "clang" else ["-O2", "-o", str(folder / "x.o")]
        )  # gcc warns as it optimises
        command = [compiler, *flags, "-Werror", *made, "-c", source]
        subprocess.run(command, check=True, cwd=library.folder, env=os.environ | _HEADERS)


def check_tool(library: Library, tool: str) -> None:
    """Fail for a diagnostic of clang-tidy or clangd, which read compile_flags.txt."""
    assert {path.name for path in library.folder.glob("*.c")} == set(library.sources)
    for source in library.sources:
        words = [
            "clang-tidy",
            "--quiet",
            _CHECKS,
            "--warnings-as-errors=*",
            *(f"--extra-arg={each}" for each in _DEPTH),
        ]
        command = [*words, source] if tool == "clang-tidy" else []
        command = command or ["clangd", f"--check={source}", "--log=error", "--tweaks=ExpandMacro"]  # tries no other
        done = subprocess.run(
            command, cwd=library.folder, capture_output=True, text=True, check=False, env=os.environ | _HEADERS
        )
        assert done.returncode == 0, done.stdout + done.stderr


def check_contained(library: Library, generated: str) -> None:
    """Find every function in a generated file, static, and in the order of the sources."""
    names = [name for source in library.sources for name in _FUNCTION.findall(text_of(library, source))]
    assert [name for name in _FUNCTION.findall(generated) if name in names] == names
    assert len(names) == len(set(names))
    for name in names:
        assert re.search(rf"^static (?:const )?\w+ \*?{name}\(", generated, re.MULTILINE), name


def check_order(library: Library, least: int) -> None:
    """Fail for a file that calls a function of one behind it: there is no circle. At least so many are public."""
    texts = {name: re.sub(r"/\*.*?\*/", "", text_of(library, name), flags=re.DOTALL) for name in library.sources}
    homes = {function: name for name, text in texts.items() for function in _PUBLIC.findall(text)}
    assert len(homes) >= least
    for place, name in enumerate(library.sources):
        called = {home for function, home in homes.items() if re.search(rf"\b{function}\(", texts[name])}
        assert called <= set(library.sources[: place + 1]), name


def check_sizes(library: Library) -> None:
    """Fail for functions of over 60 lines, files of over 500, long lines, and a conditional nested in another."""
    for file in (library.header, *library.sources):
        text = text_of(library, file)
        assert text.count("\n") <= 500
        assert [line for line in text.splitlines() if len(line) > 120] == []
        assert list(_long_or_nested(text)) == [], file


def _long_or_nested(text: str) -> Iterator[str]:
    for function in re.findall(r"^\w[^;{}#]*\)\n\{\n.*?^\}", text, re.MULTILINE | re.DOTALL):
        if function.count("\n") > 60:
            yield function.splitlines()[0]
    for statement in re.split(r"[;{}]", re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)):
        if re.search(r"\?[^()]*:[^(),]*\?", statement):
            yield statement
