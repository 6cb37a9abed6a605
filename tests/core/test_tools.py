# SPDX-License-Identifier: MIT
"""Tools, locked joints and several tips, against Pinocchio and against each other."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest

import stiffgen
from stiffgen import open_robot
from stiffgen.cli import main
from stiffgen.core.errors import ChainError
from stiffgen.core.symbolic.connection import REPRESENTATIONS
from stiffgen.core.verify.kernels.oracles import check_robot
from stiffgen.core.verify.kernels.references import References
from stiffgen.families.joints.kernels import JOINT_POTENTIALS
from support.project import ROOT, URDF, assert_close, kernels_of

DUAL = ROOT / "tests" / "data" / "dual_arm.urdf"
FRAMES = {
    "body": pin.ReferenceFrame.LOCAL,
    "spatial": pin.ReferenceFrame.WORLD,
    "hybrid": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
}
JACOBIANS = "mass_matrix", *(f"{rep}.jacobian" for rep in FRAMES)
XYZ, RPY = (0.02, -0.05, 0.24), (0.3, -0.2, 0.9)
TOOL = stiffgen.Tool(XYZ, RPY, 0.455, (0.01, 0.0, 0.09), (0.002, 0.0001, 0.0, 0.003, -0.0002, 0.0015))


def postures(model, count=10):
    return np.random.default_rng(3).uniform(model.lowerPositionLimit, model.upperPositionLimit, (count, model.nq))


def crba(model, q):
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def with_tool(placement=True):
    """Return Pinocchio's iiwa 14 with the tool's frame and body at link_ee."""
    model = pin.buildModelFromUrdf(str(URDF))
    flange = model.frames[model.getFrameId("link_ee")]
    tool = pin.SE3(pin.rpy.rpyToMatrix(*RPY), np.array(XYZ)) if placement else pin.SE3.Identity()
    model.addFrame(pin.Frame("tool", flange.parentJoint, 0, flange.placement * tool, pin.FrameType.OP_FRAME))
    xx, xy, xz, yy, yz, zz = TOOL.inertia
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    model.appendBodyToJoint(flange.parentJoint, pin.Inertia(TOOL.mass, np.array(TOOL.com), tensor), flange.placement)
    return model


def frame_jacobian(model, q, frame, rep):
    return pin.computeFrameJacobian(model, model.createData(), q, model.getFrameId(frame), FRAMES[rep])


@pytest.mark.parametrize("rep", REPRESENTATIONS)
def test_fixed_tool(rep):
    expected = with_tool()
    model = stiffgen.StiffnessModel(stiffgen.load_chain(URDF, tool=TOOL), kernels=(f"{rep}.jacobian", "mass_matrix"))
    for q in postures(expected):
        assert_close(getattr(model, rep).jacobian(q), frame_jacobian(expected, q, "tool", rep))
        assert_close(model.mass_matrix(q), crba(expected, q))


def test_runtime_tool_is_the_fixed_tool():
    """Same pose given at run time: same pose, Jacobian, derivative and stiffness; they all belong to one point."""
    kernels = ("forward_kinematics", *REPRESENTATIONS)
    fixed = stiffgen.StiffnessModel(stiffgen.load_chain(URDF, tool=TOOL), kernels=kernels)
    runtime = stiffgen.StiffnessModel(stiffgen.load_chain(URDF, runtime_tool=True), kernels=kernels)
    pose = pin.SE3(pin.rpy.rpyToMatrix(*RPY), np.array(XYZ)).homogeneous
    random = np.random.default_rng(8)
    for q in postures(with_tool(), 5):
        wrench, K = random.normal(size=6) * 10, random.normal(size=(6, 6)) * 100
        assert_close(runtime.forward_kinematics(q, pose), fixed.forward_kinematics(q))
        for rep in REPRESENTATIONS:
            ours, theirs = getattr(runtime, rep), getattr(fixed, rep)
            assert_close(ours.jacobian(q, pose), theirs.jacobian(q))
            assert_close(ours.jacobian_transpose_derivative(q, pose), theirs.jacobian_transpose_derivative(q))
            assert_close(ours.kinematic_stiffness(q, pose, wrench), theirs.kinematic_stiffness(q, wrench))
            assert_close(ours.joint_stiffness(q, pose, wrench, K), theirs.joint_stiffness(q, wrench, K))


def test_locked_joints():
    """Compare a robot with two locked joints with Pinocchio's reduced model."""
    full = with_tool()
    locks = {"A3": 0.4, "A5": -1.2}
    ids = [full.getJointId(name) for name in locks]
    reference = pin.neutral(full)
    for name, value in locks.items():
        reference[full.joints[full.getJointId(name)].idx_q] = value
    reduced = pin.buildReducedModel(full, ids, reference)
    chain = stiffgen.load_chain(URDF, tool=TOOL, lock=locks)
    assert [c.name for c in chain.coordinates] == ["A1", "A2", "A4", "A6", "A7"]
    model = stiffgen.StiffnessModel(chain, kernels=JACOBIANS)
    for q in postures(reduced):
        assert_close(model.mass_matrix(q), crba(reduced, q))
        for rep in REPRESENTATIONS:
            assert_close(getattr(model, rep).jacobian(q), frame_jacobian(reduced, q, "tool", rep))


def test_a_locked_master_holds_its_followers(tmp_path):
    """Lock a joint that another follows: the follower stays at -2 x 0.1 + 0.5 rad, by plane trigonometry."""
    urdf = tmp_path / "m.urdf"
    joint = (
        '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0.3 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/>{3}</joint>'
    )
    urdf.write_text(
        '<robot name="m"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>'
        + joint.format("first", "a", "b", "")
        + joint.format("follower", "b", "c", '<mimic joint="first" multiplier="-2" offset="0.5"/>')
        + joint.format("last", "c", "d", "")
        + "</robot>"
    )
    chain = stiffgen.load_chain(urdf, lock={"first": 0.1})
    assert [joint.name for joint in chain.joints] == ["last"]
    pose = np.asarray(stiffgen.StiffnessModel(chain, kernels="forward_kinematics").forward_kinematics([0.0]))
    angle = 0.1 + (-2 * 0.1 + 0.5)
    elbow = 0.3 + 0.3 * np.exp(0.1j)
    assert_close(pose[:2, 3], [(elbow + 0.3 * np.exp(1j * angle)).real, (elbow + 0.3 * np.exp(1j * angle)).imag])
    assert_close(pose[:2, 0], [np.cos(angle), np.sin(angle)])


@pytest.fixture(scope="module")
def dual():
    return stiffgen.load_chain(DUAL, tip=["left hand", "right-hand"])


def test_dual_arm_shares_one_q(dual):
    """Compare both arms with Pinocchio: one q, and no coupling of their masses but through the lift."""
    assert [c.name for c in dual.coordinates] == ["lift", "ls", "le", "rs", "re"]
    assert [tip.name for tip in dual.tips] == ["left_hand", "right_hand"]
    model = stiffgen.StiffnessModel(dual, kernels=JACOBIANS)
    expected = pin.buildModelFromUrdf(str(DUAL))
    order = [expected.joints[expected.getJointId(c.name)].idx_q for c in dual.coordinates]
    for q in postures(expected):
        mass = crba(expected, q)[np.ix_(order, order)]
        assert_close(model.mass_matrix(q[order]), mass)
        assert mass[1, 3] == 0 and np.asarray(model.mass_matrix(q[order]))[1, 3] == 0
        for rep in REPRESENTATIONS:
            for tip in dual.tips:
                jacobian = getattr(getattr(model, tip.name), rep).jacobian(q[order])
                assert_close(jacobian, frame_jacobian(expected, q, tip.link, rep)[:, order])


@pytest.mark.usefixtures("unoptimised")
@pytest.mark.slow
@pytest.mark.parametrize("runtime_tool", [pytest.param(False, marks=pytest.mark.wide), True])
def test_dual_arm_folder(runtime_tool, tmp_path):
    """Compile a dual arm: all oracles of both tips and of the total, and the namespaces of its module."""
    options = {"tip": ["left hand", "right-hand"], "runtime_tool": runtime_tool}
    folder = stiffgen.generate(DUAL, output=tmp_path, controller=False, **options)
    robot = open_robot(folder).module
    chain = stiffgen.load_chain(DUAL, **options)
    assert robot.TIPS == ("left hand", "right-hand")
    checks = check_robot(kernels_of(robot, chain), chain, 5, 5)
    assert [check for check in checks if not check.passed] == []
    of_joints = 4 * len(JOINT_POTENTIALS)  # energy, torque, joint stiffness, which is symmetric
    of_masses = 6 + 2  # M, bias forces, energy, gradient, Hessian, static torque; two are symmetric
    of_tip = 28 + 11  # values, and symmetry of the matrices among them
    of_both_tips = 6 + 8  # totals over the tips; numbers as counted, so that a lost check is noticed
    assert len(checks) == of_masses + of_joints + 2 * of_tip + of_both_tips
    q, random = np.zeros((3, 5)), np.random.default_rng(1)
    contacts = random.normal(size=(3, 2, 6)), random.normal(size=(3, 2, 6, 6))
    poses = [np.broadcast_to(np.eye(4), (3, 2, 4, 4))] if runtime_tool else []
    total = robot.hybrid.joint_stiffness_total(q, *poses, *contacts)
    parts = [
        owner.hybrid.joint_stiffness(q, *(p[:, k] for p in poses), *(c[:, k] for c in contacts))
        for k, owner in enumerate((robot.left_hand, robot.right_hand))
    ]
    assert_close(total, parts[0] + parts[1])
    assert np.array_equal(total, total.swapaxes(-1, -2))
    for compiler in (["gcc", "-std=c99", "-O2"], ["g++", "-x", "c++", "-std=c++11", "-O0"]):
        strict = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
        subprocess.run([*compiler, *strict, "-c", str(folder / "dual.c"), "-o", str(tmp_path / "o")], check=True)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", str(folder / "__init__.pyi")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_a_tip_on_the_way_to_another():
    """Take the elbow's link and the hand as tips: one chain lies inside the other."""
    chain = stiffgen.load_chain(URDF, tip=["link_4", "link_ee"])
    assert chain.dof == 7
    assert len(chain.branch(chain.tips[0]).joints) == 4
    model = stiffgen.StiffnessModel(chain, kernels=JACOBIANS)
    expected = pin.buildModelFromUrdf(str(URDF))
    for q in postures(expected, 3):
        assert_close(model.link_4.hybrid.jacobian(q), frame_jacobian(expected, q, "link_4", "hybrid"))
        assert_close(model.mass_matrix(q), crba(expected, q))


@pytest.mark.slow
def test_references_see_a_wrong_tool_point(robot):
    """Verify kernels of the flange against references at the tool: they must fail."""
    chain = stiffgen.load_chain(URDF, tool=TOOL)
    checks = check_robot(kernels_of(robot, chain), chain, 3, 0)
    failed = {check.kernel for check in checks if not check.passed}
    assert {"forward_kinematics", "mass_matrix", "hybrid_jacobian", "hybrid_joint_stiffness"} <= failed
    assert "spatial_jacobian" not in failed
    assert References(chain, 3, 0).pose.shape == (3, 4, 4)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--lock", "A9=0"], "A1, A2"),
        (["--lock", "joint_ee=0"], "A1, A2"),
        (["--lock", "A2=9"], "-2.0944 to 2.0944"),
        (["--lock", "A2=nan"], "cannot be locked at nan"),
        (["--tool", "runtime", "--tool", "xyz=0,0,1"], "--tool xyz"),
        (["--tool", "mass=-1"], "--tool mass=-1"),
        (["--tool", "xyz=0,inf,0"], "--tool xyz"),
        (["--tool", "com=0,0,1"], "--tool mass"),
        (["--tool", "mass=1", "--tool", "inertia=1,0,0,1,0,5"], "--tool inertia"),
        (["--tip", "link_3", "--tip", "link_ee", "--tool", "mass=1"], "--tool runtime"),
        (["--tip", "link_3", "--tip", "link_3"], "twice"),
        (["--tip", "link_0", "--tip", "link_3"], "no moving joint"),
    ],
)
def test_refusals(options, named, capsys, tmp_path):
    """Give impossible locks and tools: exit code 2, the option is named, and no folder is written."""
    assert main(["generate", str(URDF), "--output", str(tmp_path), "--no-build", *options]) == 2
    assert named in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_all_locked_is_refused():
    with pytest.raises(ChainError, match="no moving joint"):
        stiffgen.load_chain(URDF, tip="link_1", lock={"A1": 0.0})


def test_command_line_options_reach_the_chain(tmp_path):
    """Give tool and lock by the command line: header and README state them."""
    options = ["--tool", "xyz=0,0,0.24", "--tool", "mass=0.455", "--lock", "A3=0.1", "--kernels", "hybrid.jacobian"]
    options += ["--no-controller"]
    assert main(["generate", str(URDF), "--output", str(tmp_path), "--no-build", *options]) == 0
    header = (tmp_path / "iiwa14" / "iiwa14.h").read_text()
    assert "Joint A3 is held at 0.1" in header and "replaced by the tool's frame" in header
    readme = (tmp_path / "iiwa14" / "README.md").read_text()
    assert "Joint A3 is held at 0.1" in readme and "0 0 0.24 m" in readme
