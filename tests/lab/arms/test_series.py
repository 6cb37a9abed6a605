# SPDX-License-Identifier: MIT
"""Springs in series: 60 digits, the limits of rigid gears, and Pinocchio with free joints for compliant parts."""

from __future__ import annotations

import mpmath
import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from stiffgen import load_chain
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from support.project import ROOT

UR5 = ROOT / "tests" / "data" / "ur5.urdf"
FRAMES = {"body": pin.LOCAL, "spatial": pin.WORLD, "hybrid": pin.LOCAL_WORLD_ALIGNED}


def spring(random: np.random.Generator, n: int, rank: int | None = None) -> np.ndarray:
    """Return a random positive semidefinite matrix."""
    root = random.normal(size=(n, rank or n))
    return root @ root.T


def exact(Kq: np.ndarray, Kc: np.ndarray) -> np.ndarray:
    """Return Kc - Kc (Kq + Kc)^-1 Kc with 60 digits."""
    with mpmath.workdps(60):
        A, B = mpmath.matrix(Kq.tolist()), mpmath.matrix(Kc.tolist())
        return np.array((B - B * (A + B) ** -1 * B).tolist(), dtype=float)


@pytest.mark.parametrize("ratio", [1e-6, 1e-2, 1.0, 1e2, 1e6])
@pytest.mark.parametrize("rank", [7, 6, 3])
def test_soft_and_stiff_gears_against_60_digits(ratio, rank):
    """Put springs and gears in series, ratios 1e-6 to 1e6: 1e-13 of 60-digit values, and symmetric to the bit."""
    random = np.random.default_rng(rank)
    Kq = np.array([spring(random, 7, rank) for _ in range(5)])
    gears = ratio * random.uniform(1, 3, 7)
    coupled = ratio * np.array([spring(random, 7) + np.eye(7) for _ in range(5)])
    rounding = 0.0 if rank == 7 else 1e-15 * np.abs(Kq).max()  # of a singular Kq, where no spring hides it
    for Kc, each in ((gears, [np.diag(gears)] * 5), (coupled, coupled)):
        found = stiffgen.in_series(Kq, Kc)
        assert (found == found.swapaxes(1, 2)).all()
        expected = np.array([exact(*pair) for pair in zip(Kq, each, strict=True)])
        assert np.abs(found - expected).max() <= 1e-13 * np.abs(expected).max() + rounding


def test_rigid_gears():
    """Infinity is the limit of stiff gears; with rigid gears alone the controller is felt as it is."""
    Kq = spring(np.random.default_rng(0), 5)
    gears = np.array([4.0, np.inf, 2.0, np.inf, 7.0])
    found = stiffgen.in_series(Kq, gears)
    assert np.abs(found - exact(Kq, np.diag(np.where(np.isfinite(gears), gears, 1e40)))).max() <= 1e-13
    assert (stiffgen.in_series(Kq, np.full(5, np.inf)) == (Kq + Kq.T) / 2).all()
    assert np.allclose(stiffgen.in_series(Kq, np.full(5, 1e12)), Kq, rtol=1e-9)


def test_no_stable_motors_is_nan_there_alone():
    """A controller may push away from its goal only as hard as the gears pull back."""
    Kq = np.array([np.diag([5.0, k]) for k in (1.0, -2.9, -3.1, np.nan, 0.0, np.inf)])
    found = stiffgen.in_series(Kq, [10.0, 3.0])
    assert np.isnan(found).all(axis=(1, 2)).tolist() == [False, False, True, True, False, True]
    assert found[1, 1, 1] == pytest.approx(-2.9 * 3 / 0.1)
    assert np.allclose(found[4], np.diag([50 / 15, 0.0]), rtol=1e-15, atol=0)


@pytest.fixture(scope="module")
def softly_mounted():
    """Return Pinocchio's UR5 on a free joint, with a free joint between flange and tool, and the tool's frame."""
    model = pin.buildModelFromUrdf(str(UR5), pin.JointModelFreeFlyer())
    flange = model.frames[model.getFrameId("tool0")]
    gripper = pin.SE3(pin.utils.rotate("y", 0.4), np.array([0.02, -0.05, 0.11]))
    joint = model.addJoint(flange.parentJoint, pin.JointModelFreeFlyer(), flange.placement * gripper, "gripper")
    tool = pin.SE3(pin.utils.rotate("x", -0.7), np.array([0.1, 0.03, 0.2]))
    frame = model.addFrame(pin.Frame("tip", joint, model.getFrameId("tool0"), tool, pin.FrameType.OP_FRAME))
    return model, joint, frame


@pytest.mark.parametrize("representation", FRAMES)
def test_mount_and_gripper_against_pinocchio(softly_mounted, representation):
    """Compare with an unloaded chain of springs: J K^-1 J^T with the six coordinates of each compliant part."""
    model, joint, frame = softly_mounted
    data, random = model.createData(), np.random.default_rng(1)
    mount, gripper, motors = 1e-5 * spring(random, 6), 1e-5 * spring(random, 6), random.uniform(1e-4, 1e-3, 6)
    arms, poses, frames, expected = [], [], [], []
    base = pin.SE3(np.eye(4))
    for _ in range(4):
        q = pin.neutral(model)
        q[7:13] = random.uniform(-2, 2, 6)  # the arm, between the coordinates of mount and gripper
        J = pin.computeFrameJacobian(model, data, q, frame, FRAMES[representation])
        arms.append(J[:, 6:12] @ np.diag(motors) @ J[:, 6:12].T)
        expected.append(J[:, :6] @ mount @ J[:, :6].T + arms[-1] + J[:, 12:] @ gripper @ J[:, 12:].T)
        pin.framesForwardKinematics(model, data, q)
        poses.append(data.oMf[frame].homogeneous.copy())
        frames.append(data.oMi[joint].homogeneous.copy())
    arms = (np.array(arms) + np.swapaxes(arms, 1, 2)) / 2
    parts = [(mount, base.homogeneous), (gripper, np.array(frames))]
    found = stiffgen.tip_compliance_in_series(arms, np.array(poses), parts, representation)
    assert (found == found.swapaxes(1, 2)).all()
    assert np.abs(found - expected).max() <= 1e-14 * np.abs(expected).max()


def test_a_mount_under_a_load_against_a_floating_base():
    """Compare a compliant mount with six more coordinates: equal without a load, else off by less than stated."""
    options = KernelOptions(kernels=("hybrid.tip_compliance",))
    functions = [
        {each.qualified_name: casadi_function(chain, each) for each in chain_kernels(chain, options)}
        for chain in (load_chain(UR5, tip="tool0", floating_base=True), load_chain(UR5, tip="tool0"))
    ]
    (exact, _), (arm, pose) = [(each["hybrid_tip_compliance"], each["forward_kinematics"]) for each in functions]
    random, turning = np.random.default_rng(0), 2e4  # stiffness [N m/rad] of the mount against turning
    mount = np.diag([1e6] * 3 + [turning] * 3) + 1e3 * spring(random, 6)
    springs = np.diag(random.uniform(2e3, 8e3, 6))
    both = np.block([[mount, np.zeros((6, 6))], [np.zeros((6, 6)), springs]])
    for load in (0.0, 10, 10, 70, 70):
        q, wrench = random.uniform(-1.5, 1.5, 6), load * np.array([2, -3, 6, 0.4, -0.3, 0.5]) / 7
        tip = np.array(pose(q))
        parts = [(np.linalg.inv(mount), np.eye(4))]
        found = stiffgen.tip_compliance_in_series(np.array(arm(q, wrench, springs)), tip, parts)
        expected = np.array(exact(np.eye(4), q, wrench, both))
        off = np.abs(found - expected).max() / np.abs(expected).max()
        bound = load * np.linalg.norm(tip[:3, 3]) / turning
        assert off <= max(bound, 1e-14)
        assert off >= 0.1 * bound
