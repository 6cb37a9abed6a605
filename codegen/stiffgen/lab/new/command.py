# SPDX-License-Identifier: MIT
"""The command ``new``: a project of one's own around a robot."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path

from stiffgen.cli.arguments import add_robot, source_of
from stiffgen.cli.console import Progress, messages, print_note
from stiffgen.cli.records import add_options, group_of, values_of
from stiffgen.core.errors import StiffgenError
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.robot.description import Description, Reading
from stiffgen.core.symbolic.choices import KINDS
from stiffgen.lab.new.project import new_project
from stiffgen.lab.new.questions import CONTROLLERS, Answers, decide

_OPTIONS = ("base", "masses", "tool", "name", "build")
"""Options that ``new`` shares with ``generate``, beside those of the reader."""


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_robot(command)
    add_options(command, GenerationOptions, *(each.name for each in fields(Reading)), *_OPTIONS)
    group_of(command, "frames").add_argument(
        "--tip", metavar="LINK", help="link that touches things (needed where there are several)"
    )
    output = group_of(command, "output")
    output.add_argument(
        "--controller",
        choices=[*CONTROLLERS, *(f"spring={kind}" for kind in KINDS)],
        help="control law of the loop (default: impedance); spring=KIND: with this spring (default: trace)",
    )
    output.add_argument("--output", type=Path, metavar="DIR", help="folder to write (default: NAME_control; NAME_ros2)")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write a project and print its path."""
    chosen, (controller, _, spring) = values_of(options, ChainOptions), (options.controller or "").partition("=")
    if chosen.get("runtime_tool"):
        raise StiffgenError("--tool runtime: a project's loop has a fixed tool; give NAME=VALUE")
    progress = Progress(messages())
    with ExitStack() as terminal:
        reading = terminal.enter_context(Progress(messages(), lines=False).shown())
        reading(f"reading {options.urdf}")

        def decided(description: Description) -> Answers:
            """Ask what is open, and show progress only afterwards: a spinner would overwrite the questions."""
            terminal.close()
            answers = decide(
                description,
                _ask if sys.stdin is not None and sys.stdin.isatty() else None,
                tip=options.tip,
                base=options.base,
                tool=chosen["tool"],
                spring=spring or None,
                controller=controller or None,
                masses=options.masses,
            )
            terminal.enter_context(progress.shown())
            return answers

        project = new_project(
            source_of(options),
            decided,
            reading=Reading(**values_of(options, Reading)),
            name=options.name,
            output=options.output,
            build=options.build,
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
