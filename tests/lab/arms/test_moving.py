# SPDX-License-Identifier: MIT
"""A spring moved between representations: the same joint stiffness, or, moved as the paper does, another one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import stiffgen
from stiffgen.core.symbolic.connection import REPRESENTATIONS


@pytest.fixture(scope="module")
def state(model):
    """q, pose, and the wrench and covariant Hessian of a spring in hybrid form with its joint Hessian."""
    random = np.random.default_rng(6)
    q = random.uniform(-1.5, 1.5, 7)
    rest = np.array(model.forward_kinematics(random.uniform(-1.5, 1.5, 7)))
    Kt, Ko = (scale * (r @ r.T + np.eye(3)) for r, scale in ((random.normal(size=(3, 3)), s) for s in (300.0, 20.0)))
    F, K, Kq = (
        np.array(getattr(model.spring, name)(q, rest, Kt, Ko))
        for name in ("wrench", "task_stiffness", "joint_stiffness")
    )
    return q, np.array(model.forward_kinematics(q)), F.ravel(), K, Kq


@pytest.mark.parametrize(("source", "target"), list(itertools.product(REPRESENTATIONS, REPRESENTATIONS)))
def test_the_same_spring(source, target, state, model):
    """Move a stiffness there and back: the joint Hessian of the spring's energy in all representations."""
    q, pose, F, K, Kq = state
    given = stiffgen.move_stiffness(pose, F, K, "hybrid", source)
    wrench, stiffness = stiffgen.move_stiffness(pose, *given, source, target)
    assert np.allclose(stiffness, stiffness.T, rtol=0, atol=1e-10)
    found = np.array(getattr(model, target).joint_stiffness(q, wrench, stiffness))
    assert np.abs(found - Kq).max() <= 1e-12 * np.abs(Kq).max()
    back = stiffgen.move_stiffness(pose, wrench, stiffness, target, "hybrid")
    assert np.allclose(back[0], F, rtol=1e-13, atol=1e-11)
    assert np.allclose(back[1], K, rtol=1e-13, atol=1e-10)


def test_the_papers_form_is_another_spring(state, model):
    """Move a stiffness as a tensor: another joint stiffness than the exact one, equal for a moment alone."""
    q, pose, F, K, Kq = state
    wrench, stiffness = stiffgen.move_stiffness(pose, F, K, "hybrid", "spatial", as_tensor=True)
    found = np.array(model.spatial.joint_stiffness(q, wrench, stiffness))
    assert np.array_equal(found, found.T)
    assert np.abs(found - Kq).max() > 1e-2 * np.abs(Kq).max()
    exact = stiffgen.move_stiffness(pose, F, K, "hybrid", "spatial")
    assert np.array_equal(exact[0], wrench)
    moment_only = np.concatenate([np.zeros(3), F[3:]])
    for both in zip(
        stiffgen.move_stiffness(pose, moment_only, K, "hybrid", "spatial", as_tensor=True),
        stiffgen.move_stiffness(pose, moment_only, K, "hybrid", "spatial"),
        strict=True,
    ):
        assert np.array_equal(*both)
    back = stiffgen.move_stiffness(pose, wrench, stiffness, "spatial", "hybrid", as_tensor=True)
    assert np.allclose(back[1], K, rtol=1e-13, atol=1e-10)


def test_stacks(state):
    _, pose, F, K, _ = state
    stacked = stiffgen.move_stiffness(pose, np.stack([F, 2 * F]), K, "hybrid", "spatial")
    for k, one in enumerate((F, 2 * F)):
        for stack, single in zip(stacked, stiffgen.move_stiffness(pose, one, K, "hybrid", "spatial"), strict=True):
            assert np.allclose(stack[k], single, rtol=1e-14)
