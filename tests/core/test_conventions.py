# SPDX-License-Identifier: MIT
"""The lines of docs/wrench.md about programs that are installed: Pinocchio, MuJoCo, and the messages of ROS 2."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio
import pytest
from rosbags.typesys import Stores, get_typestore

from support.project import ROOT, URDF, assert_close

GRAVITY = np.array([0.0, 0.0, -9.81])
Q = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
WRENCH = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0])


@pytest.fixture(scope="module")
def pin():
    model = pinocchio.buildModelFromUrdf(str(URDF))
    return model, model.createData(), model.getFrameId("link_ee")


def test_pinocchio_frames_and_orders(pin, robot):
    """Compare the three representations with Pinocchio's frames: LOCAL, WORLD, LOCAL_WORLD_ALIGNED; linear part
    first.
    """
    model, data, frame = pin
    pinocchio.computeJointJacobians(model, data, Q)
    for name, theirs in (
        ("body", pinocchio.LOCAL), ("spatial", pinocchio.WORLD), ("hybrid", pinocchio.LOCAL_WORLD_ALIGNED),
    ):  # fmt: skip
        pinocchio.updateFramePlacements(model, data)
        J = pinocchio.getFrameJacobian(model, data, frame, theirs)
        assert_close(getattr(robot, name).jacobian(Q), J)
    force = pinocchio.Force(WRENCH)
    assert np.array_equal(force.linear, WRENCH[:3]) and np.array_equal(force.angular, WRENCH[3:])
    assert pinocchio.Quaternion(np.array([0.0, 0.0, 0.0, 1.0])).w == 1.0  # (x, y, z, w)


def test_pinocchio_gravity_has_our_sign(pin, robot):
    model, data, _ = pin
    assert_close(robot.gravity.gradient(Q, GRAVITY), pinocchio.computeGeneralizedGravity(model, data, Q))


@pytest.fixture(scope="module")
def mj():
    model = mujoco.MjModel.from_xml_path(str(URDF))
    data = mujoco.MjData(model)
    data.qpos[:] = Q
    mujoco.mj_forward(model, data)
    return model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "link_7")


def at_the_tip(model, data, body, robot):
    """MuJoCo welds fixed links to the body before: the tip's origin in world axes, and the Jacobian there."""
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, linear, angular, robot.forward_kinematics(Q)[:3, 3], body)
    return np.vstack([linear, angular])


def test_mujoco_jacobian_is_hybrid(mj, robot):
    assert_close(robot.hybrid.jacobian(Q), at_the_tip(*mj, robot))


def test_mujoco_applied_force_is_the_environments(mj, robot):
    """xfrc_applied at the centre of mass, moved to the tip, does what J^T F does, with its sign."""
    model, data, body = mj
    r = robot.forward_kinematics(Q)[:3, 3] - data.xipos[body]  # from the centre of mass to the tip
    moment = WRENCH[3:] + np.cross(r, WRENCH[:3])
    data.xfrc_applied[body] = np.concatenate([WRENCH[:3], moment])
    applied = np.zeros(model.nv)
    mujoco.mj_applyFT(model, data, WRENCH[:3], moment, data.xipos[body], body, applied)
    assert_close(applied, robot.hybrid.jacobian(Q).T @ WRENCH)
    before = data.qacc.copy()
    mujoco.mj_forward(model, data)
    change = data.qacc - before
    data.xfrc_applied[body] = 0.0
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, mass, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(mass @ change, applied, rtol=0, atol=1e-9 * np.abs(applied).max())


def test_mujoco_bias_holds_gravity(mj, robot):
    _, data, _ = mj
    assert np.abs(data.qfrc_bias - robot.gravity.gradient(Q, GRAVITY)).max() < 1e-6 * np.abs(data.qfrc_bias).max()


def test_mujoco_quaternions_begin_with_the_real_part():
    identity = np.zeros(4)
    mujoco.mju_mat2Quat(identity, np.eye(3).ravel())
    assert np.array_equal(identity, [1.0, 0.0, 0.0, 0.0])


def test_ros_messages_have_the_order_of_the_page():
    """Serialise ROS messages: force, torque; linear, angular; x, y, z, w, as the page says."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    geometry = {name: store.types[f"geometry_msgs/msg/{name}"] for name in ("Wrench", "Twist", "Vector3", "Quaternion")}
    first, second = (geometry["Vector3"](*values) for values in ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)))
    for kind, names in (("Wrench", ("force", "torque")), ("Twist", ("linear", "angular"))):
        message = geometry[kind](**dict(zip(names, (first, second), strict=True)))
        wire = bytes(store.serialize_cdr(message, f"geometry_msgs/msg/{kind}"))
        assert np.array_equal(np.frombuffer(wire[-48:]), [1, 2, 3, 4, 5, 6])
    turn = geometry["Quaternion"](x=1.0, y=2.0, z=3.0, w=4.0)
    wire = bytes(store.serialize_cdr(turn, "geometry_msgs/msg/Quaternion"))
    assert np.array_equal(np.frombuffer(wire[-32:]), [1, 2, 3, 4])


def test_the_page_has_a_section_for_each():
    page = (ROOT / "docs" / "wrench.md").read_text()
    for program in ("libfranka", "KUKA FRI", "UR", "ROS 2 messages", "ros2_control", "MuJoCo", "Drake", "Pinocchio"):
        assert f"\n### {program}" in page, program
