# SPDX-License-Identifier: MIT
"""The command ``analyze``: joint stiffness along a recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from stiffgen.cli.console import TextConsole, messages
from stiffgen.cli.parsing import Once
from stiffgen.cli.records import add_option
from stiffgen.core.described import help_of
from stiffgen.core.errors import EmptyRecordingError, terminal_text
from stiffgen.lab.analyze.analysis import SUMMARY, checked_stiffness, read_stiffness, run_analysis
from stiffgen.lab.analyze.options import GROUPS, AnalysisOptions
from stiffgen.lab.analyze.report import TABLE_HEAD, statements, table_rows
from stiffgen.lab.analyze.report import warnings as recording_warnings


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments: fields of :class:`AnalysisOptions` are its options, the recording its argument."""
    groups = {"": command} | {title: command.add_argument_group(title, text) for title, text in GROUPS.items()}
    for option in fields(AnalysisOptions):
        described = help_of(option)
        if option.name == "log":
            command.add_argument("log", help=described.meaning, **(described.command or {}))
        elif described.command is not None:
            needed: dict[str, Any] = {"required": True} if option.default is MISSING else {}
            own = {"action": _Stiffness} if option.name == "task_stiffness" else {}
            add_option(groups[described.group], option, **needed, **own)
    command.set_defaults(run=run)


class _Stiffness(Once):
    """The task stiffness: six numbers or a file. A word behind them is the recording, which may stand last."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        """Store the words, and the recording behind them."""
        words = [str(word) for word in values] if isinstance(values, list) else [str(values)]
        if len(words) in (2, 7) and namespace.log is None:
            namespace.log = words.pop()
            for action in parser._actions:
                action.required = action.required and action.dest != "log"
        super().__call__(parser, namespace, words, option)


class _ProgressBar:
    """Progress bar on a terminal; elsewhere a line per step and per tenth."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            "{task.description}",
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._task = self._bar.add_task("", total=1.0)
        self._said = ("", -1)

    def __call__(self, step: str, done: float) -> None:
        """Show a step, and the fraction of it that is done."""
        if self._console.is_terminal:
            self._bar.update(self._task, description=escape(terminal_text(step)), completed=done)
            return
        now = (step, int(10 * done))
        if now != self._said:
            self._said = now
            self._console.print(f"{terminal_text(step)} ..." + (f" {10 * now[1]} %" if now[1] else ""), markup=False)

    @contextmanager
    def shown(self) -> Iterator[_ProgressBar]:
        """Show progress until the block ends."""
        with self._bar:
            yield self


def run(options: argparse.Namespace) -> int:
    """Analyse a recording; return 1 if it has no usable row."""
    # Six numbers, or one name of a file; anything else is refused with the reason.
    stiffness = options.task_stiffness
    K = read_stiffness(stiffness[0]) if len(stiffness) == 1 else checked_stiffness(stiffness)
    chosen = {each.name: getattr(options, each.name) for each in fields(AnalysisOptions) if each.name in options}
    with _ProgressBar(messages()).shown() as progress:
        try:
            analysis = run_analysis(AnalysisOptions(**chosen | {"task_stiffness": K, "progress": progress}))
        except EmptyRecordingError as error:
            print(f"stiffgen: {terminal_text(str(error))}", file=sys.stderr)
            return 1
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    shown = [k for k, column in enumerate(TABLE_HEAD) if column not in ("mean", "least at", "most at")]
    for column in (TABLE_HEAD[k] for k in shown):
        words = column in ("quantity", "unit")
        table.add_column(column, justify="left" if words else "right", no_wrap=column != "quantity")
    for row in table_rows(analysis.summary):
        table.add_row(*(escape(row[k]) for k in shown))
    console = TextConsole(highlight=False)
    (console if console.is_terminal else TextConsole(highlight=False, width=80)).print(table)
    print(terminal_text("\n".join(statements(analysis.recording, analysis.result, analysis.summary))))
    for line in recording_warnings(analysis.recording, analysis.result):
        print(f"stiffgen: warning: {terminal_text(line)}", file=sys.stderr)
    print(terminal_text(str(analysis.folder / ("report.html" if options.figures else SUMMARY))))
    return 0
