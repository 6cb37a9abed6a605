# SPDX-License-Identifier: MIT
"""Generate a robot's folder: render, compile, and swap it into place."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from stiffgen.core.described import with_keywords
from stiffgen.core.emit.build import build_module
from stiffgen.core.emit.render import render
from stiffgen.core.errors import ChainError, OutputError, listed
from stiffgen.core.family import needed
from stiffgen.core.folder import swapped_in, unwritable
from stiffgen.core.loading import read_chain
from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.manifest import DAMAGE, MANIFEST, chain_from_manifest, read_manifest, scalar_of_manifest
from stiffgen.core.names import checked_identifier, identifier
from stiffgen.core.options import GenerationOptions
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import configuration_arguments


def generate_folder(urdf: str | Path, options: GenerationOptions) -> Path:
    """Write the folder ``output/name`` with a robot's C code and Python module.

    The folder is written beside its place and swapped in when complete: after an error, the previous folder is
    untouched.

    Args:
        urdf: path of the robot's file.
        options: record of options.

    Returns:
        Path of the robot's folder.

    Raises:
        DescriptionError: see :func:`stiffgen.load_chain`.
        ChainError: see :func:`stiffgen.load_chain`; also for options that exclude each other.
        OutputError: the folder cannot be written, another thing stands in its place, or the robot in it has
            another source, other joints, tips or arguments (``force`` replaces it).
        PotentialError: a spring or potential is refused.
        BuildError: the C code did not compile.

    """
    scalar = options.number
    if options.cuda:
        needed("cuda.backend", "--cuda")
    options.progress(f"reading {Path(urdf).name}")
    chain = read_chain(urdf, options)
    if chain.loops and scalar != DOUBLE:
        raise ChainError(
            f"--scalar {scalar.name} does not go with closed loops: close ends with a step of at most 1e-8 rad, and a "
            f"singularity is told within 1e-9, both below the last digit of a {scalar.name}; leave out one of the two"
        )
    name = identifier(chain.robot) if options.name is None else checked_identifier(options.name)
    folder = Path(options.output) / name
    try:
        refuse_foreign(folder)
    except OSError as error:
        raise unwritable(folder, error) from error
    if not options.force:
        refuse_another_robot(folder, chain, scalar)
    options.progress(f"deriving and printing the kernels of {name}")
    texts = render(chain, name, options)
    with swapped_in(folder) as staging:
        for file, text in texts.items():
            (staging / file).parent.mkdir(exist_ok=True)
            (staging / file).write_text(text, encoding="utf-8", newline="\n")
        if options.build and options.python:
            options.progress(f"compiling {name}, usually 10 to 30 s for an arm")
            build_module(staging, name)
    return folder


generate = with_keywords("generate", GenerationOptions, generate_folder)


def refuse_foreign(target: Path) -> None:
    """Raise OutputError unless ``target`` is free or holds nothing but what stiffgen wrote there."""
    if target.is_symlink() or (target.exists() and not target.is_dir()):
        raise OutputError(f"{target}: is not a folder; move it away or choose another --name or --output")
    if not target.exists():
        return
    manifest = read_manifest(target)
    if manifest is None:
        raise OutputError(
            f"{target}: exists and was not written by stiffgen (it has no {MANIFEST} of stiffgen); "
            "move it away or choose another --name or --output"
        )
    known = {MANIFEST, *manifest["files"]}
    files = {file.relative_to(target) for file in target.rglob("*") if not file.is_dir()}
    foreign = sorted(
        file.as_posix()
        for file in files
        if file.as_posix() not in known and file.suffix not in (".so", ".pyd") and "__pycache__" not in file.parts
    )
    if foreign:
        raise OutputError(
            f"{target}: holds files that stiffgen did not write ({', '.join(foreign[:5])}); move them away first"
        )


def refuse_another_robot(target: Path, chain: Chain, scalar: Scalar = DOUBLE) -> None:
    """Raise OutputError if ``target`` holds a robot of another source, or with other joints, frames or arguments."""
    manifest = read_manifest(target)
    if manifest is None:
        return
    changed = _other_source(manifest, chain)
    with suppress(*DAMAGE):  # the chain of another version of stiffgen
        meaning = _meaning(chain_from_manifest(manifest), scalar_of_manifest(manifest))
        pairs = zip(meaning, _meaning(chain, scalar), strict=True)
        changed += [(what, old, new) for (what, old), (_, new) in pairs if old != new]
    if changed:
        said = [f"{what} {listed(old) or 'none'} would become {listed(new) or 'none'}" for what, old, new in changed]
        raise OutputError(
            f"{target}: holds another robot ({'; '.join(said)}). What uses the folder would get other results: "
            "remove it first (force=True in Python), or write beside it with another --name or --output"
        )


def _other_source(manifest: dict[str, Any], chain: Chain) -> list[tuple[str, list[str], list[str]]]:
    """Return the properties of a folder's source that differ from those of a chain; () in another version's manifest.

    Robots may share an identifier: names in other alphabets, names with equal first characters, models without a name,
    the robots of one template. An edited file, and a renamed one, are the same source.
    """
    record = manifest.get("urdf")
    kept = manifest.get("chain")
    if not isinstance(record, dict) or not isinstance(kept, dict):
        return []
    pairs = [
        ("robot", [str(kept.get("robot", chain.robot))], [chain.robot]),
        ("arguments of the template", _assignments(record.get("arguments")), _assignments(dict(chain.arguments))),
    ]
    if record.get("sha256") != chain.digest:
        pairs.append(("file", [str(record.get("file", chain.source))], [chain.source]))
    return [each for each in pairs if each[1] != each[2]]


def _assignments(arguments: Any) -> list[str]:
    """Return the arguments of a template as they stand on the command line."""
    return [f"{name}:={value}" for name, value in sorted(arguments.items())] if isinstance(arguments, dict) else []


def _meaning(chain: Chain, scalar: Scalar) -> list[tuple[str, list[str]]]:
    """Return the properties that callers of a folder's functions rely on."""
    return [
        ("joints", [*chain.coordinate_names]),
        ("base", [chain.base]),
        ("tips", [tip.link for tip in chain.tips]),
        ("numbers", [scalar.name]),
        ("sensor", [chain.sensor.text] if chain.sensor else []),
        (
            "arguments",
            [each.name for each in configuration_arguments(runtime_tool=chain.runtime_tool, floating=chain.floating)],
        ),
    ]
