# SPDX-License-Identifier: MIT
"""The exact connection: the paper's coefficient lists, its torsion-free condition, and its appendix examples."""

from __future__ import annotations

import itertools

import pytest
import sympy as sp

from stiffgen.core.symbolic.connection import COEFFICIENTS, REPRESENTATIONS
from stiffgen.core.symbolic.derivation import basis_matrix, connection_coefficients, gamma_F, structure_coefficients

F = list(sp.symbols("f1:4 m1:4"))
HALF = sp.Rational(1, 2)

# The paper's list for the body form, 1-based (k, i, j): Gamma^k_ij.
BODY = {
    (3, 2, 4): 1, (1, 3, 5): 1, (2, 1, 6): 1,
    (2, 3, 4): -1, (3, 1, 5): -1, (1, 2, 6): -1,
    (4, 6, 5): HALF, (5, 4, 6): HALF, (6, 5, 4): HALF,
    (4, 5, 6): -HALF, (5, 6, 4): -HALF, (6, 4, 5): -HALF,
}  # fmt: skip


def nonzero(coefficients):
    triples = itertools.product(range(6), repeat=3)
    return {(k + 1, i + 1, j + 1): coefficients[k, i, j] for k, i, j in triples if coefficients[k, i, j] != 0}


def skew(a):
    return sp.Matrix([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def blocks(a, b, c, d):
    return sp.ImmutableMatrix(sp.BlockMatrix([[a, b], [c, d]]).as_explicit())


def test_body_coefficients_are_the_papers():
    assert nonzero(connection_coefficients("body")) == BODY


def test_spatial_coefficients_exchange_the_lower_indices():
    assert nonzero(connection_coefficients("spatial")) == {(k, j, i): value for (k, i, j), value in BODY.items()}


def test_gamma_F_in_cross_product_matrices():
    zero, force, moment = sp.zeros(3), skew(F[:3]), skew(F[3:])
    assert gamma_F("body", F) == blocks(zero, force, zero, moment / 2)
    assert gamma_F("spatial", F) == blocks(zero, zero, force.T, moment.T / 2)
    assert gamma_F("hybrid", F) == blocks(zero, zero, zero, moment.T / 2)


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_the_table_is_what_sympy_derives(rep):
    table = {(k + 1, i + 1, j + 1): value for i, j, k, value in COEFFICIENTS[rep]}
    assert table == {index: float(value) for index, value in nonzero(connection_coefficients(rep)).items()}


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_torsion_free(rep):
    gamma, c = connection_coefficients(rep), structure_coefficients(rep)
    for k, i, j in itertools.product(range(6), repeat=3):
        assert gamma[k, j, i] - gamma[k, i, j] == c[k, i, j]


def test_coefficients_are_exact():
    for rep in REPRESENTATIONS:
        for value in sp.flatten([*connection_coefficients(rep), *structure_coefficients(rep)]):
            assert isinstance(value, sp.Rational)


def test_structure_coefficients_from_brackets():
    c = structure_coefficients("body")
    for i, j in itertools.product(range(6), repeat=2):
        bracket = basis_matrix(i) * basis_matrix(j) - basis_matrix(j) * basis_matrix(i)
        assert bracket == sum((c[k, i, j] * basis_matrix(k) for k in range(6)), sp.zeros(4))
    # so(3) and its action on translations, by hand: [w1, w2] = w3, [w1, v2] = v3, translations commute.
    assert (c[5, 3, 4], c[2, 3, 1], c[2, 0, 1]) == (1, 1, 0)


def test_hybrid_is_the_body_connection_in_turned_axes():
    """Derive the hybrid connection at a general orientation, where h_a = R_ai e_i, not only at R = 1."""
    a, b, c = sp.symbols("a b c")
    turn = sp.rot_axis3(a).T * sp.rot_axis1(b).T * sp.rot_axis3(c).T
    T = sp.diag(turn, turn)
    body, hybrid = connection_coefficients("body"), connection_coefficients("hybrid")
    point = {a: sp.Rational(3, 10), b: sp.Rational(-7, 10), c: sp.Rational(11, 10)}
    for x, y in itertools.product(range(6), repeat=2):
        gradient = sp.zeros(6, 1)  # in the body frame
        for i, j in itertools.product(range(6), repeat=2):
            along = skew([int(j == 3), int(j == 4), int(j == 5)])
            derivative = sp.diag(turn * along, turn * along)  # e_j(T): R changes by R [e_j]x
            gradient[i] += T[y, j] * derivative[x, i]
            for k in range(6):
                gradient[k] += T[x, i] * T[y, j] * body[k, i, j]
        expected = T.T * sp.Matrix([hybrid[k, x, y] for k in range(6)])
        difference = (gradient - expected).subs(point).evalf(30)
        assert max(abs(entry) for entry in difference) < 1e-25


def anthropomorphic_arm():
    """The paper's appendix: three revolute joints, rotations only; q1 turns the axes of joints 2 and 3."""
    q = sp.symbols("q1:4")
    s, c = sp.sin(q[0]), sp.cos(q[0])
    return q, sp.Matrix([[0, s, s], [0, -c, -c], [1, 0, 0]]), s, c


def test_appendix_uncorrected_stiffness_of_the_anthropomorphic_arm():
    q, Jr, s, c = anthropomorphic_arm()
    m = sp.Matrix(F[3:])
    kinematic = sp.Matrix.hstack(*(sp.diff(Jr.T, qi) * m for qi in q))
    entry = c * m[0] + s * m[1]
    assert kinematic == sp.Matrix([[0, 0, 0], [entry, 0, 0], [entry, 0, 0]])


def test_appendix_corrected_stiffness_of_the_anthropomorphic_arm():
    """Compare with the closed form of the paper's appendix, by symbols: the corrected stiffness is symmetric."""
    q, Jr, s, c = anthropomorphic_arm()
    m = sp.Matrix(F[3:])
    kinematic = sp.Matrix.hstack(*(sp.diff(Jr.T, qi) * m for qi in q))
    # Angular velocity in base axes: the rotational block of the hybrid (and of the spatial) connection.
    corrected = kinematic + Jr.T * sp.Matrix(gamma_F("hybrid", F)[3:, 3:]) * Jr
    A = (c * m[0] + s * m[1]) / 2
    assert sp.simplify(corrected - sp.Matrix([[0, A, A], [A, 0, 0], [A, 0, 0]])) == sp.zeros(3)
