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

Rotation. With E = R0^T R (axis u, angle a) and G = tr(Ko)/2 I - Ko the trace form (Bullo and Murray 1999) is

    tr(G (I - E)) = (1 - cos a) u^T Ko u = tr((R - R0) G (R - R0)^T) / 2

The last expression is the one used: near the equilibrium nothing cancels in it, nor in its derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from stiffgen.robot.chain import Chain
from stiffgen.symbolic.arguments import Argument
from stiffgen.symbolic.kinematics import Expressions

Energy = Callable[..., ca.SX]
"""U(p, R, *parameters): a scalar expression of the tip's origin (3), its rotation (3x3) and the parameters."""

EQUILIBRIUM = Argument(
    "equilibrium",
    (4, 4),
    "m",
    "homogeneous pose [R0 p0; 0 1] of the tip in the base frame at which the spring is at rest; R0 must be a rotation",
    symbol="H",
    plural="equilibria",
)
TRANSLATION_STIFFNESS = Argument(
    "translation_stiffness",
    (3, 3),
    "N/m",
    "of the tip's origin, in base axes; symmetric, positive definite, only the upper triangle is read",
    symbol="Kt",
    plural="translation_stiffnesses",
)
ROTATION_STIFFNESS = Argument(
    "rotation_stiffness",
    (3, 3),
    "N m/rad",
    "in the axes of the equilibrium; symmetric, positive definite, only the upper triangle is read",
    symbol="Ko",
    plural="rotation_stiffnesses",
)


@dataclass(frozen=True)
class Spring:
    """A potential of the tip's pose.

    ``name`` is the group of its kernels ("spring"), ``parameters`` are what its energy takes after p and R,
    ``equation`` is the energy in a line, ``domain`` what a caller must know of it beyond shapes and units.
    """

    name: str
    parameters: tuple[Argument, ...]
    energy: Energy
    equation: str
    domain: str


def symmetric(matrix: ca.SX) -> ca.SX:
    """The symmetric matrix whose upper triangle is that of ``matrix``; the lower one is not read."""
    return ca.triu2symm(ca.triu(matrix))


def half_form(x: ca.SX, matrix: ca.SX) -> ca.SX:
    """x^T A x / 2 of a symmetric matrix, written so that its derivative is A x and no more."""
    total = ca.SX(0)
    for i in range(x.shape[0]):
        row = 0.5 * matrix[i, i] * x[i]
        for j in range(i + 1, x.shape[0]):
            row += matrix[i, j] * x[j]
        total += x[i] * row
    return total


def trace_energy(p: ca.SX, R: ca.SX, equilibrium: ca.SX, translation: ca.SX, rotation: ca.SX) -> ca.SX:
    """Translation (p - p0)^T Kt (p - p0) / 2, rotation by the trace form."""
    away, turned = p - equilibrium[:3, 3], R - equilibrium[:3, :3]
    Ko = symmetric(rotation)
    G = 0.5 * ca.trace(Ko) * ca.SX.eye(3) - Ko
    rotational = sum((half_form(turned[row, :].T, G) for row in range(3)), ca.SX(0))
    return half_form(away, symmetric(translation)) + rotational


TRACE = Spring(
    "spring",
    (EQUILIBRIUM, TRANSLATION_STIFFNESS, ROTATION_STIFFNESS),
    trace_energy,
    "U = (p - p0)^T Kt (p - p0)/2 + tr(G (I - R0^T R)), G = tr(Ko)/2 I - Ko (Bullo and Murray 1999)",
    "Smooth everywhere. Turned by an angle a about an axis u the rotation stores (1 - cos a) u^T Ko u: it softens with "
    "the sine of the angle, and is in unstable equilibrium at turns by pi about the eigenvectors of Ko (all axes if Ko "
    "is isotropic), nowhere else.",
)


def derivatives(energy: Energy, p: ca.SX, R: ca.SX, parameters: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """(U, F (6), K (6x6)): energy, wrench and covariant Hessian in hybrid axes.

    U(p + v, M R) is differentiated by v and by the nine entries of M = I + [w] + [w]^2/2, and the chain rule is
    closed by hand: M's own derivatives are constants.
    """
    origin, turn = ca.SX.sym("p", 3), ca.SX.sym("M", 3, 3)
    hessian, gradient = ca.hessian(energy(origin, turn @ R, *parameters), ca.vertcat(origin, ca.vec(turn)))
    place = [ca.vertcat(origin, ca.vec(turn)), ca.vertcat(p, ca.vec(ca.SX.eye(3)))]
    hessian, gradient = ca.substitute([hessian, gradient], [place[0]], [ca.densify(place[1])])
    generators = [ca.skew(ca.DM.eye(3)[:, k]) for k in range(3)]
    first = ca.horzcat(*(ca.vec(generator) for generator in generators))  # dM/dw, column-major entries
    change = ca.SX(ca.sparsify(ca.diagcat(ca.DM.eye(3), first)))
    K = change.T @ hessian @ change
    for i in range(3):
        for j in range(3):
            second = (generators[i] @ generators[j] + generators[j] @ generators[i]) / 2
            K[3 + i, 3 + j] += ca.dot(ca.SX(ca.sparsify(ca.vec(second))), gradient[3:])
    return energy(p, R, *parameters), change.T @ gradient, K


def terms(chain: Chain, pose: ca.SX, *parameters: ca.SX, spring: Spring, parts: str) -> Expressions:
    """What ``parts`` names of U ("U"), F ("F"), K ("K") and K's upper triangle ("k"), row-major below each other."""
    U, F, K = derivatives(spring.energy, pose[:3, 3], pose[:3, :3], parameters)
    values = {"U": U, "F": F, "K": ca.vec(symmetric(K).T), "k": ca.vec(ca.triu(symmetric(K)).T)}
    return Expressions(ca.vertcat(*(values[part] for part in parts)), ())
