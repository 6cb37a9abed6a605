# SPDX-License-Identifier: MIT
"""Loading of files: a robot description becomes a chain, a Python file a potential, a manifest its springs."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stiffgen.core.described import with_keywords
from stiffgen.core.errors import (
    DescriptionWarning,
    InertiaWarning,
    LimitWarning,
    LoopWarning,
    OmissionWarning,
    PotentialError,
    listed,
    printable,
)
from stiffgen.core.family import part
from stiffgen.core.names import CPP_NAMES
from stiffgen.core.robot.assembly import assemble
from stiffgen.core.robot.chain import AcceptedInertia, Chain, ChainOptions, Coordinate
from stiffgen.core.robot.description import Description, JointElement, Reading
from stiffgen.core.robot.files import FileError, read_regular
from stiffgen.core.robot.reader import read_description
from stiffgen.core.robot.selection import select
from stiffgen.core.symbolic.choices import ALL, KINDS, KernelOptions, Potential
from stiffgen.core.symbolic.kernels import RESERVED_NAMES
from stiffgen.core.symbolic.placement import Placement
from stiffgen.rooms import optional

_DEFAULTS = ChainOptions()
_MAX_SOURCE = 4 * 2**20  # of a potential's file [bytes]


def read_chain(urdf: str | Path, options: ChainOptions) -> Chain:
    """Read the chain between two links of a robot's file, or the tree between a base and several tips.

    With several tips, the chains to all of them share one vector q. A floating joint of the file between base and tips,
    behind no moving joint, frees the link behind it as ``floating_base`` frees the base.

    Args:
        urdf: path of the robot's file (URDF, xacro template or MJCF), or the robot's name. Meshes are not needed.
        options: record of options.

    Returns:
        The chain; q holds its moving joints from base to tip, a mimic joint following its master's entry. Joints off
        the chain that mimic an entry of q move with it, and so do their masses; all others off the chain stand at zero.

    Raises:
        DescriptionError: the file cannot be used (all problems that can change this chain are named).
        ChainError: no such link or joint, no moving joint between base and tip, a joint type without coordinate, an
            impossible tool, sensor or lock, or a loop that does not close, locks a motor or frees a passive joint.

    Warns:
        DescriptionWarning: the file has problems that cannot change this chain.
        InertiaWarning: an impossible inertia is accepted (``accept_inertia``).
        LimitWarning: position limits of joints that follow an entry of q exclude each other; it keeps its own limits.
        OmissionWarning: springs, tendons or gravity compensation of an MJCF file push joints at rest.
        LoopWarning: the file has constraints that close loops, which all functions leave out (``close_loops``).

    """
    description = describe(urdf, options)
    selection = select(description, options)
    if selection.beside:  # a warning names the line that called the caller
        warnings.warn(DescriptionWarning(description.file, selection.beside), stacklevel=3)
    moving = {each.name for each in (*selection.moving, *selection.side)}
    if forces := {name: force for name, force in description.forces_at_rest.items() if name in moving}:
        warnings.warn(OmissionWarning(description.file, forces), stacklevel=3)
    if description.loops and not options.close_loops:
        warnings.warn(LoopWarning(description.file, [loop.text for loop in description.loops]), stacklevel=3)
    chain = assemble(description, options, selection, _RESERVED)
    if chain.unused_limits:
        warnings.warn(LimitWarning(description.file, said_of_limits(chain)), stacklevel=3)
    if chain.accepted:
        warnings.warn(InertiaWarning(description.file, map(said_of, chain.accepted)), stacklevel=3)
    return chain


load_chain = with_keywords("load_chain", ChainOptions, read_chain)


def said_of_limits(chain: Chain) -> Iterator[str]:
    """Yield a sentence about each coordinate that keeps its own position limits: joints, numbers, remedy."""
    coordinates = {each.name: each for each in chain.coordinates}
    for each in chain.unused_limits:
        yield kept_limits(coordinates[each.joint], each.fault)


def said_of(inertia: AcceptedInertia) -> str:
    """Return a clause about an accepted inertia: link, fault, what is used."""
    use = "the nearest possible tensor is used" if inertia.is_nearest else "used as it is"
    return f"link '{printable(inertia.link)}': {inertia.fault}; {use}"


def describe(source: str | Path, reading: Reading | None = None) -> Description:
    """Read a robot's file (URDF, xacro, MJCF), or a robot by its name; the one entry of all readers.

    A name is a text without dots and slashes for which no file exists: see :mod:`stiffgen.files.names`.

    Raises:
        DescriptionError: the file cannot be read, or its links do not form a tree; all its problems are named. Or
            there is no robot of this name.
        MissingExtraError: the package that reads this format is not installed.

    """
    return read_description(*located(source, reading or Reading()))


def located(source: str | Path, reading: Reading) -> tuple[Path, Reading]:
    """Return the file of a source, which may be a robot's name, and the settings that its template needs."""
    names = optional("files.names")
    return names.find_robot(str(source), reading) if names and names.is_name(source) else (Path(source), reading)


def chain_between(description: Description, options: ChainOptions = _DEFAULTS) -> Chain:
    """Return the chain of a description that was read already; problems beside the chain give no warning."""
    return assemble(description, options, select(description, options), _RESERVED)


_RESERVED = frozenset((*RESERVED_NAMES, *CPP_NAMES, "tree"))
"""Names in a module, and in the namespace of NAME.hpp, that no tip may have."""


def read_potential(text: str) -> Potential:
    """Run a file and return the function that FILE.py:FUNCTION names.

    Raises:
        PotentialError: no such file or function, or the file fails.

    """
    path, separator, function = text.rpartition(":")
    if not separator or not path or not function:
        raise PotentialError(f"--potential {text}: is not FILE.py:FUNCTION")
    try:
        source = read_regular(path, _MAX_SOURCE).decode("utf-8")
    except FileError as error:
        raise PotentialError(f"--potential {text}: {error}; name a Python file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise PotentialError(f"--potential {path}: cannot be read ({getattr(error, 'strerror', error)})") from error
    return potential_of_source(source, Path(path).name, function)


def potential_of_source(source: str, file: str, function: str) -> Potential:
    """Run a source text and return one of its functions.

    Raises:
        PotentialError: the text fails, or has no such function.

    """
    names: dict[str, Any] = {"__name__": Path(file).stem, "__file__": file}
    try:
        exec(compile(source, file, "exec"), names)
    except Exception as error:
        raise PotentialError(f"potential {file}: fails when it is run ({type(error).__name__}: {error})") from error
    if not callable(names.get(function)):
        found = [name for name, value in names.items() if inspect.isfunction(value)]
        raise PotentialError(f"potential {file}: has no function '{function}' (it has {listed(found) or 'none'})")
    return Potential(names[function], file, source)


def sealed_potential(record: Mapping[str, Any]) -> Potential:
    """Return a potential of a manifest without running its source: name and parameters alone."""
    name = str(record["function"])

    def refuse(*_: Any) -> Any:
        raise PotentialError(
            f"potential {name}: its source in manifest.json is not run; read it, then pass --trust-potentials, or "
            "trust_potentials=True in Python"
        )

    refuse.__name__ = name
    vars(refuse)["parameters"] = {str(key): tuple(map(int, shape)) for key, shape in record["parameters"]}
    return Potential(refuse, record["file"], record["source"], is_sealed=True)


def springs_of_manifest(content: dict[str, Any], trust_potentials: bool) -> KernelOptions:
    """Return the springs of a robot's folder; a folder without a record has the default spring.

    The source of potentials is run only if ``trust_potentials`` is True.
    """
    recorded = content.get("springs")
    if recorded is None:
        return KernelOptions()
    family = part("springs.springs")
    names = {family.spring(kind).name: kind for kind in KINDS} if family else {}
    x, y, z = map(float, recorded["centre"])
    return KernelOptions(
        springs=tuple(names[name] for name in recorded["kinds"] if name in names),
        placement=Placement(recorded["translation_axes"], recorded["rotation_axes"], (x, y, z)),
        potentials=tuple(
            potential_of_source(each["source"], each["file"], each["function"])
            if trust_potentials
            else sealed_potential(each)
            for each in recorded["potentials"]
        ),
        derivatives=bool(content.get("derivatives", False)),
        kernels=tuple(recorded.get("groups", (ALL,))),
        batches=recorded.get("batches", True),
    )


def kept_limits(coordinate: JointElement | Coordinate, fault: str) -> str:
    """Return a sentence about a coordinate that keeps its own position limits (:meth:`Couplings.exclusion`)."""
    return (
        f"joint '{printable(coordinate.name)}' keeps its own position limits {coordinate.lower:g} to "
        f"{coordinate.upper:g}, since those of joints that follow it leave no range: {fault}; correct these limits or "
        "the relation of the joints, or set lower_limit and upper_limit of the controller"
    )
