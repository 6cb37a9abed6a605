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

Rotation: with E = R0^T R (axis u, angle a), G = tr(Ko)/2 I - Ko and (w, v) = (cos a/2, u sin a/2) the unit quaternion
of E with w >= 0, the energies are

    trace form (Bullo and Murray 1999)    tr(G (I - E)) = tr((R - R0) G (R - R0)^T)/2 = (1 - cos a) u^T Ko u
    quaternion form                       4 v^T Ko v/(1 + w)                          = 4 (1 - cos a/2) u^T Ko u
    rotation-vector form                  2 (acos(w)/sqrt(1 - w^2))^2 v^T Ko v        = (a^2/2) u^T Ko u

All three energies have the stiffness Ko at the equilibrium. The vectors u and v have the same entries in the tip's and
in the equilibrium's axes, so that Ko in either axes means the same spring.

Numerics:

* Trace form: the code uses the second expression, since neither the expression nor its derivatives cancel near the
  equilibrium.
* Quaternion: v is computed from R - R0 for the same reason. The products 4 (w, v) (w, v)^T are linear in E; the code
  uses their largest row, which keeps all digits up to the cut locus at a = pi.
* Rotation vector: acos(w)/sqrt(1 - w^2) is evaluated as a power series in 1 - w^2 near w = 1, in closed form elsewhere.
* Derivatives of the quaternion: a small rotation by y, in the equilibrium's axes, multiplies the quaternion (w, v) by
  (1 - |y|^2/8, y/2), exact up to second order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kinematics import Expressions
from stiffgen.symbolic.stiffness import symmetric_from_upper

Energy = Callable[..., ca.SX]
"""Function U(p, R, *parameters): a scalar expression of the tip's origin (3), its rotation (3x3) and parameters."""

EQUILIBRIUM = Argument.referred(
    "equilibrium",
    (4, 4),
    "m",
    "homogeneous pose [R0 p0; 0 1] of the tip in the {reference} frame at which the spring is at rest; R0 must be a "
    "rotation",
    symbol="H",
    plural="equilibria",
    varying=True,
)
Axes = Literal["base", "tip", "equilibrium"]
AXES: tuple[Axes, ...] = ("base", "tip", "equilibrium")
"""Axes of a stiffness: base axes, tip axes (which rotate with the tip), or the tip's axes at the equilibrium."""

_AXES_TEXT = {
    "base": "in {reference} axes",
    "tip": "in the tip's axes, which rotate with the tip",
    "equilibrium": "in the axes of the equilibrium",
}
_SYMMETRIC = "symmetric, positive definite, only the upper triangle is read"


def _translation_stiffness(axes: Axes) -> Argument:
    return Argument.referred(
        "translation_stiffness", (3, 3), "N/m", f"{_AXES_TEXT[axes]}; {_SYMMETRIC}",
        symbol="Kt", plural="translation_stiffnesses", triangle=True,
    )  # fmt: skip


def _rotation_stiffness(axes: Axes) -> Argument:
    return Argument.referred(
        "rotation_stiffness", (3, 3), "N m/rad", f"{_AXES_TEXT[axes]}; {_SYMMETRIC}",
        symbol="Ko", plural="rotation_stiffnesses", triangle=True,
    )  # fmt: skip


def _coupled_stiffness(translation: Axes, rotation: Axes) -> Argument:
    axes = _AXES_TEXT[translation] if translation == rotation else (
        f"translation {_AXES_TEXT[translation]}, rotation {_AXES_TEXT[rotation]}"
    )  # fmt: skip
    return Argument.referred(
        "stiffness", (6, 6), "N/m, N, N m", f"on (translation, rotation), {axes}; {_SYMMETRIC}",
        symbol="K", plural="stiffnesses", triangle=True,
    )  # fmt: skip


@dataclass(frozen=True)
class Spring:
    """Potential of the tip's pose.

    Attributes:
        name: group of the spring's kernels ("spring").
        parameters: arguments of the energy after p and R.
        energy: U(p, R, *parameters), or U(p, R, quaternion, *parameters) with ``takes_quaternion``.
        equation: formula of the energy, in one line.
        domain: information that a caller needs beyond shapes and units.
        takes_quaternion: whether the energy takes the unit quaternion (w, v) of R0^T R, w >= 0; the first parameter is
            then the equilibrium.

    """

    name: str
    parameters: tuple[Argument, ...]
    energy: Energy
    equation: str
    domain: str
    takes_quaternion: bool = False


@dataclass(frozen=True)
class Placement:
    """Axes and centre of the stiffnesses of springs.

    ``centre`` is the centre of stiffness in the tip's frame [m]: the translational stiffness acts on the displacement
    of this point. With ``translation_axes`` None, the axes are the base's, or for a coupled stiffness the
    equilibrium's.
    """

    translation_axes: Axes | None = None
    rotation_axes: Axes = "equilibrium"
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)


def half_form(x: ca.SX, matrix: ca.SX) -> ca.SX:
    """Return x^T A x / 2 for a symmetric A, in a form whose symbolic derivative is A x without further terms."""
    total = ca.SX(0)
    for i in range(x.shape[0]):
        row = 0.5 * matrix[i, i] * x[i]
        for j in range(i + 1, x.shape[0]):
            row += matrix[i, j] * x[j]
        total += x[i] * row
    return total


def _displacement(p: ca.SX, R: ca.SX, H: ca.SX, axes: Axes, centre: tuple[float, float, float]) -> ca.SX:
    """Return the displacement of the centre of stiffness from the equilibrium, in ``axes`` [m]."""
    offset = p - H[:3, 3]
    if any(centre):
        offset += (R - H[:3, :3]) @ ca.SX(ca.sparsify(ca.DM(centre)))
    return {"base": offset, "tip": R.T @ offset, "equilibrium": H[:3, :3].T @ offset}[axes]


def _trace_form(R: ca.SX, H: ca.SX, Ko: ca.SX, axes: Axes) -> ca.SX:
    """Return tr(D G D^T)/2 with D = R - R0, or (R - R0) R0^T for a stiffness in base axes."""
    difference = R - H[:3, :3]
    if axes == "base":
        difference = difference @ H[:3, :3].T
    G = 0.5 * ca.trace(Ko) * ca.SX.eye(3) - Ko
    return sum((half_form(difference[row, :].T, G) for row in range(3)), ca.SX(0))


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
    row, largest = rows[0], rows[0][0]
    for k in (1, 2, 3):
        is_larger = largest < rows[k][k]
        row = ca.if_else(is_larger, rows[k], row)
        largest = ca.if_else(is_larger, rows[k][k], largest)
    row = ca.if_else(row[0] < 0, -row, row)
    return row / ca.sqrt(ca.dot(row, row))


_SERIES = (1.0, 1 / 6, 3 / 40, 15 / 336)
"""Coefficients of asin(x)/x in powers of x^2: (2k)!/(4^k k!^2 (2k + 1))."""
_SERIES_BOUND = 1e-4
"""Bound on x^2 [rad^2] below which the series replaces the closed form.

Below the bound, four terms give energy, wrench and covariant Hessian exact to the last digit; above, the closed form
does. More terms would change no result.
"""


def half_angle_ratio(w: ca.SX) -> ca.SX:
    """Return acos(w)/sqrt(1 - w^2), the half angle divided by its sine."""
    square = 1 - w * w
    series = ca.SX(0)
    for coefficient in reversed(_SERIES):
        series = series * square + coefficient
    is_near = square < _SERIES_BOUND
    sine = ca.sqrt(ca.if_else(is_near, 1, square))  # 1 avoids a division by zero where the series applies
    return ca.if_else(is_near, series, 2 * ca.atan(sine / (1 + w)) / sine)


def _seen_from(v: ca.SX, H: ca.SX, axes: Axes) -> ca.SX:
    return H[:3, :3] @ v if axes == "base" else v


def _softens(stiffness: str) -> str:
    return (
        f"A rotation by the angle a about the axis u stores the energy (1 - cos a) u^T {stiffness} u. The moment grows "
        f"with the sine of a. The equilibrium is unstable at rotations by pi about the eigenvectors of {stiffness} "
        f"(about all axes if {stiffness} is isotropic), and nowhere else. The energy is smooth everywhere."
    )


_CUT = "The cut locus lies at a = pi, where the torque jumps."


def spring(kind: str = "trace", placement: Placement | None = None) -> Spring:
    """Return one of stiffgen's springs: "trace", "rotation_vector", "quaternion" or "coupled".

    Args:
        kind: energy of the rotation; "coupled" is the trace form with one 6x6 stiffness.
        placement: axes and centre of stiffness; they do not change the names and shapes of the arguments.

    Raises:
        KeyError: unknown kind.

    """
    return _kinds(placement or Placement())[kind]


def _kinds(placement: Placement) -> dict[str, Spring]:
    """Return all springs by kind; stiffgen has no second list of springs."""
    rotation, translation = placement.rotation_axes, placement.translation_axes or "base"
    centre = placement.centre
    remote = (
        " The translational stiffness acts on the displacement of the centre of stiffness at "
        f"({', '.join(map(repr, centre))}) m in the tip's frame."
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

    parameters = EQUILIBRIUM, _translation_stiffness(translation), _rotation_stiffness(rotation)
    linear_energy = "U = (p - p0)^T Kt (p - p0)/2"
    return {
        "trace": Spring(
            "spring", parameters, trace,
            f"{linear_energy} + tr(G (I - R0^T R)), G = tr(Ko)/2 I - Ko (Bullo and Murray 1999)",
            _softens("Ko") + note,
        ),
        "rotation_vector": Spring(
            "spring_rotation_vector", parameters, rotation_vector,
            f"{linear_energy} + (a^2/2) u^T Ko u, a the angle and u the axis of R0^T R",
            f"A rotation stores the energy (a u)^T Ko (a u)/2 at any angle: the spring does not soften. {_CUT}{note}",
            takes_quaternion=True,
        ),
        "quaternion": Spring(
            "spring_quaternion", parameters, by_quaternion,
            f"{linear_energy} + 4 (1 - cos a/2) u^T Ko u, a the angle and u the axis of R0^T R",
            f"The moment grows with 2 sin a/2: the spring softens less than the trace form. {_CUT}{note}",
            takes_quaternion=True,
        ),
        "coupled": _coupled(placement, note),
    }  # fmt: skip


def _coupled(placement: Placement, note: str) -> Spring:
    """Return the trace form with one 6x6 stiffness of translation and rotation."""
    rotation, translation = placement.rotation_axes, placement.translation_axes or "equilibrium"

    def energy(p: ca.SX, R: ca.SX, H: ca.SX, K: ca.SX) -> ca.SX:
        offset, stiffness = _displacement(p, R, H, translation, placement.centre), symmetric_from_upper(K)
        D = H[:3, :3].T @ (R - H[:3, :3])
        sine = 0.5 * ca.vertcat(D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1])
        cross = ca.dot(offset, stiffness[:3, 3:] @ _seen_from(sine, H, rotation))
        return half_form(offset, stiffness[:3, :3]) + _trace_form(R, H, stiffness[3:, 3:], rotation) + cross

    return Spring(
        "spring_coupled", (EQUILIBRIUM, _coupled_stiffness(translation, rotation)), energy,
        "U = e^T K11 e/2 + tr(G (I - R0^T R)) + e^T K12 s, e the displacement, s = u sin a, G = tr(K22)/2 I - K22",
        f"U >= 0; U = 0 only at the equilibrium and possibly at rotations by pi. {_softens('K22')}{note}",
    )  # fmt: skip


KINDS = tuple(_kinds(Placement()))
TRACE = spring()


def derivatives(spring: Spring, p: ca.SX, R: ca.SX, parameters: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return (U, F (6), K (6x6)): energy, wrench and covariant Hessian in hybrid axes.

    CasADi differentiates U(p + v, M R) with respect to v, the nine entries of M = I + [w] + [w]^2/2 and, for springs
    with ``takes_quaternion``, the quaternion. The chain rule from M to w is written out, since the derivatives of M
    with respect to w are constants.
    """
    origin, turn = ca.SX.sym("p", 3), ca.SX.sym("M", 3, 3)
    generators = [ca.skew(ca.DM.eye(3)[:, k]) for k in range(3)]
    variables, values = [origin, ca.vec(turn)], [p, ca.vec(ca.SX.eye(3))]
    first = ca.SX(ca.sparsify(ca.diagcat(ca.DM.eye(3), ca.horzcat(*(ca.vec(each) for each in generators)))))

    def second(i: int, j: int) -> ca.SX:
        """Return the second derivative of the entries of M, then of the quaternion, with respect to w_i and w_j."""
        return ca.SX(ca.sparsify(ca.vec(generators[i] @ generators[j] + generators[j] @ generators[i]) / 2))

    if spring.takes_quaternion:
        R0 = parameters[0][:3, :3]
        q = quaternion(R, R0)
        symbol = ca.SX.sym("q", 4)
        energy = spring.energy(origin, turn @ R, symbol, *parameters)
        variables.append(symbol)
        values.append(q)
        axes = R0.T  # column k: axis k of the base, in the equilibrium's axes
        turns = ca.horzcat(
            *(0.5 * ca.vertcat(-ca.dot(a, q[1:]), q[0] * a + ca.cross(a, q[1:])) for a in ca.horzsplit(axes))
        )
        first = ca.vertcat(first, ca.horzcat(ca.SX(4, 3), turns))
        value = spring.energy(p, R, q, *parameters)
    else:
        energy = spring.energy(origin, turn @ R, *parameters)
        value = spring.energy(p, R, *parameters)
    place, at = ca.vertcat(*variables), ca.densify(ca.vertcat(*values))
    hessian, gradient = ca.substitute(list(ca.hessian(energy, place)), [place], [at])
    K = first.T @ hessian @ first
    for i in range(3):
        for j in range(3):
            K[3 + i, 3 + j] += ca.dot(second(i, j), gradient[3:12])
        if spring.takes_quaternion:
            K[3 + i, 3 + i] -= 0.25 * ca.dot(q, gradient[12:])
    return value, first.T @ gradient, K


def terms(chain: Chain, pose: ca.SX, *parameters: ca.SX, spring: Spring, parts: str) -> Expressions:
    """Return the quantities that ``parts`` selects, row-major, stacked.

    "U" selects the energy, "F" the wrench, "K" the covariant Hessian, "k" the upper triangle of the Hessian.
    """
    U, F, K = derivatives(spring, pose[:3, 3], pose[:3, :3], parameters)
    values = {"U": U, "F": F, "K": ca.vec(symmetric_from_upper(K).T), "k": ca.vec(ca.triu(symmetric_from_upper(K)).T)}
    return Expressions(ca.vertcat(*(values[part] for part in parts)), ())
