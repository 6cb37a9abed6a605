# SPDX-License-Identifier: MIT
"""The command ``new``: a project of one's own around a robot."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path

from stiffgen.cli.arguments import add_reading, add_robot, add_tool, reading_of, source_of, tool_of
from stiffgen.cli.console import Progress, messages, print_note
from stiffgen.errors import StiffgenError
from stiffgen.new.project import new_project
from stiffgen.new.questions import CONTROLLERS, Answers, decide
from stiffgen.robot.description import Description
from stiffgen.symbolic.springs import KINDS


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_robot(command)
    add_reading(command)
    command.add_argument("--tip", metavar="LINK", help="link that touches things (needed where there are several)")
    command.add_argument("--base", metavar="LINK", help="first link of the chain (default: the root link)")
    command.add_argument("--controller", choices=list(CONTROLLERS), help="control law of the loop (default: impedance)")
    command.add_argument("--spring", choices=KINDS, help="spring of --controller spring (default: trace)")
    command.add_argument(
        "--no-masses", dest="masses", action="store_false", help="ignore masses; the simulation has rotors alone"
    )
    command.add_argument("--name", help="prefix of C names and name of the module (default: the robot's name)")
    command.add_argument(
        "--output", type=Path, metavar="DIR", help="folder to write (default: NAME_control; NAME_ros2)"
    )
    command.add_argument("--no-build", action="store_true", help="write the sources, compile nothing")
    add_tool(command, "mounted on the tip link (default: none)")
    command.set_defaults(run=run, tool=None)


def run(options: argparse.Namespace) -> int:
    """Write a project and print its path."""
    tool = tool_of(options)
    progress = Progress(messages())
    with ExitStack() as spinner:

        def decided(description: Description) -> Answers:
            answers = decide(
                description,
                _ask if sys.stdin is not None and sys.stdin.isatty() else None,
                tip=options.tip,
                base=options.base,
                tool=tool,
                spring=options.spring,
                controller=options.controller,
                masses=options.masses,
            )
            spinner.enter_context(progress.shown())
            return answers

        project = new_project(
            source_of(options),
            decided,
            reading=reading_of(options),
            name=options.name,
            output=options.output,
            build=not options.no_build,
            progress=progress,
            note=print_note,
        )
    print(project)
    return 0


def _ask(question: str) -> str:
    """Ask on standard error; standard output holds the result alone."""
    print(f"{question} ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise StiffgenError("standard input ended before the questions did; give --tip, --controller and the like")
    return answer.rstrip("\n")
