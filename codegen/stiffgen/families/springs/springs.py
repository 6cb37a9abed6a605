# SPDX-License-Identifier: MIT
"""Springs on SE(3): energies U(p, R), and the wrenches, torques and stiffnesses derived from them.

A spring is defined by its energy U [J] alone: a CasADi expression of the tip's origin p [m], the tip's rotation R (both
in base axes) and parameters. All other quantities are derivatives of U, in hybrid axes (base axes, tip's origin; twist
x = (v, w), linear first):

    F = dU                      wrench that balances the spring, F_i = dU/dx_i at x = 0
    K = covariant Hessian       K_ij = d2U/dx_i dx_j at x = 0, of U(p + v, exp([w]) R)
    torque = -J^T F             joint torque of the spring, -dU/dq
    Kq = dJ^T/dq . F + J^T (K + Gamma F) J = d2U/dq2        Lachner, Nah, Hogan 2025, central equation

F and K derive from the same U. Kq is therefore the Hessian of U as a function of q: the exact tangent -d torque/dq of
the spring's torque in every configuration. The torque does no work along a closed path. For derivatives up to second
order, exp([w]) may be replaced by I + [w] + [w]^2/2.

Rotation: with E = R0^T R (axis u, angle a), G = tr(Ko)/2 I - Ko and (eta, eps) = (cos a/2, u sin a/2) the unit
quaternion of E with eta >= 0, the energies are

    trace form (Bullo and Murray 1999)    tr(G (I - E)) = tr((R - R0) G (R - R0)^T)/2 = (1 - cos a) u^T Ko u
    quaternion form                       4 eps^T Ko eps/(1 + eta)                    = 4 (1 - cos a/2) u^T Ko u
    rotation-vector form                  2 (acos(eta)/sqrt(1 - eta^2))^2 eps^T Ko eps = (a^2/2) u^T Ko u

All three energies have the stiffness Ko at the equilibrium. The vectors u and eps have the same entries in the tip's
and in the equilibrium's axes, so that Ko in either axes means the same spring.

stiffgen's springs are sums of parts with F and K in closed form (:mod:`stiffgen.families.springs.parts`); 60 digits
compare them with their energies. A potential of one's own is differentiated by CasADi.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.arguments import SYMMETRIC_PART, Argument
from stiffgen.core.symbolic.kinematics import Expressions, Section
from stiffgen.core.symbolic.placement import Axes, Placement
from stiffgen.core.symbolic.quantities import PositiveDefinite, Uniform, pose_within, random_poses
from stiffgen.core.symbolic.stiffness import symmetric_from_upper
from stiffgen.families.springs.parts import (
    Terms,
    bounded,
    by_quaternion,
    coupled,
    quaternion_factor,
    rotation_vector_factor,
    trace_form,
    translation,
)

Energy = Callable[..., ca.SX]
"""Function U(p, R, *parameters): a scalar expression of the tip's origin (3), its rotation (3x3) and parameters."""
Derivation = Callable[..., Terms]
"""Function of (p, R, *parameters) that returns energy, wrench and covariant Hessian."""

EQUILIBRIUM = Argument.referred(
    "equilibrium",
    (4, 4),
    "m",
    "homogeneous pose [R0 p0; 0 1] of the tip in the {reference} frame at which the spring is at rest; R0 must be a "
    "rotation",
    symbol="H",
    plural="equilibria",
    varying=True,
    draw=random_poses,
    blocks=pose_within("reach"),
    turns=True,
)

_AXES_TEXT = {
    "base": "in {reference} axes",
    "tip": "in the tip's axes, which rotate with the tip",
    "equilibrium": "in the axes of the equilibrium",
}
_SYMMETRIC = "positive definite, " + SYMMETRIC_PART


def _translation_stiffness(axes: Axes) -> Argument:
    return Argument.referred(
        "translation_stiffness", (3, 3), "N/m", f"{_AXES_TEXT[axes]}; {_SYMMETRIC}",
        symbol="Kt", plural="translation_stiffnesses", symmetric_part=True,
        draw=PositiveDefinite(300.0), largest="translation_stiffness",
    )  # fmt: skip


def _rotation_stiffness(axes: Axes) -> Argument:
    return Argument.referred(
        "rotation_stiffness", (3, 3), "N m/rad", f"{_AXES_TEXT[axes]}; {_SYMMETRIC}",
        symbol="Ko", plural="rotation_stiffnesses", symmetric_part=True,
        draw=PositiveDefinite(20.0), largest="rotation_stiffness",
    )  # fmt: skip


def _coupled_stiffness(translation: Axes, rotation: Axes) -> Argument:
    """Return the 6x6 stiffness, whose blocks may have axes of their own."""
    axes = _AXES_TEXT[translation] if translation == rotation else (
        f"translation {_AXES_TEXT[translation]}, rotation {_AXES_TEXT[rotation]}"
    )  # fmt: skip
    return Argument.referred(
        "stiffness", (6, 6), "N/m, N, N m", f"on (translation, rotation), {axes}; {_SYMMETRIC}",
        symbol="K", plural="stiffnesses", symmetric_part=True, draw=PositiveDefinite(30.0), largest="none",
    )  # fmt: skip


FORCE_LIMIT = Argument(
    "force_limit", (), "N", "largest force of the spring, positive", symbol="fl", plural="force_limits",
    draw=Uniform(20.0, 100.0), largest="none",
)  # fmt: skip
MOMENT_LIMIT = Argument(
    "moment_limit", (), "N m", "largest moment of the spring about the tip's origin, positive", symbol="ml",
    plural="moment_limits", draw=Uniform(5.0, 20.0), largest="none",
)  # fmt: skip


@dataclass(frozen=True)
class Spring:
    """Potential of the tip's pose.

    Attributes:
        name: group of the spring's kernels ("spring").
        parameters: arguments of the energy after p and R.
        define: energy U(p, R, *parameters), which is differentiated, or a function that returns :class:`Terms`.
        equation: formula of the energy, in one line.
        domain: information that a caller needs beyond shapes and units.

    """

    name: str
    parameters: tuple[Argument, ...]
    define: Energy | Derivation
    equation: str
    domain: str

    def energy(self, p: ca.SX, R: ca.SX, *parameters: ca.SX) -> ca.SX:
        """Return U."""
        defined = self.define(p, R, *parameters)
        return defined.V if isinstance(defined, Terms) else defined


def _softens(stiffness: str) -> str:
    return (
        f"A rotation by the angle a about the axis u stores the energy (1 - cos a) u^T {stiffness} u. The moment grows "
        f"with the sine of a. The equilibrium is unstable at rotations by pi about the eigenvectors of {stiffness} "
        f"(about all axes if {stiffness} is isotropic), and nowhere else. The energy is smooth everywhere."
    )


_BOUNDED = (
    "Force and moment are those of the group spring, divided by the square roots. They stay below force_limit and "
    "moment_limit: far away the energy grows linearly. kt and ko, the largest sums of absolute values in a row of Kt "
    "and Ko, are bounds on the eigenvalues. A direction with the smaller stiffness k pulls with at most force_limit "
    "sqrt(k/kt). At the equilibrium the task stiffness is Kt and Ko. At half turns about eigenvectors of Ko the moment "
    "is zero and the equilibrium unstable, as with the group spring. The energy is smooth everywhere. Limits must be "
    "positive and finite."
)
_CUT = "The cut locus lies at a = pi, where the torque jumps."
_LINEAR = "U = (p - p0)^T Kt (p - p0)/2"


def spring(kind: str = "trace", placement: Placement | None = None) -> Spring:
    """Return one of stiffgen's springs: "trace", "rotation_vector", "quaternion", "coupled" or "bounded".

    Args:
        kind: energy of the rotation; "coupled" is the trace form with one 6x6 stiffness, "bounded" the trace form with
            bounded force and moment.
        placement: axes and centre of stiffness; they do not change the names and shapes of the arguments.

    Raises:
        KeyError: unknown kind.

    """
    return _kinds(placement or Placement())[kind]


def _kinds(placement: Placement) -> dict[str, Spring]:
    """Return all springs by kind; stiffgen has no second list of springs.

    ``linear`` is the part of the translation, which all but the coupled spring share; Kt and Ko are read from their
    upper triangles.
    """
    rotation, axes = placement.rotation_axes, placement.translation_axes or "base"
    centre, symmetric = placement.centre, symmetric_from_upper
    remote = (
        " The translational stiffness acts on the displacement of the centre of stiffness at "
        f"({', '.join(map(repr, centre))}) m in the tip's frame."
    )
    note = remote if any(centre) else ""

    def linear(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX) -> Terms:
        return translation(p, R, H, symmetric(Kt), axes, centre)

    def trace(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> Terms:
        return linear(p, R, H, Kt) + trace_form(R, H, symmetric(Ko), rotation)

    def quaternion(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> Terms:
        meaning = "factor g = 4/(1 + eta) of the energy g eps^T Ko eps, its derivatives -fall and ddg"
        return linear(p, R, H, Kt) + by_quaternion(R, H, symmetric(Ko), rotation, quaternion_factor, meaning)

    def rotation_vector(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> Terms:
        meaning = "half angle over its sine h, by a series (near) or an arc tangent (far); factor g = 2 h^2, dg, ddg"
        return linear(p, R, H, Kt) + by_quaternion(R, H, symmetric(Ko), rotation, rotation_vector_factor, meaning)

    def saturating(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX, force: ca.SX, moment: ca.SX) -> Terms:
        turning = bounded(trace_form(R, H, symmetric(Ko), rotation), symmetric(Ko), moment, "o")
        return bounded(linear(p, R, H, Kt), symmetric(Kt), force, "t") + turning

    parameters = EQUILIBRIUM, _translation_stiffness(axes), _rotation_stiffness(rotation)
    return {
        "trace": Spring(
            "spring", parameters, trace,
            f"{_LINEAR} + tr(G (I - R0^T R)), G = tr(Ko)/2 I - Ko (Bullo and Murray 1999)",
            _softens("Ko") + note,
        ),
        "rotation_vector": Spring(
            "spring_rotation_vector", parameters, rotation_vector,
            f"{_LINEAR} + (a^2/2) u^T Ko u, a the angle and u the axis of R0^T R",
            f"A rotation stores the energy (a u)^T Ko (a u)/2 at any angle: the spring does not soften. {_CUT}{note}",
        ),
        "quaternion": Spring(
            "spring_quaternion", parameters, quaternion,
            f"{_LINEAR} + 4 (1 - cos a/2) u^T Ko u, a the angle and u the axis of R0^T R",
            f"The moment grows with 2 sin a/2: the spring softens less than the trace form. {_CUT}{note}",
        ),
        "coupled": _coupled(placement, note),
        "bounded": Spring(
            "spring_bounded", (*parameters, FORCE_LIMIT, MOMENT_LIMIT), saturating,
            "U = 2 Vt/(1 + sqrt(1 + 2 Vt kt/force_limit^2)) + 2 Vo/(1 + sqrt(1 + 2 Vo ko/moment_limit^2)), "
            "Vt = (p - p0)^T Kt (p - p0)/2, Vo = tr(G (I - R0^T R)), G = tr(Ko)/2 I - Ko",
            _BOUNDED + note,
        ),
    }  # fmt: skip


def _coupled(placement: Placement, note: str) -> Spring:
    """Return the trace form with one 6x6 stiffness of translation and rotation."""
    rotation, translation = placement.rotation_axes, placement.translation_axes or "equilibrium"

    def define(p: ca.SX, R: ca.SX, H: ca.SX, K: ca.SX) -> Terms:
        return coupled(p, R, H, symmetric_from_upper(K), (translation, rotation), placement.centre)

    return Spring(
        "spring_coupled", (EQUILIBRIUM, _coupled_stiffness(translation, rotation)), define,
        "U = e^T K11 e/2 + tr(G (I - R0^T R)) + e^T K12 s, e the displacement, s = u sin a, G = tr(K22)/2 I - K22",
        f"U >= 0; U = 0 only at the equilibrium and possibly at rotations by pi. {_softens('K22')}{note}",
    )  # fmt: skip


KINDS = tuple(_kinds(Placement()))
TRACE = spring()


def derivatives(spring: Spring, p: ca.SX, R: ca.SX, parameters: Sequence[ca.SX]) -> Terms:
    """Return energy, wrench and covariant Hessian, docs/theory.md (5), in hybrid axes.

    Of an energy, CasADi differentiates U(p + v, M R) with respect to v and the nine entries of M = I + [w] + [w]^2/2.
    The chain rule from M to w is written out, since the derivatives of M with respect to w are constants.
    """
    defined = spring.define(p, R, *parameters)
    if isinstance(defined, Terms):
        return defined
    origin, turn = ca.SX.sym("p", 3), ca.SX.sym("M", 3, 3)
    generators = [ca.skew(ca.DM.eye(3)[:, k]) for k in range(3)]
    # First derivative of p + v and of the entries of M (12) with respect to the twist (v, w) at zero.
    first = ca.SX(ca.sparsify(ca.diagcat(ca.DM.eye(3), ca.horzcat(*(ca.vec(each) for each in generators)))))

    def second(i: int, j: int) -> ca.SX:
        """Return the second derivative of the entries of M with respect to w_i and w_j."""
        return ca.SX(ca.sparsify(ca.vec(generators[i] @ generators[j] + generators[j] @ generators[i]) / 2))

    moved = spring.energy(origin, turn @ R, *parameters)
    variables, point = ca.vertcat(origin, ca.vec(turn)), ca.densify(ca.vertcat(p, ca.vec(ca.SX.eye(3))))
    hessian, gradient = ca.substitute(list(ca.hessian(moved, variables)), [variables], [point])
    K = first.T @ hessian @ first
    for i in range(3):
        for j in range(3):
            K[3 + i, 3 + j] += ca.dot(second(i, j), gradient[3:12])
    return Terms(defined, first.T @ gradient, K)


def terms(chain: Chain, pose: ca.SX, *parameters: ca.SX, spring: Spring, parts: str) -> Expressions:
    """Return the quantities that ``parts`` selects, row-major, stacked.

    "U" selects the energy, "F" the wrench, "K" the covariant Hessian, "k" the upper triangle of the Hessian, "s" the
    sums of absolute values in its rows.
    """
    quantities = derivatives(spring, pose[:3, 3], pose[:3, :3], parameters)
    K = symmetric_from_upper(quantities.K)
    values: dict[str, Callable[[], ca.SX]] = {
        "U": lambda: quantities.V,
        "F": lambda: quantities.F,
        "K": lambda: ca.vec(K.T),
        "k": lambda: ca.vec(ca.triu(K).T),
        "s": lambda: ca.vertcat(*(sum(map(ca.fabs, ca.horzsplit(K[row, :])), ca.SX(0)) for row in range(6))),
    }
    sections = quantities.sections
    if "K" in parts or "s" in parts:  # its entries stand in both triangles
        sections += (Section("covariant Hessian", {"hessian": K}, shared=True),)
    return Expressions(ca.vertcat(*(values[part]() for part in parts)), sections)
