# SPDX-License-Identifier: MIT
"""Output of the commands: consoles, tables, progress."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from stiffgen.errors import terminal_text


class TextConsole(Console):
    """A console on which a closed pipe is an error; rich itself would end the process with exit code 1."""

    def on_broken_pipe(self) -> None:
        """Let the error through."""
        raise


def messages(*, wide: bool = True) -> TextConsole:
    """Return the console of progress and messages, standard error; ``wide`` never breaks a line."""
    return TextConsole(stderr=True, highlight=False, soft_wrap=wide)


def tables() -> TextConsole:
    """Return standard output; wide enough for a whole table where no terminal sets a width."""
    console = TextConsole(highlight=False)
    return console if console.is_terminal else TextConsole(highlight=False, width=200)


def table(*columns: str, right: tuple[str, ...] = ()) -> Table:
    """Return an empty table; the columns in ``right`` are aligned to the right."""
    made = Table(show_edge=False, pad_edge=False)
    for column in columns:
        made.add_column(escape(column), justify="right" if column in right else "left")
    return made


def print_note(text: str) -> None:
    """Print a remark on standard error that changes nothing."""
    print(f"stiffgen: note: {terminal_text(text)}", file=sys.stderr)


class Progress:
    """Progress as a spinner on a terminal, as lines elsewhere."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = console.status("") if console.is_terminal else None

    def __call__(self, step: str) -> None:
        """Show the next step."""
        if self._status:
            self._status.update(escape(terminal_text(step)))
        else:
            self._console.print(f"{terminal_text(step)} ...", markup=False)

    @contextmanager
    def shown(self) -> Iterator[Progress]:
        """Show steps until the block ends."""
        if self._status:
            with self._status:
                yield self
        else:
            yield self
