# SPDX-License-Identifier: MIT
"""Companions of the controller: files beside it, each usable alone. They make commands, or are the paper's law.

A companion is a record of :data:`COMPANIONS`, a C library, a header's and a source's template, and Python modules with
its C. Sources, CMake, module, stubs and README go through this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stiffgen.control.core.field import Field
from stiffgen.control.follow.fields import FOLLOW_ERRORS, FOLLOW_STATE, FOLLOW_STATUS, FOLLOW_STRUCTS
from stiffgen.control.paper_fields import PAPER_STRUCTS
from stiffgen.control.policy.fields import POLICY_ERRORS, POLICY_STATE, POLICY_STRUCTS, POLICY_WORDS
from stiffgen.control.press.fields import PRESS_ERRORS, PRESS_STAGES, PRESS_STATE, PRESS_STRUCTS
from stiffgen.control.settle.fields import SETTLE_ERRORS, SETTLE_STATE, SETTLE_STATUS, SETTLE_STRUCTS
from stiffgen.control.structs import Struct, check_of, defaults, joint_defaults, struct_of
from stiffgen.core.library import Library
from stiffgen.core.robot.chain import Chain, Tip

_HERE = Path(__file__).parent
_FIRST_FIELD_ERROR = -20
_REACH_MARGIN = 0.05
"""Share by which a pose may be farther away than the links reach: the robot's file may be that wrong."""

Words = tuple[tuple[str, str], ...]
"""Words of an enumeration with their meanings."""


def _always(chain: Chain) -> bool:
    return True


def _is_tree(chain: Chain) -> bool:
    return not chain.loops


def _is_serial(chain: Chain) -> bool:
    return len(chain.tips) == 1 and not chain.loops


@dataclass(frozen=True)
class Companion:
    """Files NAME_<name>.h and NAME_<name>.c, their class or functions in Python, and the tables of both.

    Attributes:
        name: name of the files and of the Python module.
        summary: its use, in one sentence.
        library: C of NAME_<name>.c.
        present: function that returns whether the robots with a controller have it.
        calls: classes and functions of the robot's module with their arguments.
        enumerations: enumerations of the robot's module.
        structs: name, summary and fields of each struct that Python knows, too.
        state: fields of the memory between calls; the template adds records.
        words: enumerations that Python knows, too: name, and words with meanings.
        errors: errors with texts, from -1 down; those of the configuration's fields follow.
        of_several: C that robots of several tips have behind the library's; the shared functions are the library's.

    """

    # More than twelve fields: one table row describes a companion in C, in Python and on the page.
    name: str
    summary: str
    library: Library
    calls: tuple[str, ...]
    present: Callable[[Chain], bool] = _always
    enumerations: tuple[str, ...] = ()
    structs: tuple[tuple[str, str, tuple[Field, ...]], ...] = ()
    state: tuple[Field, ...] = ()
    words: tuple[tuple[str, Words], ...] = ()
    errors: Words = ()
    of_several: Library | None = None

    @property
    def files(self) -> dict[str, str]:
        """Templates of the C files, by what follows the robot's name."""
        return {f"_{self.name}.{ending}": f"{self.name}.{ending}.j2" for ending in ("h", "c")}


SHARED = Library(_HERE / "shared", "shared.h", ("vectors.c", "matrices.c", "damping.c", "ramps.c", "poses.c"))
"""C of which the files of controller and companions contain what they use."""
FOLLOW = Library(_HERE / "follow", "follow.h", ("twists.c", "solve.c", "fold.c", "follow.c"), shared=SHARED)
"""C of every NAME_follow.c."""
CARRY = Library(_HERE / "carry", "carry.h", ("carry.c",))
"""C of the NAME_follow.c of robots with several tips, behind the other."""
POLICY = Library(_HERE / "policy", "policy.h", ("checks.c", "policy.c"), shared=SHARED)
"""C of every NAME_policy.c."""
GAINS = Library(_HERE / "gains", "gains.h", ("gains.c",), shared=SHARED)
"""C of every NAME_gains.c."""
POSTURE = Library(_HERE / "posture", "posture.h", ("posture.c",), shared=SHARED)
"""C of every NAME_find_posture.c."""
SETTLE = Library(_HERE / "settle", "settle.h", ("decay.c", "settle.c"), shared=SHARED)
"""C of every NAME_settle.c."""
PRESS = Library(_HERE / "press", "press.h", ("press.c",), shared=SHARED)
"""C of every NAME_press.c."""
LAW = Library(_HERE / "paper", "law.h", ("law.c",))
"""C of every NAME_paper.c."""

_ALL = (
    Companion(
        "follow",
        "Joint positions q0 from poses of the tips, on straight lines within all limits; says what is out of reach.",
        FOLLOW,
        ("Follow(q, sample_time=..., **fields)",),
        _is_tree,
        ("FollowStatus",),
        FOLLOW_STRUCTS,
        FOLLOW_STATE,
        (("follow", FOLLOW_STATUS),),
        FOLLOW_ERRORS,
        CARRY,
    ),
    Companion(
        "policy",
        "Port for slow commanders, such as learned policies: checks, interpolates, holds and fades their proposals.",
        POLICY,
        ("Policy(pose=..., now=..., **settings)",),
        enumerations=("PolicyRefused", "PolicyStage"),
        structs=POLICY_STRUCTS,
        state=POLICY_STATE,
        words=POLICY_WORDS,
        errors=POLICY_ERRORS,
    ),
    Companion(
        "gains",
        "Split of a torque for motors with a controller inside, and the most work that a late host costs.",
        GAINS,
        ("joint_gains(...)", "late_work(...)"),
        errors=(
            ("null", "a pointer is NULL"),
            ("number", "every argument must be finite, and no limit below 0"),
        ),
    ),
    Companion(
        "find_posture",
        "Joint positions that have the tips at poses, searched from a start on; too slow for a control loop.",
        POSTURE,
        ("find_posture(pose, start)",),
        _is_tree,
        errors=(
            ("null", "a pointer is NULL"),
            ("pose", "a pose is no pose, or start is not finite"),
            ("bounds", "lower and upper: lower must not be above upper"),
            ("no_posture", "no posture of the poses was found within the bounds; one may exist"),
        ),
    ),
    Companion(
        "settle",
        "No error at rest under friction and an unknown payload: an integral moves the commanded pose within a limit.",
        SETTLE,
        ("Settle(controller, settle_force=..., **fields)",),
        _is_serial,
        ("SettleStatus",),
        SETTLE_STRUCTS,
        SETTLE_STATE,
        (("settle", SETTLE_STATUS),),
        SETTLE_ERRORS,
    ),
    Companion(
        "press",
        "Force along an axis with a sensor's wrench: approach, contact, loss; it makes a pose and a wrench_command.",
        PRESS,
        ("Press(controller, **fields)",),
        _is_serial,
        ("PressStage",),
        PRESS_STRUCTS,
        PRESS_STATE,
        (("press_stage", PRESS_STAGES),),
        PRESS_ERRORS,
    ),
    Companion(
        "paper",
        "Law Kq(q, F) (q0 - q) - B dq within limits of torque and rate, to reproduce the paper.",
        LAW,
        ("PaperLaw(formula, **fields)",),
        _is_serial,
        structs=PAPER_STRUCTS,
    ),
)
COMPANIONS = {companion.name: companion for companion in _ALL}
"""Companions by name, in the order of their files."""


@dataclass(frozen=True)
class CompanionPage:
    """Entry of the variable ``controller.companions`` of the templates.

    Attributes:
        name, summary, calls, enumerations, words: as in :class:`Companion`.
        exports: names of classes and functions.
        interface: types and constants of the C library.
        library: functions of the C library, static.
        structs: structs that Python knows, too.
        state: memory between calls; None without one.
        errors: name, code and text.
        checks: C condition on the configuration c, by field.
        defaults, joint_defaults: C statements that set the configuration's fields, and entry i of those over joints.

    """

    # More than twelve fields: one for each variable that the companions' templates read.
    name: str
    summary: str
    calls: tuple[str, ...]
    exports: tuple[str, ...]
    enumerations: tuple[str, ...]
    words: tuple[tuple[str, Words], ...]
    interface: str
    library: str
    structs: list[Struct]
    state: Struct | None
    errors: list[tuple[str, int, str]]
    checks: dict[str, str]
    defaults: list[str]
    joint_defaults: list[str]


def companions_of(chain: Chain) -> list[Companion]:
    """Return the companions that a robot with a controller has."""
    return [companion for companion in COMPANIONS.values() if companion.present(chain)]


def companion_pages(name: str, chain: Chain) -> dict[str, CompanionPage]:
    """Return the template variables of a robot's companions, by name."""
    return {companion.name: _page(companion, name, chain) for companion in companions_of(chain)}


def _page(companion: Companion, name: str, chain: Chain) -> CompanionPage:
    """Return what the templates print of a companion: structs, checks, defaults and functions."""
    prefix = name.upper()
    structs = [(struct, summary, _with_reach(fields, chain)) for struct, summary, fields in companion.structs]
    config: Sequence[Field] = next((f for struct, _, f in structs if struct == f"{companion.name}_config"), ())
    checks = {field.name: check_of(field) for field in config}
    more = companion.of_several.functions(name) if companion.of_several and len(chain.tips) > 1 else ""
    callers = "\n".join((*checks.values(), more))
    return CompanionPage(
        name=companion.name,
        summary=companion.summary,
        calls=companion.calls,
        exports=tuple(call.partition("(")[0] for call in companion.calls),
        enumerations=companion.enumerations,
        words=companion.words,
        interface=companion.library.interface(name, callers),
        library=companion.library.functions(name, callers=callers) + more,
        structs=[struct_of(chain, prefix, *each) for each in structs],
        state=struct_of(chain, prefix, f"{companion.name}_state", "", companion.state) if companion.state else None,
        errors=_errors(companion, name, config),
        checks=checks,
        defaults=[line for field in config for line in defaults(field, prefix)],
        joint_defaults=joint_defaults(config, name),
    )


def _errors(companion: Companion, name: str, config: Sequence[Field]) -> list[tuple[str, int, str]]:
    """Return name, code and text of a companion's own errors, then of those of the configuration's fields."""
    own = [(error, -1 - k, text.replace("NAME", name)) for k, (error, text) in enumerate(companion.errors)]
    return own + [
        (f"config_{field.name}", _FIRST_FIELD_ERROR - k, f"{field.name}: {field.rule}")
        for k, field in enumerate(config)
    ]


def _with_reach(fields: tuple[Field, ...], chain: Chain) -> tuple[Field, ...]:
    """Put the reach of the robot's tips into the defaults that ask for it."""
    reach = max(_reach(chain, tip) for tip in chain.tips)
    farthest = repr(math.ceil(1e3 * (1.0 + _REACH_MARGIN) * reach) / 1e3) if math.isfinite(reach) else "HUGE_VAL"
    return tuple(replace(field, default=field.default.replace("{reach}", farthest)) for field in fields)


def _reach(chain: Chain, tip: Tip) -> float:
    """Return an upper bound on the distance from the base's origin to a tip [m]: all links in one line."""
    if chain.runtime_tool:
        return math.inf
    reach, index = math.hypot(*tip.translation), tip.joint
    while index >= 0:
        joint = chain.joints[index]
        reach += math.hypot(*joint.translation)
        if joint.prismatic:
            each = chain.coordinates[joint.coordinate - chain.base_joints]
            ends = (joint.multiplier * each.lower + joint.offset, joint.multiplier * each.upper + joint.offset)
            reach += max(map(abs, ends))
        index = joint.parent
    return reach
