# SPDX-License-Identifier: MIT
"""Drake's line of docs/wrench.md: ``make campaign NAME=drake``; Drake is too large for the other tests."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable

import stiffgen
from support.project import URDF, assert_close

Q = np.radians([70.45, 55.35, -36.13, -94.85, 2.43, 11.60, 139.89])
LINEAR_FIRST = [3, 4, 5, 0, 1, 2]


@pytest.fixture(scope="module")
def model():
    return stiffgen.StiffnessModel(stiffgen.load_chain(URDF, tip="link_ee"))


@pytest.fixture(scope="module")
def drake():
    """Return Drake's plant of the iiwa 14, welded to the world, and its context at Q."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(URDF))
    base = plant.GetBodyByName(stiffgen.load_chain(URDF).base)
    if base not in plant.GetBodiesWeldedTo(plant.world_body()):
        plant.WeldFrames(plant.world_frame(), base.body_frame())
    plant.Finalize()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, Q)
    return plant, context


def test_torque_and_rotation_come_first():
    assert np.array_equal(SpatialForce(tau=[4.0, 5, 6], f=[1.0, 2, 3]).get_coeffs(), [4, 5, 6, 1, 2, 3])
    assert np.array_equal(SpatialVelocity(w=[4.0, 5, 6], v=[1.0, 2, 3]).get_coeffs(), [4, 5, 6, 1, 2, 3])


def test_jacobian_is_the_hybrid_one_with_the_angular_rows_first(drake, model):
    plant, context = drake
    world, tip = plant.world_frame(), plant.GetFrameByName("link_ee")
    J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, tip, np.zeros(3), world, world)
    assert_close(J[LINEAR_FIRST], np.asarray(model.hybrid.jacobian(Q)))


def test_gravity_has_the_opposite_sign(drake, model):
    plant, context = drake
    gravity = plant.gravity_field().gravity_vector()
    assert gravity[2] < -9
    ours = np.asarray(model.gravity.gradient(Q, gravity)).ravel()
    assert_close(plant.CalcGravityGeneralizedForces(context), -ours)


def test_a_force_applied_to_the_body_is_the_environments(drake, model):
    """F_BBo_W of an external force does J^T F, with its sign."""
    plant, context = drake
    wrench = np.array([5.0, -10.0, 15.0, 4.0, -3.0, 8.0])
    world, tip = plant.world_frame(), plant.GetFrameByName("link_ee")
    J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, tip, np.zeros(3), world, world)
    force = SpatialForce(tau=wrench[3:], f=wrench[:3])
    assert_close(J.T @ force.get_coeffs(), np.asarray(model.hybrid.jacobian(Q)).T @ wrench)


def test_quaternions_begin_with_the_real_part():
    assert np.array_equal(Quaternion(wxyz=[1.0, 0, 0, 0]).wxyz(), [1, 0, 0, 0])
    assert Quaternion(w=0.6, x=0.8, y=0.0, z=0.0).wxyz()[0] == 0.6
