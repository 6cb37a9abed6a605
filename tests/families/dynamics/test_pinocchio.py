# SPDX-License-Identifier: MIT
"""Pinocchio as the oracle: Jacobians, joint Hessians and the mass matrix of all robots in urdf/."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from support.project import ROOT, assert_close

FRAMES = {
    "body": pin.ReferenceFrame.LOCAL,
    "spatial": pin.ReferenceFrame.WORLD,
    "hybrid": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
}
ROBOTS = ("iiwa14", "iiwa7", "med14", "med7")


@cache
def load(robot, tip):
    """Return model, Pinocchio's model and data, and 20 random postures within the limits."""
    urdf = ROOT / "urdf" / f"{robot}.urdf"
    pinocchio = pin.buildModelFromUrdf(str(urdf))
    postures = np.random.default_rng(5).uniform(
        pinocchio.lowerPositionLimit, pinocchio.upperPositionLimit, (20, pinocchio.nq)
    )
    names = [f"{rep}.{name}" for rep in FRAMES for name in ("jacobian", "jacobian_transpose_derivative")]
    chain = stiffgen.load_chain(urdf, tip=tip)
    model = stiffgen.StiffnessModel(chain, kernels=("forward_kinematics", "mass_matrix", *names))
    return model, pinocchio, pinocchio.createData(), postures


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("rep", FRAMES)
def test_jacobian_and_pose(robot, rep):
    """Compare Jacobians and poses with Pinocchio's."""
    model, pinocchio, data, postures = load(robot, "link_ee")
    tip = pinocchio.getFrameId("link_ee")
    for q in postures:
        expected = pin.computeFrameJacobian(pinocchio, data, q, tip, FRAMES[rep])
        assert_close(getattr(model, rep).jacobian(q), expected)
        pin.framesForwardKinematics(pinocchio, data, q)
        assert_close(model.forward_kinematics(q), data.oMf[tip].homogeneous)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("rep", FRAMES)
def test_joint_hessian(robot, rep):
    """Pinocchio has Hessians of joints, not of frames: the tip is the last joint's link."""
    model, pinocchio, data, postures = load(robot, "link_7")
    joint = pinocchio.getJointId("A7")
    for q in postures:
        pin.computeJointKinematicHessians(pinocchio, data, q)
        hessian = np.asarray(pin.getJointKinematicHessian(pinocchio, data, joint, FRAMES[rep]))
        # [k, b, i] = dJ[k, b]/dq_i, in column-major memory that the Python binding labels row-major.
        expected = hessian.ravel().reshape(pinocchio.nv, pinocchio.nv, 6)
        assert_close(np.asarray(getattr(model, rep).jacobian_transpose_derivative(q)).reshape(expected.shape), expected)


@pytest.mark.parametrize("robot", ROBOTS)
def test_mass_matrix(robot):
    model, pinocchio, data, postures = load(robot, "link_ee")
    for q in postures:
        upper = np.triu(pin.crba(pinocchio, data, q))
        assert_close(model.mass_matrix(q), upper + np.triu(upper, 1).T)
