# SPDX-License-Identifier: MIT
"""The closed forms against CasADi's own differentiation, symbolically independent of each other."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kinematics import forward_kinematics, joint_jacobian
from stiffgen.core.verify.result import relative_error
from support.project import ROOT


def postures(count, n, seed):
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (count, n))


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_derivative_is_casadis_derivative_of_the_jacobian(rep, chain, model):
    """Compare dJ^T/dq with CasADi's own derivative of the Jacobian, at 20 postures."""
    q = ca.SX.sym("q", chain.dof)
    jacobian = joint_jacobian(chain, q, representation=rep).result
    differentiated = ca.Function("dJ", [q], [ca.jacobian(ca.vec(jacobian), q)])
    for posture in postures(20, chain.dof, seed=1):
        # vec() stacks columns: row 6 b + k, column i holds dJ[k, b]/dq_i.
        expected = np.asarray(differentiated(posture)).reshape(chain.dof, 6, chain.dof).transpose(2, 0, 1)
        found = np.asarray(getattr(model, rep).jacobian_transpose_derivative(posture)).reshape(expected.shape)
        assert relative_error(found[None], expected[None]) <= 1e-13


def test_jacobians_are_the_derivative_of_the_pose(chain, model):
    """Compare the three Jacobians with twists from CasADi's derivative of the pose, at 20 postures."""
    q = ca.SX.sym("q", chain.dof)
    pose = forward_kinematics(chain, q).result
    rate = ca.Function("dH", [q], [ca.jacobian(ca.vec(pose), q), pose])
    for posture in postures(20, chain.dof, seed=2):
        rates, H = (np.asarray(value) for value in rate(posture))
        for i in range(chain.dof):
            dH = rates[:, i].reshape(4, 4).T
            for rep, twist in (("body", np.linalg.inv(H) @ dH), ("spatial", dH @ np.linalg.inv(H))):
                column = np.asarray(getattr(model, rep).jacobian(posture))[:, i]
                expected = [*twist[:3, 3], twist[2, 1], twist[0, 2], twist[1, 0]]
                assert np.allclose(column, expected, rtol=0, atol=1e-13)
            hybrid = np.asarray(model.hybrid.jacobian(posture))[:, i]
            assert np.allclose(hybrid[:3], dH[:3, 3], rtol=0, atol=1e-13)
            w = dH[:3, :3] @ H[:3, :3].T
            assert np.allclose(hybrid[3:], [w[2, 1], w[0, 2], w[1, 0]], rtol=0, atol=1e-13)


@pytest.mark.parametrize(("robot", "lengths"), [
    ("iiwa14", (0.36, 0.42, 0.4, 0.126)),
    ("iiwa7", (0.34, 0.4, 0.4, 0.126)),
    ("med7", (0.34, 0.4, 0.4, 0.126)),
    ("med14", (0.3595, 0.42, 0.4, 0.126)),
])  # fmt: skip
def test_lumped_lengths_of_the_lbr_arms(robot, lengths):
    """Shoulder height, upper arm, forearm, wrist to flange: the figures on which descriptions of these arms differ."""
    loaded = stiffgen.load_chain(ROOT / "urdf" / f"{robot}.urdf")
    offsets = [np.linalg.norm(joint.translation) for joint in loaded.joints] + [np.linalg.norm(loaded.tip_translation)]
    assert tuple(round(offset, 15) for offset in offsets if offset > 0) == lengths
