# SPDX-License-Identifier: MIT
"""Modes of the damping: solved anew and refined from others, against SciPy; the step depends on no earlier modes."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from support.controller_inputs import SPRING, Q
from support.controller_library import Matrices, pencils, residual, symmetric


@pytest.fixture(scope="module")
def matrices(tmp_path_factory: pytest.TempPathFactory) -> Matrices:
    return Matrices(tmp_path_factory.mktemp("modes"))


def deviation(K: np.ndarray, M: np.ndarray, values: np.ndarray, V: np.ndarray) -> float:
    """Return the largest error of modes V and eigenvalues, relative to the largest eigenvalue."""
    exact = scipy.linalg.eigvalsh(K, M)
    size = max(np.abs(exact).max(), 1e-300)
    normal = np.abs(V.T @ M @ V - np.eye(len(K))).max()
    return max(normal, residual(K, M, values, V), np.abs(values - exact).max() / size)


def test_modes_are_solved(matrices: Matrices) -> None:
    for K, M in pencils(11, 300):
        code, values, V = matrices.solve_modes(K, M)
        assert code == 0
        assert deviation(K, M, values, V) <= 1e-11
    assert matrices.solve_modes(np.eye(3), -np.eye(3))[0] == 2
    assert matrices.solve_modes(np.diag([1.0, np.nan, 1.0]), np.eye(3))[0] == 1


def test_near_modes_are_refined(matrices: Matrices) -> None:
    """Modes off by 1e-3 become those of SciPy if no two eigenvalues are close, whatever their order and signs."""
    random = np.random.default_rng(12)
    worst, refined = 0.0, 0
    for _ in range(300):
        n = int(random.integers(1, 13))
        K = symmetric(random, np.cumsum(random.uniform(1.0, 3.0, n)) * 10 ** random.uniform(-3, 4) - 3.0)
        M = symmetric(random, 10 ** random.uniform(-1.5, 1.5, n))
        V = scipy.linalg.eigh(K, M)[1] * random.choice([-1.0, 1.0], n)
        gaps = np.diff(scipy.linalg.eigvalsh(K, M)).min(initial=np.inf) / max(np.ptp(scipy.linalg.eigvalsh(K, M)), 1e-9)
        off = 1e-3 * min(gaps, 1.0)
        start = V @ (np.eye(n) + off * random.uniform(-1, 1, (n, n))) @ np.eye(n)[random.permutation(n)]
        good, values, V = matrices.refine_modes(K, M, start)
        refined += good
        if good:
            assert np.all(np.diff(values) >= 0)
            worst = max(worst, deviation(K, M, values, V))
    print(f"worst deviation {worst:.1e}, {refined} of 300 refined")
    assert refined >= 290
    assert worst <= 1e-11


def test_refined_modes_are_right_or_refused(matrices: Matrices) -> None:
    """Far, foreign, singular and infinite starts, equal and close eigenvalues: no modes, or those of the pencil."""
    random = np.random.default_rng(13)
    refused = 0
    for index, (K, M) in enumerate(pencils(14, 300)):
        n = len(K)
        exact = scipy.linalg.eigh(K, M)[1]
        starts = [
            exact @ (np.eye(n) + 10 ** random.uniform(-9, 0) * random.normal(size=(n, n))),
            np.zeros((n, n)), np.full((n, n), np.nan), np.full((n, n), 1e200), np.ones((n, n)),
            random.normal(size=(n, n)), exact[:, np.r_[0, : n - 1]],
        ]  # fmt: skip
        good, values, V = matrices.refine_modes(K, M, starts[index % len(starts)])
        refused += not good
        assert not good or deviation(K, M, values, V) <= 1e-11
    assert 100 < refused < 300
    for K, M in ((np.full((3, 3), np.nan), np.eye(3)), (np.eye(3), np.full((3, 3), np.inf)), (np.eye(3), -np.eye(3))):
        assert not matrices.refine_modes(K, M, np.eye(3))[0]


def test_the_step_depends_on_no_earlier_modes(robot: ModuleType) -> None:
    """Modes overwritten before each step change damping and torque by rounding alone, and are no fault."""
    random = np.random.default_rng(15)
    controllers: list[Any] = [robot.Impedance(motor_inertia=0.1) for _ in range(2)]
    modes = controllers[1]._state.view(np.float64)[-2 * 49 :]
    for k in range(400):
        jump = 0.2 if k >= 200 else 0.0  # of the wanted position
        rate = np.arange(1, 8) * 1e-3
        inputs = {"q": Q + 0.2 * np.sin(rate * k), "dq": 200 * rate * np.cos(rate * k), "q0": Q + jump, **SPRING}
        assert np.any(modes != 0.0) == (k > 0), "the state ends with the modes"
        kinds = [np.zeros(98), np.full(98, np.nan), random.normal(size=98), 1e300 * np.ones(98), modes[::-1].copy()]
        modes[:] = kinds[k % 5]
        one, other = (each.step(**inputs) for each in controllers)
        assert not one.fault and not other.fault
        assert np.linalg.norm(one.damping - other.damping) <= 1e-12 * np.linalg.norm(one.damping)
        np.testing.assert_allclose(one.eigenvalues, other.eigenvalues, rtol=0, atol=1e-12 * one.eigenvalues[-1])
        np.testing.assert_allclose(one.torque, other.torque, rtol=0, atol=1e-9)
