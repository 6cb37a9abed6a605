# SPDX-License-Identifier: MIT
"""Kernels of springs between two tips: energy, wrench, torque, task and joint stiffness of one energy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from stiffgen.core.family import Asked
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic import quantities
from stiffgen.core.symbolic.arguments import BASE_POSE, SYMMETRIC_PART, Argument, Q
from stiffgen.core.symbolic.kernel import Kernel, Span
from stiffgen.core.symbolic.program import Program
from stiffgen.core.symbolic.quantities import Blocks
from stiffgen.families.pair import tips
from stiffgen.families.pair.programs import EnergyOfTips
from stiffgen.families.pair.springs import (
    BOUNDED,
    REST,
    ROTATION_STIFFNESS,
    TOOL_POSES,
    TRACE,
    TRANSLATION_STIFFNESS,
    PairKind,
    seen_from_first,
)
from stiffgen.families.pair.way import TipPair, pairs_of
from stiffgen.families.springs.kernels import spring_joint_terms, spring_terms
from stiffgen.families.springs.springs import Spring

ENERGY = Argument("energy", (), "J", "energy U of the spring, 0 at rest")
WRENCHES = Argument.referred(
    "wrench", (12,), "N, N m",
    "F = dU, (force, moment) on A, then on B, that balance the spring, in {reference} axes, moments about each tip's "
    "origin",
    blocks=Blocks(quantities.WRENCH.kinds, lambda row: row // 3 % 2),
)  # fmt: skip
TASK_STIFFNESS = Argument.referred(
    "task_stiffness", (12, 12), "N/m, N, N m",
    "covariant Hessian of U on the twists (linear, angular) of A, then of B, {reference} axes at each tip's origin; "
    "bitwise symmetric", symmetric=True,
    blocks=Blocks(quantities.STIFFNESS.kinds, lambda row, column: row // 3 % 2 + column // 3 % 2),
)  # fmt: skip
TORQUE = Argument("torque", ("n",), "N m or N", "-dU/dq: torque that the spring exerts on the joints")
JOINT_STIFFNESS = Argument(
    "joint_stiffness", ("n", "n"), "N m/rad", "d2U/dq2 = -d torque/dq, bitwise symmetric", symmetric=True
)


_ABSOLUTE = (
    "Kt acts on the middle of the origins of A and B, half of Ko on the rotation of each: a common turn costs what it "
    "costs an ordinary spring, and the relative rotational stiffness grows by Ko/4. Of rest, the absolute spring reads "
    "the rotation alone. The energy is smooth everywhere."
)
_TWO = "U = (pm - p0)^T Kt (pm - p0)/2 + (tr(G (I - R0^T A)) + tr(G (I - R0^T B)))/2, pm = (pa + pb)/2"
_HESSIAN = "d2U/dq2 = Ja^T (Kaa Ja + Kab Jb) + Jb^T (Kba Ja + Kbb Jb) + load terms of Fa and Fb"
EQUILIBRIUM = Argument.referred(
    "equilibrium", (4, 4), "m",
    "homogeneous pose [R0 p0; 0 1] in the {reference} frame: p0 is the middle of the origins of A and B at rest, R0 "
    "the rotation of A; R0 must be a rotation",
    symbol="H0", varying=True, draw=quantities.random_poses, blocks=quantities.pose_within("reach"), turns=True,
)  # fmt: skip
_IN_BASE = f"in {{reference}} axes; positive definite, {SYMMETRIC_PART}"
HELD_TRANSLATION = Argument.referred(
    "translation_stiffness", (3, 3), "N/m", _IN_BASE, symbol="Kt", symmetric_part=True,
    draw=quantities.PositiveDefinite(300.0), largest="translation_stiffness",
)  # fmt: skip
HELD_ROTATION = replace(
    ROTATION_STIFFNESS, meaning=f"in the axes of the equilibrium; positive definite, {SYMMETRIC_PART}"
)
RELATIVE_TRANSLATION = replace(TRANSLATION_STIFFNESS, name="relative_translation_stiffness", symbol="KtAB")
RELATIVE_ROTATION = replace(ROTATION_STIFFNESS, name="relative_rotation_stiffness", symbol="KoAB")


_HELD = EQUILIBRIUM, REST, HELD_TRANSLATION, HELD_ROTATION
PARAMETERS: dict[str, tuple[Argument, ...]] = {
    "pair": TRACE.parameters,
    "pair_bounded": BOUNDED.parameters,
    "absolute": _HELD,
    "bimanual": (*_HELD, RELATIVE_TRANSLATION, RELATIVE_ROTATION),
}
"""Arguments of each kind of energy behind the configuration."""


@dataclass(frozen=True)
class _TipEnergy:
    """Energy of two tips, from which six kernels follow.

    Attributes:
        group: group of the kernels.
        words: name of the energy in summaries.
        equation: formula of the energy.
        hessian: formula of the joint stiffness.
        note: information for callers.
        in_joints: program of energy, torque, joint stiffness, by the results' records; with its arguments and span.
        of_tips: the energy on the poses of both tips, with its arguments; its span.

    """

    group: str
    words: str
    equation: str
    hessian: str
    note: str
    in_joints: Callable[..., Program]
    arguments: tuple[Argument, ...]
    span: Span
    of_tips: EnergyOfTips
    span_of_tips: Span

    def kernels(self) -> tuple[Kernel, ...]:
        """Return the six kernels."""
        joints = partial(Kernel, group=self.group, arguments=self.arguments, note=self.note, batch=True, span=self.span)
        tips = partial(joints, arguments=self.of_tips.inputs, span=self.span_of_tips)
        program, quantity, words = self.in_joints, self.of_tips.quantity, self.words
        return (
            joints(
                name="energy", results=(ENERGY,), summary=f"Energy of {words}.", equation=self.equation,
                program=partial(program, energy=ENERGY),
            ),
            tips(
                name="wrench", results=(WRENCHES,),
                summary=f"Wrenches of {words} on both tips: gradient of its energy.",
                equation="F = dU", program=partial(quantity, result=WRENCHES, part="F"),
            ),
            tips(
                name="task_stiffness", results=(TASK_STIFFNESS,),
                summary=f"Task stiffness of {words} on both tips: covariant Hessian of its energy.",
                equation="K_ij = d2/dx_i dx_j U at p + v, exp([w]) R of both tips, x = (va, wa, vb, wb) = 0",
                program=partial(quantity, result=TASK_STIFFNESS, part="K"),
            ),
            joints(
                name="torque", results=(TORQUE,), summary=f"Joint torque of {words}.",
                equation="-dU/dq = -Ja^T Fa - Jb^T Fb", program=partial(program, torque=TORQUE),
            ),
            joints(
                name="joint_stiffness", results=(JOINT_STIFFNESS,),
                summary=f"Joint stiffness of {words}: the exact tangent of its torque.",
                equation=self.hessian, program=partial(program, joint_stiffness=JOINT_STIFFNESS),
                part_of="linearization",
            ),
            joints(
                name="linearization", results=(ENERGY, TORQUE, JOINT_STIFFNESS),
                summary=f"Energy, torque and joint stiffness of {words} in one call.",
                equation=f"U, -dU/dq, {self.hessian}",
                program=partial(program, energy=ENERGY, torque=TORQUE, joint_stiffness=JOINT_STIFFNESS),
            ),
        )  # fmt: skip


def _seen_from_first(chain: Chain, spring: Spring, **results: Argument) -> Program:
    """Return the program of a spring on the joints from A to B; the energy alone needs no columns."""
    if set(results) == {"energy"}:
        return spring_terms(chain, spring, (results["energy"],), "U")
    return spring_joint_terms(chain, spring, **results)


def _between(of: Asked, pair: TipPair, kind: PairKind) -> _TipEnergy:
    """Return the spring between the tips."""
    tools = (TOOL_POSES,) if of.runtime_tool else ()
    group, seen = pair.group(f"pair{kind.suffix}"), (Q, *tools, *kind.parameters)
    spring = seen_from_first(group, kind, has_tools=of.runtime_tool)
    hessian = "d2U/dq2 = dJ^T/dq . F + J^T (K + Gamma F) J on the joints from A to B, F and K of B seen from A"
    return _TipEnergy(
        group=group,
        words="the spring between the tips",
        equation=kind.equation,
        hessian=f"{hessian} (Lachner, Nah, Hogan 2025)",
        note=f"{pair.note} {kind.domain}",
        in_joints=partial(_seen_from_first, spring=spring),
        arguments=seen,
        span=pair.on_the_way,
        of_tips=EnergyOfTips(partial(tips.relative, kind), (*_base(of), *seen)),
        span_of_tips=pair.from_the_base,
    )


def _held(of: Asked, pair: TipPair, kind: str) -> _TipEnergy:
    """Return the absolute spring of both tips, or its sum with the spring between them."""
    tools = (TOOL_POSES,) if of.runtime_tool else ()
    define, words, equation, note = tips.absolute, "the spring that holds both tips", _TWO, _ABSOLUTE
    if kind == "bimanual":
        define, words = tips.bimanual, "the springs that hold both tips and between them"
        equation, note = (
            "sum of the energies of absolute and pair",
            f"{_ABSOLUTE} The spring between the tips is that of pair.",
        )
    inputs = (*_base(of), Q, *tools, *PARAMETERS[kind])
    energy, span = EnergyOfTips(define, inputs), pair.from_the_base
    return _TipEnergy(
        group=pair.group(kind),
        words=words,
        equation=equation,
        hessian=_HESSIAN,
        note=f"{pair.note} {note}",
        in_joints=energy.in_joints,
        arguments=inputs,
        span=span,
        of_tips=energy,
        span_of_tips=span,
    )


def _base(of: Asked) -> tuple[Argument, ...]:
    return (BASE_POSE,) if of.floating else ()


def kinds_of(springs: tuple[Any, ...]) -> tuple[str, ...]:
    """Return the kinds of energies: all, without the bounded spring where tips do not have it."""
    has_bounded = any(each.name == "spring_bounded" for each in springs)
    return tuple(kind for kind in PARAMETERS if has_bounded or kind != "pair_bounded")


def pair_kernels(of: Asked) -> Iterator[Kernel]:
    """Yield the kernels of the pairs that the user chose."""
    for pair in pairs_of(of.chain, of.pairs):
        for kind in kinds_of(of.springs):
            made = {"pair": TRACE, "pair_bounded": BOUNDED}.get(kind)
            energy = _between(of, pair, made) if made else _held(of, pair, kind)
            yield from energy.kernels()
