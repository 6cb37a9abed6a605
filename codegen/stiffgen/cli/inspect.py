# SPDX-License-Identifier: MIT
"""The command ``inspect``: joints, chains and problems of a robot's file."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator

from rich.markup import escape
from rich.table import Table

from stiffgen.cli.arguments import add_robot, source_of
from stiffgen.cli.console import Progress, messages, print_table, table, tables
from stiffgen.cli.records import add_options, group_of, values_of
from stiffgen.cli.robots import LISTS, list_robots
from stiffgen.cli.survey import TipSurvey, missing_limits, narrowed_limits, survey_tip
from stiffgen.core.errors import DescriptionError, StiffgenError, counted, listed, printable, terminal_text
from stiffgen.core.loading import chain_between, describe
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.robot.couplings import Couplings
from stiffgen.core.robot.description import Description, JointElement, Reading
from stiffgen.rooms import optional

_MOST_TIPS, _MOST_DOUBTED, _LONGEST = 100, 3, 200
"""Largest number of tips that ``inspect`` shows; humanoids with hands have some 40."""


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_robot(command, nargs="?")
    add_options(command, Reading, "package_path")
    group_of(command, "frames").add_argument(
        "--tip", metavar="LINK", help="show the chain to this link (default: to every leaf link)"
    )
    command.add_argument(
        "--list",
        choices=LISTS,
        help="in place of a file: list the robots that can be named, list the cache of stiffgen.load(), or clear it; "
        "FILE is a part of their names",
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Show a robot's file, or lists of robots; return 1 if the file has problems."""
    if options.list is not None:
        return list_robots(options.list, options.urdf or "")
    if options.urdf is None:
        raise StiffgenError("inspect: give a robot's FILE; --list known lists the robots that can be named")
    try:
        with Progress(messages(), lines=False).shown() as progress:
            progress(f"reading {options.urdf}")
            description = describe(source_of(options), Reading(**values_of(options, Reading)))
    except DescriptionError as error:
        raise StiffgenError(error.full) from error  # all problems, where other commands show the first ones
    console = tables()
    moving = sum(joint.type not in ("fixed",) for joint in description.joints.values())
    console.print(
        f"robot {_shown(description.robot)}: {counted(len(description.links), 'link', 'links')}, "
        f"{counted(len(description.joints), 'joint', 'joints')} "
        f"({moving} moving), root link {_shown(description.root)}",
        markup=False,
    )
    if description.parameters:
        console.print(_parameters(description), markup=False)
    print_table(console, _joint_table(description))
    tips = description.leaves if options.tip is None else [options.tip]
    surveys = [survey_tip(description, tip) for tip in tips[:_MOST_TIPS]]
    console.print()
    print_table(console, _tip_table(surveys, names=20 if options.tip else 4))
    if len(tips) > _MOST_TIPS:
        console.print(f"and {len(tips) - _MOST_TIPS} more tips; --tip shows one", markup=False)
    for lines in _findings(description, surveys):
        print("\n" + "\n".join(lines))
    return int(bool(description.problems))


def _findings(description: Description, surveys: list[TipSurvey]) -> Iterator[list[str]]:
    """Yield paragraphs about the file: notes, remarks, limits, doubts, loops that stay open, problems."""
    coordinates = _coordinates(description, surveys)
    notes = counted(len(description.notes), "note, which changes", "notes, which change")
    closing = counted(len(description.loops), "constraint closes a loop", "constraints close loops")
    problems = counted(len(description.problems), "problem", "problems")
    paragraphs: list[tuple[str, list[str]]] = [
        (f"{notes} nothing:", list(description.notes)),
        ("", list(description.remarks)),
        ("", list(map(terminal_text, narrowed_limits(description, coordinates)))),
        ("", list(map(terminal_text, _doubts(description, surveys)))),
        ("", list(map(terminal_text, missing_limits(description.file, coordinates, is_mjcf=description.is_mjcf)))),
        (f"{closing}; left out without --close-loops:", [printable(loop.text) for loop in description.loops]),
        (
            f"{problems}; chains that a problem can affect are rejected:",
            [problem.text for problem in description.problems],
        ),
    ]
    for heading, lines in paragraphs:
        if lines:
            yield [heading, *(f"  {line}" for line in lines)] if heading else lines


def _coordinates(description: Description, surveys: list[TipSurvey]) -> list[JointElement]:
    """Return the coordinates of the chains with their limits; a base that floats has no controller."""
    names = dict.fromkeys(name for survey in surveys if not survey.floating for name in survey.coordinates)
    couplings = Couplings(description, {})
    return [couplings.limited(description.joints[name]) for name in names]


def _parameters(description: Description) -> str:
    """Return the arguments of a template with their values, as they are given, and where these come from."""
    given = dict(description.arguments)
    words = [
        f"{name}:={printable(given.get(name, default or ''), _LONGEST)}" for name, default in description.parameters
    ]
    words = [f"{word} (given)" if word.split(":=")[0] in given else word for word in words]
    return f"arguments of the template, with defaults: {', '.join(words)}"


def _shown(name: str) -> str:
    """Return a name as it is written, so that --tip takes it; control characters are escaped."""
    return printable(name, _LONGEST)


def _doubts(description: Description, surveys: list[TipSurvey]) -> list[str]:
    """Return what hints at wrong units in the longest chains."""
    lint = optional("files.plausibility")
    if lint is None:
        return []
    usable = [survey for survey in surveys if survey.coordinates]
    usable.sort(key=lambda survey: -len(survey.coordinates))
    found: dict[str, None] = {}
    for survey in usable[:_MOST_DOUBTED]:
        base = None if survey.floating else survey.base
        options = ChainOptions(tip=survey.tip, base=base, masses=not survey.hindrance)
        found |= dict.fromkeys(lint.doubts(chain_between(description, options)))
    return list(found)


def _tip_table(surveys: list[TipSurvey], names: int) -> Table:
    """Return a row per tip; of the joints that are left out of q, ``names`` are named for each reason."""
    shown = table("tip", "base", "coordinates (q)", "left out of q")
    for survey in surveys:
        coordinates = f"{len(survey.coordinates)}: {listed(survey.coordinates)}" if survey.coordinates else ""
        lines = [coordinates, survey.hindrance] if survey.hindrance else [coordinates]
        shown.add_row(
            escape(_shown(survey.tip)),
            escape(_shown(survey.base) + (", which floats" if survey.floating else "")),
            escape("\n".join(filter(None, lines))),
            escape("\n".join(f"{what}: {len(joints)} ({listed(joints, names)})" for what, joints in survey.left_out)),
        )
    return shown


def _joint_table(description: Description) -> Table:
    """Return a row per joint with its child link; numbers of joints that do not move are left out."""
    numbers = ("lower", "upper", "velocity", "effort", "mass [kg]")
    shown = table("joint", "type", "axis", *numbers[:4], "parent", "link", numbers[4], right=numbers)
    for joint in _from_root(description):
        inertial = description.inertials[joint.child]
        limits = (joint.lower, joint.upper, joint.velocity, joint.effort)
        moves = joint.type in ("revolute", "continuous", "prismatic")
        kind = joint.type if joint.mimic is None else f"{joint.type}, mimics {_shown(joint.mimic.joint)}"
        shown.add_row(
            escape(_shown(joint.name)),
            escape(kind),
            " ".join(f"{value:.4g}" for value in joint.axis) if moves else "",
            *(f"{value:.6g}" if moves and math.isfinite(value) else "" for value in limits),
            escape(_shown(joint.parent)),
            escape(_shown(joint.child)),
            "" if inertial is None else f"{inertial.mass:.6g}",
        )
    return shown


def _from_root(description: Description) -> Iterator[JointElement]:
    """Yield the joints depth first from the root: a chain appears in order."""
    below: dict[str, list[JointElement]] = {}
    for joint in description.joints.values():
        below.setdefault(joint.parent, []).append(joint)
    stack = list(reversed(below.get(description.root, [])))
    while stack:
        joint = stack.pop()
        yield joint
        stack.extend(reversed(below.get(joint.child, [])))
