# SPDX-License-Identifier: MIT
"""C libraries: files that compile by themselves, on a stub robot, and of which generated files contain the text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_FUNCTIONS = "/* ---- functions, by file ---- */"
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_DEFINED = re.compile(r"^(?:static )?(?:const )?\w+ \*?(\w+)(?=\(| =)", re.MULTILINE)
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
        shared: library of which the generated file contains, before these files, what they use.

    """

    folder: Path
    header: str
    sources: tuple[str, ...]
    inline: bool = False
    shared: Library | None = None

    def interface(self, name: str, callers: str = "") -> str:
        """Return types and constants of the header for a robot's name. ``callers`` as for :meth:`functions`."""
        note, body = self._interface()
        used = self.shared.used_by(self._whole() + callers)[0] if self.shared else []
        return note + whole_names("\n".join((*used, body)), name) + "\n"

    def functions(self, name: str, sources: tuple[str, ...] = (), callers: str = "") -> str:
        """Return the functions of some or all sources for a robot's name: static, unless their name is the robot's.

        ``callers``: text of the generated file beside these sources that calls shared functions, too.
        """
        used = self.shared.used_by(self._whole() + callers)[1] if self.shared else []
        texts = ["\n\n".join(used) + "\n"] if used else []
        texts += [self._text(source).replace(f'#include "{self.header}"\n', "") for source in sources or self.sources]
        pattern, words = (_DEFINITION, "static inline ") if self.inline else (_OWN_DEFINITION, "static ")
        return whole_names(pattern.sub(words, "\n".join(texts)), name)

    def used_by(self, text: str) -> tuple[list[str], list[str]]:
        """Return the paragraphs of the header and of the sources whose definitions a text uses, or that those use."""
        header = self._interface()[1].split("\n\n")
        paragraphs = [each.strip("\n") for source in self.sources for each in self._text(source).split("\n\n")]
        names = {each: _DEFINED.findall(each) for each in (*header, *paragraphs)}
        used: list[str] = []
        while True:
            words = set(re.findall(r"\w+", _COMMENT.sub("", "\n".join((text, *used)))))
            new = [each for each in names if each not in used and words.intersection(names[each])]
            if not new:
                return [each for each in header if each in used], [each for each in paragraphs if each in used]
            used += new

    def _interface(self) -> tuple[str, str]:
        """Return the note above the header's guard, and its text from the includes up to the functions."""
        guard = self.header.replace(".", "_").upper()
        note, _, rest = self._text(self.header).partition(f"#ifndef {guard}\n")
        return note, rest.partition(_FUNCTIONS)[0].rpartition("\n#include ")[2].partition("\n")[2].strip("\n")

    def _whole(self) -> str:
        return "\n".join(map(self._text, (self.header, *self.sources)))

    def _text(self, file: str) -> str:
        return (self.folder / file).read_text(encoding="utf-8")


def whole_names(text: str, name: str) -> str:
    """Write a robot's names in full, for whoever searches them: ID(OK) becomes IIWA14_OK, CALL(step) iiwa14_step."""
    text = re.sub(r"\bID\((\w+)\)", rf"{name.upper()}_\1", text)
    return re.sub(r"\bCALL\((\w+)\)", rf"{name}_\1", text)
