# SPDX-License-Identifier: MIT
"""The command ``generate``: C code and Python module of a robot."""

from __future__ import annotations

import argparse
from pathlib import Path

from stiffgen.cli.arguments import add_robot, source_of
from stiffgen.cli.console import Progress, messages, print_note
from stiffgen.cli.records import add_options, group_of, values_of
from stiffgen.cli.survey import missing_limits
from stiffgen.core.errors import printable
from stiffgen.core.generate import generate_folder
from stiffgen.core.manifest import chain_from_manifest, read_manifest
from stiffgen.core.options import GenerationOptions
from stiffgen.rooms import optional


def add(command: argparse.ArgumentParser) -> None:
    """Add the arguments: fields of :class:`GenerationOptions` are the options."""
    add_robot(command, nargs="?")
    group_of(command, "robot").add_argument(
        "--robot",
        metavar="NAME",
        help="robot by its name alone, instead of FILE; 'stiffgen inspect --list known' lists them",
    )
    add_options(command, GenerationOptions)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Generate a folder and print its path."""
    with Progress(messages()).shown() as progress:
        source = source_of(options)
        chosen = GenerationOptions(**values_of(options, GenerationOptions), progress=progress)
        folder = generate_folder(source, chosen)
        if (cache := optional("files.cache")) is not None:
            cache.keep(source, chosen, folder)
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
    lint = optional("files.plausibility")
    for sentence in lint.doubts(chain) if lint else ():
        print_note(f"{printable(chain.source)}: {sentence}")
