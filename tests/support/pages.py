# SPDX-License-Identifier: MIT
"""Read the pages of the documentation and their blocks of code.

Every block is fenced and says its language. A comment of HTML before a block can say why no test of pages runs it:

    <!-- held by tests/FILE.py::TEST -->       that test does
    <!-- quoted from FILE -->                  it is a part of that file
    <!-- edit FILE after TEXT -->              an edit of a recipe (CONTRIBUTING.md): the line with TEXT is unique;
    <!-- edit FILE at the end -->              tests/house/test_contributing.py makes it in a copy
    <!-- not run: REASON -->                   nobody does

and one that begins with a language has code that is run with the page's but not shown: what a reader has at hand, and
what is to come out. `<!-- unseen python -->` takes the next cell of tests/house/unseen/PAGE.txt, where cells
end at `# ---`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from support.project import ROOT

PAGES = (
    *(
        ROOT / page
        for page in ("README.md", "CONTRIBUTING.md", "codegen/stiffgen/core/emit/README.md", "urdf/README.md")
    ),
    *sorted((ROOT / "docs").glob("*.md")),
)
_PARTS = re.compile(
    r"^<!-- (?P<marker>held by|quoted from|edit|not run:) (?P<what>[^\n]*) -->$"
    r"|^<!-- (?P<unseen>python|cpp|c)\n(?P<given>.*?)^-->$"
    r"|^<!-- unseen (?P<kept>python) -->$"
    r"|^(?P<indent> *)```(?P<language>[^\n]*)\n(?P<code>.*?)^(?P=indent)```$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """Block of code, its place, and the marker in the comment before it."""

    page: Path
    line: int
    language: str
    code: str
    shown: bool = True
    prints: bool = False
    """Whether the block follows the word "prints": it is the standard output of the blocks before it."""
    marker: str = ""
    """``held by``, ``quoted from``, ``edit`` or ``not run:``; empty where the page's own test runs it."""
    what: str = ""
    """The test, the file, or the reason."""

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page in their order."""
    text = page.read_text()
    found: list[Block] = []
    cells = iter(_cells(page))
    marker, what = "", ""
    for part in _PARTS.finditer(text):
        line = text.count("\n", 0, part.start()) + 1
        if part["marker"]:
            marker, what = part["marker"], part["what"]
            following = text[part.end() :].lstrip("\n")
            assert re.match(" *```", following), f"{page}:{line}: a marker stands before a block"
        elif part["kept"]:
            found.append(Block(page, line, part["kept"], next(cells), shown=False))
        elif part["unseen"]:
            found.append(Block(page, line, part["unseen"], part["given"], shown=False))
        else:
            code = re.sub(f"^{part['indent']}", "", part["code"], flags=re.MULTILINE)
            prints = text[: part.start()].rstrip().endswith("prints")
            found.append(Block(page, line, part["language"], code, prints=prints, marker=marker, what=what))
            marker, what = "", ""
    assert next(cells, None) is None, f"{page}: a cell of unseen code without a comment"
    return found


def _cells(page: Path) -> list[str]:
    """Return the cells of unseen code of a page."""
    file = ROOT / "tests" / "house" / "unseen" / f"{page.stem}.txt"
    if not file.exists():
        return []
    return file.read_text().partition("# ---\n")[2].split("# ---\n")


def commands(block: Block) -> list[str]:
    """Return the lines of a block of commands, without their comments."""
    lines = (re.sub(r"\s+# .*$", "", line).strip() for line in block.code.splitlines())
    return [line for line in lines if line]
