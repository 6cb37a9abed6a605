# SPDX-License-Identifier: MIT
"""Kernel table: the only list of generated functions, from which stiffgen makes every output.

A new kernel is one record of a family (:mod:`stiffgen.families`): name, arguments with shapes and units,
results, summary, equation and program. Header, source, Python module, stubs, documentation tables, ``casadi.Function``
objects, benchmarks and the parametrised tests follow from the record.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stiffgen.core.errors import ChainError, PotentialError, listed, printable
from stiffgen.core.family import RESERVED, Asked, asked, needed
from stiffgen.core.names import CPP_NAMES
from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import configuration_arguments
from stiffgen.core.symbolic.choices import ALL, KernelOptions
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernel import PACKED, Kernel
from stiffgen.core.symbolic.pose import jacobian_kernels, pose_kernels
from stiffgen.core.symbolic.stiffness_kernels import stiffness_kernels
from stiffgen.rooms import optional

__all__ = ["KERNELS", "MAX_BATCH_JOINTS", "PACKED", "RESERVED_NAMES", "Kernel", "chain_kernels"]


def _tip_kernels(of: Asked, tip: Tip | None) -> tuple[Kernel, ...]:
    """Return the kernels of one tip; ``tip`` is None for a robot with one tip."""
    kernels = [*pose_kernels(of.configuration, of.reference), *asked("tip, first", of)]
    for rep in REPRESENTATIONS:
        seen = of.seen_from_tip if rep == "body" else of.configuration
        kernels += [*jacobian_kernels(rep, seen), *stiffness_kernels(rep, seen, of.reference)]
    kernels += asked("tip", of)
    note = "'Tip' means the frame of the tool at tool_pose." if of.runtime_tool else ""
    return tuple(replace(kernel, tip=tip, note=" ".join(filter(None, (kernel.note, note)))) for kernel in kernels)


def _of_features(
    springs: tuple[Any, ...], *, runtime_tool: bool = False, floating: bool = False, **further: Any
) -> Asked:
    """Return what families are asked about a robot with these features."""
    return Asked(
        configuration=configuration_arguments(runtime_tool=runtime_tool, floating=floating),
        seen_from_tip=configuration_arguments(runtime_tool=runtime_tool),
        reference="world" if floating else "base",
        runtime_tool=runtime_tool,
        floating=floating,
        springs=springs,
        **further,
    )


def _serial(of: Asked, *, masses: bool = True) -> tuple[Kernel, ...]:
    """Return the kernels of a robot with one tip: pose, dynamics, all others of the tip, potentials of the joints."""
    first, *others = _tip_kernels(of, None)
    dynamics = asked("tree", of) if masses else ()
    return (first, *dynamics, *others, *asked("joints", of))


_DEFAULT = _of_features(KernelOptions().all_springs())
KERNELS: tuple[Kernel, ...] = _serial(_DEFAULT)
"""Kernels of a chain with one tip, in the order of printing."""

RESERVED_NAMES = RESERVED
"""Names in a robot's module that are forbidden for tips and potentials."""

_ARGUMENT_NAMES = frozenset(
    argument.name
    for kernel in (*KERNELS, *asked("request, of one tip", _DEFAULT))
    for argument in (*kernel.arguments, *kernel.results, arguments.BASE_POSE, arguments.TOOL_POSE)
)
_COMPANIONS = optional("control.companions")
"""Files beside the controller, which may have been taken out."""
_FORBIDDEN_NAMES = (
    RESERVED_NAMES
    | _ARGUMENT_NAMES
    | {kernel.name for kernel in KERNELS}
    | {"impedance", *(_COMPANIONS.COMPANIONS if _COMPANIONS else ()), *CPP_NAMES}
)
"""Names that are forbidden for potentials."""


def _check_names(springs: tuple[Any, ...]) -> None:
    """Raise PotentialError if a user's potential has a name of the kernel table."""
    for spring in springs:
        if spring.name in _FORBIDDEN_NAMES:
            raise PotentialError(
                f"potential {spring.name}: the name is taken by stiffgen's own functions; give it another"
            )


MAX_BATCH_JOINTS = 24
"""Largest number of moving joints with batch functions, which would double a C source of nearly a megabyte."""


def chain_kernels(chain: Chain, options: KernelOptions | None = None) -> tuple[Kernel, ...]:
    """Return the kernels of a chain in the order of printing; ``options`` adds springs to the default.

    A chain without masses has no kernels of dynamics. With several tips, each tip has its own kernels, and totals add
    up the joint stiffnesses of all contacts and the springs at all tips. ``options.groups`` adds kernels on request.
    """
    options = options or KernelOptions()
    springs = options.all_springs()
    _check_names(springs[len(springs) - len(options.potentials) :])
    pairs = tuple(options.pairs)
    if pairs:
        needed("pair.kernels", "--pair")
    of = _of_features(springs, runtime_tool=chain.runtime_tool, floating=chain.floating, known=chain, pairs=pairs)
    on_request = asked("request", of)
    everything = *_all_kernels(chain, of), *asked("pairs", of), *asked("motors", of), *on_request
    kernels = _select(everything, options.groups)
    if chain.loops:  # vectors of joints also hold coordinates, of which a path to a tip has more than joints
        kernels = tuple(replace(each, of_masses=True) if each.of_coordinates else each for each in kernels)
    if chain.floating:
        kernels = tuple(map(_on_floating_base, kernels))
    if options.derivatives:  # last: products take over the arguments as they are now
        needed("derivatives.products", "--derivatives")
        kernels = (*kernels, *asked("products", of, kernels=kernels))
    if options.batches and len(chain.joints) <= MAX_BATCH_JOINTS:
        return kernels
    return tuple(replace(kernel, batch=False) for kernel in kernels)


def _select(kernels: tuple[Kernel, ...], groups: tuple[str, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of some groups, always with the tips' poses.

    Without groups, and for the word "all", return all kernels but those on request.

    Raises:
        ChainError: the robot has no such group or function.

    """
    _refuse_unknown(kernels, groups)
    whole = not groups or ALL in groups
    return tuple(
        kernel
        for kernel in kernels
        if kernel.name == "forward_kinematics" or set(kernel.choices) & set(groups) or (whole and not kernel.on_request)
    )


def _refuse_unknown(kernels: tuple[Kernel, ...], groups: tuple[str, ...]) -> None:
    """Raise ChainError for the first group that the robot does not have, with the reason if it lacks it on purpose."""
    known = {choice for kernel in kernels for choice in kernel.choices}
    unknown = next((group for group in groups if group not in (ALL, *known)), None)
    if unknown is None:
        return
    absent = {f"{each.group}.{name}": reason for each in kernels for name, reason in each.absent}
    if unknown in absent:
        raise ChainError(f"--kernels {printable(unknown)}: {absent[unknown]}")
    raise ChainError(
        f"--kernels {printable(unknown)}: this robot has no such group or function; groups are "
        f"{listed(list(dict.fromkeys(kernel.choices[0] for kernel in kernels)))}, a function is "
        "GROUP.NAME; of dynamics, its name alone"
    )


def _on_floating_base(kernel: Kernel) -> Kernel:
    """Return a kernel whose arguments and results have their meanings for a floating base."""
    return replace(
        kernel,
        arguments=tuple(argument.on_floating_base() for argument in kernel.arguments),
        results=tuple(result.on_floating_base() for result in kernel.results),
    )


def _all_kernels(chain: Chain, of: Asked) -> tuple[Kernel, ...]:
    """Return the kernels in joint coordinates: of one tip, or of each tip and their totals."""
    if len(chain.tips) == 1:
        return _serial(replace(of, sensor=chain.sensor), masses=chain.masses)
    sensors = [chain.sensor if chain.sensor and chain.sensor.tip == k else None for k in range(len(chain.tips))]
    per_tip = [
        kernel
        for tip, sensor in zip(chain.tips, sensors, strict=True)
        for kernel in _tip_kernels(replace(of, sensor=sensor), tip)
    ]
    of_masses = asked("tree", of, tips=chain.tips) if chain.masses else ()
    totals = asked("totals", of, kernels=_tip_kernels(of, None))
    return (*of_masses, *per_tip, *totals, *asked("joints", of))
