# SPDX-License-Identifier: MIT
"""The option ``--completion SHELL``: a script that completes commands, options and files in a shell."""

from __future__ import annotations

import argparse
from typing import Any

from stiffgen.cli.parsing import CommandParser
from stiffgen.core.errors import MissingExtraError, install_command

SHELLS = ("bash", "zsh", "tcsh", "fish")


class Completion(argparse.Action):
    """Print the script of a shell, made by shtab from all commands, and end the program."""

    def __init__(self, option_strings: list[str], dest: str, help: str | None = None) -> None:
        super().__init__(option_strings, dest, choices=SHELLS, metavar="SHELL", default=argparse.SUPPRESS, help=help)

    def __call__(self, parser: argparse.ArgumentParser, namespace: object, values: Any, option: Any = None) -> None:
        """Print the script."""
        try:
            import shtab
        except ImportError as error:
            raise MissingExtraError(f"--completion needs shtab; {install_command('completion')}") from error
        for action in parser._actions:
            commands = action.choices if isinstance(action, argparse._SubParsersAction) else {}
            for command in commands.values():
                if isinstance(command, CommandParser):
                    command.complete()
        print(shtab.complete(parser, str(values)))
        parser.exit()
