# SPDX-License-Identifier: MIT
"""Variables of the impedance controller's templates, made from the field table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stiffgen.control.companions import COMPANIONS, SHARED, CompanionPage, companion_pages, companions_of
from stiffgen.control.core.config import CONFIG, CONFIG_SECTIONS, STATED
from stiffgen.control.core.field import MAX_DOF, Field
from stiffgen.control.core.memory import RANGES, RECORDS
from stiffgen.control.core.signals import INPUT, OUTPUT, OUTPUT_SECTIONS
from stiffgen.control.core.words import COMMANDS, ERRORS, FAULTS, MODES, REASONS, REFUSALS, SEEN, STATUS
from stiffgen.control.presets import motor_tables
from stiffgen.control.structs import (
    Member,
    Struct,
    bound_text,
    check_of,
    defaults,
    joint_defaults,
    present,
    struct_of,
)
from stiffgen.core.errors import printable
from stiffgen.core.family import needed
from stiffgen.core.library import Library
from stiffgen.core.lower.scalar import DOUBLE, Scalar
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.placement import Placement
from stiffgen.rooms import optional

LIBRARY = Path(__file__).parent / "core" / "library"
"""Folder of the C library that every NAME_impedance.c contains."""
_PARTS = (
    "matrix", "modes", "springs", "account", "command", "watch", "sample", "reference", "feedforward", "law", "guard",
    "memory", "text", "init", "step",
)  # fmt: skip
SOURCES = tuple(f"{part}.c" for part in _PARTS)
IMPEDANCE = Library(LIBRARY, "impedance.h", SOURCES, shared=SHARED)
"""C of every NAME_impedance.c."""
MODULE = Library(
    Path(__file__).parent / "python", "controller.h", ("controller.c", *(f"{each}.c" for each in COMPANIONS))
)
"""C of every NAME_python.c with a controller and all companions."""
LOOPS = Library(Path(__file__).parent / "loops", "loops.h", ("loops.c",))
"""C of the NAME_impedance.c of robots with closed loops."""
CONTROLLER_KERNELS = ("hybrid.jacobian", "spring.energy", "spring.wrench", "spring.linearization")
"""Functions that every controller calls, besides the poses of the tips."""
TREE_KERNELS = ("mass_matrix", "bias_forces")
"""Functions that the controller calls in robots without closed loops."""
PAPER_KERNELS = ("hybrid.joint_stiffness", "hybrid.joint_stiffness_uncorrected")
"""Functions that the paper's law calls besides the mass matrix."""
LOOP_KERNELS = ("close", *(f"motors.{name}" for name in ("jacobian", "mass_matrix", "bias_forces", "from_joints")))
"""Functions that the controller calls in robots with closed loops, in place of those of the tree."""
BOUNDED_KERNELS = tuple(f"spring_bounded.{name}" for name in ("energy", "wrench", "linearization"))
"""Functions that the controller calls in folders with the bounded spring."""
_STRUCTS = (
    ("config", "Configuration; start from the defaults, and state what has none.", CONFIG),
    ("input", "One sample and a command. A struct of zeros is a missed sample without a clock.", INPUT),
    ("output", "Result of a step, complete enough to draw a log from it.", OUTPUT),
)
_SECTIONS = {
    struct: {fields[0].name: heading for heading, fields in sections}
    for struct, sections in (("config", CONFIG_SECTIONS), ("output", OUTPUT_SECTIONS))
}
"""Heading above the first field of each section, by struct."""
_FIRST_FIELD_ERROR = -20
_CAUSES = {
    "position_limits": "position",
    "config_lower_limit": "position",
    "config_upper_limit": "position",
    "config_velocity_limit": "velocity",
}
"""Errors that follow from a wrong unit in the robot's file, and what the number is about (files/plausibility.py)."""
REFERENCE_SHARE = 0.72
"""Share of a joint's velocity limit that the reference uses; an arm that is faster is braked."""


def config_of(chain: Chain) -> tuple[Field, ...]:
    """Return the fields of the configuration that a chain's controller has, with the chain's defaults.

    Acceleration limits of the file (URDF 1.2) lengthen ``ramp_time``: the reference starts and stops with at most
    0.72 ``velocity_limit`` / ``ramp_time``.
    """
    slowest = 0.0
    for each in chain.motor_coordinates:
        limit = min(each.acceleration, each.deceleration)
        if math.isfinite(limit) and math.isfinite(each.velocity):
            slowest = max(slowest, REFERENCE_SHARE * each.velocity / limit)
    default = next(field.default for field in CONFIG if field.name == "ramp_time")
    ramp_time = repr(max(float(default), math.ceil(1e4 * slowest) / 1e4))
    return tuple(replace(field, default=ramp_time) if field.name == "ramp_time" else field for field in CONFIG)


def has_controller(chain: Chain, scalar: Scalar = DOUBLE) -> bool:
    """Return whether a robot can have the controller: masses, a fixed base, at most MAX_DOF coordinates, doubles.

    All functions that the controller calls must exist: a family may have been taken out.
    """
    fits = scalar == DOUBLE and chain.masses and not chain.floating and len(chain.motor_coordinates) <= MAX_DOF
    return fits and set(called_kernels(chain, ())) <= {kernel.choices[1] for kernel in chain_kernels(chain)}


def called_kernels(chain: Chain, springs: Sequence[str], pairs: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the functions that controller and companions of a robot with these springs and pairs call."""
    bounded = BOUNDED_KERNELS if "bounded" in springs else ()
    groups = ("bimanual", "absolute", "pair_bounded") if bounded else ("bimanual",)
    of_pairs = tuple(
        f"{group}{pair.suffix}.{name}"
        for pair in pairs_of(chain, pairs)
        for group in groups
        for name in ("energy", "wrench", "linearization")
    )
    paper = PAPER_KERNELS if any(each.name == "paper" for each in companions_of(chain)) else ()
    return (*CONTROLLER_KERNELS, *bounded, *of_pairs, *paper, *(LOOP_KERNELS if chain.loops else TREE_KERNELS))


@dataclass(frozen=True)
class HeldPair:
    """Pair of tips that the controller has springs of: the tips' numbers, and what follows the names of its groups."""

    first: int
    second: int
    suffix: str


def pairs_of(chain: Chain, words: Sequence[str]) -> tuple[HeldPair, ...]:
    """Return the pairs of tips that words A:B name."""
    found = needed("pair.way", "--pair").pairs_of(chain, words) if words else ()
    return tuple(
        HeldPair(chain.tips.index(pair.first), chain.tips.index(pair.second), f"_{pair.name}" if pair.name else "")
        for pair in found
    )


@dataclass(frozen=True)
class ControllerPage:
    """Variable ``controller`` of the templates.

    Attributes:
        n: number of motors.
        interface: types and constants of the C library.
        library: functions of the C library, static.
        loops_interface, loops: types and functions of closed loops.
        module_interface, module: types and functions of the C that gives the controller to Python.
        tool: whether the tool's pose is an argument.
        bounded: whether the folder has the bounded spring.
        companions: files beside the controller, by name.
        tips: number of tips.
        pairs: pairs of tips with springs.
        scopes: prefix of the kernels' names, per tip.
        status, modes, faults: name and meaning.
        reasons: name, class of the fault and meaning.
        seen: reason and the meaning of its numbers.
        reason_classes: number of each reason's class.
        refusals, commands: name and meaning; arguments of a command.
        turns: 1 for each motor a turn of which leaves the robot the same, else 0.
        errors: name, code and text.
        checks: C condition on the configuration c, by field.
        stated: fields of the configuration without a default.
        structs: config, input and output.
        memory: records of the memory between steps.
        ranges: integers of the memory with their record, their bounds, and whether they are arrays over joints.
        remembered: fields of the output copied from the memory: name, the memory's member, whether it is an array.
        choice_fields: name and words of the fields that are choices.
        outcomes: name and words of what a step reports.
        defaults, joint_defaults: C statements that set the configuration's fields, and entry i of those over joints.
        motors: tables of the motors, per coordinate: name, source and C initialiser.
        axes: axes of the translational and of the rotational stiffness.
        centre: centre of stiffness in the tip's frame, as a C initialiser.
        start: motors' positions at which closed loops are closed; empty without loops.

    """

    # More than twelve fields: one for each variable that the controller's templates read.
    n: int
    interface: str
    library: str
    loops_interface: str
    loops: str
    module_interface: str
    module: str
    tool: bool
    bounded: bool
    companions: dict[str, CompanionPage]
    tips: int
    pairs: tuple[HeldPair, ...]
    scopes: list[str]
    status: tuple[tuple[str, str], ...]
    modes: tuple[tuple[str, str], ...]
    faults: tuple[tuple[str, str], ...]
    reasons: tuple[tuple[str, str, str], ...]
    seen: list[tuple[str, str]]
    reason_classes: list[int]
    refusals: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]
    stated: list[str]
    turns: list[int]
    errors: list[tuple[str, int, str]]
    checks: dict[str, str]
    structs: list[Struct]
    memory: list[Struct]
    ranges: tuple[tuple[str, str, int, int, bool], ...]
    remembered: list[tuple[str, str, bool]]
    choice_fields: list[tuple[str, tuple[str, ...]]]
    outcomes: list[tuple[str, tuple[str, ...]]]
    defaults: list[str]
    joint_defaults: list[str]
    motors: list[tuple[str, str, str]]
    axes: tuple[str, str]
    centre: str
    start: list[float]


def _scopes(chain: Chain) -> list[str]:
    """Return the prefixes of the tips' functions."""
    return [f"{tip.name}_" if tip.name else "" for tip in chain.tips]


def _reason_classes() -> list[int]:
    """Return the number of the fault of each reason."""
    faults = [fault for fault, _ in FAULTS]
    return [faults.index(fault) for _, fault, _ in REASONS]


def _choice_fields(fields: tuple[Field, ...]) -> list[tuple[str, tuple[str, ...]]]:
    """Return the fields that take one of several constants, with these."""
    return [(f.name, f.choices) for f in (*fields, *INPUT) if f.choices]


def controller_page(
    name: str, chain: Chain, scalar: Scalar, placement: Placement, *, bounded: bool, pairs: Sequence[str] = ()
) -> ControllerPage | None:
    """Return the template variables of a robot's controller; None without one."""
    if not has_controller(chain, scalar):
        return None
    prefix, index = name.upper(), "loop_motors[i]" if chain.loops else "i"
    fields = present(config_of(chain), chain, bounded=bounded)
    checks = {field.name: check_of(field) for field in fields}
    held = pairs_of(chain, pairs)
    return ControllerPage(
        n=len(chain.motor_coordinates),
        interface=IMPEDANCE.interface(name),
        library=IMPEDANCE.functions(name, callers="\n".join(checks.values())),
        loops_interface=LOOPS.interface(name),
        loops=LOOPS.functions(name),
        module_interface=MODULE.interface(name),
        module=MODULE.functions(name, ("controller.c", *(f"{each.name}.c" for each in companions_of(chain)))),
        tool=chain.runtime_tool,
        bounded=bounded,
        companions=companion_pages(name, chain),
        tips=len(chain.tips),
        pairs=held,
        scopes=_scopes(chain),
        status=STATUS,
        modes=MODES,
        faults=FAULTS,
        reasons=REASONS,
        seen=list(SEEN.items()),
        reason_classes=_reason_classes(),
        refusals=REFUSALS,
        commands=COMMANDS,
        stated=[field.name for field in STATED],
        turns=_turns(chain),
        errors=errors_of(name, chain, fields),
        checks=checks,
        structs=_structs(chain, prefix, fields, len(held)),
        memory=[_without_padding(struct_of(chain, prefix, *each, pairs=len(held))) for each in RECORDS],
        ranges=RANGES,
        remembered=[(f.name, f.memory, bool(f.shape)) for f in OUTPUT if f.memory],
        choice_fields=_choice_fields(fields),
        outcomes=_outcomes(chain),
        defaults=[line for f in fields for line in defaults(f, prefix)],
        joint_defaults=joint_defaults(fields, name, index),
        motors=_motors(chain),
        axes=(placement.translation_axes or "base", placement.rotation_axes),
        centre=", ".join(map(repr, placement.centre)),
        start=[chain.start[k] for k in chain.actuated],
    )


def _structs(chain: Chain, prefix: str, fields: tuple[Field, ...], pairs: int) -> list[Struct]:
    """Return the structs of the header; the configuration has these fields."""
    tables = (("config", _STRUCTS[0][1], fields), *_STRUCTS[1:])
    return [struct_of(chain, prefix, *each, _SECTIONS.get(each[0]), pairs=pairs) for each in tables]


def _turns(chain: Chain) -> list[int]:
    """Return 1 for each motor a turn of which leaves the robot the same, else 0."""
    return [int(_makes_whole_turns(chain, index)) for index in range(len(chain.motor_coordinates))]


def _makes_whole_turns(chain: Chain, index: int) -> bool:
    """Return whether the robot is the same a turn of a coordinate farther: all its joints make whole turns."""
    moved = [joint for joint in chain.joints if joint.coordinate == index]
    whole = all(not joint.prismatic and float(joint.multiplier).is_integer() for joint in moved)
    return whole and not chain.loops and chain.motor_coordinates[index].type == "continuous"


def _outcomes(chain: Chain) -> list[tuple[str, tuple[str, ...]]]:
    """Return name and words of the enumerations that a step reports."""
    tables = {"mode": MODES, "fault": FAULTS, "refusal": REFUSALS, "reason": REASONS}
    words = [(name, tuple(row[0] for row in rows)) for name, rows in tables.items()]
    for each in companions_of(chain):
        words += [(name, tuple(word for word, _ in rows)) for name, rows in each.words]
    return [*words, ("command", COMMANDS)]


def _without_padding(struct: Struct) -> Struct:
    """Return a record of the memory whose size is a multiple of 8: all its bytes are in the checksum."""
    halves = sum(math.prod(field.extents) for field in struct.fields if field.format.endswith("4"))
    if halves % 2 == 0:
        return struct
    padding = Member("padding", "int padding", ["/* of the record */"], "i4", [], False, "")
    return replace(struct, fields=[*struct.fields, padding])


def _motors(chain: Chain) -> list[tuple[str, str, str]]:
    """Return name, source and C initialiser of the tables of motors."""
    motors = motor_tables(chain)
    rows = (
        ("motor_inertia", motors.inertia_source, motors.motor_inertia),
        ("torque_rate", motors.rate_source, motors.torque_rate),
    )
    return [(name, source, ", ".join(map(bound_text, values))) for name, source, values in rows]


def errors_of(name: str, chain: Chain, fields: Sequence[Field] = CONFIG) -> list[tuple[str, int, str]]:
    """Return name, code and text of every error; a number of the robot's file that may be its cause is named."""
    general = [(error, -1 - k, text.replace("NAME", name)) for k, (error, text) in enumerate(ERRORS)]
    general += [
        (f"config_{field.name}", _FIRST_FIELD_ERROR - k, _error_text(field))
        for k, field in enumerate(CONFIG)
        if field in fields or field.name in {each.name for each in fields}
    ]
    causes: dict[str, str] = {}
    lint = optional("files.plausibility")
    for doubt in lint.find_doubts(chain) if lint else ():
        causes.setdefault(doubt.about, f"; {printable(chain.source)}: {doubt.text}")
    return [(error, code, text + causes.get(_CAUSES.get(error, ""), "")) for error, code, text in general]


def _error_text(field: Field) -> str:
    """Return what a refused field is told: its condition, or that it has no default, and why."""
    if field.default:
        return f"{field.name}: {field.rule}"
    return f"{field.name} [{field.unit}]: state it, since {field.reason}; {field.rule}"
