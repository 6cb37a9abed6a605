# SPDX-License-Identifier: MIT
"""The controller's linear algebra against SciPy."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from support.controller_library import MAX_ROWS, Matrices, pencils, residual, symmetric


@pytest.fixture(scope="module")
def matrices(tmp_path_factory: pytest.TempPathFactory) -> Matrices:
    return Matrices(tmp_path_factory.mktemp("matrix"))


def test_pencils(matrices: Matrices) -> None:
    """Plain, clustered, repeated, singular, indefinite and graded spectra of every size."""
    worst = 0.0
    for K, M in pencils(1, 600):
        code, values, V = matrices.solve_pencil(K, M)
        assert code == 0
        assert np.all(np.diff(values) >= 0)
        worst = max(worst, residual(K, M, values, V), np.abs(V.T @ M @ V - np.eye(len(K))).max())
        exact = scipy.linalg.eigvalsh(K, M)
        assert np.abs(values - exact).max() <= 1e-10 * max(np.abs(exact).max(), 1e-300)
    print(f"worst relative residual {worst:.1e}")
    assert worst <= 1e-11


def test_eigenvectors_of_special_matrices(matrices: Matrices) -> None:
    """Zero, diagonal, repeated, singular, nearly zero and reversed: all to rounding."""
    random = np.random.default_rng(2)
    tridiagonal = np.diag([2.0] * 6) + np.diag([-1.0] * 5, 1) + np.diag([-1.0] * 5, -1)
    nearly_zero = symmetric(random, np.array([1.0, 1.0, 1.0, 1e-12, -1e-12]))
    cases = [np.zeros((4, 4)), np.eye(5), np.diag([3.0, -1, 2]), np.ones((6, 6)), tridiagonal, np.array([[2.5]])]
    for A in [*cases, nearly_zero, np.ascontiguousarray(np.eye(3)[::-1])]:
        code, values, V = matrices.diagonalise_symmetric(A)
        assert code == 0
        np.testing.assert_allclose(V @ np.diag(values) @ V.T, A, atol=1e-14 * max(1, np.abs(A).max()))
        np.testing.assert_allclose(V.T @ V, np.eye(len(A)), atol=1e-14)
        np.testing.assert_allclose(values, np.linalg.eigvalsh(A), atol=1e-14 * max(1, np.abs(A).max()))


def test_largest_eigenvalue_of_three(matrices: Matrices) -> None:
    """Against LAPACK, to rounding: apart, and pairs of every distance at the top and at the bottom of the spectrum."""
    random = np.random.default_rng(3)
    worst = 0.0
    for index in range(3000):
        near = 1.0 - 10 ** random.uniform(-17, 0)
        spectra = [
            random.normal(size=3),
            [1.0, near, random.uniform()],
            [1.0, 0.3, 0.3 * near],
            [1.0, near, near],
            [1.0, 0.0, 0.0],
        ]
        A = symmetric(random, np.array(spectra[index % 5]) * 10 ** random.uniform(-9, 9))
        exact = np.linalg.eigvalsh(A)
        worst = max(worst, abs(matrices.find_largest_eigenvalue(A) - exact[-1]) / np.abs(exact).max())
    print(f"worst relative error {worst:.1e}")
    assert worst <= 3e-15
    for A in (np.zeros((3, 3)), np.diag([2.0, 5.0, 2.0]), np.diag([5.0, 2.0, 5.0]), 5.0 * np.eye(3)):
        assert matrices.find_largest_eigenvalue(A) == pytest.approx(A.max(), rel=1e-15)
    assert np.isnan(matrices.find_largest_eigenvalue(np.full((3, 3), np.nan)))


def test_what_is_refused(matrices: Matrices) -> None:
    good = np.diag([2.0, 3.0, 4.0])
    for bad in (np.nan, np.inf):
        spoiled = np.where(np.eye(3), bad, good)
        assert matrices.solve_pencil(spoiled, good)[0] == 1
        assert matrices.solve_pencil(good, spoiled)[0] == 2
    for mass in (np.diag([1.0, 1.0, 0.0]), np.diag([1.0, -1.0, 1.0]), np.zeros((3, 3))):
        assert matrices.solve_pencil(good, mass)[0] == 2


def test_the_symmetric_part_counts(matrices: Matrices) -> None:
    """Of the stiffness: the paper's conventional formula has another part, that says nothing about damping."""
    random = np.random.default_rng(5)
    K, M = random.normal(size=(7, 7)), symmetric(random, np.exp(random.normal(size=7)))
    code, values, _ = matrices.solve_pencil(K, M)
    assert code == 0
    np.testing.assert_allclose(values, scipy.linalg.eigvalsh((K + K.T) / 2, M), rtol=0, atol=1e-11)


def test_a_change_of_stiffness_is_split(matrices: Matrices) -> None:
    """K' - K into what costs and what releases, in the basis that makes both diagonal: K + the rest stays positive."""
    random = np.random.default_rng(3)
    worst = np.inf
    for _ in range(500):
        K, wanted = (symmetric(random, 10 ** random.uniform(0, 4, 3)) for _ in range(2))
        changed, rest, cost = matrices.soften(wanted, 1.0, K)
        assert changed == 1
        np.testing.assert_allclose(rest + cost, wanted, rtol=0, atol=1e-9)
        _, part, part_of_cost = matrices.soften(wanted, 0.3, K)
        np.testing.assert_allclose(part_of_cost, 0.3 * cost, rtol=0, atol=1e-9)
        np.testing.assert_allclose(part, K + 0.3 * (rest - K), rtol=0, atol=1e-9)
        values, W = scipy.linalg.eigh(wanted, K)  # W^T K W = I, W^T K' W = diag(values)
        inverse = np.linalg.inv(W)
        trace = np.trace(K + wanted)
        np.testing.assert_allclose(
            rest, inverse.T @ np.diag(np.minimum(values, 1)) @ inverse, rtol=0, atol=1e-7 * trace
        )
        S = K + wanted + 1e-10 * trace * np.eye(3)  # the metric, where no direction is without stiffness
        values, W = scipy.linalg.eigh(wanted - K, S)
        np.testing.assert_allclose(cost, S @ W @ np.diag(np.maximum(values, 0)) @ W.T @ S, rtol=0, atol=1e-12 * trace)
        worst = min(worst, np.linalg.eigvalsh(rest).min() / np.linalg.eigvalsh(K).min())
        assert np.linalg.eigvalsh(cost).min() >= -1e-9
        assert np.linalg.eigvalsh(wanted - rest).min() >= -1e-8
        assert np.linalg.eigvalsh(K - rest).min() >= -1e-8  # rest <= K: it only releases
    assert worst > 0
    assert matrices.soften(wanted, 0.3, wanted)[0] == 0
    # nearly there: the last bit of the way at once, whatever the share, and a wanted one that is not quite symmetric
    close = wanted * (1 + 1e-11) + 1e-9 * np.triu(np.ones((3, 3)), 1)
    changed, rest, cost = matrices.soften(close, 0.3, wanted)
    assert changed == 1
    np.testing.assert_allclose(rest + cost, close, rtol=1e-14, atol=0)


def test_semidefinite(matrices: Matrices) -> None:
    """Eigenvalues of 0 are accepted, one of -1e-3 is not; nor are asymmetric matrices and NaN, at any size."""
    random = np.random.default_rng(4)
    for n in (1, 3, 6):
        for _ in range(100):
            values = np.abs(random.normal(size=n)) + 1e-3
            assert matrices.is_positive_semidefinite(symmetric(random, values))
            values[0] = 0.0
            assert matrices.is_positive_semidefinite(symmetric(random, values))
            values[0] = -1e-3
            assert not matrices.is_positive_semidefinite(symmetric(random, values))
    assert matrices.is_positive_semidefinite(np.zeros((3, 3)))
    for size in (5e-324, 7e-318, 1e-310, 1e300):  # the reciprocal of the first three overflows
        assert matrices.is_positive_semidefinite(np.diag([size, size, 0.0]))
        assert not matrices.is_positive_semidefinite(np.diag([size, -size, 0.0]))
    assert not matrices.is_positive_semidefinite(np.array([[1.0, 0.1], [0.0, 1.0]]))
    assert not matrices.is_positive_semidefinite(np.array([[np.nan]]))


def test_rows_of_a_triangular_system(matrices: Matrices) -> None:
    """L^-1 X against SciPy, with every number of columns: blocks of 4 and 8 and what is left of them."""
    random = np.random.default_rng(6)
    for n in (1, 2, 3, 7, MAX_ROWS):
        for count in (*range(1, 18), MAX_ROWS):
            L = random.normal(size=(n, n)) / n  # the upper triangle has numbers, too, which count for nothing
            np.fill_diagonal(L, random.choice([-1.0, 1.0], n) * random.uniform(1.0, 3.0, n))
            X = random.normal(size=(n, count))
            expected = scipy.linalg.solve_triangular(L, X, lower=True)
            np.testing.assert_allclose(matrices.solve_rows(L, X), expected, rtol=0, atol=1e-13)


def test_damped_system(matrices: Matrices) -> None:
    """(A + shift I)^-1 x against LAPACK, also where A alone is singular or indefinite; the lower triangle is read."""
    random = np.random.default_rng(7)
    for n in (1, 2, 3, 7, MAX_ROWS):
        for lowest, shift in ((0.5, 0.0), (0.5, 1.0), (0.0, 0.1), (-1.0, 1.5), (2.0, -1.0)):
            A, x = symmetric(random, np.append(random.uniform(2.0, 9.0, n - 1), lowest)), random.normal(size=n)
            expected = np.linalg.solve(A + shift * np.eye(n), x)
            lower = np.tril(A) + np.triu(np.full((n, n), 1e3), 1)
            for each in (A, lower):
                is_definite, solved = matrices.solve_damped(each, shift, x)
                assert is_definite
                np.testing.assert_allclose(solved, expected, rtol=0, atol=1e-13 * max(1, np.abs(expected).max()))
        for lowest, shift in ((0.0, 0.0), (-1.0, 0.5), (1.0, -1.5), (1.0, np.nan), (np.nan, 1.0), (1.0, np.inf)):
            A = np.diag(np.append(np.full(n - 1, 2.0), lowest))
            assert not matrices.solve_damped(A, shift, np.ones(n))[0], (n, lowest, shift)


def test_the_files_stand_alone() -> None:
    """No name of the generator in what robots get, but for the adapter's prefix, which no robot's name has."""
    from stiffgen.control.page import LIBRARY

    for path in Path(LIBRARY).glob("*.[ch]"):
        assert "stiffgen" not in re.sub(r"\bstiffgen_\w+\(", "", path.read_text()).lower()
