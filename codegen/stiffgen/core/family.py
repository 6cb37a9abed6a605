# SPDX-License-Identifier: MIT
"""Families of kernels: their names, and what the core asks of each. A folder that has been taken out adds nothing.

A family is a folder below ``families`` whose module ``family`` has a record ``FAMILY``. What two families share is an
adapter in the later one, a module with a record of its own. The core knows the names alone; their order is that of
printing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

from stiffgen.core.errors import ChainError

if TYPE_CHECKING:
    from stiffgen.core.robot.chain import Chain, MountedSensor, Tip
    from stiffgen.core.symbolic.arguments import Argument
    from stiffgen.core.symbolic.kernel import Kernel

FAMILIES: dict[str, tuple[str, ...]] = {
    "manipulability": ("derivatives",),
    "derivatives": (),
    "dynamics": (),
    "springs": (),
    "sensor": (),
    "contacts": ("springs",),
    "pair": ("springs",),
    "joints": (),
    "loops": (),
    "loops.of_joints": ("loops", "joints"),
    "loops.of_springs": ("loops", "springs"),
    "loops.of_dynamics": ("loops", "dynamics"),
    "loops.of_derivatives": ("loops", "derivatives"),
    "compliance": ("contacts",),
    "loops.of_compliance": ("loops", "compliance"),
    "springs.of_tangents": ("springs",),
}
"""Folder or adapter below ``families`` -> families without which it adds nothing."""

RESERVED = frozenset(
    ("body", "spatial", "hybrid", "spring", "posture", "limits", "gravity", "motors", "sensor", "close", "packed",
     "pair", "absolute", "bimanual", "forward_kinematics", "mass_matrix", "bias_forces", "static_torque_derivatives",
     "manipulability", "manipulability_gradient")
)  # fmt: skip
"""Names that no tip may have: those of all families, so that a robot keeps its names when a family is taken out."""

TablePlace = Literal[
    "tip, first",  # behind the pose
    "tip",  # behind the stiffnesses
    "tree",  # of all joints
    "totals",  # sums over tips
    "pairs",  # of two tips
    "joints",
    "motors",
    "motors, joints",
    "motors, tip",
    "motors, masses",
    "request",
    "request, of one tip",  # whose arguments' names no potential may have
    "compliance, tip",
    "products",  # of the kernels before
]
"""Places in the table of kernels."""


@dataclass(frozen=True)
class Asked:
    """Facts that the core states when it asks for kernels.

    Attributes:
        configuration: arguments that describe where the robot is: base pose, q, tool pose.
        seen_from_tip: those of the body representation, without the base's pose.
        reference: "base" or "world".
        runtime_tool: whether the tool's pose is an argument.
        floating: whether the base moves.
        springs: records of the chosen springs.
        pairs: words of --pair.
        known: the robot; None for the table of a robot without special features.
        tips: of several, all.
        sensor: of this tip.
        kernels: those at earlier places.

    """

    configuration: tuple[Argument, ...]
    seen_from_tip: tuple[Argument, ...]
    reference: str
    runtime_tool: bool
    floating: bool
    springs: tuple[Any, ...]
    known: Chain | None = None
    tips: tuple[Tip, ...] = ()
    sensor: MountedSensor | None = None
    kernels: tuple[Kernel, ...] = ()
    pairs: tuple[str, ...] = ()

    @property
    def chain(self) -> Chain:
        """The robot, at places that depend on it: motors, totals, kernels on request."""
        assert self.known is not None
        return self.known


@dataclass(frozen=True)
class Family:
    """Record of a family.

    Attributes:
        kernels: function of :class:`Asked` for each place where the family has kernels.
        oracles: module below ``families`` with ``ORACLES``, and ``of_options(options)`` where they follow from options;
            only ``verify`` imports it.
        rules: reverse rules of steps.
        lowering: module below ``families`` with ``RULES``, the lowering of steps of its own.

    """

    kernels: Mapping[TablePlace, Callable[[Asked], Iterable[Kernel]]] = field(default_factory=dict)
    oracles: str = ""
    rules: Mapping[type, Callable[..., None]] = field(default_factory=dict)
    lowering: str = ""


def is_there(name: str) -> bool:
    """Return whether a family, and all that it needs, is there."""
    if find_spec("stiffgen.families") is None:
        return False
    folder = find_spec(f"stiffgen.families.{name.partition('.')[0]}")
    return folder is not None and folder.origin is not None and all(map(is_there, FAMILIES.get(name, ())))


@cache
def families() -> tuple[Family, ...]:
    """Return the records of the families that are there."""
    modules = (name if "." in name else f"{name}.family" for name in FAMILIES if is_there(name))
    return tuple(import_module(f"stiffgen.families.{module}").FAMILY for module in modules)


def part(module: str) -> Any:
    """Return a module of a family that the core calls by name, or None where the family has been taken out."""
    return import_module(f"stiffgen.families.{module}") if is_there(module.partition(".")[0]) else None


def needed(module: str, option: str) -> Any:
    """Return a module of a family that an option needs.

    Raises:
        ChainError: the family has been taken out.

    """
    found = part(module)
    if found is None:
        raise ChainError(
            f"{option} needs the family {module.partition('.')[0]}, which has been taken out of this stiffgen; leave "
            "the option out, or install stiffgen whole"
        )
    return found


def asked(place: TablePlace, of: Asked, **changes: Any) -> Iterator[Kernel]:
    """Yield the kernels that all families have at a place of the table."""
    for family in families():
        if place in family.kernels:
            yield from family.kernels[place](replace(of, **changes) if changes else of)
