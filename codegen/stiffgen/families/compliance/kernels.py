# SPDX-License-Identifier: MIT
"""Compliance of the tip: the way back from springs in the joints to the tip, under a load.

An arm rests with springs of stiffness Kth in its joints, under a wrench F. The wrench grows by dF, and keeps its
components along geodesics of the tip. The joints then move by dq and the tip by the twist C dF, with

    H = Kth - dJ^T/dq . F - J^T (Gamma F) J      dq = H^-1 J^T dF      C = J H^-1 J^T

The family is made on request: ``--kernels all,compliance``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple, Protocol

import casadi as ca
import numpy as np

from stiffgen.core.family import Asked, asked
from stiffgen.core.robot.chain import Chain, Tip
from stiffgen.core.symbolic import arguments, kinematics, pieces
from stiffgen.core.symbolic.arguments import Argument, configuration_arguments
from stiffgen.core.symbolic.connection import REPRESENTATIONS, Representation
from stiffgen.core.symbolic.kernel import Kernel
from stiffgen.core.symbolic.kinematics import Expressions
from stiffgen.core.symbolic.program import Array, Operand, Over, Program, Step
from stiffgen.core.symbolic.quantities import BlockKind, Blocks
from stiffgen.core.symbolic.steps import Congruence, Map, Shared, StraightLine, SumJoints
from stiffgen.families.compliance import expressions as compliance
from stiffgen.families.compliance.draws import stiff_springs
from stiffgen.families.contacts import expressions as contacts


class Loaded(NamedTuple):
    """Stiffness of a load in the joints, and Jacobian: with respect to coordinates, which several joints may share."""

    steps: Program
    """Steps that compute the two arrays."""
    stiffness: Array
    """dJ^T/dq . F + J^T (Gamma F) J."""
    J: Array
    """Jacobian; the steps write it for kernels that read it."""


class LoadSteps(Protocol):
    """Steps of a load: its stiffness and, if the kernel reads it, the Jacobian."""

    def __call__(self, chain: Chain, *, reads_J: bool) -> Loaded:
        """Return the steps and their arrays."""


JOINT_QUANTITIES = "loaded_hessian", "deflection", "stability"
"""Functions of the joints. The group "spatial" lacks them: one load has one Hessian."""
_ABSENT = (
    "one load has one Hessian, so that joint quantities have no representation; take {name} of hybrid, with the moment "
    "about the tip (m - p x f), or of body"
)
REQUEST = "compliance"
"""Word of --kernels for the family."""


def _quarter_of_tips(row: int, column: int) -> int:
    return row % 6 // 3 + column % 6 // 3


_COMPLIANCE = Blocks(
    (
        BlockKind("translation block", "m/N"),
        BlockKind("coupling", "rad/N"),
        BlockKind("rotation block", "rad/(N m)"),
    ),
    _quarter_of_tips,
)
_STIFFNESS = Blocks(
    (BlockKind("translation block", "N/m"), BlockKind("coupling", "N"), BlockKind("rotation block", "N m")),
    _quarter_of_tips,
)
LOAD_STIFFNESS = Argument("load_stiffness", ("n", "n"), "N m/rad", "", symmetric=True, symbol="Kload")
UNSTABLE = "NaN where the posture is unstable under its load: H is not positive definite."
_OF_SPATIAL = (
    "H is that of the tip's load, as in hybrid representation with the moment about the tip: "
    "C = X C_hybrid X^T, X = [1 [p]; 0 1]."
)
_HESSIAN = "H = Kth - dJ^T/dq . F - J^T (Gamma F) J"


def joint_stiffness(size: str) -> Argument:
    """Return the argument Kth of all joints ("n") or of the motors of closed loops ("a")."""
    of = "motors" if size == "a" else "joints"
    return Argument(
        "joint_stiffness", (size, size), "N m/rad",
        f"Kth, Hessian of the energy of the {of}' springs and of gravity; {arguments.SYMMETRIC_PART}",
        symbol="Kth", symmetric_part=True, draw=stiff_springs, largest="none",
    )  # fmt: skip


def increment(representation: Representation) -> Argument:
    """Return the change of the wrench on a tip."""
    wrench = arguments.wrench(representation)
    return replace(
        wrench, name="increment", symbol="dF", plural="increments", meaning=f"change of {wrench.meaning}",
        floating_meaning=f"change of {wrench.floating_meaning}",
    )  # fmt: skip


@dataclass(frozen=True)
class CompliantTip:
    """Kernels with one kind of load.

    ``load`` returns the steps of stiffness and Jacobian, ``size`` is the extent of the joint stiffness, ``tips`` the
    number of tips, ``prefix`` the beginning of the names of C functions, ``suffix`` the end of those of kernels,
    ``domain`` a note for all of them.
    """

    group: str
    configuration: tuple[Argument, ...]
    wrench: Argument
    increment: Argument
    load: LoadSteps
    size: str = "n"
    tips: int = 1
    prefix: str = ""
    suffix: str = ""
    domain: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the group's kernels; several tips move in more directions than their joints."""
        of_tip = ("tip_compliance",) if self.suffix else ("tip_compliance", "tip_stiffness")
        return (*of_tip, *(() if self.group == "spatial" else JOINT_QUANTITIES))

    def kernels(self) -> tuple[Kernel, ...]:
        """Return the kernels."""
        size, rows, of = self.size, 6 * self.tips, " of all tips, in their order" * bool(self.suffix)
        kernels = (
            self._kernel(
                Argument("loaded_hessian", (size, size), "N m/rad", "H, bitwise symmetric", symmetric=True),
                summary="Stiffness of the joints under a load: Hessian of the energy of springs and load.",
                equation=_HESSIAN, expressions=compliance.loaded_hessian, more=(),
            ),
            self._kernel(
                Argument("tip_compliance", (rows, rows), "m/N, 1/N, rad/(N m)", f"C{of}, bitwise symmetric",
                    symmetric=True, blocks=_COMPLIANCE),
                summary="Compliance of the tip under a load: twist of the tip per wrench.",
                equation="C = J H^-1 J^T", expressions=compliance.tip_compliance, more=("J",), note=UNSTABLE,
                as_step=_congruence,
            ),
            self._kernel(
                Argument("tip_stiffness", (rows, rows), "N/m, N, N m", f"C^-1{of}, bitwise symmetric",
                    symmetric=True, blocks=_STIFFNESS),
                summary="Stiffness of the tip under a load: wrench per twist of the tip.",
                equation="C^-1 = (J H^-1 J^T)^-1", expressions=compliance.tip_stiffness, more=("J",),
                note=f"{UNSTABLE} NaN where the Jacobian has no full row rank, too.",
            ),
            self._kernel(
                Argument("deflection", (size,), "rad or m", "dq, displacement of the joints"),
                summary="Displacement of the joints as the wrench changes.", equation="dq = H^-1 J^T dF",
                expressions=compliance.deflection, more=("J", self.increment), note=UNSTABLE,
            ),
            self._stability(
                Argument("stability", (), "N m/rad", "smallest eigenvalue of H, positive for a stable posture")
            ),
        )  # fmt: skip
        return tuple(each for each in kernels if each.name.removesuffix("_total") in self.names)

    def _kernel(
        self,
        result: Argument,
        summary: str,
        equation: str,
        expressions: Callable[..., Expressions],
        more: tuple[Argument | str, ...],
        note: str = "",
        as_step: Callable[..., StraightLine] = StraightLine,
    ) -> Kernel:
        """Return the kernel of one C function of joint stiffness, load stiffness and ``more``: "J" and arguments.

        ``as_step`` returns the step of the expressions.
        """
        springs, result = joint_stiffness(self.size), replace(result, name=f"{result.name}{self.suffix}")
        others = tuple(each for each in more if isinstance(each, Argument))

        def program(chain: Chain) -> Program:
            steps, load, J = self.load(chain, reads_J=bool(more))
            output, Kth = result.array(chain), springs.array(chain)
            if not more:
                return *steps, StraightLine((output,), expressions, (Kth, load), heading=equation)
            pack, H = packed(Kth, load)
            values = J, H, *(each.array(chain) for each in others)
            line = as_step((output,), expressions, values, heading=equation)
            per_joint = (J,) if J.name == "J" else ()  # other Jacobians have a column per coordinate
            name = f"{self.prefix}{result.name}_of"
            shared = Shared.of(name, summary, (line,), values, output, *per_joint)
            return *steps, pack, shared

        return self._record(result, others, summary, equation, program, note)

    def _record(
        self,
        result: Argument,
        others: tuple[Argument, ...],
        summary: str,
        equation: str,
        program: Callable[[Chain], Program],
        note: str,
    ) -> Kernel:
        """Return the record of a kernel with the family's arguments, then ``others``."""
        inputs = (*self.configuration, self.wrench, joint_stiffness(self.size), *others)
        notes = " ".join(filter(None, (note, _OF_SPATIAL if self.group == "spatial" else "", self.domain)))
        absent = [f"{name}{self.suffix}" for name in JOINT_QUANTITIES] if self.group == "spatial" else []
        return Kernel(
            name=result.name,
            group=self.group,
            arguments=inputs,
            results=(result,),
            summary=summary,
            equation=equation,
            program=program,
            note=notes,
            batch=True,
            on_request=REQUEST,
            absent=tuple((name, _ABSENT.format(name=name)) for name in absent),
        )

    def _stability(self, result: Argument) -> Kernel:
        """Return the kernel of the smallest eigenvalue: tridiagonal form, then bisection by one function."""
        springs, result = joint_stiffness(self.size), replace(result, name=f"{result.name}{self.suffix}")

        def program(chain: Chain) -> Program:
            steps, load, _ = self.load(chain, reads_J=False)
            pack, H = packed(springs.array(chain), load)
            n = load.shape[0]
            if n == 1:
                only = StraightLine((result.array(chain),), compliance.only_entry, (H,), heading="H is a number")
                return *steps, pack, only
            # H as a tridiagonal matrix, of which the eigenvalue's interval is halved
            form = Array("diagonal", (n,), "d"), Array("squares", (n - 1,), "s")
            intervals = [Array(f"interval{k}", (2,), "x") for k in range(compliance.CALLS + 1)]
            first = StraightLine(
                outputs=(*form, intervals[0]),
                expressions=compliance.tridiagonal,
                arguments=(H,),
                name=f"{self.prefix}tridiagonal",
                meaning="Tridiagonal form of H: diagonal, squares beside it, interval of the smallest eigenvalue",
            )
            halvings = [  # one function, called with the interval of the call before
                StraightLine(
                    outputs=(after,),
                    expressions=compliance.halved,
                    arguments=(*form, before),
                    name=f"{self.prefix}halved_interval",
                    meaning="Interval of the smallest eigenvalue, halved some times",
                )
                for before, after in itertools.pairwise(intervals)
            ]
            output = result.array(chain)
            last = StraightLine((output,), compliance.middle, (intervals[-1],), heading="smallest eigenvalue of H")
            return *steps, pack, first, *halvings, last

        kernel = self._record(
            result, (), "Stability of the posture under its load: smallest eigenvalue of H.",
            f"smallest eigenvalue of {_HESSIAN}", program, "Without a load, the smallest stiffness of the joints.",
        )  # fmt: skip
        return replace(kernel, is_gradient=True)  # an eigenvalue that occurs twice has no gradient


def _congruence(
    outputs: tuple[Array, ...], expressions: Callable[..., Expressions], arguments: tuple[Array, ...], *, heading: str
) -> Congruence:
    """Return the step of a product J H^-1 J^T, from J and the upper triangle of H."""
    _, H = arguments
    factors = Array("factors", H.shape)
    title = "H = L D L^T: rows of L, each with its entry of D^-1"
    of_H = StraightLine((factors,), compliance.packed_factors, (H,), heading=title)
    return Congruence(outputs, expressions, arguments, heading=heading, factors=of_H)


def packed(springs: Array, load: Array) -> tuple[StraightLine, Array]:
    """Return the step that computes the upper triangle of H, and its array."""
    n = load.shape[0]
    H = Array("H", (n * (n + 1) // 2,), "H")
    return StraightLine((H,), compliance.packed_hessian, (springs, load), heading="H = Kth - Kload"), H


def load_of_tip(chain: Chain, representation: Representation, wrench: Argument, *, reads_J: bool) -> Loaded:
    """Return the stiffness of a wrench on a tip, and the tip's Jacobian.

    A wrench has one load, whatever representation states it: that of the tip, which keeps its components along
    geodesics of the tip. A spatial wrench is moved to the tip for it. Where joints are coupled (mimic joints), the
    columns of the joints are summed into those of their coordinates.
    """
    if representation == "spatial":
        steps, J, load = _spatial_load(chain, wrench.array(chain), reads_J=reads_J)
    else:
        recursion, J = pieces.columns_of(chain, representation)
        steps, load = (recursion,), _tangent_of_load(chain, J, wrench.array(chain), representation)
    if not chain.coupled:
        return Loaded((*steps, *load), LOAD_STIFFNESS.array(chain), J)
    of_coordinates = Array("J_of_coordinates", (6, chain.dof), "J")
    summed = (SumJoints(J, of_coordinates, columns=True),) if reads_J else ()
    return Loaded((*steps, *load, *summed), LOAD_STIFFNESS.array(chain), of_coordinates)


def _tangent_of_load(chain: Chain, J: Array, wrench: Array, representation: Representation) -> Program:
    """Return the steps of a load's stiffness from columns of the moving joints."""
    return pieces.over_joints(
        chain, LOAD_STIFFNESS, lambda output: pieces.load_tangent(chain, J, wrench, representation, output), mirror=True
    )


def _spatial_load(chain: Chain, wrench: Array, *, reads_J: bool) -> tuple[Program, Array, Program]:
    """Return the steps of columns in spatial representation, their array, and the steps of the load at the tip.

    The load's own connection is that of the tip: the spatial one belongs to a load at the point of the body that
    passes the origin, whose Hessian is another (theory.md).
    """
    columns = 6, len(chain.joints)
    of_tip, J, pose = Array("J_of_tip", columns), Array("J", columns), Array("pose", (4, 4))
    at_tip = Array("F_at_tip", (6,))
    operands = Operand(pose, ""), Operand(wrench, "")
    steps: tuple[Step, ...] = (
        pieces.columns_and_pose(chain, of_tip, pose),
        Map("wrench with its moment about the tip", Over.ONCE, Operand(at_tip, ""), operands, compliance.wrench_at_tip),
    )
    if reads_J:
        moved = Operand(of_tip, "j"), Operand(pose, "")
        comment = "J_j = X (column j at the tip): velocity of the point that passes the origin"
        steps += (Map(comment, Over.JOINTS, Operand(J, "j"), moved, compliance.column_at_origin),)
    return steps, J, _tangent_of_load(chain, of_tip, at_tip, "hybrid")


def _of_tips(chain: Chain, representation: Representation, inputs: tuple[Argument, ...], *, reads_J: bool) -> Loaded:
    """Return the load of wrenches on all tips; ``inputs`` are the configuration arguments and the wrenches."""
    m, J = len(chain.joints), Array("J_of_tips", (6 * len(chain.tips), chain.dof), "J")
    S, u = Array("S", (6, m)), Array("u", (6, m))
    expressions = partial(contacts.columns_of_loads, representation=representation, jacobians=reads_J)
    heading = "columns S of the joints at one point; covectors u of the loads beyond each joint"
    outputs: tuple[Array, ...] = (S, u)
    if reads_J:
        heading, outputs = f"{heading}; Jacobians of the tips", (S, u, J)
    values = tuple(argument.array(chain) for argument in inputs)
    step = StraightLine(outputs, expressions, values, heading=heading, columns=2)

    def pairs(output: Array) -> Program:
        return pieces.pairs_on_the_way(chain, S, u, output, "Kload_ij = S_i . u_j", ca.dot)

    steps = step, *pieces.over_joints(chain, LOAD_STIFFNESS, pairs, mirror=True)
    return Loaded(steps, LOAD_STIFFNESS.array(chain), J)


def compliance_of_tip(configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of a robot with one tip, or of a tip among several."""
    kernels: list[Kernel] = []
    for rep in REPRESENTATIONS:
        wrench = arguments.wrench(rep)
        load = partial(load_of_tip, representation=rep, wrench=wrench)
        kernels += CompliantTip(rep, _seen(configuration, rep), wrench, increment(rep), load).kernels()
    return tuple(kernels)


def _seen(configuration: tuple[Argument, ...], representation: Representation) -> tuple[Argument, ...]:
    """Return the configuration that a representation needs: all but the base's pose in body representation."""
    return tuple(each for each in configuration if not (each.is_base_pose and representation == "body"))


def _of_all_tips(tips: Sequence[Tip], configuration: tuple[Argument, ...]) -> tuple[Kernel, ...]:
    """Return the kernels of loads at all tips: the compliance has a block C_ab = J_a H^-1 J_b^T per pair of tips."""
    names, kernels = [tip.name for tip in tips], list[Kernel]()
    of_all = tuple(each if each.of_configuration else each.of_all_tips(names) for each in configuration)
    for rep in REPRESENTATIONS:
        seen, wrenches = _seen(of_all, rep), arguments.wrench(rep).of_all_tips(names)
        load = partial(_of_tips, representation=rep, inputs=(*seen, wrenches))
        increments = increment(rep).of_all_tips(names)
        kernels += CompliantTip(rep, seen, wrenches, increments, load, tips=len(tips), suffix="_total").kernels()
    return tuple(kernels)


def compliance_kernels(of: Asked) -> tuple[Kernel, ...]:
    """Return the kernels of a chain: of each tip, also in motor coordinates, and of all tips."""
    chain, configuration = of.chain, of.configuration
    several = len(chain.tips) > 1
    kernels: list[Kernel] = []
    for tip in chain.tips:
        owner = tip if several else None
        of_tip = (replace(each, tip=owner) for each in compliance_of_tip(configuration))
        kernels += (each for each in of_tip if _is_finite(chain, each))
        kernels += (replace(each, tip=owner) for each in asked("compliance, tip", of))
    if several:
        kernels += (each for each in _of_all_tips(chain.tips, configuration) if _is_finite(chain, each))
    return tuple(kernels)


def _is_finite(chain: Chain, kernel: Kernel) -> bool:
    """Return False for the stiffness of a tip that cannot move in all six directions, which is infinite."""
    return kernel.name != "tip_stiffness" or _rank(kernel.scope(chain)) >= 6


@cache
def _rank(chain: Chain) -> int:
    """Return the rank of the Jacobian at a configuration without symmetries."""
    configuration = configuration_arguments(runtime_tool=chain.runtime_tool)
    symbols = [ca.SX.sym(a.name, *a.shape) for a in (argument.array(chain) for argument in configuration)]
    columns = kinematics.joint_jacobian(chain, *symbols, representation="body").result
    J = ca.SX.zeros(6, chain.dof)
    for k, joint in enumerate(chain.joints):
        J[:, joint.coordinate] += joint.multiplier * columns[:, k]
    q, tool_pose = np.sin(np.arange(1.0, len(chain.coordinates) + 1.0)), np.eye(4)  # no two positions are related
    values = (q, tool_pose) if chain.runtime_tool else (q,)
    jacobian = np.array(ca.Function("J", symbols, [ca.densify(J)])(*values))
    return int(np.linalg.matrix_rank(jacobian, tol=1e-9 * np.abs(jacobian).max()))
