# SPDX-License-Identifier: MIT
"""C libraries: files that compile by themselves, on a stub robot, and of which generated files contain the text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_FUNCTIONS = "/* ---- functions, by file ---- */"
_DEFINITION = re.compile(r"^(?=(?!static\b)(?:const )?\w+ \*?\w+\()", re.MULTILINE)
_OWN_DEFINITION = re.compile(r"^(?=(?!static\b)(?:const )?\w+ \*?(?!CALL\()\w+\()", re.MULTILINE)


@dataclass(frozen=True)
class Library:
    """Files that become part of one generated file.

    Attributes:
        folder: folder of the files.
        header: name of their header: types and constants, then the declarations of functions and of the robot's tables.
        sources: files in the order in which the generated file contains them: no function is used before its file.
        inline: whether the generated file is a header, in which all functions are static and inline.

    """

    folder: Path
    header: str
    sources: tuple[str, ...]
    inline: bool = False

    def interface(self, name: str) -> str:
        """Return types and constants of the header for a robot's name."""
        text = self._text(self.header)
        guard = self.header.replace(".", "_").upper()
        note, _, rest = text.partition(f"#ifndef {guard}\n")
        body = rest.partition(_FUNCTIONS)[0].rpartition("\n#include ")[2].partition("\n")[2]
        return note + whole_names(body.strip("\n"), name) + "\n"

    def functions(self, name: str, sources: tuple[str, ...] = ()) -> str:
        """Return the functions of some or all sources for a robot's name: static, unless their name is the robot's."""
        texts = [self._text(source).replace(f'#include "{self.header}"\n', "") for source in sources or self.sources]
        pattern, words = (_DEFINITION, "static inline ") if self.inline else (_OWN_DEFINITION, "static ")
        return whole_names(pattern.sub(words, "\n".join(texts)), name)

    def _text(self, file: str) -> str:
        return (self.folder / file).read_text(encoding="utf-8")


def whole_names(text: str, name: str) -> str:
    """Write a robot's names in full, for whoever searches them: ID(OK) becomes IIWA14_OK, CALL(step) iiwa14_step."""
    text = re.sub(r"\bID\((\w+)\)", rf"{name.upper()}_\1", text)
    return re.sub(r"\bCALL\((\w+)\)", rf"{name}_\1", text)
