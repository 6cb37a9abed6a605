# SPDX-License-Identifier: MIT
"""Output of the commands: consoles, tables, progress."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from stiffgen.core.errors import terminal_text


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


def print_table(console: Console, shown: Table) -> None:
    """Print a table; where it is wider than the console, each row as lines that break no word.

    A column that is cut off or broken could not be copied into a command. A row's first cell is a line; the short cells
    follow in common lines, and each cell that is a list or has several lines has lines of its own.
    """
    if _natural_width(console, shown) <= console.width:
        console.print(shown)
        return
    first, *others = shown.columns
    for number, title in enumerate(first.cells):
        console.print(title, soft_wrap=True)
        cells = [(str(column.header), str(list(column.cells)[number])) for column in others]
        parts = [f"{header} {cell}" for header, cell in cells if cell and "\n" not in cell and ", " not in cell]
        lines = list(_joined(parts, console.width - 2))
        for header, cell in cells:
            for line in cell.splitlines() if "\n" in cell or ", " in cell else ():
                lines += _joined(f"{header}: {line}".split(", "), console.width - 2)
        for line in lines:
            console.print(f"  {line}", soft_wrap=True)


def _joined(parts: list[str], width: int) -> Iterator[str]:
    """Join parts by commas into lines of at most a width, as far as no part is longer."""
    line = ""
    for part in parts:
        longer = f"{line}, {part}" if line else part
        if line and len(longer) > width:
            yield f"{line},"
            longer = f"  {part}"
        line = longer
    if line:
        yield line


def _natural_width(console: Console, shown: Table) -> int:
    """Return the width of a table whose cells are not broken."""
    cells = [[column.header, *column.cells] for column in shown.columns]
    widths = [max(console.measure(cell).maximum for cell in column) for column in cells]
    return sum(widths) + 3 * (len(widths) - 1)


def print_note(text: str) -> None:
    """Print a remark on standard error that changes nothing."""
    print(f"stiffgen: note: {terminal_text(text)}", file=sys.stderr)


class Progress:
    """Progress as a spinner on a terminal, as lines elsewhere if ``lines``."""

    def __init__(self, console: Console, *, lines: bool = True) -> None:
        self._console, self._lines = console, lines
        self._status = console.status("") if console.is_terminal else None

    def __call__(self, step: str) -> None:
        """Show the next step."""
        if self._status:
            self._status.update(escape(terminal_text(step)))
        elif self._lines:
            self._console.print(f"{terminal_text(step)} ...", markup=False)

    @contextmanager
    def shown(self) -> Iterator[Progress]:
        """Show steps until the block ends."""
        if self._status:
            with self._status:
                yield self
        else:
            yield self
