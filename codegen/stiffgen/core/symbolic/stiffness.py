# SPDX-License-Identifier: MIT
"""CasADi expressions of the stiffness: contributions of one joint and of one pair of joints.

Kq = dJ^T/dq . F + J^T (K + Gamma F) J  (Lachner, Nah, Hogan 2025; docs/theory.md (3)). The expressions take Jacobian
columns J_i (6) and therefore hold for any chain and any type of joint. :mod:`stiffgen.families` repeats them
over joints and pairs of joints.
"""

from __future__ import annotations

import casadi as ca

from stiffgen.core.symbolic.connection import COEFFICIENTS, Representation
from stiffgen.core.symbolic.kinematics import Section, jacobian_column_derivative


def gamma_F(representation: Representation, wrench: ca.SX) -> ca.SX:
    """Return (Gamma F)_ij = sum_k Gamma^k_ij F_k (6x6), from the exact coefficients of the connection."""
    result = ca.SX(6, 6)
    for i, j, k, coefficient in COEFFICIENTS[representation]:
        result[i, j] += coefficient * wrench[k]
    return result


def halves_of_wrench(wrench: ca.SX) -> tuple[Section, ...]:
    """Return the section of what several entries of Gamma F share."""
    halves = {"half_f": 0.5 * wrench[:3], "half_m": 0.5 * wrench[3:]}
    return (Section("halves of force and moment", halves, shared=True),)


def base_connection(generalised_force: ca.SX) -> ca.SX:
    """Return the connection term of a floating base, to add to symmetric second derivatives per joint (m x m).

    The second derivatives treat the base as six joints in series: it slides along x, y, z, then rotates about x, y, z.
    Entry (i, j) with i < j is the derivative with respect to j first, then with respect to i.

    Args:
        generalised_force: tau (m), one entry per joint; entries 3..5 are the moment on the base in base link axes.

    Returns:
        -Gamma(tau) of the body representation in the base's six rows and columns. The entries below the diagonal
        (half the moment) fill both triangles.

    """
    size = generalised_force.shape[0]
    gamma = gamma_F("body", generalised_force[:6])
    result = ca.SX(size, size)
    for i in range(6):
        for j in range(i):  # below the diagonal
            if not gamma[i, j].is_zero():
                result[i, j] = result[j, i] = -gamma[i, j]
    return result


def symmetric_from_upper(matrix: ca.SX) -> ca.SX:
    """Return the symmetric matrix with the upper triangle of ``matrix``; the lower triangle is not read."""
    return ca.triu2symm(ca.triu(matrix))


def kinematic_covector(representation: Representation, column: ca.SX, wrench: ca.SX, *, outward: bool) -> ca.SX:
    """Return z_j (6), where (dJ_i/dq_j)^T F = J_i . z_j.

    With ``outward`` the result holds for all joints i nearer the base than j, otherwise for all other joints i. Since
    dJ_i/dq_j is linear in J_i, z_j is the gradient of the contraction with respect to J_i.
    """
    other = ca.SX.sym("J_i", 6)
    derivative = jacobian_column_derivative(representation, other, column, moving_is_outward=outward)
    return ca.densify(ca.jacobian(ca.dot(derivative, wrench), other).T)


def diagonal_is_outward(representation: Representation) -> bool:
    """Return whether the pair (j, j) belongs to the joints beyond j; a vanishing derivative is then exactly 0.0."""
    return representation != "body"


def stiffness_covector(representation: Representation, column: ca.SX, wrench: ca.SX, corrected: ca.SX) -> ca.SX:
    """Return u_j (6) = (K + Gamma F) J_j + z_j, where ``corrected`` is the matrix K + Gamma F.

    One half of the joint stiffness is Kq_ij = J_i . u_j: the half i <= j, in body form the half i >= j.
    """
    return uncorrected_covector(
        representation, column, wrench, corrected @ column, outward=diagonal_is_outward(representation)
    )


def load_covector(representation: Representation, column: ca.SX, wrench: ca.SX) -> ca.SX:
    """Return u_j of a load without task stiffness: (Gamma F) J_j + z_j."""
    return stiffness_covector(representation, column, wrench, gamma_F(representation, wrench))


def uncorrected_covector(
    representation: Representation, column: ca.SX, wrench: ca.SX, product: ca.SX, *, outward: bool
) -> ca.SX:
    """Return u_j (6) = K J_j + z_j of docs/theory.md (2), where ``product`` is the vector K J_j."""
    return ca.densify(product + kinematic_covector(representation, column, wrench, outward=outward))
