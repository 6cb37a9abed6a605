# SPDX-License-Identifier: MIT
"""External wrenches against NumPy's least squares and statistics; deviations of a stiffness against drawn wrenches."""

from __future__ import annotations

import numpy as np
import pytest

import stiffgen

K = np.diag([700.0, 700, 800, 30, 30, 30])


@pytest.fixture(scope="module")
def module(robot_folder):
    return stiffgen.open_robot(robot_folder).module


def test_wrench_of_exact_torques(module):
    """Torques of a wrench come back as the wrench, with nothing unexplained, for a stack of postures."""
    random = np.random.default_rng(0)
    q, wrench = random.uniform(-1, 1, (5, 7)), random.normal(size=(5, 6)) * 20
    torque = np.einsum("sij,si->sj", module.hybrid.jacobian(q), wrench)
    found = stiffgen.external_wrench(module, q, torque)
    np.testing.assert_allclose(found.wrench, wrench, rtol=0, atol=1e-9)
    assert np.abs(found.unexplained).max() < 1e-10
    np.testing.assert_allclose(found.condition, np.linalg.cond(np.swapaxes(module.hybrid.jacobian(q), 1, 2)), rtol=1e-9)


def test_weighted_least_squares(module):
    """Friction that no wrench explains: NumPy's solution of the scaled system, and covariances of drawn torques."""
    random, q = np.random.default_rng(1), np.linspace(-0.8, 0.9, 7)
    deviation, friction = np.array([3.0, 3, 2, 2, 1, 0.5, 0.5]), random.normal(size=7)
    across = module.hybrid.jacobian(q).T
    expected, *_ = np.linalg.lstsq(across / deviation[:, None], friction / deviation, rcond=None)
    found = stiffgen.external_wrench(module, q, friction, deviation)
    np.testing.assert_allclose(found.wrench, expected, rtol=1e-9)
    np.testing.assert_allclose(found.unexplained, friction - across @ expected, rtol=0, atol=1e-9)
    assert not np.allclose(stiffgen.external_wrench(module, q, friction).wrench, expected, rtol=0.01)
    drawn = stiffgen.external_wrench(module, q, random.normal(size=(20000, 7)) * deviation, deviation).wrench
    scale = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(scale, scale), found.covariance / np.outer(scale, scale), atol=0.04
    )


def test_no_wrench_from_a_singular_posture(module):
    """At zero the arm is stretched: some wrenches cause no torque, and no number is made up for them."""
    found = stiffgen.external_wrench(module, np.zeros((2, 7)), np.ones(7))
    assert np.all(found.condition > 1e10) and np.all(np.isnan(found.wrench))
    with np.errstate(invalid="ignore"):
        assert np.all(np.isnan(stiffgen.external_wrench(module, np.full(7, np.nan), np.ones(7)).wrench))


@pytest.mark.parametrize(
    ("torque", "deviation", "message"),
    [
        (np.ones(6), 1.0, "external_torque must end with 7"),
        (np.ones(7), np.ones(3), "deviation must be one number or end with 7"),
        (np.ones(7), 0.0, "every standard deviation must be positive"),
        (np.ones(7), np.nan, "every standard deviation must be positive"),
    ],
)
def test_refused(module, torque, deviation, message):
    with pytest.raises(ValueError, match=message):
        stiffgen.external_wrench(module, np.ones(7), torque, deviation)


def test_deviations_of_the_stiffness(module):
    """Standard deviations of 20000 drawn wrenches, correlated ones."""
    random, q = np.random.default_rng(2), np.array([0.4, 0.9, -0.3, -1.2, 0.5, 1.0, 0.2])
    root = np.diag([0.4, 0.5, 0.8, 0.02, 0.03, 0.05]) @ (np.eye(6) + 0.4 * random.normal(size=(6, 6)))
    mean, covariance = np.array([10.0, -20, 30, 5, -8, 3]), root @ root.T
    found = stiffgen.stiffness_deviation(module, q, mean, K, covariance)
    np.testing.assert_array_equal(found.joint_stiffness, module.hybrid.joint_stiffness(q, mean, K))
    wrenches = mean + random.normal(size=(20000, 6)) @ root.T
    drawn = module.hybrid.joint_stiffness(q, wrenches, K)
    np.testing.assert_allclose(found.deviation, drawn.std(axis=0), rtol=0.03, atol=1e-9)
    smallest = np.linalg.eigvalsh(drawn)[:, 0]
    assert found.smallest == pytest.approx(np.linalg.eigvalsh(found.joint_stiffness)[0], abs=1e-9)
    assert found.smallest_deviation == pytest.approx(smallest.std(), rel=0.03)
    conventional = module.hybrid.joint_stiffness_uncorrected(q, wrenches, K)
    sizes = np.linalg.norm((conventional - np.swapaxes(conventional, 1, 2)) / 2, ord=2, axis=(1, 2))
    assert found.antisymmetric == pytest.approx(sizes.mean(), rel=0.03)
    assert found.antisymmetric_deviation == pytest.approx(sizes.std(), rel=0.03)


def test_deviations_of_stacks(module):
    """Stacks of postures and covariances broadcast; an exact wrench leaves no deviation."""
    random = np.random.default_rng(3)
    q, wrench = random.uniform(-1, 1, (3, 7)), random.normal(size=(3, 6))
    stack = stiffgen.stiffness_deviation(module, q, wrench, K, np.eye(6))
    one = stiffgen.stiffness_deviation(module, q[1], wrench[1], K, np.eye(6))
    for name in ("deviation", "smallest_deviation", "antisymmetric_deviation"):
        np.testing.assert_allclose(getattr(stack, name)[1], getattr(one, name), rtol=1e-9, atol=1e-12)
    assert not stiffgen.stiffness_deviation(module, q, wrench, K, np.zeros((6, 6))).deviation.any()
