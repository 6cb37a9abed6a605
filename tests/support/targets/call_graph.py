# SPDX-License-Identifier: MIT
"""Deepest stack of a call path, from the call graphs that gcc writes (-fcallgraph-info=su)."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(?:\\n(\d+) bytes \((static|dynamic,bounded)\))?"')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


class _Compiling(Protocol):
    @property
    def compiler(self) -> Sequence[str]: ...


def compiled_object(machine: _Compiling, source: Path, work: Path) -> str:
    """Compile a source to an object in ``work``; return the text of its call graph, "" for clang, which writes none."""
    target = work / f"{source.stem}.o"
    graph = [] if "clang" in machine.compiler[0] else ["-fcallgraph-info=su"]
    flags = ["-O2", "-std=gnu99", f"-I{source.parent}", *graph, "-c", str(source), "-o", str(target)]
    subprocess.run([flag for flag in (*machine.compiler, *flags) if flag != "-static"], check=True, cwd=work)
    return target.with_suffix(".ci").read_text() if graph else ""


class CallGraph:
    """Frames [bytes] of functions, and calls between them, of several sources.

    Functions of libm and of the compiler's own library have no frame here: their stack comes on top.
    """

    def __init__(self) -> None:
        self.sizes: dict[str, int] = {}
        self.calls: dict[str, set[str]] = {}

    def add(self, text: str) -> None:
        """Add the graph of one source: the name of an internal function begins with the file's."""
        for title, size, _ in _NODE.findall(text):
            if size:
                self.sizes[title] = int(size)
        for caller, called in _EDGE.findall(text):
            self.calls.setdefault(caller, set()).add(called)

    def depth(self, function: str, above: tuple[str, ...] = ()) -> int:
        """Return the deepest stack below and with a function; ValueError for a recursion or a call by pointer."""
        if function in above or function == "__indirect_call":
            raise ValueError(f"no bound on the stack: {' calls '.join((*above, function))}")
        below = (self.depth(each, (*above, function)) for each in self.calls.get(function, ()))
        return self.sizes.get(function, 0) + max(below, default=0)
