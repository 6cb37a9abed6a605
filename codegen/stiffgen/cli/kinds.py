# SPDX-License-Identifier: MIT
"""Compare all kernels with their oracles on the smallest robot of every kind: ``stiffgen verify --kinds``.

A folder is one robot, and shows nothing of what its robot lacks: a kernel that drops the multiplier of mimic joints is
right on an arm without one. The functions are CasADi's, of which C is printed: nothing is compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from stiffgen.core.errors import StiffgenError, listed
from stiffgen.core.family import is_there
from stiffgen.core.folder import temporary_folder
from stiffgen.core.loading import read_chain
from stiffgen.core.robot.chain import Chain, ChainOptions
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_kernels, check_oracles
from stiffgen.core.verify.kernels.references import References
from stiffgen.core.verify.result import Check, attempted

_COUNT = 3
"""Number of states: a wrong program is wrong in all of them."""
_INERTIAL = (
    '<inertial><origin xyz="0.02 0.01 0.1" rpy="0.1 0.2 0.3"/><mass value="1.5"/>'
    '<inertia ixx="0.02" iyy="0.025" izz="0.015" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>'
)
_MIMIC = '<mimic joint="one" multiplier="-0.5" offset="0.3"/>'
_AXES = {"one": "0 0 1", "two": "0.6 0 0.8", "three": "0 1 0"}


@dataclass(frozen=True)
class RobotKind:
    """Kind of robot.

    Attributes:
        joints: links and joints of the smallest robot on the link ``base``, as XML.
        is_of: function of a chain that returns whether the chain has what makes the kind.
        options: options of ``load_chain``.
        pairs: pairs of tips with springs between them, where the family is there.

    """

    joints: str
    is_of: Callable[[Chain], bool]
    options: dict[str, Any] = field(default_factory=lambda: {"tip": "tip"})
    pairs: tuple[str, ...] = ()

    def chain(self, folder: Path) -> Chain:
        """Write the robot's file into a folder and read it."""
        file = folder / "kind.urdf"
        file.write_text(f'<robot name="kind"><link name="base">{_INERTIAL}</link>{self.joints}</robot>')
        return read_chain(file, ChainOptions(**self.options))


def _joint(parent: str, child: str, kind: str = "revolute", more: str = "") -> str:
    """Return a link and the joint that leads to it, of the same name."""
    return (
        f'<link name="{child}">{_INERTIAL}</link><joint name="{child}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0.05 -0.02 0.3" rpy="0.1 0.2 0.3"/><axis xyz="{_AXES[child]}"/>'
        f'<limit lower="-1" upper="1" effort="10" velocity="2"/>{more}</joint>'
    )


def _tip(parent: str, name: str = "tip") -> str:
    """Return a link that is fixed off the parent's joint: the last joint moves its origin, too."""
    return (
        f'<link name="{name}"/><joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
        '<origin xyz="0.07 0.04 -0.15" rpy="0.3 -0.2 0.5"/></joint>'
    )


def _slides(chain: Chain) -> bool:
    return any(joint.prismatic for joint in chain.without_side_joints().joints[chain.base_joints :])


def _mimics(chain: Chain) -> bool:
    return any(joint.multiplier != 1.0 for joint in chain.without_side_joints().joints)


_TWO = _joint("base", "one") + _joint("one", "two") + _tip("two")
_SLIDE = _joint("base", "one") + _joint("one", "two", "prismatic") + _tip("two")
_FOLLOWER = _joint("base", "one") + _joint("one", "two", more=_MIMIC) + _joint("two", "three", "prismatic")
_FOLLOWER += _tip("three")
KINDS: dict[str, RobotKind] = {
    "turning joint": RobotKind(
        _TWO, lambda chain: any(not joint.prismatic for joint in chain.joints[chain.base_joints :])
    ),
    "slide": RobotKind(_SLIDE, _slides),
    "slide before a turning joint": RobotKind(
        _joint("base", "one", "prismatic") + _joint("one", "two") + _tip("two"), _slides
    ),
    "mimic on the path": RobotKind(_FOLLOWER, _mimics),
    "mimic beside the path": RobotKind(
        _TWO + _joint("one", "three", more=_MIMIC),
        lambda chain: len(chain.without_side_joints().joints) < len(chain.joints),
    ),
    "two tips": RobotKind(
        _TWO + _joint("one", "three", "prismatic"),
        lambda chain: len(chain.tips) > 1,
        {"tip": ["tip", "three"]},
        ("tip:three",),
    ),
    "tool at run time": RobotKind(_SLIDE, lambda chain: chain.runtime_tool, {"tip": "tip", "runtime_tool": True}),
    "floating base": RobotKind(_TWO, lambda chain: chain.floating, {"tip": "tip", "floating_base": True}),
    "mimic on a floating base with a tool at run time": RobotKind(
        _FOLLOWER,
        lambda chain: chain.floating and chain.runtime_tool and _mimics(chain),
        {"tip": "tip", "floating_base": True, "runtime_tool": True},
    ),
}
"""Kinds by name; a kind that is two at once finds programs that are right for each alone."""


def lacking_kinds(chain: Chain) -> list[str]:
    """Return the names of the kinds that a robot is not of: comparisons on it show nothing of these."""
    return [name for name, kind in KINDS.items() if not kind.is_of(chain)]


def check_kinds(
    only: Sequence[str] = (), seed: int = 0, progress: Callable[[str], None] = lambda step: None
) -> list[Check]:
    """Compare kernels with their oracles on the smallest robot of every kind.

    Args:
        only: functions to compare, by group and name ("hybrid_joint_stiffness"); none for all.
        seed: of the random generator, not negative.
        progress: called with a few words before each kind.

    Returns:
        A row for each comparison; its kernel has the kind in front ("slide: hybrid_jacobian").

    Raises:
        StiffgenError: no kind has a function of a name in ``only``.

    """
    checks: list[Check] = []
    seen: set[str] = set()
    for number, (name, kind) in enumerate(KINDS.items(), start=1):
        progress(f"{name} ({number} of {len(KINDS)})")
        with temporary_folder("kind") as folder:
            chain = kind.chain(folder)
        pairs = kind.pairs if is_there("pair") else ()
        options = KernelOptions(kernels="all,compliance,tangents", pairs=pairs)
        table = [kernel for kernel in chain_kernels(chain, options) if not only or kernel.function in only]
        seen |= {kernel.function for kernel in table}
        checks += [replace(check, kernel=f"{name}: {check.kernel}") for check in _rows(chain, table, options, seed)]
    unknown = [each for each in only if each not in seen]
    if unknown:
        raise StiffgenError(f"{listed(unknown)}: no function of any kind of robot")
    return checks


class _FunctionsOnDemand(dict[str, Callable[..., Any]]):
    """CasADi functions of a robot's kernels by qualified name, each made when it is first asked for."""

    def __init__(self, chain: Chain, options: KernelOptions) -> None:
        super().__init__()
        self._chain = chain
        self._kernels = {kernel.qualified_name: kernel for kernel in chain_kernels(chain, options)}

    def __missing__(self, name: str) -> Callable[..., Any]:
        self[name] = function = function_of_stacks(self._chain, self._kernels[name])
        return function


def _rows(chain: Chain, table: Sequence[Kernel], options: KernelOptions, seed: int) -> list[Check]:
    """Return the rows of one robot; a program that does not run for its kind is a fault."""
    references, functions = References(chain, _COUNT, seed, options), _FunctionsOnDemand(chain, options)
    checks = check_oracles(table, options)
    for kernel in table:
        checks += attempted(kernel.qualified_name, partial(check_kernels, functions, references, [kernel]))
    return checks
