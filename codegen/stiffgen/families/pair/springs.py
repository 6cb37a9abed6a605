# SPDX-License-Identifier: MIT
"""Springs between two tips: arguments, and the energy as a potential of the second tip's pose seen from the first.

Rest: pose (E0, d0) of tip b in tip a. Kt and Ko are in a's axes at rest. With A = Ra and B = Rb E0^T, equal at rest,

    e = pb - pa - (A + B) d0/2                      displacement at the point half-way between the tips at rest
    U = e^T S e/2 + tr(G (I - A^T B))               S = (A Kt A^T + B Kt B^T)/2,  G = tr(Ko)/2 I - Ko

U is a polynomial in the poses, smooth everywhere, and unchanged when the tips are exchanged (with the inverse of the
rest pose, and the stiffnesses in b's axes). Seen from a, with (p, R) the pose of b, (p0, R0) the rest pose and
N = R R0^T, U is half the spring whose stiffness stands still plus half the one whose stiffness turns with b:

    U = (e^T Kt e + (N^T e)^T Kt (N^T e))/4 + tr(G (I - N)),    e = p - p0 + (R - R0) c,    c = -E0^T d0/2

Tools at run time, (Ra', ta) and (Rb', tb) in the tips' frames, leave the potential of the pose of link b seen from
link a: its rest pose is that of the links, c = tb - Rb' E0^T d0/2, and the stiffnesses are turned by Ra'.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffgen.core.robot.geometry import FloatArray
from stiffgen.core.symbolic.arguments import SYMMETRIC_PART, Argument
from stiffgen.core.symbolic.kinematics import Kind, Section
from stiffgen.core.symbolic.quantities import (
    Blocks,
    PositiveDefinite,
    Sampling,
    pose_within,
    random_poses,
)
from stiffgen.core.symbolic.stiffness import symmetric_from_upper
from stiffgen.families.springs.parts import Displacement, Terms, bounded, trace_form
from stiffgen.families.springs.springs import FORCE_LIMIT, MOMENT_LIMIT, Spring

_IN_TOOL = pose_within("tool")


def _two_poses(to: Sampling) -> FloatArray:
    """Draw a pose for each of two tips."""
    one, other = (random_poses(Sampling(to.random, to.count, (4, 4), to.chain, to.values)) for _ in range(2))
    return np.stack([one, other], axis=1)


TOOL_POSES = Argument(
    "tool_poses", (2, 4, 4), "m",
    "homogeneous poses [R p; 0 1] of the tools of A and B in the tips' frames, such as one frame of an object that "
    "both hold; R must be rotations",
    symbol="T", draw=_two_poses, blocks=Blocks(_IN_TOOL.kinds, lambda _, row, column: _IN_TOOL.number(row, column)),
    turns=True,
)  # fmt: skip
REST = Argument(
    "rest", (4, 4), "m", "homogeneous pose [E0 d0; 0 1] of tip B in tip A at which the spring is at rest; E0 must be a "
    "rotation", symbol="H", varying=True, draw=random_poses, blocks=pose_within("reach"), turns=True,
)  # fmt: skip
_IN_AXES = f"in the axes of tip A at rest; positive definite, {SYMMETRIC_PART}"
TRANSLATION_STIFFNESS = Argument(
    "translation_stiffness", (3, 3), "N/m", _IN_AXES, symbol="Kt", symmetric_part=True, draw=PositiveDefinite(300.0),
    largest="translation_stiffness",
)  # fmt: skip
ROTATION_STIFFNESS = Argument(
    "rotation_stiffness", (3, 3), "N m/rad", _IN_AXES, symbol="Ko", symmetric_part=True, draw=PositiveDefinite(20.0),
    largest="rotation_stiffness",
)  # fmt: skip
EQUATION = (
    "U = e^T S e/2 + tr(G (I - A^T B)), e = pb - pa - (A + B) d0/2, A = Ra, B = Rb E0^T, "
    "S = (A Kt A^T + B Kt B^T)/2, G = tr(Ko)/2 I - Ko"
)
DOMAIN = (
    "The wrenches on the two tips are opposite: an object that both hold gets no net wrench. The moment grows with the "
    "sine of the relative angle; half turns about eigenvectors of Ko are unstable equilibria. The energy is smooth "
    "everywhere, and the same when the tips are exchanged. Joints that carry both tips get no torque."
)
_BOUNDED = (
    " Force and moment are divided by the square roots and stay below force_limit and moment_limit, which must be "
    "positive and finite. kt and ko are the largest sums of absolute values in a row of Kt and Ko."
)


@dataclass(frozen=True)
class PairKind:
    """Kind of springs between two tips: word behind the group's name, parameters, equation, note."""

    suffix: str
    parameters: tuple[Argument, ...]
    equation: str
    domain: str

    @property
    def is_bounded(self) -> bool:
        """Whether force and moment have limits."""
        return FORCE_LIMIT in self.parameters


_PARAMETERS = REST, TRANSLATION_STIFFNESS, ROTATION_STIFFNESS
TRACE = PairKind("", _PARAMETERS, EQUATION, DOMAIN)
BOUNDED = PairKind(
    "_bounded", (*_PARAMETERS, FORCE_LIMIT, MOMENT_LIMIT),
    "U = 2 Vt/(1 + sqrt(1 + 2 Vt kt/force_limit^2)) + 2 Vo/(1 + sqrt(1 + 2 Vo ko/moment_limit^2)), Vt and Vo the two "
    f"terms of {EQUATION}", DOMAIN + _BOUNDED,
)  # fmt: skip


def matrices(tool_poses: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the poses (4x4) of both tools from their row-major entries."""
    one, other = ca.vertsplit(ca.vec(tool_poses), 16)
    return ca.reshape(one, 4, 4).T, ca.reshape(other, 4, 4).T


def with_limits(kind: PairKind, translation: Terms, rotation: Terms, parameters: tuple[ca.SX, ...]) -> Terms:
    """Return the sum of both parts, each within its limit for bounded springs; ``parameters`` are those of the kind."""
    if not kind.is_bounded:
        return translation + rotation
    _, Kt, Ko, force, moment = parameters
    turning = bounded(rotation, symmetric_from_upper(Ko), moment, "o")
    return bounded(translation, symmetric_from_upper(Kt), force, "t") + turning


def seen_from_first(group: str, kind: PairKind, *, has_tools: bool) -> Spring:
    """Return the spring as a potential of the second tip link's pose (p, R) seen from the first tip link."""

    def define(p: ca.SX, R: ca.SX, *given: ca.SX) -> Terms:
        tools, parameters = (matrices(given[0]), given[1:]) if has_tools else (None, given)
        rest, Kt, Ko, *_ = parameters  # then the limits of a bounded spring
        translation, rotation = _parts(p, R, tools, rest, Kt, Ko)
        return with_limits(kind, translation, rotation, parameters)

    tools = (TOOL_POSES,) if has_tools else ()
    return Spring(group, (*tools, *kind.parameters), define, kind.equation, kind.domain)


def _parts(
    p: ca.SX, R: ca.SX, tools: tuple[ca.SX, ca.SX] | None, rest: ca.SX, Kt: ca.SX, Ko: ca.SX
) -> tuple[Terms, Terms]:
    """Return translation and rotation of the energy, by the last two paragraphs of the module's head.

    (p, R) is the pose of tip link B seen from tip link A. ``rest`` is that of tip B seen from tip A without force.
    """
    Kt, Ko = symmetric_from_upper(Kt), symmetric_from_upper(Ko)
    c = -(rest[:3, :3].T @ (0.5 * rest[:3, 3]))  # from B to the point half-way at rest, in B's axes
    sections = list[Section]()
    if tools is not None:
        rest, c, Kt, Ko = _between_links(tools, rest, c, Kt, Ko)
        values = {"R0": rest[:3, :3], "p0": rest[:3, 3], "Kta": Kt, "Koa": Ko}
        title = "between the tip links: rest rotation R0, origin p0; stiffnesses in A's axes"
        sections.append(Section(title, values, {"R0": Kind.ROTATION}))
    p0, R0 = rest[:3, 3], rest[:3, :3]
    N, arm = R @ R0.T, R @ c  # N: how far B is turned from rest, in A's axes (1 at rest)
    e = p - p0 + (R - R0) @ c
    d = N.T @ e  # e in axes that turn with B
    sections += [
        Section("c: point half-way at rest in B's axes; displacement e there, in A's axes", {"c": c, "e": e}),
        Section("N = R R0^T; d = N^T e", {"N": N, "d": d}, {"N": Kind.ROTATION}),
    ]
    stands = Displacement(
        d=e, X=None, arm=arm, bend=arm, with_tip=False, section=Section("c in A's axes", {"arm": arm})
    )
    turns = Displacement(
        d=d, X=N, arm=arm - e, bend=e - arm, with_tip=True, section=Section("e - c in A's axes", {"bend": e - arm})
    )
    half = 0.5 * Kt
    first, second = (each.terms(half @ each.d, half).of_tip(k) for k, each in enumerate((stands, turns)))
    whole = first + second
    translation = Terms(whole.V, whole.F, whole.K, (*sections, *whole.sections))
    return translation, trace_form(R, rest, Ko, "base")


def _between_links(
    tools: tuple[ca.SX, ca.SX], rest: ca.SX, c: ca.SX, Kt: ca.SX, Ko: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return rest pose (4x4), centre c, Kt and Ko between the tip links from those between the tools on them.

    With the poses Xa, Xb of the tools in the links, the links' rest pose is Xa rest Xb^-1.
    """
    Xa, Xb = tools
    (Ra, pa), (Rb, pb) = (Xa[:3, :3], Xa[:3, 3]), (Xb[:3, :3], Xb[:3, 3])
    R0 = (Ra @ rest[:3, :3]) @ Rb.T
    p0 = pa + Ra @ rest[:3, 3] - R0 @ pb
    between = ca.blockcat([[R0, p0], [ca.SX.zeros(1, 3), ca.SX.ones(1)]])
    Kt_of_link, Ko_of_link = (symmetric_from_upper((Ra @ each) @ Ra.T) for each in (Kt, Ko))
    return between, pb + Rb @ c, Kt_of_link, Ko_of_link
