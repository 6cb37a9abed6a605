# SPDX-License-Identifier: MIT
"""The closed forms against CasADi's own differentiation, symbolically independent of each other."""

from __future__ import annotations

from functools import reduce

import casadi as ca
import numpy as np
import pytest

import stiffgen
from stiffgen.symbolic.connection import REPRESENTATIONS
from stiffgen.symbolic.kernels import chain_kernels
from stiffgen.symbolic.kinematics import forward_kinematics, joint_jacobian
from stiffgen.verify.result import as_results, relative_error
from stiffgen.verify.verify import References, check_kernels
from support.project import ROOT


def postures(count, n, seed):
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (count, n))


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_derivative_is_casadis_derivative_of_the_jacobian(rep, chain, model):
    q = ca.SX.sym("q", chain.dof)
    jacobian = joint_jacobian(chain, q, representation=rep).result
    differentiated = ca.Function("dJ", [q], [ca.jacobian(ca.vec(jacobian), q)])
    for posture in postures(20, chain.dof, seed=1):
        # vec() stacks columns: row 6 b + k, column i holds dJ[k, b]/dq_i.
        expected = np.asarray(differentiated(posture)).reshape(chain.dof, 6, chain.dof).transpose(2, 0, 1)
        found = np.asarray(getattr(model, rep).jacobian_transpose_derivative(posture)).reshape(expected.shape)
        assert relative_error(found[None], expected[None]) <= 1e-13


def test_jacobians_are_the_derivative_of_the_pose(chain, model):
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


COM = '<origin xyz="0.01 -0.02 0.05" rpy="0.3 0.2 0.1"/>'
LINK = '<link name="{0}"><inertial>' + COM + '<mass value="1.5"/>{1}</inertial></link>'
INERTIA = '<inertia ixx="0.02" ixy="0.001" ixz="-0.002" iyy="0.03" iyz="0.003" izz="0.025"/>'
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>'
    '<origin xyz="{4}" rpy="{5}"/>{6}<limit lower="-2" upper="2" velocity="1" effort="1"/>{7}</joint>'
)

# Prismatic, continuous, oblique axes, fixed joints in front, between and behind, and a mimic joint.
MIXED = "".join(
    [
        '<robot name="mixed">',
        *(LINK.format(f"l{k}", INERTIA) for k in range(9)),
        JOINT.format("mount", "fixed", "l0", "l1", "0.1 0.2 0.3", "0.1 -0.4 0.7", "", ""),
        JOINT.format("lift", "prismatic", "l1", "l2", "0 0 0.2", "0.2 0 0", '<axis xyz="0 0 -1"/>', ""),
        JOINT.format("waist", "continuous", "l2", "l3", "0.3 0 0.1", "0 1.57079632679 0", '<axis xyz="1 2 -2"/>', ""),
        JOINT.format("bracket", "fixed", "l3", "l4", "0 0.1 0", "1.5707963267948966 0 0", '<axis xyz="0 0 0"/>', ""),
        JOINT.format("elbow", "revolute", "l4", "l5", "0 0 0.4", "0 0 0.5", '<axis xyz="0 -1 0"/>', ""),
        JOINT.format(
            "follower", "revolute", "l5", "l6", "0.2 0 0", "0 0.3 0", '<axis xyz="1 0 0"/>',
            '<mimic joint="elbow" multiplier="-0.5" offset="0.2"/>',
        ),
        JOINT.format("slide", "prismatic", "l6", "l7", "0.1 0 0", "0 0 0.4", '<axis xyz="3 0 4"/>', ""),
        JOINT.format("tool", "fixed", "l7", "l8", "0 0 0.1", "-0.7 0.1 0.3", "", ""),
        "</robot>",
    ]
)  # fmt: skip


@pytest.fixture(scope="module")
def mixed_chain(tmp_path_factory):
    urdf = tmp_path_factory.mktemp("mixed") / "mixed.urdf"
    urdf.write_text(MIXED)
    return stiffgen.load_chain(urdf)


def test_mixed_chain_against_all_oracles(mixed_chain):
    assert [joint.name for joint in mixed_chain.joints] == ["lift", "waist", "elbow", "follower", "slide"]
    assert [c.name for c in mixed_chain.coordinates] == ["lift", "waist", "elbow", "slide"]
    model = stiffgen.StiffnessModel(mixed_chain)

    def stacked(kernel):
        function = getattr(reduce(getattr, kernel.path, model), kernel.name)
        shapes = [result.array(mixed_chain).shape for result in kernel.results]

        def call(*arguments):
            each = [as_results(function(*one)) for one in zip(*arguments, strict=True)]
            stacks = tuple(
                np.stack([np.asarray(value).reshape(shape) for value in values])
                for values, shape in zip(zip(*each, strict=True), shapes, strict=True)
            )
            return stacks if len(stacks) > 1 else stacks[0]

        return call

    kernels = {kernel.qualified_name: stacked(kernel) for kernel in chain_kernels(mixed_chain)}
    checks = check_kernels(kernels, References(mixed_chain, count=10, seed=3))
    assert [check for check in checks if not check.passed] == []


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
