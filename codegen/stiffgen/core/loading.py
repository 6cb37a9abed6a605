# SPDX-License-Identifier: MIT
"""Loading of a robot's file: its description becomes a chain."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

from stiffgen.core.described import with_keywords
from stiffgen.core.errors import (
    DescriptionWarning,
    InertiaWarning,
    LimitWarning,
    LoopWarning,
    OmissionWarning,
    printable,
)
from stiffgen.core.names import CPP_NAMES
from stiffgen.core.robot.assembly import assemble
from stiffgen.core.robot.chain import AcceptedInertia, Chain, ChainOptions, Coordinate
from stiffgen.core.robot.description import Description, JointElement, Reading
from stiffgen.core.robot.reader import read_description
from stiffgen.core.robot.selection import select
from stiffgen.core.symbolic.kernels import RESERVED_NAMES
from stiffgen.rooms import optional

_DEFAULTS = ChainOptions()


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


def kept_limits(coordinate: JointElement | Coordinate, fault: str) -> str:
    """Return a sentence about a coordinate that keeps its own position limits (:meth:`Couplings.exclusion`)."""
    return (
        f"joint '{printable(coordinate.name)}' keeps its own position limits {coordinate.lower:g} to "
        f"{coordinate.upper:g}, since those of joints that follow it leave no range: {fault}; correct these limits or "
        "the relation of the joints, or set lower_limit and upper_limit of the controller"
    )
