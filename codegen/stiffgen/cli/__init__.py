# SPDX-License-Identifier: MIT
"""The command line ``stiffgen``: its commands, its exit codes, signals and closed streams.

Exit code 0: done; 1: a check failed, or a recording has no usable row; 2: refused input or usage, or unwritable
output; 3: ``prove`` leaves a claim undecided. A refusal is one message on standard error.
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import stiffgen
from stiffgen.cli.completion import SHELLS, Completion
from stiffgen.cli.parsing import CommandParser, Parser
from stiffgen.core.errors import DescriptionWarning, StiffgenError, printable, terminal_text
from stiffgen.rooms import is_there

COMMANDS = {
    "generate": ("cli.generate", "generate C code and a Python module for a robot"),
    "new": ("lab.new.command", "write a project: a 1 kHz loop, a simulated robot, a test, a script"),
    "inspect": ("cli.inspect", "show joints, chains and problems of a robot's file; list the robots that can be named"),
    "verify": ("cli.verify", "verify a robot's compiled functions against independent references (7 joints: a minute)"),
    "prove": ("lab.prove.command", "prove contracts of a robot's C code for all inputs"),
    "play": ("lab.play.command", "write a robot's playground, a page for the browser, and open it"),
    "passport": ("lab.passport.command", "stiffness, force and damping that a robot's tip can render, as a page"),
    "analyze": ("lab.analyze.command", "joint stiffness along a recording, corrected and conventional"),
    "calibrate": ("lab.calibrate.command", "bias and payload of a force-torque sensor, from a recording"),
    "measure": ("lab.measure.command", "stiffness from a motion about a pose, and what is wrong with the sensor"),
}
"""Commands with the module that adds their arguments, and their help; those of rooms taken out are not listed."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    made = Parser(prog="stiffgen", description=stiffgen.__doc__)
    made.add_argument("--version", action="version", version=f"stiffgen {stiffgen.__version__}")
    shells = f"{', '.join(SHELLS[:-1])} or {SHELLS[-1]}"
    made.add_argument("--completion", action=Completion, help=f"print the script of completions for {shells}")
    commands = made.add_subparsers(metavar="COMMAND", parser_class=CommandParser)
    for name, (module, meaning) in COMMANDS.items():
        if is_there(module):
            commands.add_parser(name, help=meaning).module = module
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    try:
        with _stopped_by_signals():
            if sys.stdout is None:  # closed
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            code = _run(arguments)
            sys.stdout.flush()
            return code
    except StiffgenError as error:
        message, code = str(error), 2
    except KeyboardInterrupt:
        message, code = "interrupted", 130
    except _Terminated as error:
        message, code = f"ended by {signal.Signals(error.number).name}", 128 + error.number
    except MemoryError:
        message, code = "the memory that this process may use is not enough; allow more (ulimit -v)", 2
    except BrokenPipeError:  # a reader such as head has what it wants
        _discard_output()
        return 128 + signal.SIGPIPE
    except OSError as error:
        where = "standard output" if error.filename is None else printable(str(error.filename), 200)
        message, code = f"{where}: {error.strerror or error}", 2
        _discard_output()
    with suppress(OSError):
        print(f"stiffgen: {terminal_text(message)}", file=sys.stderr, flush=True)
    return code


def _run(arguments: Sequence[str] | None) -> int:
    """Parse the arguments and run the command; without one print the help. Return the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of any script, terminals of any encoding
    try:
        program = parser()
        options = program.parse_args(arguments)
        if "run" not in options:
            program.print_help(sys.stdout)
            return 0
    except SystemExit:
        sys.stdout.flush()  # after --help and --version
        raise
    with warnings.catch_warnings():
        warnings.simplefilter("always", DescriptionWarning)
        warnings.showwarning = _show_warning
        return int(options.run(options))


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning in one line, in place of warnings.showwarning, whose signature this is."""
    print(f"stiffgen: warning: {terminal_text(str(message))}", file=sys.stderr)


class _Terminated(BaseException):
    """A signal that asks the process to end; passes through every block that cleans up."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """End the block by an exception at SIGTERM and SIGHUP, so that nothing half-written stays."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: object) -> None:
        raise _Terminated(number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = [(number, signal.getsignal(number)) for number in numbers]
    for number, handler in before:
        if handler is signal.SIG_DFL:  # nohup and whoever calls this from Python keep their own way
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before:
            if handler is not None:
                signal.signal(number, handler)


def _discard_output() -> None:
    """Python flushes standard output once more when it ends, and would say so if that fails."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        with Path(os.devnull).open("w") as nowhere, suppress(OSError):
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
