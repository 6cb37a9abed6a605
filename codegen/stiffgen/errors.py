"""What stiffgen refuses, and how it says so.

Every message names the thing at fault (file, element, option) and the remedy. The command line prints the
message alone and exits with code 2.
"""

from __future__ import annotations

from collections.abc import Iterable


class StiffgenError(Exception):
    """Base of every refusal of stiffgen; ``str(error)`` is a sentence for the user."""


class DescriptionError(StiffgenError):
    """The robot description (URDF file) cannot be used.

    ``problems`` holds every problem found, each a sentence; the message shows the first ones.
    """

    _SHOWN = 5

    def __init__(self, file: str, problems: Iterable[str]) -> None:
        self.file = file
        self.problems = tuple(problems)
        shown = self.problems[: self._SHOWN]
        left = len(self.problems) - len(shown)
        tail = f"\n  ({left} more; 'stiffgen inspect' lists them all)" if left else ""
        if len(self.problems) == 1:
            super().__init__(f"{file}: {self.problems[0]}")
        else:
            super().__init__(f"{file}:" + "".join(f"\n  {p}" for p in shown) + tail)


class ChainError(StiffgenError):
    """The description is sound, but the chain asked for does not exist or cannot be used."""


class OutputError(StiffgenError):
    """The folder to write cannot be written, or holds something that stiffgen did not write."""


class BuildError(StiffgenError):
    """The generated C did not compile; the message ends with the compiler's last lines."""
