# SPDX-License-Identifier: MIT
"""Derivative of the static torque dU/dq - J^T F with respect to q, against Pinocchio and against differentiated poses.

Pinocchio holds the wrench in the axes of the joint that carries it, the function in base axes (world axes on a floating
base). The difference is J^T (w_i x f, w_i x m) with the angular rows w_i of J.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import folded
from stiffgen.core.verify.kernels.references import References
from stiffgen.families.dynamics.oracles import static_torque_derivatives
from support.chains import chain_urdf
from support.pinocchio_oracle import with_exact_right_angles
from support.project import ROOT, assert_close

DATA = ROOT / "tests" / "data"
ROBOTS = {
    ROOT / "urdf" / "iiwa14.urdf": ["link_ee"],
    DATA / "ur5.urdf": ["tool0"],
    DATA / "panda.urdf": ["panda_hand"],
    DATA / "solo12.urdf": ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"],
}

BASES = pytest.mark.parametrize(
    "floating", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["fixed", "floating"]
)


KERNEL = "static_torque_derivatives"


def function_of(chain):
    return getattr(stiffgen.StiffnessModel(chain, kernels=KERNEL), KERNEL)


class Pinocchio:
    """Pinocchio's model of a chain, and its rows and columns in the order of the chain's coordinates."""

    def __init__(self, file, chain):
        self.chain = chain
        self.model = pin.buildModelFromUrdf(str(file), *([pin.JointModelFreeFlyer()] if chain.floating else []))
        self.data = self.model.createData()
        self.joints = [self.model.joints[self.model.getJointId(each.name)] for each in chain.coordinates]
        self.order = [*range(chain.base_joints), *(joint.idx_v for joint in self.joints)]

    def move(self, q, base):
        """Place the robot; ``base`` is the pose of a floating base."""
        self.at = pin.neutral(self.model)
        if self.chain.floating:
            self.at[:7] = pin.SE3ToXYZQUAT(base)
        self.at[[joint.idx_q for joint in self.joints]] = q
        pin.computeJointJacobians(self.model, self.data, self.at)
        pin.updateFramePlacements(self.model, self.data)

    def in_joint_axes(self, wrenches):
        """Return the loads on the joints that carry the tips, in these joints' axes, as Pinocchio takes them."""
        loads = pin.StdVec_Force()
        loads.extend([pin.Force.Zero() for _ in range(self.model.njoints)])
        for tip, wrench in zip(self.chain.tips, wrenches, strict=True):
            number = self.model.getFrameId(tip.link)
            link = self.model.frames[number]
            in_tip_axes = self.data.oMf[number].rotation.T @ wrench.reshape(2, 3).T
            loads[link.parentJoint] += link.placement.act(pin.Force(in_tip_axes.T.ravel()))
        return loads

    def turning(self, wrenches):
        """Return J^T (w_i x f, w_i x m): a wrench keeps base axes, and Pinocchio's turns with joint i."""
        total = np.zeros((self.model.nv, self.model.nv))
        for tip, wrench in zip(self.chain.tips, wrenches, strict=True):
            number = self.model.getFrameId(tip.link)
            J = pin.getFrameJacobian(self.model, self.data, number, pin.LOCAL_WORLD_ALIGNED)
            total += J.T @ np.vstack([np.cross(J[3:].T, part).T for part in (wrench[:3], wrench[3:])])
        return total

    def derivatives(self, wrenches, gravity):
        """Return d(dU/dq - J^T F)/dq with wrenches and gravity constant in base axes."""
        self.model.gravity.linear = gravity
        turning, loads = self.turning(wrenches), self.in_joint_axes(wrenches)
        found = pin.computeStaticTorqueDerivatives(self.model, self.data, self.at, loads)
        return (turning + np.reshape(found, turning.shape))[np.ix_(self.order, self.order)]

    def gravity_derivatives(self, gravity):
        """Return d2U/dq2 of gravity alone."""
        self.model.gravity.linear = gravity
        found = pin.computeGeneralizedGravityDerivatives(self.model, self.data, self.at)
        return np.reshape(found, (self.model.nv, self.model.nv))[np.ix_(self.order, self.order)]


@BASES
@pytest.mark.parametrize("urdf", ROBOTS, ids=lambda urdf: urdf.stem)
@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.DescriptionWarning")
def test_derivative_of_the_static_torque_by_pinocchio(urdf, floating, tmp_path):
    """Compare the derivative of the static torque with Pinocchio's, with wrenches and with gravity alone."""
    file = tmp_path / urdf.name
    file.write_text(with_exact_right_angles(urdf.read_text()))
    chain = stiffgen.load_chain(file, tip=ROBOTS[urdf], floating_base=floating)
    function, oracle = function_of(chain), Pinocchio(file, chain)
    random = np.random.default_rng(6)
    for _ in range(3):
        q, gravity = random.uniform(-2, 2, len(chain.coordinates)), random.normal(size=3) * 6
        base, wrenches = pin.SE3.Random(), random.normal(size=(len(chain.tips), 6)) * 20
        oracle.move(q, base)
        where = (*([base.homogeneous] if floating else []), q)
        of_tips = wrenches if len(chain.tips) > 1 else wrenches[0]
        assert_close(np.array(function(*where, of_tips, gravity)), oracle.derivatives(wrenches, gravity))
        assert_close(np.array(function(*where, 0 * of_tips, gravity)), oracle.gravity_derivatives(gravity))


@BASES
@pytest.mark.parametrize("types", ["rprrp", "prmr", "rrmrr"])
def test_prismatic_and_mimic_joints_and_a_tool_of_run_time(types, floating, tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(chain_urdf(types))
    _compare(stiffgen.load_chain(file, floating_base=floating, runtime_tool=True))


@pytest.mark.slow
@BASES
def test_two_arms_with_a_tool_each(floating):
    tips = ["left hand", "right-hand"]
    _compare(stiffgen.load_chain(DATA / "dual_arm.urdf", tip=tips, floating_base=floating, runtime_tool=True))


def _compare(chain):
    """Compare the function with the derivative of dU/dq - J^T F, differentiated along the poses in long doubles."""
    function = function_of(chain)
    references = References(chain, 3, 8)
    (kernel,) = (each for each in chain_kernels(chain) if each.name == KERNEL)
    given, expected = references.samples.of(kernel.arguments), references.of(static_torque_derivatives)
    for k in range(3):
        found = function(*(np.reshape(each[k], folded(each[k].shape)) for each in given))
        assert_close(np.array(found), expected[k])
