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


@BASES
@pytest.mark.parametrize("urdf", ROBOTS, ids=lambda urdf: urdf.stem)
@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.DescriptionWarning")
def test_derivative_of_the_static_torque_by_pinocchio(urdf, floating, tmp_path):
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
        pin.computeJointJacobians(model, data, at)
        pin.updateFramePlacements(model, data)
        loads, wrenches = pin.StdVec_Force(), random.normal(size=(len(chain.tips), 6)) * 20
        loads.extend([pin.Force.Zero() for _ in range(model.njoints)])
        held = np.zeros((model.nv, model.nv))
        for tip, wrench in zip(chain.tips, wrenches, strict=True):
            frame = model.getFrameId(tip.link)
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            held += J.T @ np.vstack([np.cross(J[3:].T, part).T for part in (wrench[:3], wrench[3:])])
            turned = data.oMf[frame].rotation.T @ wrench.reshape(2, 3).T
            link = model.frames[frame]
            loads[link.parentJoint] += link.placement.act(pin.Force(turned.T.ravel()))
        where = (*([base.homogeneous] if floating else []), q)
        of_tips = wrenches if len(chain.tips) > 1 else wrenches[0]
        found = np.array(kernels.static_torque_derivatives(*where, of_tips, gravity))
        expected = held + pin.computeStaticTorqueDerivatives(model, data, at, loads).reshape(model.nv, model.nv)
        assert_close(found, expected[np.ix_(order, order)])
        found = np.array(kernels.static_torque_derivatives(*where, 0 * of_tips, gravity))
        expected = pin.computeGeneralizedGravityDerivatives(model, data, at)
        assert_close(found, np.reshape(expected, (model.nv, model.nv))[np.ix_(order, order)])


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
    function = getattr(stiffgen.StiffnessModel(chain), KERNEL)
    references = References(chain, 3, 8)
    (kernel,) = (each for each in chain_kernels(chain) if each.name == KERNEL)
    given, expected = references.samples.of(kernel.arguments), references.of(static_torque_derivatives)
    for k in range(3):
        found = function(*(np.reshape(each[k], folded(each[k].shape)) for each in given))
        assert_close(np.array(found), expected[k])
