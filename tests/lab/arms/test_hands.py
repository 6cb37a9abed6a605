# SPDX-License-Identifier: MIT
"""Two hands on one object: compliance of one seen from the other, internal wrench of two sensors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stiffgen
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.verify.kernels.missing import function_of_stacks
from support.exact_tree import tree_urdf

RANDOM = np.random.default_rng(3)


def two_hands(folder: Path) -> Chain:
    file = folder / "robot.urdf"
    file.write_text(tree_urdf(7))
    return stiffgen.load_chain(file, tip=["left", "right"])


def poses(chain: Chain, q: np.ndarray) -> list[np.ndarray]:
    table = [kernel for kernel in chain_kernels(chain) if kernel.name == "forward_kinematics"]
    return [np.asarray(function_of_stacks(chain, kernel)(q[None]))[0] for kernel in table]


def at(wrench: np.ndarray, from_point: np.ndarray, point: np.ndarray) -> np.ndarray:
    return np.concatenate([wrench[:3], wrench[3:] + np.cross(from_point - point, wrench[:3])])


def test_relative_compliance_is_the_motion_of_one_hand_seen_from_the_other(tmp_path: Path) -> None:
    """Squeeze two unloaded hands a little: the relative pose moves as the compliance says."""
    chain = two_hands(tmp_path)
    table = chain_kernels(chain, stiffgen.KernelOptions(kernels="all,compliance"))
    kernel = {each.qualified_name: each for each in table}
    q, n = RANDOM.uniform(-1, 1, len(chain.coordinates)), chain.dof
    root = RANDOM.normal(size=(n, n))
    Kth = 100 * (root @ root.T + n * np.eye(n))
    given = q[None], np.zeros((1, 2, 6)), Kth[None]
    C12 = np.asarray(function_of_stacks(chain, kernel["hybrid_tip_compliance_total"])(*given))[0]
    a, b = poses(chain, q)
    C = stiffgen.relative_compliance(C12, a, b)
    assert np.array_equal(C, C.T) and np.linalg.eigvalsh(C)[0] > 0
    F = RANDOM.normal(size=6)
    wrenches = -at(F, b[:3, 3], a[:3, 3]), F
    J = [
        np.asarray(function_of_stacks(chain, kernel[f"{tip}_hybrid_jacobian"])(q[None]))[0] for tip in ("left", "right")
    ]
    dq = np.linalg.solve(Kth, sum(j.T @ w for j, w in zip(J, wrenches, strict=True)))
    ends = [np.linalg.inv(x) @ y for x, y in (poses(chain, q + step * dq) for step in (1e-3, -1e-3))]
    rate, here = (ends[0] - ends[1]) / 2e-3, np.linalg.inv(a) @ b
    spin = rate[:3, :3] @ here[:3, :3].T
    twist = np.concatenate([a[:3, :3] @ rate[:3, 3], a[:3, :3] @ [spin[2, 1], spin[0, 2], spin[1, 0]]])
    np.testing.assert_allclose(C @ F, twist, atol=1e-6 * np.abs(twist).max())
    stack = stiffgen.relative_compliance(np.stack([C12, C12]), np.stack([a, a]), b)
    np.testing.assert_array_equal(stack, np.stack([C, C]))


def test_internal_wrench_of_a_squeezed_box(tmp_path: Path) -> None:
    """Squeeze a box of any weight: the internal wrench comes back, and a bias shows in the residual."""
    chain = two_hands(tmp_path)
    q = RANDOM.uniform(-1, 1, len(chain.coordinates))
    # [N], [N m] about a hand's tip, about point
    (a, b), squeeze, weight = poses(chain, q), RANDOM.normal(size=6), np.array([0.3, 0, -20.0, 0.1, 0.2, 0])
    pa, pb, point = a[:3, 3], b[:3, 3], RANDOM.normal(size=3)
    # each hand bears half of the weight; at(w, from, to) moves a wrench's point
    on_a = at(weight / 2 - at(squeeze, pb, point), point, pa)
    on_b = at(weight / 2, point, pb) + squeeze
    found = stiffgen.internal_wrench(on_a, on_b, a, b, point=point, load=weight)
    np.testing.assert_allclose(at(found.internal, point, pb), squeeze, atol=1e-13)
    np.testing.assert_allclose(found.net, weight, atol=1e-13)
    assert np.abs(found.residual).max() < 1e-13
    bias = np.array([1.0, 0, 0, 0, 0, 0])
    wrong = stiffgen.internal_wrench(on_a, on_b + bias, a, b, point=point, load=weight)
    # half of a bias on one hand is a squeeze, half is net; the known load uncovers it
    np.testing.assert_allclose(wrong.internal[:3] - found.internal[:3], bias[:3] / 2, atol=1e-13)
    np.testing.assert_allclose(wrong.residual[:3], bias[:3], atol=1e-13)
    opposite = stiffgen.internal_wrench(on_a - bias, on_b + bias, a, b, point=point, load=weight)
    assert np.abs(opposite.residual[:3]).max() < 1e-13
    middle = stiffgen.internal_wrench(np.stack([on_a, on_a]), on_b, a, b)
    np.testing.assert_allclose(at(middle.net[1], (pa + pb) / 2, point), weight, atol=1e-12)


def test_refused() -> None:
    with pytest.raises(stiffgen.StiffgenError, match=r"wrench_a must be \(\.\.\., 6\)"):
        stiffgen.internal_wrench(np.zeros(5), np.zeros(6), np.eye(4), np.eye(4))
    with pytest.raises(stiffgen.StiffgenError, match="compliance must be"):
        stiffgen.relative_compliance(np.zeros((6, 6)), np.eye(4), np.eye(4))
    with pytest.raises(stiffgen.StiffgenError, match="symmetric"):
        stiffgen.relative_compliance(np.triu(np.ones((12, 12))), np.eye(4), np.eye(4))
