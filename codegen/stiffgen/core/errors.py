# SPDX-License-Identifier: MIT
"""Refusals of stiffgen, and text that is safe in a message.

Every message names the thing at fault (file, element, option) and the remedy. The command line prints the
message alone and exits with code 2.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence

_WHOLE = 1000
"""Length up to which a name that the user copies from a message is whole."""


def printable(text: str, most: int = 60) -> str:
    """Return text of a file or a user for a message: no control characters, at most ``most`` characters."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[:most])
    return f"{shown}..." if len(text) > most else shown


def terminal_text(text: str) -> str:
    """Escape everything in a message that is neither printable nor the end of a line."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def whole(name: str) -> str:
    """Return a name for a message from which the user copies it: without control characters, and not cut."""
    return printable(name, _WHOLE)


def shell_word(name: str) -> str:
    """Return a name as a shell takes it for one word of a command."""
    return shlex.quote(whole(name))


def install_command(extra: str) -> str:
    """Return the command that installs an extra from where stiffgen itself came from.

    An index has no stiffgen yet. pip keeps the clone's folder, the wheel's file or the repository's address in the
    package's record, and nothing if an index was the source.
    """
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        origin = json.loads(distribution("stiffgen").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        origin = {}
    url, wanted = origin.get("url", ""), f"stiffgen[{extra}]"
    if "vcs_info" in origin:
        wanted += f" @ {origin['vcs_info']['vcs']}+{url}"
    elif url.startswith("file:"):
        wanted = f"{url2pathname(urlsplit(url).path)}[{extra}]"
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f"pip install {editable}{shell_word(wanted)}"


def listed(names: Sequence[str], most: int = 20) -> str:
    """Return the first names of a list, each whole, and how many more there are."""
    shown = ", ".join(whole(name) for name in names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def counted(number: int, one: str, many: str) -> str:
    """Return a number with the words for one thing, or for several: 1 joint has, 2 joints have."""
    return f"{number} {one if number == 1 else many}"


class StiffgenError(Exception):
    """Base of every refusal of stiffgen; ``str(error)`` is a sentence for the user."""

    def reword(self, change: Callable[[str], str]) -> None:
        """Change the words of the message."""
        self.args = (change(str(self)),)


class OptionError(StiffgenError, TypeError):
    """A caller from Python gave an unknown option, or a value of another type; also Python's error for both."""


class DescriptionError(StiffgenError):
    """The robot description (URDF file) cannot be used.

    ``problems`` holds every problem found, each a sentence; the message shows the first ones.
    """

    _SHOWN = 5

    def __init__(self, file: str, problems: Iterable[str]) -> None:
        self.file = file = printable(file, 200)
        self.problems = tuple(problems)
        super().__init__(self._message(self._SHOWN))

    def reword(self, change: Callable[[str], str]) -> None:
        """Change the words of the message and of each problem."""
        super().reword(change)
        self.problems = tuple(map(change, self.problems))

    @property
    def full(self) -> str:
        """Message with all problems."""
        return self._message(len(self.problems))

    def _message(self, most: int) -> str:
        """Return the message with the first ``most`` problems."""
        if len(self.problems) == 1:
            return f"{self.file}: {self.problems[0]}"
        left = len(self.problems) - most
        tail = f"\n  ({left} more; 'stiffgen inspect' lists them all)" if left > 0 else ""
        return f"{self.file}:" + "".join(f"\n  {p}" for p in self.problems[:most]) + tail


class DescriptionWarning(UserWarning):
    """The robot description has problems off the chain, which cannot affect it."""

    def __init__(self, file: str, problems: Iterable[str]) -> None:
        self.file = printable(file, 200)
        self.problems = tuple(problems)
        super().__init__(f"{self.file}: {self._text()}")

    def _text(self) -> str:
        first, left = self.problems[0], len(self.problems) - 1
        more = f" ({left} more; 'stiffgen inspect' lists them all)" if left else ""
        return f"without effect on this chain: {first}{more}"


class LoopWarning(DescriptionWarning):
    """The file has constraints that close loops; all functions are those of the tree."""

    def _text(self) -> str:
        left = counted(len(self.problems), "constraint that closes a loop is", "constraints that close loops are")
        return (
            f"{left} left out, and joints of a loop are independent of each other: {listed(self.problems, 4)}; "
            "--close-loops (in Python close_loops=True) closes them"
        )


class InertiaWarning(DescriptionWarning):
    """The user accepts inertias that no rigid body has."""

    def _text(self) -> str:
        return f"accepted although no rigid body has it: {'; '.join(self.problems)}"


class LimitWarning(DescriptionWarning):
    """The position limits of joints that follow a coordinate exclude each other, and none of them is used."""

    def _text(self) -> str:
        return "; ".join(self.problems)


class OmissionWarning(DescriptionWarning):
    """The file's model has forces at rest that no function contains."""

    def __init__(self, file: str, forces: Mapping[str, float]) -> None:
        self._most = max(forces.values())
        super().__init__(file, forces)

    def _text(self) -> str:
        return (
            f"springs, tendons or gravity compensation of the model push joints {listed(self.problems, 8)} at rest "
            f"(up to {self._most:.3g} N m or N); no function contains these forces, nor do gravity and bias forces "
            "('stiffgen inspect' lists them)"
        )


class ChainError(StiffgenError):
    """The description is sound, but the requested chain does not exist or cannot be used."""


class PotentialError(StiffgenError):
    """A spring or a user's potential is refused."""


class OutputError(StiffgenError):
    """A folder cannot be written, or holds something that stiffgen did not write."""


class BuildError(StiffgenError):
    """The generated C did not compile; the message ends with the compiler's last lines."""


class NoCompilerError(BuildError):
    """No compiler is installed; the message names the package."""


class RecordingError(StiffgenError):
    """A recording cannot be read: its format, its columns or the requested analysis is wrong."""


class EmptyRecordingError(RecordingError):
    """A recording holds no row that can be analysed."""


class MissingExtraError(StiffgenError):
    """A package is not installed; the message names the extra of stiffgen that installs it."""
