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
from stiffgen.core.names import CPP_NAMES
from stiffgen.core.robot.chain import Chain, MountedSensor, Tip
from stiffgen.core.symbolic import arguments
from stiffgen.core.symbolic.arguments import configuration_arguments
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernel import PACKED, Kernel
from stiffgen.core.symbolic.pose import jacobian_kernels, pose_kernels
from stiffgen.core.symbolic.stiffness_kernels import direction_gradient_kernel, stiffness_kernels
from stiffgen.families.compliance.kernels import compliance_kernels, compliance_of_tip
from stiffgen.families.contacts.kernels import total_kernels
from stiffgen.families.derivatives.products import products
from stiffgen.families.dynamics.kernels import dynamics_kernels
from stiffgen.families.joints.kernels import JOINT_POTENTIAL_KERNELS, JOINT_POTENTIALS
from stiffgen.families.loops.kernels import GROUP, motor_kernels
from stiffgen.families.manipulability.kernels import manipulability_kernels
from stiffgen.families.sensor.kernels import GROUP as SENSOR
from stiffgen.families.sensor.kernels import sensor_kernels
from stiffgen.families.springs.kernels import spring_kernels
from stiffgen.families.springs.potentials import ALL, KernelOptions
from stiffgen.families.springs.springs import TRACE, Spring
from stiffgen.families.springs.tangents import tangent_kernels

__all__ = [
    "KERNELS",
    "MAX_BATCH_JOINTS",
    "PACKED",
    "RESERVED_NAMES",
    "Kernel",
    "chain_kernels",
]


def _tip_kernels(
    tip: Tip | None,
    springs: tuple[Spring, ...],
    *,
    runtime_tool: bool,
    floating: bool = False,
    sensor: MountedSensor | None = None,
) -> tuple[Kernel, ...]:
    """Return the kernels of one tip; ``tip`` is None for a robot with one tip."""
    configuration = configuration_arguments(runtime_tool=runtime_tool, floating=floating)
    reference = "world" if floating else "base"
    seen_from_tip = configuration_arguments(runtime_tool=runtime_tool)  # body representation: without the base's pose
    kernels = [*pose_kernels(configuration, reference), *manipulability_kernels(seen_from_tip)]
    for rep in REPRESENTATIONS:
        seen = seen_from_tip if rep == "body" else configuration
        kernels += [*jacobian_kernels(rep, seen), *stiffness_kernels(rep, seen, reference)]
    kernels.append(direction_gradient_kernel(configuration))
    for spring in springs:
        kernels += spring_kernels(spring, configuration)
    if sensor:
        kernels += sensor_kernels(configuration, sensor, reference)
    note = "'Tip' means the frame of the tool at tool_pose." if runtime_tool else ""
    return tuple(replace(kernel, tip=tip, note=" ".join(filter(None, (kernel.note, note)))) for kernel in kernels)


def _serial(
    springs: tuple[Spring, ...] = (TRACE,),
    *,
    runtime_tool: bool = False,
    masses: bool = True,
    floating: bool = False,
    sensor: MountedSensor | None = None,
) -> tuple[Kernel, ...]:
    """Return the kernels of a robot with one tip: pose, dynamics, all others of the tip, potentials of the joints."""
    first, *others = _tip_kernels(None, springs, runtime_tool=runtime_tool, floating=floating, sensor=sensor)
    dynamics = dynamics_kernels(runtime_tool=runtime_tool, floating=floating) if masses else ()
    return (first, *dynamics, *others, *JOINT_POTENTIAL_KERNELS)


KERNELS: tuple[Kernel, ...] = _serial()
"""Kernels of a chain with one tip, in the order of printing."""

RESERVED_NAMES = frozenset(kernel.group or kernel.name for kernel in KERNELS) | {
    PACKED.lstrip("_"),
    GROUP,
    SENSOR,
    "close",
}
"""Names in a robot's module that are forbidden for tips and potentials."""

_ARGUMENT_NAMES = frozenset(
    argument.name
    for kernel in (*KERNELS, *compliance_of_tip(configuration_arguments(runtime_tool=False)))
    for argument in (*kernel.arguments, *kernel.results, arguments.BASE_POSE, arguments.TOOL_POSE)
)
_FORBIDDEN_NAMES = (
    RESERVED_NAMES | _ARGUMENT_NAMES | {kernel.name for kernel in KERNELS} | {"impedance", "paper", *CPP_NAMES}
)
"""Names that are forbidden for potentials."""


def _check_names(springs: tuple[Spring, ...]) -> None:
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
    on_request = *compliance_kernels(chain), *tangent_kernels(chain, springs)
    everything = *_all_kernels(chain, springs), *motor_kernels(chain, springs), *on_request
    kernels = _select(everything, options.groups)
    if chain.loops:  # vectors of joints also hold coordinates, of which a path to a tip has more than joints
        kernels = tuple(replace(each, of_masses=True) if _of_coordinates(each) else each for each in kernels)
    if chain.floating:
        kernels = tuple(map(_on_floating_base, kernels))
    if options.derivatives:  # last: products take over the arguments as they are now
        kernels = (*kernels, *products(kernels))
    if options.batches and len(chain.joints) <= MAX_BATCH_JOINTS:
        return kernels
    return tuple(replace(kernel, batch=False) for kernel in kernels)


def _of_coordinates(kernel: Kernel) -> bool:
    """Return whether a kernel, or the kernel of the tree behind it, loops over the coordinates."""
    names = [potential.name for potential in JOINT_POTENTIALS]
    of_motors = [f"{name}_{part}" for name in names for part in ("torque", "joint_stiffness")]
    return kernel.group in names or (kernel.group == GROUP and kernel.name in of_motors)


def _select(kernels: tuple[Kernel, ...], groups: tuple[str, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of some groups, always with the tips' poses.

    Without groups, and for the word "all", return all kernels but those on request.

    Raises:
        ChainError: the robot has no such group or function.

    """
    known = dict.fromkeys(choice for kernel in kernels for choice in kernel.choices)
    unknown = [group for group in groups if group not in (ALL, *known)]
    if unknown:
        raise ChainError(
            f"--kernels {printable(unknown[0])}: this robot has no such group or function; groups are "
            f"{listed(list(dict.fromkeys(kernel.choices[0] for kernel in kernels)))}, a function is "
            "GROUP.NAME; of dynamics, its name alone"
        )
    whole = not groups or ALL in groups
    return tuple(
        kernel
        for kernel in kernels
        if kernel.name == "forward_kinematics" or set(kernel.choices) & set(groups) or (whole and not kernel.on_request)
    )


def _on_floating_base(kernel: Kernel) -> Kernel:
    """Return a kernel whose arguments and results have their meanings for a floating base."""
    return replace(
        kernel,
        arguments=tuple(argument.on_floating_base() for argument in kernel.arguments),
        results=tuple(result.on_floating_base() for result in kernel.results),
    )


def _all_kernels(chain: Chain, springs: tuple[Spring, ...]) -> tuple[Kernel, ...]:
    """Return the kernels in joint coordinates: of one tip, or of each tip and their totals."""
    if len(chain.tips) == 1:
        return _serial(
            springs,
            runtime_tool=chain.runtime_tool,
            masses=chain.masses,
            floating=chain.floating,
            sensor=chain.sensor,
        )
    options: dict[str, Any] = {"runtime_tool": chain.runtime_tool, "floating": chain.floating}
    sensors = [chain.sensor if chain.sensor and chain.sensor.tip == k else None for k in range(len(chain.tips))]
    per_tip = [
        kernel
        for tip, sensor in zip(chain.tips, sensors, strict=True)
        for kernel in _tip_kernels(tip, springs, **options, sensor=sensor)
    ]
    of_masses = dynamics_kernels(chain.tips, **options) if chain.masses else ()
    totals = total_kernels(chain, _tip_kernels(None, springs, **options), springs)
    return (*of_masses, *per_tip, *totals, *JOINT_POTENTIAL_KERNELS)
