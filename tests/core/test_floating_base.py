# SPDX-License-Identifier: MIT
"""A floating base: coordinates, connection, values by Pinocchio; test_exact_values.py has 60 digits."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from stiffgen.core.errors import ChainError
from stiffgen.core.symbolic.choices import KernelOptions, Potential
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.symbolic.kernels import chain_kernels
from support.exact_tree import as_array, exponential, mp, tree_urdf
from support.pinocchio_oracle import with_exact_right_angles
from support.project import ROOT, assert_close

DATA = ROOT / "tests" / "data"
TIPS = ["left", "right"]
FRAMES = {
    "body": pin.ReferenceFrame.LOCAL,
    "spatial": pin.ReferenceFrame.WORLD,
    "hybrid": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
}


OF_TIPS = [
    f"{rep}.{name}"
    for rep in REPRESENTATIONS
    for name in (
        "jacobian", "jacobian_transpose_derivative", "kinematic_stiffness", "connection_correction", "joint_stiffness",
        "joint_stiffness_uncorrected",
    )
]  # fmt: skip


def random_pose(random):
    """A pose of doubles; its rotation is one to the last digit or two."""
    pose = np.eye(4)
    pose[:3, :3] = as_array(exponential(mp.matrix(random.normal(size=3).tolist())))
    pose[:3, 3] = random.normal(size=3)
    return pose


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """Return a floating robot with two tips, sliding and mimic joints, and a configuration of it."""
    file = tmp_path_factory.mktemp("floating") / "tree.urdf"
    file.write_text(tree_urdf(7, 6))
    chain = stiffgen.load_chain(file, tip=TIPS, floating_base=True)
    random = np.random.default_rng(4)
    return SimpleNamespace(
        file=file,
        chain=chain,
        model=stiffgen.StiffnessModel(chain, kernels=(*OF_TIPS, "spring.joint_stiffness", "bias_forces", "gravity")),
        base=random_pose(random),
        q=random.uniform(-2, 2, len(chain.coordinates)),
        velocity=random.normal(size=chain.dof),
        gravity=np.array([1.5, -2.0, -9.0]),
    )


def values(result, shape=None):
    found = np.asarray(result)
    return found.reshape(shape) if shape else found


def test_shapes(tree):
    chain = tree.chain
    assert (len(chain.joints), len(chain.coordinates), chain.dof) == (12, 5, 11)
    assert chain.coupled and any(joint.prismatic for joint in chain.joints[6:])


def test_the_bases_own_connection_term_matters(tree):
    """Leave the base's own term out: its block is not even symmetric, as docs/whole_body.md says."""
    wrench = np.array([20.0, -30, 10, 5, 8, -6])  # [N], [N m] in the tip's axes
    stiffness = np.diag([900.0, 400, 1500, 40, 20, 60])  # [N/m], [N m/rad]
    found = values(tree.model.left.body.joint_stiffness(tree.q, wrench, stiffness))
    J = values(tree.model.left.body.jacobian(tree.q))
    kinematic = values(tree.model.left.body.kinematic_stiffness(tree.q, wrench))
    force, moment = wrench[:3], wrench[3:]

    def cross(v):
        return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])

    def gamma(f, m):  # the connection's term: what the wrench adds to the stiffness of a turning tip
        return np.block([[np.zeros((3, 3)), cross(f)], [np.zeros((3, 3)), cross(m) / 2]])

    without = kinematic + J.T @ (stiffness + gamma(force, moment)) @ J
    on_base = (J.T @ wrench)[:6]  # the wrench as the base bears it, in the base's axes
    expected = without.copy()
    expected[:6, :6] -= gamma(on_base[:3], on_base[3:])
    assert_close(found, expected)
    assert np.abs(without - without.T).max() > 0.1 * np.abs(on_base).max()


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_derivative_of_the_jacobian_along_the_coordinates(rep, tree):
    """Compare with differences of the Jacobian's kernel, the base moved along each of its unit twists."""
    group, n, step = getattr(tree.model.left, rep), tree.chain.dof, 1e-4

    def jacobian(k, far):
        x = far * step * np.eye(n)[k]
        turn = np.eye(4)
        turn[:3, :3] = as_array(exponential(mp.matrix(x[3:6].tolist())))
        turn[:3, 3] = x[:3]
        where = (tree.q + x[6:],) if rep == "body" else (tree.base @ turn, tree.q + x[6:])
        return values(group.jacobian(*where))

    where = (tree.q,) if rep == "body" else (tree.base, tree.q)
    found = values(group.jacobian_transpose_derivative(*where), (n, n, 6))
    wrench = np.array([20.0, -30, 10, 5, 8, -6])
    for k in range(n):
        near, far = (jacobian(k, d) - jacobian(k, -d) for d in (1, 2))
        expected = (8 * near - far) / (12 * step)  # five-point rule
        assert np.abs(found[k].T - expected).max() < 1e-10 * max(1, np.abs(expected).max())
    kinematic = values(group.kinematic_stiffness(*where, wrench))
    assert_close(kinematic, np.einsum("ibk,k->bi", found, wrench))
    K = np.random.default_rng(2).normal(size=(6, 6))
    J = values(group.jacobian(*where))
    assert_close(values(group.joint_stiffness_uncorrected(*where, wrench, K)), kinematic + J.T @ K @ J)


def test_spatial_form(tree):
    """Kin + J^T (K + Gamma F) J less the base's Gamma, with the tip's spatial connection: symmetric by that alone."""
    wrench = np.array([20.0, -30, 10, 5, 8, -6])
    K = np.random.default_rng(2).normal(size=(6, 6)) * 100
    K = K + K.T
    group, where = tree.model.left.spatial, (tree.base, tree.q)
    J, kinematic = values(group.jacobian(*where)), values(group.kinematic_stiffness(*where, wrench))
    expected = kinematic + J.T @ (K + values(group.connection_correction(wrench))) @ J
    on_base = J.T @ wrench
    expected[:6, :6] -= values(tree.model.left.body.connection_correction(on_base[:6]))
    assert_close(expected, expected.T)
    assert_close(values(group.joint_stiffness(*where, wrench, K)), expected)


def test_rigid_motion_of_everything(tree):
    """Base, equilibria and gravity moved together leave the springs' and gravity's joint stiffness as it is."""
    random = np.random.default_rng(9)
    motion, equilibria = random_pose(random), [random_pose(random) for _ in TIPS]
    Kt, Ko = np.diag([900.0, 400, 1500]), np.diag([40.0, 20, 60])
    turn = motion[:3, :3]

    def total(base, equilibria, Kt, gravity):
        kinds = (np.concatenate(each) for each in (equilibria, 2 * [Kt], 2 * [Ko]))
        stiffness = values(tree.model.spring.joint_stiffness_total(base, tree.q, *kinds))
        return stiffness, values(tree.model.gravity.joint_stiffness(base, tree.q, gravity))

    before = total(tree.base, equilibria, Kt, tree.gravity)
    moved = [motion @ each for each in equilibria]
    after = total(motion @ tree.base, moved, turn @ Kt @ turn.T, turn @ tree.gravity)
    for a, b in zip(after, before, strict=True):
        assert_close(a, b)
        assert np.array_equal(a, a.T)


def free_flyer(tree):
    model = pin.buildModelFromXML(tree.file.read_text(), pin.JointModelFreeFlyer(), mimic=True)
    model.gravity.linear = tree.gravity
    names = [c.name for c in tree.chain.coordinates]
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    return model, model.createData(), [*range(6), *order]


def test_pinocchio(tree):
    """Compare bias forces and Jacobians of a floating robot with Pinocchio's, with gravity and without."""
    model, data, order = free_flyer(tree)
    q, v = pin.neutral(model), np.zeros(model.nv)
    q[:7] = pin.SE3ToXYZQUAT(pin.SE3(tree.base[:3, :3], tree.base[:3, 3]))
    for name, position in zip([c.name for c in tree.chain.coordinates], tree.q, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = position
    v[order] = tree.velocity
    given = tree.base, tree.q
    bias = values(tree.model.bias_forces(*given, tree.velocity, tree.gravity), tree.chain.dof)
    assert_close(bias, pin.nonLinearEffects(model, data, q, v)[order])
    model.gravity.linear = np.zeros(3)
    still = values(tree.model.bias_forces(*given, tree.velocity, np.zeros(3)), tree.chain.dof)
    assert_close(still, pin.nonLinearEffects(model, data, q, v)[order])
    for tip in TIPS:
        frame = model.getFrameId(tip)
        for rep, reference in FRAMES.items():
            where = (tree.q,) if rep == "body" else given
            expected = pin.computeFrameJacobian(model, data, q, frame, reference)[:, order]
            assert_close(values(getattr(getattr(tree.model, tip), rep).jacobian(*where)), expected)


def test_a_floating_root_joint_is_the_base(tree, tmp_path):
    """Declare the floating base by a root joint: the same chain as by the option floating_base."""
    text = tree.file.read_text()
    world = (
        '<link name="world"/><joint name="free" type="floating"><parent link="world"/><child link="pelvis"/></joint>'
    )
    file = tmp_path / "world.urdf"
    file.write_text(text.replace("<link", world + "<link", 1))
    chain = stiffgen.load_chain(file, tip=TIPS)
    assert chain.floating and chain.base == "pelvis" and chain.joints == tree.chain.joints
    assert not stiffgen.load_chain(file, tip=TIPS, base="pelvis").floating
    with pytest.raises(ChainError, match=r"remove base=\.\.\., or use base='world'"):
        stiffgen.load_chain(file, tip=TIPS, base="left_0", floating_base=True)


def test_what_moves_before_a_floating_joint_refuses_it(tree, tmp_path):
    """Put a moving joint above the floating one: refused, with the base to choose."""
    text = tree.file.read_text()
    before = (
        '<link name="world"/><link name="cart"/><joint name="rail" type="prismatic"><parent link="world"/>'
        '<child link="cart"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        '<joint name="free" type="floating"><parent link="cart"/><child link="pelvis"/></joint>'
    )
    file = tmp_path / "cart.urdf"
    file.write_text(text.replace("<link", before + "<link", 1))
    with pytest.raises(ChainError, match=r"'free'.*floating.*base='pelvis'"):
        stiffgen.load_chain(file, tip=TIPS)


ROBOTS = {
    "talos_data/robots/talos_reduced.urdf": (
        "left_sole_link",
        "right_sole_link",
        "gripper_left_base_link",
        "gripper_right_base_link",
    ),
    "solo12.urdf": ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"),
}
"""Solo 12 is in tests/data, Talos in example-robot-data."""


def urdf_of(robot):
    """Return the file of a robot of the test data or of example-robot-data; skip without it."""
    if (DATA / robot).exists():
        return DATA / robot
    try:
        data_files = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data (400 MB) is not installed: pip install -e '.[robots]'")
    return Path(str(data_files.locate_file("cmeel.prefix/share/example-robot-data/robots"))) / robot


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.DescriptionWarning")
def test_real_robots(robot, tmp_path):
    """Compare J, M, gravity and bias forces of a humanoid and a quadruped with Pinocchio's free-flyer."""
    urdf = urdf_of(robot)
    text = with_exact_right_angles(urdf.read_text())
    urdf = tmp_path / urdf.name
    urdf.write_text(text)
    chain = stiffgen.load_chain(urdf, tip=ROBOTS[robot], floating_base=True)
    names = ("mass_matrix", "bias_forces", "gravity.gradient", *(f"{rep}.jacobian" for rep in FRAMES))
    kernels = stiffgen.StiffnessModel(chain, kernels=names)
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    data, names = model.createData(), [c.name for c in chain.coordinates]
    order = [*range(6), *(model.joints[model.getJointId(name)].idx_v for name in names)]
    random = np.random.default_rng(3)
    for _ in range(3):
        base, gravity = random_pose(random), random.normal(size=3) * 6
        q, velocity = random.uniform(-1, 1, len(names)), random.normal(size=chain.dof)
        model.gravity.linear = gravity
        at, rates = pin.neutral(model), np.zeros(model.nv)
        at[:7] = pin.SE3ToXYZQUAT(pin.SE3(base[:3, :3], base[:3, 3]))
        at[[model.joints[model.getJointId(name)].idx_q for name in names]] = q
        rates[order] = velocity
        mass = np.triu(pin.crba(model, data, at))
        mass = (mass + np.triu(mass, 1).T)[np.ix_(order, order)]
        assert_close(values(kernels.mass_matrix(q)), mass)
        gradient = values(kernels.gravity.gradient(base, q, gravity), chain.dof)
        assert_close(gradient, pin.computeGeneralizedGravity(model, data, at)[order])
        bias = values(kernels.bias_forces(base, q, velocity, gravity), chain.dof)
        assert_close(bias, pin.nonLinearEffects(model, data, at, rates)[order])
        for tip in chain.tips:
            for rep, reference in FRAMES.items():
                where = (q,) if rep == "body" else (base, q)
                expected = pin.computeFrameJacobian(model, data, at, model.getFrameId(tip.link), reference)
                found = getattr(getattr(kernels, tip.name), rep).jacobian(*where)
                assert_close(values(found), expected[:, order])


def test_texts_name_the_world_and_a_users_docstring_stays():
    """Check the texts of a floating robot: "world" in place of "base", except in a user's own docstring."""

    def own(p, R, parameters):
        """Act in base axes, in the base frame."""
        return p[0] ** 2

    chain = stiffgen.load_chain(DATA / "solo12.urdf", tip="FL_FOOT", floating_base=True)
    kernels = {
        kernel.qualified_name: kernel for kernel in chain_kernels(chain, KernelOptions(potentials=(Potential(own),)))
    }
    assert kernels["own_energy"].note == own.__doc__
    assert kernels["forward_kinematics"].summary == "Pose of the tip in the world frame."
    of_kernel = {argument.name: argument.meaning for argument in kernels["spatial_joint_stiffness"].arguments}
    assert of_kernel["wrench"].endswith("in world axes, moment about the world's origin")
    texts = [argument.meaning for kernel in kernels.values() for argument in (*kernel.arguments, *kernel.results)]
    assert not [text for text in texts if "{" in text or re.search(r"base axes|base frame|base's origin", text)]
