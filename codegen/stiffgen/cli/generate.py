# SPDX-License-Identifier: MIT
"""The command ``generate``: C code and Python module of a robot."""

from __future__ import annotations

import argparse
import math
from dataclasses import fields, replace
from pathlib import Path

from stiffgen.cli.arguments import add_option, add_robot, add_sensor, add_tool, sensor_of, source_of, tool_of
from stiffgen.cli.console import Progress, messages, print_note
from stiffgen.emit.manifest import chain_from_manifest, read_manifest
from stiffgen.errors import StiffgenError, printable
from stiffgen.generate import generate_folder
from stiffgen.loading import read_potential
from stiffgen.lower.rounding import Ranges
from stiffgen.options import GenerationOptions, help_of
from stiffgen.robot.plausibility import doubts
from stiffgen.robot.survey import missing_limits
from stiffgen.symbolic.potentials import SpringOptions
from stiffgen.symbolic.springs import AXES, KINDS, Placement


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_robot(command)
    for option in fields(GenerationOptions):
        if help_of(option).command is not None:
            readers = {"lock": _lock, "ranges": _range}
            add_option(command, option, **{"type": readers[option.name]} if option.name in readers else {})
    _add_springs(command)
    tool = add_tool(command, "fixed at generation, or a pose that the functions take at run time")
    tool.add_argument("--tool", choices=["runtime"], help="pass the tool's pose (4x4, in the tip) after q")
    add_sensor(command)
    command.set_defaults(run=run)


def _add_springs(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("springs", "additional spring potentials, and vector-Jacobian products")
    group.add_argument(
        "--spring", choices=KINDS, action="append", default=[], help="additional spring (default: trace); repeatable"
    )
    group.add_argument(
        "--potential",
        metavar="FILE.py:FUNCTION",
        action="append",
        default=[],
        help="your own U(p, R, parameters) of CasADi expressions; runs the file; repeatable",
    )
    group.add_argument(
        "--translation-axes",
        choices=AXES,
        help="axes of the translational stiffness (default: base; coupled: equilibrium)",
    )
    group.add_argument(
        "--rotation-axes",
        choices=AXES,
        default="equilibrium",
        help="axes of the rotational stiffness (default: equilibrium)",
    )
    group.add_argument(
        "--spring-centre",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        default=(0.0, 0.0, 0.0),
        help="centre of stiffness in the tip's frame [m] (default: its origin)",
    )
    group.add_argument(
        "--derivatives", action="store_true", help="generate NAME_vjp for every function: gradients in reverse mode"
    )


def run(options: argparse.Namespace) -> int:
    """Generate a folder and print its path."""
    with Progress(messages()).shown() as progress:
        folder = generate_folder(source_of(options), _generation_options(options, progress))
    _print_notes(folder, options.controller)
    print(folder)
    return 0


def _print_notes(folder: Path, controller: bool) -> None:
    """Print the limits that the controller of a folder lacks, and numbers that are probably in another unit."""
    manifest = read_manifest(folder)
    if manifest is None:
        return
    chain = chain_from_manifest(manifest)
    if controller and (folder / f"{folder.name}_impedance.h").exists():
        for sentence in missing_limits(chain.source, chain.coordinates, is_mjcf=chain.is_mjcf):
            print_note(sentence)
    for sentence in doubts(chain):
        print_note(f"{printable(chain.source)}: {sentence}")


def _generation_options(options: argparse.Namespace, progress: Progress) -> GenerationOptions:
    """Return the options of the command line as a record."""
    described = {option.name for option in fields(GenerationOptions) if help_of(option).command is not None}
    values = {name: value for name, value in vars(options).items() if name in described}
    tips = options.tip or []
    return GenerationOptions(
        **values
        | {
            "tip": tips[0] if len(tips) == 1 else options.tip,
            "ignore": options.ignore or (),
            "accept_inertia": options.accept_inertia or (),
            "arguments": options.arguments,
            "package_path": options.package_path or (),
            "lock": _locks(options.lock or []),
            "loop": options.loop or (),
            "actuated": options.actuated or (),
            "ranges": replace(Ranges(), **dict(options.ranges or [])),
            "tool": tool_of(options),
            "sensor": sensor_of(options),
            "runtime_tool": options.tool == "runtime",
            "springs": _springs(options),
            "progress": progress,
        }
    )


def _springs(options: argparse.Namespace) -> SpringOptions:
    x, y, z = options.spring_centre
    if not all(map(math.isfinite, (x, y, z))):
        raise StiffgenError("--spring-centre must be three finite numbers")
    placement = Placement(options.translation_axes, options.rotation_axes, (x, y, z))
    potentials = tuple(map(read_potential, options.potential))
    return SpringOptions(tuple(options.spring), placement, potentials, options.derivatives)


def _lock(text: str) -> tuple[str, float]:
    joint, separator, value = text.rpartition("=")
    if not separator or not joint:
        raise argparse.ArgumentTypeError(f"'{text}' is not JOINT=VALUE")
    return joint, float(value)


def _locks(locks: list[tuple[str, float]]) -> dict[str, float]:
    names = [joint for joint, _ in locks]
    for joint in names:
        if names.count(joint) > 1:
            raise StiffgenError(f"--lock names joint '{printable(joint)}' twice; leave one of them out")
    return dict(locks)


def _range(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    known = [field.name for field in fields(Ranges)]
    if name not in known:
        raise argparse.ArgumentTypeError(f"'{text}' is none of the ranges {', '.join(known)}; write NAME=VALUE")
    try:
        size = float(value)
    except ValueError:
        size = math.nan
    if not 0 < size < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}': the largest {name} must be a positive number")
    return name, size
