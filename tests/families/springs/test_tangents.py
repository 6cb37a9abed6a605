# SPDX-License-Identifier: MIT
"""Positive tangents of springs: a bound on the joint stiffness, and its formula, at random and far configurations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.core.symbolic.choices import KINDS, KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.verify import verify
from stiffgen.families.springs.springs import spring
from support.project import ROOT, URDF

TREE = ROOT / "tests" / "data" / "dual_arm.urdf"
TREE_OPTIONS = {"tip": ["left hand", "right-hand"]}


def rotation(random: np.random.Generator) -> np.ndarray:
    R = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return np.asarray(R * np.sign(np.linalg.det(R)))


def positive(random: np.random.Generator, n: int, scale: float) -> np.ndarray:
    A = random.normal(size=(n, n))
    return np.asarray(scale * (A @ A.T + 0.1 * np.eye(n)))


def arguments(kind: str, random: np.random.Generator) -> list[np.ndarray]:
    """Draw an equilibrium somewhere around, and stiffnesses with unequal axes."""
    equilibrium = np.eye(4)
    equilibrium[:3, :3], equilibrium[:3, 3] = rotation(random), random.uniform(-1, 1, 3)
    if kind == "coupled":
        return [equilibrium, positive(random, 6, 100.0)]
    limits = [np.array(40.0), np.array(8.0)] if kind == "bounded" else []
    return [equilibrium, positive(random, 3, 300.0), positive(random, 3, 20.0), *limits]


@pytest.mark.parametrize("kind", KINDS)
def test_the_tangent_bounds_the_joint_stiffness(kind: str) -> None:
    """P - Kq and P + Kq are positive where Kq is not, and P is the sum of both parts."""
    chain, group = stiffgen.load_chain(URDF), spring(kind).name
    table = chain_kernels(chain, KernelOptions(springs=KINDS, kernels=("all", "tangents")))
    names = f"{group}_positive_tangent", f"{group}_joint_stiffness", f"{group}_task_stiffness", "hybrid_jacobian"
    P_of, Kq_of, K_of, J_of = (
        casadi_function(chain, next(each for each in table if each.qualified_name == name)) for name in names
    )
    random, negative = np.random.default_rng(9), 0
    for _ in range(40):
        q, given = random.uniform(-2, 2, 7), arguments(kind, random)
        P, Kq, K = (np.array(function(q, *given)) for function in (P_of, Kq_of, K_of))
        J = np.array(J_of(q))
        load = Kq - J.T @ K @ J
        assert np.abs(P - J.T @ np.diag(np.abs(K).sum(1)) @ J - np.diag(np.abs(load).sum(1))).max() < 1e-12 * P.max()
        assert np.array_equal(P, P.T)
        for sign in (1, -1):
            assert np.linalg.eigvalsh(P + sign * Kq).min() > -1e-11 * P.max()
        negative += np.linalg.eigvalsh(Kq).min() < -1.0
    assert negative > 10


def test_the_family_is_on_request() -> None:
    chain = stiffgen.load_chain(TREE, **TREE_OPTIONS)
    usual = {kernel.qualified_name for kernel in chain_kernels(chain)}
    more = {kernel.qualified_name for kernel in chain_kernels(chain, KernelOptions(kernels=("all", "tangents")))}
    assert more - usual == {"left_hand_spring_positive_tangent", "right_hand_spring_positive_tangent"}


@pytest.mark.slow
@pytest.mark.usefixtures("unoptimised", "narrowest_width")
@pytest.mark.parametrize(
    "options", [TREE_OPTIONS, pytest.param({"tip": "left hand", "floating_base": True}, marks=pytest.mark.wide)]
)
def test_verified_on_trees_and_floating_bases(options: dict[str, object], tmp_path: Path) -> None:
    """Verify the tangents of springs on a tree and on a floating base."""
    folder = stiffgen.generate(
        TREE, output=tmp_path, kernels=("tangents",), springs=("bounded", "coupled"), masses=False, controller=False,
        **options,
    )  # fmt: skip
    checks = verify(folder, count=20)
    assert [check for check in checks if not check.passed] == []
    assert sum("positive_tangent" in str(check) for check in checks) > 10
