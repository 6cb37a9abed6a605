# SPDX-License-Identifier: MIT
"""docs/derivatives.md: which entry of the Hessian is which at Pinocchio's and MuJoCo's, and the manipulability."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio
import pytest

import stiffgen
from support.project import URDF, assert_close


@pytest.fixture(scope="module")
def model():
    names = "hybrid.jacobian", "hybrid.jacobian_transpose_derivative"
    return stiffgen.StiffnessModel(stiffgen.load_chain(URDF, tip="link_7"), derivatives=True, kernels=names)


def hessian(model, q):
    n = len(q)
    return np.asarray(model.hybrid.jacobian_transpose_derivative(q)).reshape(n, n, 6)


@pytest.fixture(params=range(5))
def q(request):
    return np.random.default_rng(request.param).uniform(-2, 2, 7)


def test_entries_are_derivatives_of_jacobian_entries(model, q):
    """By differences of the Jacobian: which index is the joint that moves cannot be mistaken."""
    H, step = hessian(model, q), 1e-5
    for i in range(7):
        moved = [np.asarray(model.hybrid.jacobian(q + sign * step * np.eye(7)[i])) for sign in (1, -1)]
        assert np.abs(H[i].T - (moved[0] - moved[1]) / (2 * step)).max() < 1e-9


def test_only_linear_rows_of_the_hybrid_form_are_symmetric(model, q):
    H = hessian(model, q)
    assert np.abs(H - H.transpose(1, 0, 2))[..., :3].max() < 1e-13
    assert np.abs(H - H.transpose(1, 0, 2))[..., 3:].max() > 0.1


def test_pinocchio(model, q):
    robot = pinocchio.buildModelFromUrdf(str(URDF))
    data, joint = robot.createData(), robot.getJointId("A7")
    pinocchio.computeJointKinematicHessians(robot, data, q)
    T = np.asarray(pinocchio.getJointKinematicHessian(robot, data, joint, pinocchio.LOCAL_WORLD_ALIGNED))
    H = T.ravel().reshape(robot.nv, robot.nv, 6)
    assert_close(hessian(model, q), H)


def test_mujoco(model, q):
    """Compare the Jacobian's derivative times dq with MuJoCo's mj_jacDot."""
    robot = mujoco.MjModel.from_xml_path(str(URDF))
    data, body = mujoco.MjData(robot), mujoco.mj_name2id(robot, mujoco.mjtObj.mjOBJ_BODY, "link_7")
    data.qpos[:], data.qvel[:] = q, np.random.default_rng(9).normal(size=7)
    for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
        update(robot, data)
    linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
    mujoco.mj_jacDot(robot, data, linear, angular, data.xpos[body], body)
    theirs = np.vstack([linear, angular])
    ours = np.einsum("ibk,i->kb", hessian(model, q), data.qvel)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(ours).max()


def test_gradient_of_the_manipulability(model, q):
    """Compare the gradient of sqrt(det J J^T) through the VJP with differences (step 1e-5 rad) and with the Hessian."""

    def manipulability(q):
        J = np.asarray(model.hybrid.jacobian(q))
        return np.sqrt(np.linalg.det(J @ J.T))

    J, w = np.asarray(model.hybrid.jacobian(q)), manipulability(q)
    J_bar = w * np.linalg.solve(J @ J.T, J)
    gradient = np.asarray(model.hybrid.jacobian_vjp(q, J_bar)).ravel()
    step = 1e-5
    differences = [(manipulability(q + step * e) - manipulability(q - step * e)) / (2 * step) for e in np.eye(7)]
    assert np.abs(gradient - differences).max() < 1e-8
    assert np.abs(gradient - np.einsum("ibk,kb->i", hessian(model, q), J_bar)).max() < 1e-13
