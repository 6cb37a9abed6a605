# SPDX-License-Identifier: MIT
"""Kinematic connection on SE(3), derived exactly from the basis of se(3) with SymPy.

A twist is xi = (v, w), linear first; e_1..e_3 translate, e_4..e_6 rotate. The 4x4 basis matrices E_i determine all
coefficients:

* Structure coefficients: [e_i, e_j] = sum_k C^k_ij e_k, from the matrix commutator. Body twists belong to
  left-invariant fields. Spatial twists belong to right-invariant fields, whose bracket has the opposite sign.
* Body connection: torsion-free. A rotation carries a translation field along as a vector of the body:
  grad_{e_i} e_j = e_i x e_j for i rotational and j translational. Two rotations share their bracket evenly between the
  two orders (the bi-invariant connection of SO(3)). Translations are flat.
* Spatial connection: the body connection with the two lower indices exchanged.
* Hybrid connection (linear velocity of the tip and angular velocity, both in base axes): the body connection in
  another moving basis, by the gauge transformation with T = blkdiag(R, R).

Gamma^k_ij is the e_k component of grad_{e_j} e_i. The torsion-free condition fixes the sign
Gamma^k_ji - Gamma^k_ij = C^k_ij (the paper's appendix; Section 2 of the paper has the opposite sign). The correction of
the task stiffness is (Gamma F)_ij = sum_k Gamma^k_ij F_k.

Source: Lachner, Nah, Hogan, "A Physically Consistent Stiffness Formulation for Contact-Rich Manipulation"
(Int. J. Robotics Research 2025, doi 10.1177/02783649251393332, arXiv 2503.06802), Section 2 and appendix.
"""

from __future__ import annotations

from functools import cache
from typing import Any, TypeAlias

import sympy as sp

from stiffgen.core.symbolic.connection import Representation

_TRANSLATIONS = range(3)
_ROTATIONS = range(3, 6)
_BASIS = range(6)

Coefficients: TypeAlias = Any
"""SymPy array of exact rationals, shape (6, 6, 6), indexed [k, i, j]: upper index k, lower indices i, j."""


def basis_matrix(i: int) -> sp.ImmutableMatrix:
    """Return the 4x4 matrix E_i = [[w]x, v; 0, 0] of the i-th basis twist (0-based, linear first)."""
    return _hat([sp.Integer(i == k) for k in _BASIS])


def _hat(xi: list[sp.Expr]) -> sp.ImmutableMatrix:
    vx, vy, vz, wx, wy, wz = xi
    return sp.ImmutableMatrix([[0, -wz, wy, vx], [wz, 0, -wx, vy], [-wy, wx, 0, vz], [0, 0, 0, 0]])


def _vee(matrix: sp.Matrix) -> list[sp.Expr]:
    m = matrix
    xi = [m[0, 3], m[1, 3], m[2, 3], m[2, 1], m[0, 2], m[1, 0]]
    if sp.simplify(_hat(xi) - m) != sp.zeros(4, 4):
        raise ArithmeticError(f"{m} is not in se(3)")
    return xi


@cache
def structure_coefficients(representation: Representation) -> Coefficients:
    """Return the coefficients C^k_ij of the brackets [e_i, e_j] = C^k_ij e_k of the representation's frame field.

    Body: the matrix commutator. Spatial: the negative commutator (right-invariant fields). Hybrid: translations along
    base axes commute with all fields; rotations about base axes have the bracket of right-invariant fields of SO(3).
    """
    c = [[[sp.Integer(0)] * 6 for _ in _BASIS] for _ in _BASIS]
    for i in _BASIS:
        for j in _BASIS:
            ei, ej = basis_matrix(i), basis_matrix(j)
            bracket = _vee(ei * ej - ej * ei)  # twist (6) of the commutator
            if representation == "spatial":
                bracket = [-b for b in bracket]
            elif representation == "hybrid":
                bracket = [-b if i in _ROTATIONS and j in _ROTATIONS else sp.Integer(0) for b in bracket]
            for k in _BASIS:
                c[k][i][j] = bracket[k]
    return sp.ImmutableDenseNDimArray(c)


@cache
def connection_coefficients(representation: Representation) -> Coefficients:
    """Return the coefficients Gamma^k_ij of the kinematic connection, as exact rationals [k, i, j].

    The connection is torsion-free: Gamma^k_ji - Gamma^k_ij = C^k_ij of the same representation.
    """
    if representation == "hybrid":
        return _hybrid_from_body()
    c = structure_coefficients("body")
    gamma = [[[sp.Integer(0)] * 6 for _ in _BASIS] for _ in _BASIS]
    for k in _BASIS:
        for i in _BASIS:
            for j in _BASIS:
                # grad_{e_j} e_i: field i, direction j; a rotation turns a translation's axis, and half of a rotation's.
                if j in _ROTATIONS and i in _TRANSLATIONS:
                    value = c[k, j, i]
                elif j in _ROTATIONS and i in _ROTATIONS:
                    value = c[k, j, i] / 2
                else:
                    value = sp.Integer(0)
                if representation == "body":
                    gamma[k][i][j] = value
                else:
                    gamma[k][j][i] = value
    return sp.ImmutableDenseNDimArray(gamma)


def _hybrid_from_body() -> Coefficients:
    """Return the body connection in the hybrid frame field h_a = sum_i R_ai e_i (a, i both linear or both angular).

    The definition gives grad_{h_b} h_a = h_b(R_ai) e_i + R_ai R_bj grad_{e_j} e_i. Cross products are equivariant under
    rotations, so that the coefficients equal those at R = 1, where h_b(R) = [e_b]x for a rotation, 0 for a translation.
    """
    body = connection_coefficients("body")
    gamma = [[[body[k, a, b] for b in _BASIS] for a in _BASIS] for k in _BASIS]
    for b in _ROTATIONS:
        turn = basis_matrix(b)[:3, :3]  # [e_b]x
        for a in _BASIS:
            for i in range(3):
                gamma[i + 3 * (a // 3)][a][b] += turn[a % 3, i]
    return sp.ImmutableDenseNDimArray(gamma)


def gamma_F(representation: Representation, wrench: list[sp.Expr]) -> sp.ImmutableMatrix:
    """Return (Gamma F)_ij = sum_k Gamma^k_ij F_k as a 6x6 SymPy matrix, [N] and [N m]; ``wrench`` is (f, m)."""
    gamma = connection_coefficients(representation)
    return sp.ImmutableMatrix(6, 6, lambda i, j: sum((gamma[k, i, j] * wrench[k] for k in _BASIS), sp.Integer(0)))
