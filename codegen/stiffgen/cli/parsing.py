# SPDX-License-Identifier: MIT
"""Parsers whose options may appear once, and whose commands are imported when they are chosen."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from stiffgen.cli.memory import check_memory
from stiffgen.cli.replaced import refusal
from stiffgen.cli.waiting import waiting
from stiffgen.core.errors import StiffgenError

_ASSIGNMENT = re.compile(r"(\w+):=(.*)", re.DOTALL)


class Once(argparse.Action):
    """Store a value, and refuse the option's second appearance, which would silently replace the first."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        """Store the value."""
        seen = namespace.__dict__.setdefault("_seen", set())
        if option is not None and self.dest in seen:
            parser.error(f"{option} is given twice; leave one of them out")
        seen.add(self.dest)
        setattr(namespace, self.dest, values)


class OnceTrue(Once):
    """Store True, and refuse the option's second appearance."""

    value = True

    def __init__(self, option_strings: Sequence[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, nargs=0, default=not self.value, help=help)

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: object, option: str | None = None
    ) -> None:
        """Store the value."""
        super().__call__(parser, namespace, self.value, option)


class OnceFalse(OnceTrue):
    """Store False, and refuse the option's second appearance."""

    value = False


class Parser(argparse.ArgumentParser):
    """A parser whose options may appear once, unless they collect values.

    ``takes_arguments`` tells whether words NAME:=VALUE, anywhere on the command line, are arguments of a template.
    """

    takes_arguments = False

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("action", None, Once)
        self.register("action", "store_true", OnceTrue)
        self.register("action", "store_false", OnceFalse)

    def parse_known_args(  # type: ignore[override]  # argparse's overloads serve namespaces of other types
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse a command line; take the arguments of a template out of it first, wherever they stand."""
        words = list(sys.argv[1:] if args is None else args)
        if not self.takes_arguments:
            return super().parse_known_args(words, namespace)
        found = [(match[1], match[2]) for match in map(_ASSIGNMENT.fullmatch, words) if match]
        names = [name for name, _ in found]
        for name in names:
            if names.count(name) > 1:
                self.error(f"argument {name} of the template is given twice; leave one of them out")
        rest = [word for word in words if not _ASSIGNMENT.fullmatch(word)]
        options, unknown = super().parse_known_args(rest, namespace)
        options.arguments = dict(found)
        if "robot" in options and (options.urdf is None) == (options.robot is None):
            self.error("give a robot's FILE or --robot NAME, one of the two")
        return options, unknown

    def _print_message(self, message: str, file: Any = None) -> None:
        if message:  # argparse would hide that it cannot be written
            (file or sys.stderr).write(message)


class CommandParser(Parser):
    """Parser of a command, whose ``module`` of the package adds the arguments when the command is chosen.

    Importing all modules at once would take most of a second, and more memory than ``inspect`` needs.
    """

    module = ""
    _is_complete = False

    def complete(self) -> None:
        """Add the command's arguments on first use."""
        if not self._is_complete:
            self._is_complete = True
            check_memory()
            try:
                with waiting(f"{self.prog}: loading packages"):
                    module = import_module(f"stiffgen.{self.module}")
            except ModuleNotFoundError as error:
                if not str(error.name).startswith("stiffgen."):
                    raise
                raise StiffgenError(
                    f"{self.prog.split()[-1]}: needs {str(error.name).removeprefix('stiffgen.')}, which has been taken "
                    "out of this stiffgen; install stiffgen whole"
                ) from error
            module.add(self)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Add the command's arguments on first use, then parse; refuse what it does not take in the command's name."""
        self.complete()
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(refusal(self.prog.split()[-1], unknown))
        return options, unknown
