# SPDX-License-Identifier: MIT
"""URDF -> a robot's folder: render, compile, and swap it into place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from stiffgen.emit.build import build_module
from stiffgen.emit.manifest import DAMAGE, MANIFEST, chain_from_manifest, read_manifest, scalar_of_manifest
from stiffgen.emit.render import render
from stiffgen.errors import ChainError, OutputError, listed
from stiffgen.folder import swapped_in, unwritable
from stiffgen.loading import read_chain
from stiffgen.lower.rounding import Ranges
from stiffgen.lower.scalar import DOUBLE, SCALARS, Scalar
from stiffgen.names import checked_identifier, identifier
from stiffgen.robot.chain import Chain, ChainOptions, Tool
from stiffgen.symbolic.arguments import posture
from stiffgen.symbolic.potentials import SpringOptions


def generate(
    urdf: str | Path,
    *,
    tip: str | Sequence[str] | None = None,
    base: str | None = None,
    tool: Tool | None = None,
    runtime_tool: bool = False,
    lock: Mapping[str, float] | None = None,
    name: str | None = None,
    output: str | Path = "generated",
    build: bool = True,
    masses: bool = True,
    cuda: bool = False,
    force: bool = False,
    springs: SpringOptions | None = None,
    floating_base: bool = False,
    ranges: Ranges | None = None,
    scalar: str = "double",
    progress: Callable[[str], None] = lambda step: None,
) -> Path:
    """Write the folder ``output/name`` with a robot's C code and Python module.

    The folder is written beside its place and swapped in when complete: on any error what was there before is
    untouched.

    Args:
        urdf: path of the URDF file.
        tip: tip link, or several (default: the only leaf link).
        base: base link (default: the root link).
        tool: what is mounted on the tip link.
        runtime_tool: the kernels take the tool's pose as an argument.
        lock: joints to hold at a position [rad or m].
        name: prefix of the C names and name of the Python module (default: from the robot's name).
        output: folder that gets the robot's folder.
        build: compile the Python module.
        masses: False ignores all masses of the file and leaves the mass matrix out.
        cuda: also write NAME.cu and NAME_cuda.h, CUDA for the functions that have a batch.
        force: replace a folder although what its users call changes: joints, base, tips, or the arguments of functions.
        springs: springs beyond the default one, their axes and centre, and potentials of your own.
        floating_base: the base link is free: its pose is an argument, its body twist comes before the joints' rates.
        ranges: of the arguments for which the header states bounds of the rounding errors.
        scalar: "double", or "float": functions of single precision, without controller and derivatives.
        progress: called with a few words before each step.

    Returns:
        Path of the robot's folder.

    Raises:
        DescriptionError, ChainError: see :func:`stiffgen.load_chain`; ChainError also for ``cuda`` and a chain too
            long for it, and for a ``scalar`` that does not go with the other options.
        OutputError: the folder cannot be written, something else stands in its place, or the robot in it has other
            joints, tips or arguments (``force`` replaces it).
        PotentialError: a spring or potential is refused.
        BuildError: the C code did not compile.

    """
    number = _checked_scalar(scalar, springs or SpringOptions())
    progress(f"reading {Path(urdf).name}")
    options = ChainOptions(tip, base, masses, tool, runtime_tool, lock, floating_base)
    chain = read_chain(urdf, options)
    name = identifier(chain.robot) if name is None else checked_identifier(name)
    output = Path(output)
    target = output / name
    try:
        refuse_foreign(target)
    except OSError as error:
        raise unwritable(target, error) from error
    if not force:
        refuse_another_robot(target, chain, number)
    progress(f"deriving and printing the kernels of {name}")
    texts = render(chain, name, scalar=number, cuda=cuda, options=springs, ranges=ranges)
    with swapped_in(target) as staging:
        for file, text in texts.items():
            (staging / file).write_text(text, encoding="utf-8", newline="\n")
        if build:
            progress(f"compiling {name}")
            build_module(staging, name)
    return target


def _checked_scalar(name: str, springs: SpringOptions) -> Scalar:
    """The type of a number; ChainError if there is none like it, or what was asked for beside it needs doubles."""
    if name not in SCALARS:
        raise ChainError(f"--scalar {name}: is not one of {listed(list(SCALARS))}")
    needs_doubles = {
        "--derivatives": springs.derivatives,
        "--spring rotation_vector": "rotation_vector" in springs.kinds,  # its series ends where doubles want it to
    }
    for option, given in needs_doubles.items():
        if given and name != DOUBLE.name:
            raise ChainError(
                f"--scalar {name} does not go with {option}, which is made for doubles; leave out one of the two, or "
                "generate a second folder of doubles with another --name"
            )
    return SCALARS[name]


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
    known = {MANIFEST, "__pycache__", *manifest["files"]}
    foreign = sorted(
        entry.name for entry in target.iterdir() if entry.name not in known and entry.suffix not in (".so", ".pyd")
    )
    if foreign:
        raise OutputError(
            f"{target}: holds files that stiffgen did not write ({', '.join(foreign[:5])}); move them away first"
        )


def refuse_another_robot(target: Path, chain: Chain, scalar: Scalar = DOUBLE) -> None:
    """Raise OutputError if ``target`` holds a robot whose functions mean another thing: q, frames, types, arguments."""
    manifest = read_manifest(target)
    if manifest is None:
        return
    try:
        before = _meaning(chain_from_manifest(manifest), scalar_of_manifest(manifest))
        changed = [
            f"{what} {listed(old) or 'none'} would become {listed(new) or 'none'}"
            for (what, old), (_, new) in zip(before, _meaning(chain, scalar), strict=True)
            if old != new
        ]
    except DAMAGE:  # of another version of stiffgen
        return
    if changed:
        raise OutputError(
            f"{target}: holds another robot ({'; '.join(changed)}). What uses the folder would get other results: "
            "take --force to replace it, or write beside it with another --name or --output"
        )


def _meaning(chain: Chain, scalar: Scalar) -> list[tuple[str, list[str]]]:
    """What the callers of a folder's functions rely on."""
    return [
        ("joints", [coordinate.name for coordinate in chain.coordinates]),
        ("base", [chain.base]),
        ("tips", [tip.link for tip in chain.tips]),
        ("numbers", [scalar.name]),
        ("arguments", [each.name for each in posture(runtime_tool=chain.runtime_tool, floating=chain.floating)]),
    ]
