# SPDX-License-Identifier: MIT
"""Modes and pencils of the damping, and the eigenvalue of a stiffness, against NumPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.controller_library import Matrices, residual, spectra, symmetric


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 2, 3, 6, 7, 12, 40])
def test_modes_are_those_of_the_matrix(rows: int, tmp_path: Path) -> None:
    """Compare modes with NumPy's. Before: errors of the matrix's size in 47 % of clustered ones, after 65 turns."""
    matrices, random = Matrices(tmp_path, rows), np.random.default_rng(11)
    for A in spectra(random, rows, 240 if rows < 12 else 30):
        values, V = matrices.find_modes(A)
        assert residual(A, values, V) <= 1e-13 * (1 + rows)
    for bad in (np.nan, np.inf, 1e300):  # the turns end
        matrices.call("find_modes", np.full((rows, rows), bad), np.zeros(20 * rows**2 + 100))


def test_pencils_are_formed(tmp_path: Path) -> None:
    """Compare L^-1 K L^-T, where M = L L^T, with NumPy; a mass matrix that is not positive is refused."""
    matrices, random = Matrices(tmp_path, 7), np.random.default_rng(12)
    for K in spectra(random, 7, 60):
        M = symmetric(random, 10 ** random.uniform(-1.5, 1.5, 7))
        positive, C = matrices.form_pencil(K, M)
        root = np.linalg.inv(np.linalg.cholesky(M))
        assert positive
        np.testing.assert_allclose(C, root @ K @ root.T, rtol=0, atol=1e-11 * np.abs(C).max())
        assert not matrices.form_pencil(K, -M)[0]
        assert not matrices.form_pencil(K, np.full((7, 7), np.nan))[0]


def test_the_smallest_eigenvalue_of_a_stiffness(tmp_path: Path) -> None:
    matrices, random = Matrices(tmp_path, 3), np.random.default_rng(13)
    for A in spectra(random, 3, 240):
        assert abs(matrices.smallest_eigenvalue(A) - np.linalg.eigvalsh(A)[0]) <= 1e-8 * np.abs(A).max()
