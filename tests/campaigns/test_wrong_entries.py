# SPDX-License-Identifier: MIT
"""Every single entry of dJ^T/dq matters: falsify each one and see checks fail.

The checks are those of ``stiffgen verify`` (:mod:`stiffgen.core.verify.kernels.oracles`), run on the compiled kernels
with one entry of the derivative falsified, and all that is made from it: the contraction, and the joint stiffness
put together the way the generated code does it, one half computed and mirrored. It stays symmetric throughout.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.verify.kernels import comparison
from stiffgen.core.verify.kernels.oracles import check_kernels
from stiffgen.core.verify.kernels.poses import gamma_F
from stiffgen.core.verify.kernels.references import References
from support.project import kernels_of

PERTURBATION = 1e-6


@pytest.fixture(scope="module")
def references(chain):
    return References(chain, count=2, seed=11)


def memoised(function):
    """Cache results: the kernels without a fault see the same inputs 294 times."""
    cache = {}

    def call(*arguments):
        key = tuple(np.asarray(a).tobytes() for a in arguments)
        if key not in cache:
            cache[key] = function(*arguments)
        return cache[key]

    return call


@pytest.fixture
def kept_errors(monkeypatch):
    """Compute rounding errors once, since they do not depend on the kernels' values."""
    errors, known = comparison.rounding_errors, {}

    def once(chain, kernel, given, scalar, *, rounded):
        key = (kernel.qualified_name, scalar, rounded, *(np.asarray(a).tobytes() for a in given))
        if key not in known:
            known[key] = errors(chain, kernel, given, scalar, rounded=rounded)
        return known[key]

    monkeypatch.setattr(comparison, "rounding_errors", once)


def falsified(kernels, rep, entry):
    """Return the kernels with dJ^T/dq off at one entry (i, b, k)."""
    i, b, k = entry
    derivative, jacobian = kernels[f"{rep}_jacobian_transpose_derivative"], kernels[f"{rep}_jacobian"]

    def wrong_derivative(q):
        value = np.array(derivative(q))
        value[..., i, b, k] += PERTURBATION
        return value

    def kinematic(q, wrench):
        return np.einsum("sibk,sk->sbi", wrong_derivative(q), wrench)

    def uncorrected(q, wrench, K):
        J = jacobian(q)
        return kinematic(q, wrench) + np.swapaxes(J, 1, 2) @ K @ J

    def stiffness(q, wrench, K):
        full = uncorrected(q, wrench, K + gamma_F(rep, wrench))
        half = np.triu(full) if rep != "body" else np.tril(full)
        return half + np.swapaxes(half, 1, 2) - np.eye(full.shape[-1]) * full

    return kernels | {
        f"{rep}_jacobian_transpose_derivative": wrong_derivative,
        f"{rep}_kinematic_stiffness": kinematic,
        f"{rep}_joint_stiffness_uncorrected": uncorrected,
        f"{rep}_joint_stiffness": stiffness,
    }


def failures(checks):
    return {(check.kernel, check.oracle) for check in checks if not check.passed}


@pytest.mark.slow
@pytest.mark.usefixtures("kept_errors")
@pytest.mark.parametrize("every", [11, pytest.param(1, marks=pytest.mark.wide)])
@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_no_entry_can_be_wrong_unnoticed(rep, every, chain, robot, references):
    """Spoil each entry, or each eleventh (prime to 6 and 7, so that all rows, columns and joints occur): verify sees
    it.
    """
    kernels = {name: memoised(function) for name, function in kernels_of(robot, chain).items()}
    assert failures(check_kernels(kernels, references)) == set()
    n, missed, blind = chain.dof, [], 0
    entries = list(itertools.product(range(n), range(n), range(6)))[::every]
    for entry in entries:
        found = failures(check_kernels(falsified(kernels, rep, entry), references))
        i, b, _ = entry
        expected = {
            (f"{rep}_jacobian_transpose_derivative", "differentiated Jacobian"),
            (f"{rep}_kinematic_stiffness", "differentiated Jacobian . F"),
            (f"{rep}_joint_stiffness_uncorrected", "formula on differentiated Jacobian"),
        }
        read = b <= i if rep != "body" else b >= i  # entry [b, i] of the stiffness: the half that is computed
        if read:
            expected.add((f"{rep}_joint_stiffness", "formula on differentiated Jacobian"))
            if rep != "spatial":
                expected.add((f"{rep}_joint_stiffness", "Hessian of a potential"))
        if not expected <= found:
            missed.append((entry, expected - found))
        if (f"{rep}_joint_stiffness", "bitwise symmetry") not in found:
            blind += 1
    assert missed == []
    assert blind == len(entries) > 20  # symmetry alone would have caught none of them
