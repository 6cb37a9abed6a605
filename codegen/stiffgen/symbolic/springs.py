# SPDX-License-Identifier: MIT
"""Springs on SE(3): an energy U(p, R), and everything that follows from it by differentiation.

A spring is defined once, by its energy U [J] as a CasADi expression of the tip's origin p [m], the tip's rotation R
(both in base axes) and parameters. From it follow, in hybrid axes (base axes, tip's origin; twist x = (v, w), linear
first):

    F = dU                      wrench that the spring takes to be held at x, F_i = dU/dx_i at x = 0
    K = covariant Hessian       K_ij = d2U/dx_i dx_j at x = 0, of U(p + v, exp([w]) R)
    torque = -J^T F             joint torque of the spring, -dU/dq
    Kq = dJ^T/dq . F + J^T (K + Gamma F) J = d2U/dq2        Lachner, Nah, Hogan 2025, central equation

F and K belong to one U, so that Kq is the Hessian of U along the forward kinematics: the exact tangent -d torque/dq of
the spring's torque, in every posture, and the torque does no work round a closed orbit. For derivatives up to second
order exp([w]) may be replaced by I + [w] + [w]^2/2.

Rotation. With E = R0^T R (axis u, angle a), G = tr(Ko)/2 I - Ko and (w, v) = (cos a/2, u sin a/2) the unit quaternion
of E with w >= 0, the energies are

    trace form (Bullo and Murray 1999)    tr(G (I - E)) = tr((R - R0) G (R - R0)^T)/2 = (1 - cos a) u^T Ko u
    quaternion form                       4 v^T Ko v/(1 + w)                          = 4 (1 - cos a/2) u^T Ko u
    rotation-vector form                  2 (acos(w)/sqrt(1 - w^2))^2 v^T Ko v        = (a^2/2) u^T Ko u

All have the stiffness Ko at the equilibrium. Seen in the tip's axes u and v are what they are in the equilibrium's, so
that Ko in either means the same spring. The second expression of the trace form is the one used: near the equilibrium
nothing cancels in it, nor in its derivatives. v is taken from R - R0 for the same reason, and from that row of the
quaternion's products 4 (w, v) (w, v)^T, all linear in E, which is largest: it keeps its digits up to the cut locus at
a = pi. acos(w)/sqrt(1 - w^2) is a power series in 1 - w^2 near w = 1 and analytic from there to w = 0 and beyond.

Where the quaternion is used, it is differentiated as what it is: a small turn by y, seen in the equilibrium's axes,
makes (1 - |y|^2/8, y/2) * (w, v) of it, exact up to second order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kinematics import Expressions
from stiffgen.symbolic.stiffness import symmetric_from_upper

Energy = Callable[..., ca.SX]
"""U(p, R, *parameters): a scalar expression of the tip's origin (3), its rotation (3x3) and the parameters."""

EQUILIBRIUM = Argument(
    "equilibrium",
    (4, 4),
    "m",
    "homogeneous pose [R0 p0; 0 1] of the tip in the base frame at which the spring is at rest; R0 must be a rotation",
    symbol="H",
    plural="equilibria",
    varying=True,
)
Axes = Literal["base", "tip", "equilibrium"]
AXES: tuple[Axes, ...] = ("base", "tip", "equilibrium")
"""Axes in which a stiffness may be given: of the base, the tip (they turn with it), or the tip at the equilibrium."""

TRANSLATION_STIFFNESS = Argument(
    "translation_stiffness",
    (3, 3),
    "N/m",
    "in base axes; symmetric, positive definite, only the upper triangle is read",
    symbol="Kt",
    plural="translation_stiffnesses",
    triangle=True,
)
ROTATION_STIFFNESS = Argument(
    "rotation_stiffness",
    (3, 3),
    "N m/rad",
    "in the axes of the equilibrium; symmetric, positive definite, only the upper triangle is read",
    symbol="Ko",
    plural="rotation_stiffnesses",
    triangle=True,
)


@dataclass(frozen=True)
class Spring:
    """Potential of the tip's pose.

    ``name`` is the group of its kernels ("spring"), ``parameters`` are what its energy takes after p and R,
    ``equation`` is the energy in a line, ``domain`` what a caller must know of it beyond shapes and units. With
    ``turned``, the first parameter is the equilibrium, and the energy takes the unit quaternion (w, v) of R0^T R,
    w >= 0, between R and the parameters.
    """

    name: str
    parameters: tuple[Argument, ...]
    energy: Energy
    equation: str
    domain: str
    turned: bool = False


@dataclass(frozen=True)
class Placement:
    """Axes and centre of the stiffnesses of springs.

    ``centre`` is the centre of stiffness in the tip's frame [m]: the point whose displacement the translation stiffness
    sees. None as translation axes: the base's, for a coupled stiffness the equilibrium's.
    """

    translation_axes: Axes | None = None
    rotation_axes: Axes = "equilibrium"
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)


def half_form(x: ca.SX, matrix: ca.SX) -> ca.SX:
    """Return x^T A x / 2 for a symmetric A, written so that its derivative is A x and no more."""
    total = ca.SX(0)
    for i in range(x.shape[0]):
        row = 0.5 * matrix[i, i] * x[i]
        for j in range(i + 1, x.shape[0]):
            row += matrix[i, j] * x[j]
        total += x[i] * row
    return total


def _displacement(p: ca.SX, R: ca.SX, H: ca.SX, axes: Axes, centre: tuple[float, float, float]) -> ca.SX:
    """Return the displacement of the centre of stiffness from the equilibrium, in ``axes`` [m]."""
    away = p - H[:3, 3]
    if any(centre):
        away += (R - H[:3, :3]) @ ca.SX(ca.sparsify(ca.DM(centre)))
    return {"base": away, "tip": R.T @ away, "equilibrium": H[:3, :3].T @ away}[axes]


def _trace_form(R: ca.SX, H: ca.SX, Ko: ca.SX, axes: Axes) -> ca.SX:
    """Return tr(D G D^T)/2 with D = R - R0, or (R - R0) R0^T for a stiffness in base axes."""
    turned = R - H[:3, :3]
    if axes == "base":
        turned = turned @ H[:3, :3].T
    G = 0.5 * ca.trace(Ko) * ca.SX.eye(3) - Ko
    return sum((half_form(turned[row, :].T, G) for row in range(3)), ca.SX(0))


def quaternion(R: ca.SX, R0: ca.SX) -> ca.SX:
    """Return the unit quaternion (w, v) of R0^T R with w >= 0."""
    E = R0.T @ R
    D = R0.T @ (R - R0)
    x, y, z = D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]
    xy, xz, yz = E[0, 1] + E[1, 0], E[0, 2] + E[2, 0], E[1, 2] + E[2, 1]
    rows = (
        ca.vertcat(1 + E[0, 0] + E[1, 1] + E[2, 2], x, y, z),
        ca.vertcat(x, 1 + E[0, 0] - E[1, 1] - E[2, 2], xy, xz),
        ca.vertcat(y, xy, 1 - E[0, 0] + E[1, 1] - E[2, 2], yz),
        ca.vertcat(z, xz, yz, 1 - E[0, 0] - E[1, 1] + E[2, 2]),
    )
    chosen, largest = rows[0], rows[0][0]
    for k in (1, 2, 3):
        better = largest < rows[k][k]
        chosen = ca.if_else(better, rows[k], chosen)
        largest = ca.if_else(better, rows[k][k], largest)
    chosen = ca.if_else(chosen[0] < 0, -chosen, chosen)
    return chosen / ca.sqrt(ca.dot(chosen, chosen))


_SERIES = (1.0, 1 / 6, 3 / 40, 15 / 336)
"""Coefficients of asin(x)/x in powers of x^2: (2k)!/(4^k k!^2 (2k + 1))."""
_NEAR = 1e-4
"""Bound on x^2: below it four terms of the series are exact to the last digit of energy, wrench and covariant Hessian,
above it the closed form is. More terms would change no result."""


def half_angle_ratio(w: ca.SX) -> ca.SX:
    """Return acos(w)/sqrt(1 - w^2), the half angle over its sine."""
    square = 1 - w * w
    near = ca.SX(0)
    for coefficient in reversed(_SERIES):
        near = near * square + coefficient
    is_near = square < _NEAR
    sine = ca.sqrt(ca.if_else(is_near, 1, square))  # 1: nothing divides by zero where the series is chosen
    return ca.if_else(is_near, near, 2 * ca.atan(sine / (1 + w)) / sine)


def _seen_from(v: ca.SX, H: ca.SX, axes: Axes) -> ca.SX:
    return H[:3, :3] @ v if axes == "base" else v


_STIFFNESSES = (EQUILIBRIUM, TRANSLATION_STIFFNESS, ROTATION_STIFFNESS)
_AXES_TEXT = {
    "base": "in base axes",
    "tip": "in the tip's axes, which turn with it",
    "equilibrium": "in the axes of the equilibrium",
}
_SOFTENS = (
    "Turned by an angle a about an axis u the rotation stores (1 - cos a) u^T Ko u: it softens with the sine of the "
    "angle, and is in unstable equilibrium at turns by pi about the eigenvectors of Ko (all axes if Ko is isotropic), "
    "nowhere else. Smooth everywhere."
)
_CUT = "At a = pi lies the cut locus: the torque jumps there from one side's to the other's."


def _placed(argument: Argument, axes: Axes) -> Argument:
    return replace(argument, meaning=argument.meaning.replace(_AXES_TEXT[_DEFAULT[argument.name]], _AXES_TEXT[axes]))


_DEFAULT: dict[str, Axes] = {
    "translation_stiffness": "base", "rotation_stiffness": "equilibrium", "stiffness": "equilibrium",
}  # fmt: skip

COUPLED_STIFFNESS = Argument(
    "stiffness",
    (6, 6),
    "N/m, N, N m",
    "on (translation, rotation), in the axes of the equilibrium; symmetric, positive definite, only the upper triangle "
    "is read",
    symbol="K",
    plural="stiffnesses",
    triangle=True,
)


def spring(kind: str = "trace", placement: Placement | None = None) -> Spring:
    """Return one of stiffgen's springs: "trace", "rotation_vector", "quaternion" or "coupled".

    Args:
        kind: energy of the rotation; "coupled" is the trace form with one 6x6 stiffness.
        placement: axes and centre of stiffness; the arguments of the kernels stay the same.

    Raises:
        KeyError: there is no such spring.

    """
    return _kinds(placement or Placement())[kind]


def _kinds(where: Placement) -> dict[str, Spring]:
    """Return every spring by its kind: the only list of them."""
    rotation, translation, centre = where.rotation_axes, where.translation_axes or "base", where.centre
    remote = (
        f" Displacements are those of the centre of stiffness at ({', '.join(map(repr, centre))}) m in the tip's frame."
    )
    note = remote if any(centre) else ""

    def linear(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX) -> ca.SX:
        return half_form(_displacement(p, R, H, translation, centre), symmetric_from_upper(Kt))

    def trace(p: ca.SX, R: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> ca.SX:
        return linear(p, R, H, Kt) + _trace_form(R, H, symmetric_from_upper(Ko), rotation)

    def by_quaternion(p: ca.SX, R: ca.SX, q: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> ca.SX:
        turn = 8 * half_form(_seen_from(q[1:], H, rotation), symmetric_from_upper(Ko)) / (1 + q[0])
        return linear(p, R, H, Kt) + turn

    def rotation_vector(p: ca.SX, R: ca.SX, q: ca.SX, H: ca.SX, Kt: ca.SX, Ko: ca.SX) -> ca.SX:
        turn = 2 * half_angle_ratio(q[0]) * _seen_from(q[1:], H, rotation)
        return linear(p, R, H, Kt) + half_form(turn, symmetric_from_upper(Ko))

    stiffnesses = (EQUILIBRIUM, _placed(TRANSLATION_STIFFNESS, translation), _placed(ROTATION_STIFFNESS, rotation))
    away = "U = (p - p0)^T Kt (p - p0)/2"
    return {
        "trace": Spring(
            "spring", stiffnesses, trace,
            f"{away} + tr(G (I - R0^T R)), G = tr(Ko)/2 I - Ko (Bullo and Murray 1999)", _SOFTENS + note,
        ),
        "rotation_vector": Spring(
            "spring_rotation_vector", stiffnesses, rotation_vector,
            f"{away} + (a^2/2) u^T Ko u, a the angle and u the axis of R0^T R",
            f"The rotation does not soften: it stores (a u)^T Ko (a u)/2 at any angle. {_CUT}{note}", turned=True,
        ),
        "quaternion": Spring(
            "spring_quaternion", stiffnesses, by_quaternion,
            f"{away} + 4 (1 - cos a/2) u^T Ko u, a the angle and u the axis of R0^T R",
            f"The rotation's moment grows with 2 sin a/2: it softens less than the trace form. {_CUT}{note}",
            turned=True,
        ),
        "coupled": _coupled(where, note),
    }  # fmt: skip


def _coupled(where: Placement, note: str) -> Spring:
    """Return the trace form with one 6x6 stiffness of translation and rotation."""
    rotation, translation = where.rotation_axes, where.translation_axes or "equilibrium"

    def energy(p: ca.SX, R: ca.SX, H: ca.SX, K: ca.SX) -> ca.SX:
        away, stiffness = _displacement(p, R, H, translation, where.centre), symmetric_from_upper(K)
        D = H[:3, :3].T @ (R - H[:3, :3])
        sine = 0.5 * ca.vertcat(D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1])
        cross = ca.dot(away, stiffness[:3, 3:] @ _seen_from(sine, H, rotation))
        return half_form(away, stiffness[:3, :3]) + _trace_form(R, H, stiffness[3:, 3:], rotation) + cross

    axes = _AXES_TEXT[translation] if translation == rotation else (
        f"translation {_AXES_TEXT[translation]}, rotation {_AXES_TEXT[rotation]}"
    )  # fmt: skip
    stiffness = replace(COUPLED_STIFFNESS, meaning=COUPLED_STIFFNESS.meaning.replace(_AXES_TEXT["equilibrium"], axes))
    return Spring(
        "spring_coupled", (EQUILIBRIUM, stiffness), energy,
        "U = e^T K11 e/2 + tr(G (I - R0^T R)) + e^T K12 s, e the displacement, s = u sin a, G = tr(K22)/2 I - K22",
        f"U >= 0, and 0 at the equilibrium alone or at a turn by pi. {_SOFTENS.replace('Ko', 'K22')}{note}",
    )  # fmt: skip


KINDS = tuple(_kinds(Placement()))
TRACE = spring()


def derivatives(spring: Spring, p: ca.SX, R: ca.SX, parameters: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return (U, F (6), K (6x6)): energy, wrench and covariant Hessian in hybrid axes.

    U(p + v, M R) is differentiated with respect to v, the nine entries of M = I + [w] + [w]^2/2 and, where
    the energy takes it, the quaternion. The chain rule is closed by hand: the derivatives of M with respect to w are
    constants.
    """
    origin, turn = ca.SX.sym("p", 3), ca.SX.sym("M", 3, 3)
    generators = [ca.skew(ca.DM.eye(3)[:, k]) for k in range(3)]
    variables, values = [origin, ca.vec(turn)], [p, ca.vec(ca.SX.eye(3))]
    first = ca.SX(ca.sparsify(ca.diagcat(ca.DM.eye(3), ca.horzcat(*(ca.vec(each) for each in generators)))))

    def second(i: int, j: int) -> ca.SX:
        """Return the second derivative of the entries of M, then of the quaternion, with respect to w_i and w_j."""
        return ca.SX(ca.sparsify(ca.vec(generators[i] @ generators[j] + generators[j] @ generators[i]) / 2))

    if spring.turned:
        R0 = parameters[0][:3, :3]
        q = quaternion(R, R0)
        symbol = ca.SX.sym("q", 4)
        moved = spring.energy(origin, turn @ R, symbol, *parameters)
        variables.append(symbol)
        values.append(q)
        axes = R0.T  # column k: axis k of the base, seen from the equilibrium
        turns = ca.horzcat(
            *(0.5 * ca.vertcat(-ca.dot(a, q[1:]), q[0] * a + ca.cross(a, q[1:])) for a in ca.horzsplit(axes))
        )
        first = ca.vertcat(first, ca.horzcat(ca.SX(4, 3), turns))
        value = spring.energy(p, R, q, *parameters)
    else:
        moved = spring.energy(origin, turn @ R, *parameters)
        value = spring.energy(p, R, *parameters)
    place, at = ca.vertcat(*variables), ca.densify(ca.vertcat(*values))
    hessian, gradient = ca.substitute(list(ca.hessian(moved, place)), [place], [at])
    K = first.T @ hessian @ first
    for i in range(3):
        for j in range(3):
            K[3 + i, 3 + j] += ca.dot(second(i, j), gradient[3:12])
        if spring.turned:
            K[3 + i, 3 + i] -= 0.25 * ca.dot(q, gradient[12:])
    return value, first.T @ gradient, K


def terms(chain: Chain, pose: ca.SX, *parameters: ca.SX, spring: Spring, parts: str) -> Expressions:
    """Return what ``parts`` names of U ("U"), F ("F"), K ("K") and K's upper triangle ("k"), row-major, stacked."""
    U, F, K = derivatives(spring, pose[:3, 3], pose[:3, :3], parameters)
    values = {"U": U, "F": F, "K": ca.vec(symmetric_from_upper(K).T), "k": ca.vec(ca.triu(symmetric_from_upper(K)).T)}
    return Expressions(ca.vertcat(*(values[part] for part in parts)), ())
