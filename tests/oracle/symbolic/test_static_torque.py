# SPDX-License-Identifier: MIT
"""Derivative of the static torque dU/dq - J^T F with respect to q, from two kernels, against Pinocchio's.

Pinocchio holds the wrench in the axes of the joint that carries it: the body form.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from stiffgen.verify.poses import gamma_F
from support.pinocchio_oracle import with_exact_right_angles
from support.project import ROOT, assert_close

DATA = ROOT / "tests" / "data"
ROBOTS = {
    ROOT / "urdf" / "iiwa14.urdf": ["link_ee"],
    DATA / "ur5.urdf": ["tool0"],
    DATA / "panda.urdf": ["panda_hand"],
    DATA / "solo12.urdf": ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"],
}


@pytest.mark.parametrize("floating", [False, True], ids=["fixed", "floating"])
@pytest.mark.parametrize("urdf", ROBOTS, ids=lambda urdf: urdf.stem)
@pytest.mark.filterwarnings("ignore::stiffgen.errors.DescriptionWarning")
def test_derivative_of_the_static_torque_by_pinocchio(urdf, floating, tmp_path):
    """Fixed base: gravity's joint stiffness minus the kinematic stiffness; a floating base adds Gamma dU/dq."""
    file = tmp_path / urdf.name
    file.write_text(with_exact_right_angles(urdf.read_text()))
    chain = stiffgen.load_chain(file, tip=ROBOTS[urdf], floating_base=floating)
    kernels, names = stiffgen.StiffnessModel(chain), [c.name for c in chain.coordinates]
    model = pin.buildModelFromUrdf(str(file), *([pin.JointModelFreeFlyer()] if floating else []))
    data, joints = model.createData(), [model.joints[model.getJointId(name)] for name in names]
    order = [*range(chain.base_joints), *(joint.idx_v for joint in joints)]
    random = np.random.default_rng(6)
    for _ in range(3):
        at, q, gravity = pin.neutral(model), random.uniform(-2, 2, len(names)), random.normal(size=3) * 6
        if floating:
            base = pin.SE3.Random()
            at[:7] = pin.SE3ToXYZQUAT(base)
        at[[joint.idx_q for joint in joints]] = q
        model.gravity.linear = gravity
        falling = (*([base.homogeneous] if floating else []), q, gravity)
        found = np.array(kernels.gravity.joint_stiffness(*falling))
        if floating:
            gradient = np.array(kernels.gravity.gradient(*falling)).ravel()
            found[:6, :6] += gamma_F("body", gradient[:6])
        loads = pin.StdVec_Force()
        loads.extend([pin.Force.Zero() for _ in range(model.njoints)])
        for tip in chain.tips:
            wrench, frame = random.normal(size=6) * 20, model.frames[model.getFrameId(tip.link)]
            loads[frame.parentJoint] += frame.placement.act(pin.Force(wrench))
            of_tip = getattr(kernels, tip.name) if len(chain.tips) > 1 else kernels
            found -= np.array(of_tip.body.kinematic_stiffness(q, wrench))
        expected = pin.computeStaticTorqueDerivatives(model, data, at, loads).reshape(model.nv, model.nv)
        assert_close(found, expected[np.ix_(order, order)])
