# SPDX-License-Identifier: MIT
"""CasADi expressions of the stiffness: what one joint and one pair of joints contribute.

Kq = dJ^T/dq . F + J^T (K + Gamma F) J  (Lachner, Nah, Hogan 2025, central equation). Everything here takes
Jacobian columns J_i (6), so it holds for any chain and any joint type; :mod:`stiffgen.symbolic.programs` runs it over
joints and pairs of joints.
"""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca

from stiffgen.symbolic import connection
from stiffgen.symbolic.connection import Representation
from stiffgen.symbolic.kinematics import jacobian_column_derivative


def gamma_F(representation: Representation, wrench: ca.SX) -> ca.SX:
    """Return (Gamma F)_ij = sum_k Gamma^k_ij F_k (6x6), from the exact coefficients of the connection."""
    result = ca.SX(6, 6)
    for i, j, k, coefficient in _coefficients(representation):
        result[i, j] += coefficient * wrench[k]
    return result


@cache
def _coefficients(representation: Representation) -> tuple[tuple[int, int, int, float], ...]:
    """Return (i, j, k, Gamma^k_ij) of the coefficients that are not zero."""
    exact = connection.connection_coefficients(representation)
    places = product(range(6), repeat=3)
    return tuple((i, j, k, float(exact[k, i, j])) for i, j, k in places if exact[k, i, j] != 0)


def base_connection(generalised_force: ca.SX) -> ca.SX:
    """Return what a floating base's connection adds to symmetric second derivatives, joint after joint (m x m).

    Args:
        generalised_force: tau (m), joint by joint; its entries 3..5 are the moment on the base in its own axes.

    Returns:
        -Gamma(tau) of the body representation in the base's six rows and columns, entries below the diagonal taken
        for both sides: joint after joint the base slides along x, y, z, then turns about x, y, z, and entry (i, j) for
        i < j is the derivative by j before that by i. Of Gamma, only the half moment stands below the diagonal.

    """
    size = generalised_force.shape[0]
    gamma = gamma_F("body", generalised_force[:6])
    result = ca.SX(size, size)
    for i in range(6):
        for j in range(i):
            if not gamma[i, j].is_zero():
                result[i, j] = result[j, i] = -gamma[i, j]
    return result


def symmetric_from_upper(matrix: ca.SX) -> ca.SX:
    """Return the symmetric matrix whose upper triangle is that of ``matrix``; the lower one is not read."""
    return ca.triu2symm(ca.triu(matrix))


def kinematic_covector(representation: Representation, column: ca.SX, wrench: ca.SX, *, outward: bool) -> ca.SX:
    """Return z_j (6) with (dJ_i/dq_j)^T F = J_i . z_j, for every joint i nearer the base than j (``outward``) or not.

    dJ_i/dq_j is linear in J_i, so z_j is the gradient of the contraction with respect to J_i.
    """
    other = ca.SX.sym("J_i", 6)
    derivative = jacobian_column_derivative(representation, other, column, by_is_outward=outward)
    return ca.densify(ca.jacobian(ca.dot(derivative, wrench), other).T)


def diagonal_is_outward(representation: Representation) -> bool:
    """Return whether the pair (j, j) counts with the joints beyond j, so that a vanishing derivative is 0.0."""
    return representation != "body"


def stiffness_covector(representation: Representation, column: ca.SX, wrench: ca.SX, corrected: ca.SX) -> ca.SX:
    """Return u_j (6) with Kq_ij = J_i . u_j for i <= j, or for i >= j in body form, where dJ_i/dq_j vanishes.

    u_j = (K + Gamma F) J_j + z_j, with ``corrected`` the matrix K + Gamma F.
    """
    return uncorrected_covector(
        representation, column, wrench, corrected @ column, outward=diagonal_is_outward(representation)
    )


def uncorrected_covector(
    representation: Representation, column: ca.SX, wrench: ca.SX, product: ca.SX, *, outward: bool
) -> ca.SX:
    """Return u_j (6) = K J_j + z_j, with ``product`` the vector K J_j."""
    return ca.densify(product + kinematic_covector(representation, column, wrench, outward=outward))
