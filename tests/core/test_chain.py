# SPDX-License-Identifier: MIT
"""From description to chain: which joints are coordinates, what they carry, where the base is. Values by Pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffgen import StiffnessModel, load_chain
from stiffgen.core.emit.render import render
from stiffgen.core.errors import ChainError, DescriptionError
from stiffgen.core.robot.chain import MAX_MOVING_JOINTS, Chain
from stiffgen.core.symbolic.arguments import Q
from stiffgen.core.symbolic.kernels import KERNELS, chain_kernels
from stiffgen.core.verify.kernels.samples import Samples
from support.chain_checks import disagreements, value
from support.chains import ARM, INERTIAL, replaced
from support.pinocchio_oracle import PinocchioChain, readable_by_pinocchio
from support.project import ROOT
from support.random_urdf import Plain, random_robot

URDF = ROOT / "urdf"


def loaded(folder: Path, text: str, **options) -> Chain:
    file = folder / "arm.urdf"
    file.write_text(text, encoding="utf-8")
    return load_chain(file, **options)


def assert_agrees(chain: Chain, text: str) -> None:
    oracle = PinocchioChain(text, chain.tip, chain.base, masses=chain.masses)
    assert disagreements(chain, oracle, np.random.default_rng(0)) == {}


@pytest.mark.parametrize(
    "robot", ["iiwa14", "med7", *(pytest.param(robot, marks=pytest.mark.wide) for robot in ("iiwa7", "med14"))]
)
def test_arms_of_this_repository(robot):
    text = (URDF / f"{robot}.urdf").read_text()
    for base, tip in ((None, "link_ee"), ("link_2", "link_6"), ("link_0", "link_1")):
        assert_agrees(load_chain(URDF / f"{robot}.urdf", base=base, tip=tip), text)


@pytest.mark.parametrize(
    ("base", "tip", "names"),
    [
        (None, None, ["shoulder", "elbow", "grip"]),
        ("base", "hand", ["shoulder", "elbow"]),
        ("base", "upper", ["shoulder"]),
        ("upper", "finger", ["elbow", "grip"]),
        ("hand", "finger", ["grip"]),
    ],
)
def test_base_and_tip_anywhere(tmp_path, base, tip, names):
    """Take a part of the arm as chain: coordinates and values are those of Pinocchio between the two links."""
    chain = loaded(tmp_path, ARM, base=base, tip=tip)
    assert [c.name for c in chain.coordinates] == names
    assert_agrees(chain, ARM)


def test_the_masses_beyond_the_tip_and_beside_the_chain_are_carried(tmp_path):
    """In closed form: the elbow turns lower (at its frame) and the finger, 0.3 m out and 0.05 m aside."""
    chain = loaded(tmp_path, ARM, base="upper", tip="lower")
    inertia_about_y = 0.02 + 0.02 + 2 * (0.3**2)
    assert np.allclose(value(chain, KERNELS[1], q=np.array([0.7])), inertia_about_y, rtol=1e-14)
    assert chain.massless == ("hand",)


def test_submatrix_is_pinocchios_reduced_model(tmp_path):
    """Compare the oracle's rows and columns of the whole mass matrix with a robot whose other joints are locked."""
    oracle = PinocchioChain(ARM, "lower")
    locked = [oracle.model.getJointId("grip")]
    reduced = pin.buildReducedModel(oracle.model, locked, pin.neutral(oracle.model))
    q = np.array([0.3, -0.4])
    mass = pin.crba(reduced, reduced.createData(), q)
    assert np.allclose(np.triu(mass), np.triu(oracle.at(q).mass_matrix), atol=1e-14)
    assert readable_by_pinocchio(ARM).find("link[@name='finger']/inertial") is not None


MIMICS = {
    "the joint before": ("grip", '<mimic joint="elbow" multiplier="-0.02" offset="0.03"/>'),
    "a joint beyond": ("shoulder", '<mimic joint="elbow" multiplier="2"/>'),
    "defaults": ("elbow", '<mimic joint="shoulder"/>'),
    "multiplier zero": ("elbow", '<mimic joint="shoulder" multiplier="0" offset="0.4"/>'),
    "a fixed joint": ("elbow", '<mimic joint="wrist" offset="-0.6" multiplier="3"/>'),
    "a fixed joint, sliding": ("grip", '<mimic joint="wrist" offset="0.6"/>'),
}


@pytest.mark.parametrize("name", MIMICS)
def test_mimic(tmp_path, name):
    """Let one joint follow another: two coordinates are left, with Pinocchio's values."""
    joint, mimic = MIMICS[name]
    head = f'<joint name="{joint}" type="{"prismatic" if joint == "grip" else "revolute"}">'
    text = replaced((head, head + mimic))
    chain = loaded(tmp_path, text)
    assert chain.dof == 2
    assert_agrees(chain, text)


def test_a_multiplier_of_zero_makes_no_coordinate(tmp_path):
    text = replaced(('<axis xyz="0 1 0"/>', '<mimic joint="grip" multiplier="0" offset="0.4"/>'))
    chain = loaded(tmp_path, text, tip="hand")
    assert [c.name for c in chain.coordinates] == ["shoulder"]
    assert_agrees(chain, text)


def test_mimics_of_mimics_and_of_joints_off_the_chain(tmp_path):
    """Chain two mimic relations to a joint off the path: multipliers, limits and values agree with Pinocchio's."""
    crank = (
        f'<link name="crank">{INERTIAL}</link><joint name="motor" type="revolute"><parent link="base"/>'
        '<child link="crank"/><axis xyz="0 1 1"/><limit lower="-0.5" upper="0.7" velocity="8" effort="9"/></joint>'
        "</robot>"
    )
    text = replaced(
        ("</robot>", crank),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="motor" multiplier="-2" offset="0.1"/>'),
        ('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="elbow" multiplier="0.1" offset="0.2"/>'),
        ('upper="0.04" effort="5" velocity="0.1"', 'upper="0.4" effort="50" velocity="5"'),
    )
    chain = loaded(tmp_path, text, tip="finger")
    assert [c.name for c in chain.coordinates] == ["shoulder", "motor"]
    motor = chain.coordinates[1]
    # The elbow follows at -2 motor + 0.1, within -1 and 1, at most at 4 rad/s.
    assert (motor.lower, motor.upper, motor.velocity, motor.effort) == (-0.45, 0.55, 2, 9)
    assert [(j.multiplier, j.offset) for j in chain.joints] == [(1, 0), (-2, 0.1), (-0.2, pytest.approx(0.21)), (1, 0)]
    assert [(j.name, j.parent) for j in chain.joints[3:]] == [("motor", -1)], "the master moves its own mass"
    assert_agrees(chain, text)


def test_a_follower_beside_the_chain_is_carried_at_its_offset(tmp_path):
    follower = '<axis xyz="1 0 0"/><mimic joint="elbow" multiplier="0.1" offset="0.2"/>'
    text = replaced(('<axis xyz="1 0 0"/>', follower), ('upper="0.04"', 'upper="0.4"'))
    chain = loaded(tmp_path, text, tip="hand")
    assert chain.dof == 2
    assert_agrees(chain, text)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_floating_and_planar_joints(tmp_path, kind):
    """Put a floating or planar joint into the path: refused with a base beyond it; beside the path it is no fault."""
    text = replaced(('name="grip" type="prismatic"', f'name="grip" type="{kind}"'))
    assert_agrees(loaded(tmp_path, text, tip="hand"), text)
    with pytest.raises(ChainError) as refusal:
        loaded(tmp_path, text, tip="finger")
    assert all(word in str(refusal.value) for word in ("'grip'", kind, "base='finger'"))
    text = replaced(('name="shoulder" type="revolute"', f'name="shoulder" type="{kind}"'))
    if kind == "planar":
        with pytest.raises(ChainError, match="base='upper'"):
            loaded(tmp_path, text)
    else:
        assert loaded(tmp_path, text).floating and loaded(tmp_path, text).base == "upper"
    assert_agrees(loaded(tmp_path, text, base="upper"), text)
    follower = replaced(('<axis xyz="0 1 0"/>', '<mimic joint="shoulder"/>'),
                        ('name="shoulder" type="revolute"', f'name="shoulder" type="{kind}"'))  # fmt: skip
    with pytest.raises(DescriptionError, match="'elbow' mimics 'shoulder', which has no coordinate"):
        loaded(tmp_path, follower, base="upper")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tip": "foot"}, ["'foot'", "finger", "inspect"]),
        ({"base": "foot"}, ["'foot'", "base, upper, lower"]),
        ({"base": "finger", "tip": "upper"}, ["'finger'", "no ancestor", "possible bases: base"]),
        ({"base": "hand", "tip": "hand"}, ["no moving joint", "finger"]),
        ({"base": "lower", "tip": "hand"}, ["no moving joint", "finger"]),
        ({"tip": "x\x1b[2J"}, ["'x\\x1b[2J'"]),
    ],
)
def test_chains_that_do_not_exist(tmp_path, options, words):
    """Ask for tips and bases that do not exist or have no joint between: refused, with those that are possible."""
    with pytest.raises(ChainError) as refusal:
        loaded(tmp_path, ARM, **options)
    assert str(refusal.value).startswith("arm.urdf")
    assert all(word in str(refusal.value) for word in words), refusal.value


def test_several_leaves_need_a_tip(tmp_path):
    text = replaced(("</robot>", '<link name="camera"/><joint name="mount" type="fixed"><parent link="hand"/>'
                                 '<child link="camera"/></joint></robot>'))  # fmt: skip
    with pytest.raises(ChainError, match=r"tip=\.\.\.: hand, finger, camera"):
        loaded(tmp_path, text)
    assert loaded(tmp_path, text, tip="camera").dof == 2


def test_too_many_moving_joints(tmp_path):
    """Give one joint more than the most allowed: refused, with the count."""
    count = MAX_MOVING_JOINTS + 1
    text = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/></joint>'
        for k in range(1, count + 1)
    )
    with pytest.raises(ChainError, match=f"{count} moving joints .* choose a nearer base"):
        loaded(tmp_path, f'<robot name="snake"><link name="l0"/>{text}</robot>')


def test_right_angles_leave_exact_zeros_and_ones(tmp_path):
    for angle in ("1.5707963267948966", "1.57079632679", "-4.71238898038469"):
        chain = loaded(tmp_path, ARM.replace("1.5707963267948966", angle))
        assert chain.joints[0].rotation == ((0, 0, 1), (0, 1, 0), (-1, 0, 0))
    assert chain.joints[1].rotation == ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    nearly = loaded(tmp_path, ARM.replace("1.5707963267948966", "1.5707963"))
    assert nearly.joints[0].rotation[0][0] == pytest.approx(2.6794896585e-8, rel=1e-6)


@pytest.mark.parametrize("angle", ["1e9", "123456.789", "1e12", "-99999999999.5"])
def test_many_turns(tmp_path, angle):
    text = ARM.replace("1.5707963267948966", angle)
    assert_agrees(loaded(tmp_path, text), text)


def test_masses_left_out_on_request(tmp_path):
    """Leave impossible masses out by masses=False: no function of masses is generated."""
    text = replaced(('izz="0.03"', 'izz="0.3"'))
    with pytest.raises(DescriptionError, match=r"'upper'.*masses=False"):
        loaded(tmp_path, text)
    chain = loaded(tmp_path, text, masses=False)
    assert not chain.masses and chain.massless == ()
    assert not hasattr(StiffnessModel(chain), "mass_matrix")
    assert_agrees(chain, text)
    assert "mass_matrix" not in "".join(render(chain, "arm").values())


@pytest.mark.slow
def test_forty_joints_are_generated_in_size(tmp_path):
    """Generate the largest chain, 40 joints: values agree with Pinocchio, and the text grows linearly."""
    robot = None
    for seed in range(1000):
        robot = random_robot(Plain(seed), 40)
        chain = loaded(tmp_path, robot.text, tip=robot.tip, base=robot.base)
        if len(chain.joints) == 40:
            break
    texts = render(chain, "snake")
    assert len(texts["snake.c"]) < 27_000 * len(chain_kernels(chain))
    assert disagreements(chain, PinocchioChain(robot.text, robot.tip, robot.base), np.random.default_rng(0), 0) == {}


def test_a_leaf_without_a_moving_joint_on_its_way_is_no_tip(tmp_path):
    """ROS-Industrial marks the base by a leaf of its own: nobody is asked which of the two is the tip."""
    mark = (
        '<link name="mark"/><joint name="base-mark" type="fixed"><parent link="base"/><child link="mark"/></joint>'
        "</robot>"
    )
    assert loaded(tmp_path, replaced(("</robot>", mark))).tip == "finger"


BEYOND = ((-10.0, -5.0), (-9.0, -8.5), (4.0, 4.3), (5.0, 40.0), (-2.0, 2.0), (-40.0, 40.0), (0.0, 0.04))


@pytest.mark.parametrize(("lower", "upper"), BEYOND)
def test_a_range_within_a_reach_stays_within_the_limits(tmp_path, lower, upper):
    """Draw from a range below -pi: within the limits. Before, it was cut at -pi, beyond them."""
    text = replaced(('lower="-2" upper="2"', f'lower="{lower}" upper="{upper}"'))
    assert text != replaced()
    chain = loaded(tmp_path, text)
    for reach in (1.0, 1.5, np.pi):
        for each in chain.coordinates:
            low, high = each.range_within(reach)
            assert each.lower <= low < high <= each.upper
            assert high - low <= 2 * reach
    positions = Samples(chain, 200, seed=0)[Q]
    limits = np.array([(each.lower, each.upper) for each in chain.coordinates])
    assert (positions >= limits[:, 0]).all() and (positions <= limits[:, 1]).all()
