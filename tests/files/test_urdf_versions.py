# SPDX-License-Identifier: MIT
"""Versions of URDF against Pinocchio, whose urdfdom reads the versions 1.0 to 1.2 itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from stiffgen import StiffnessModel, load_chain
from stiffgen.core.errors import DescriptionError
from stiffgen.core.loading import describe

INERTIAL = '<origin xyz="0.1 0.2 0.1" {0}/><mass value="1"/><inertia ixx="0.01" iyy="0.02" izz="0.015"'
LIMIT = 'lower="-2" upper="1.5" velocity="1" effort="10"'


def arm(version: str = "", origin: str = "", of_inertial: str = "", limit: str = LIMIT, kind: str = "revolute") -> str:
    """Return a one-joint URDF of a version, with given attributes of its origins, inertia and limit."""
    stated = f' version="{version}"' if version else ""
    inertial = f'<inertial>{INERTIAL.format(of_inertial)} ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>'
    return (
        f'<robot name="arm"{stated}><link name="base"/><link name="a">{inertial}</link><link name="tip"/>'
        f'<joint name="j" type="{kind}"><parent link="base"/><child link="a"/><origin xyz="0 0 0.3" {origin}/>'
        f'<axis xyz="0 0.6 0.8"/><limit {limit}/></joint><joint name="f" type="fixed"><parent link="a"/>'
        f'<child link="tip"/><origin xyz="0.4 0 0" {origin}/></joint></robot>'
    )


def written(folder: Path, text: str) -> Path:
    (folder / "arm.urdf").write_text(text)
    return folder / "arm.urdf"


def assert_agrees(file: Path) -> None:
    """Fail unless pose, mass and limits agree with Pinocchio's at q = 0.7 rad."""
    chain = load_chain(file)
    model = pin.buildModelFromUrdf(str(file))
    data = model.createData()
    q = np.array([0.7])
    pin.framesForwardKinematics(model, data, q)
    placement = data.oMf[model.getFrameId("tip")].homogeneous
    ours = StiffnessModel(chain)
    assert np.array(ours.forward_kinematics(q)) == pytest.approx(placement, abs=1e-12)
    assert float(ours.mass_matrix(q)) == pytest.approx(float(pin.crba(model, data, q)[0, 0]), rel=1e-12)
    (j,) = chain.coordinates
    assert (j.lower, j.upper) == (model.lowerPositionLimit[0], model.upperPositionLimit[0])


@pytest.mark.slow
@pytest.mark.parametrize("version", ["1.1", "1.2"])
@pytest.mark.parametrize("xyzw", ["0.5 0.5 0.5 0.5", "0.1 -0.7 0.2 0.3", "1 2 3 4", "0 0 0.70710678118 0.70710678118"])
def test_quaternions(version: str, xyzw: str, tmp_path: Path) -> None:
    """In joints and in inertials, of any length."""
    assert_agrees(written(tmp_path, arm(version, f'quat_xyzw="{xyzw}"', f'quat_xyzw="{xyzw}"')))


@pytest.mark.slow
@pytest.mark.parametrize("version", ["", "1.0", "1.1"])
def test_angles_and_missing_bounds_of_older_versions(version: str, tmp_path: Path) -> None:
    for limit in (LIMIT, 'upper="2" velocity="1" effort="10"', 'lower="-1" velocity="1" effort="10"'):
        assert_agrees(written(tmp_path, arm(version, 'rpy="0.1 0.2 0.3"', limit=limit)))
    assert any("has no upper, which is taken as 0" in each for each in describe(tmp_path / "arm.urdf").remarks)


REFUSED = {
    "before 1.1": (arm("", 'quat_xyzw="0.5 0.5 0.5 0.5"'), r'before URDF 1.1; state <robot version="1.1">'),
    "also in 1.0": (arm("1.0", 'quat_xyzw="0.5 0.5 0.5 0.5"'), r'before URDF 1.1; state <robot version="1.1">'),
    "in an inertial": (arm("1.0", of_inertial='quat_xyzw="0.5 0.5 0.5 0.5"'), r"link 'a': .*before URDF 1.1"),
    "both": (arm("1.1", 'rpy="0 0 1" quat_xyzw="0.5 0.5 0.5 0.5"'), "rpy and quat_xyzw; remove one"),
    "zero": (arm("1.1", 'quat_xyzw="0 0 0 0"'), r"quaternion \(0, 0, 0, 0\) has no direction"),
    "three numbers": (arm("1.1", 'quat_xyzw="0 0 1"'), "3 words, expected 4 numbers"),
    "misspelt": (arm("1.1", 'quat_xyz="0 0 0 1"'), r"did you mean 'quat_xyzw'\?"),
    "numbers in another order": (
        arm("1.1", 'quat_wxyz="0 0 0 1"'),
        r"did you mean 'quat_xyzw', with its numbers in this order\?",
    ),
    "angles in another order": (arm("", 'ypr="0 0 1"'), "did you mean 'rpy', with its numbers in this order"),
    "angles of an inertial": (arm("", of_inertial='ryp="0 0 1"'), "did you mean 'rpy', with its numbers in this order"),
    "numbers of unknown meaning": (arm("1.0", 'orientation="0 0 0 1"'), "correct it .*ignore=..orientation"),
    "no lower in 1.2": (arm("1.2", limit='upper="2" velocity="1" effort="10"'), "has no lower, .* 1.2 requires"),
    "no upper in 1.2": (arm("1.2", limit='lower="-2" velocity="1" effort="10"'), "has no upper, .* 1.2 requires"),
    "no bounds in 1.2": (arm("1.2", limit='velocity="1"'), "has no lower and upper, which URDF 1.2 requires"),
    "slide": (arm("1.2", limit='upper="2" velocity="1"', kind="prismatic"), "has no lower, which URDF 1.2"),
    "negative": (
        arm("1.2", limit=f'{LIMIT} acceleration="-5"'),
        "acceleration=.-5.> is negative.* or remove acceleration",
    ),
    "not a number": (arm("1.2", limit=f'{LIMIT} jerk="fast"'), "'fast' is not a finite decimal number"),
    "of the future": (arm("1.3"), "newer than 1.2"),
}


MIMIC = (
    '<mimic joint="i" {}/></joint><link name="side"/>'
    '<joint name="i" type="revolute"><parent link="base"/><child link="side"/></joint>'
)
DECIDING = {
    "a ratio": ("</joint>", MIMIC.format('ratio="2"'), "mimic.*'ratio'.*ignore="),
    "a factor": ("</joint>", MIMIC.format('factor="-1.5e0"'), "mimic.*'factor'"),
    "a bias": ("</joint>", MIMIC.format('bias=".1"'), "mimic.*'bias'.*ignore="),
    "a pose": ('<origin xyz="0 0 0.3" />', "<pose>0 0 0.3 0 0 0</pose>", "<pose> is no element of <joint>; correct"),
    "a place": ('<origin xyz="0 0 0.3" />', '<transform xyz="0 0 0.3"/>', "<transform> is no element of <joint>"),
    "a position": (
        '<origin xyz="0 0 0.3" />',
        "<position> 0 0 3e-1\n</position>",
        "<position> is no element of <joint>; .*ignore=",
    ),
    "min and max": (LIMIT, 'min="-2" max="1.5" velocity="1" effort="10"', "limit.*'min'.*ignore="),
    "a range": (LIMIT, 'range="-2 1.5" velocity="1" effort="10"', "limit.*'range'.*ignore="),
    "a maximum": (LIMIT, 'lower="-2" maximum="1.5" velocity="1" effort="10"', "limit.*'maximum'.*ignore="),
}


@pytest.mark.parametrize("name", DECIDING)
def test_unknown_numbers_that_decide_the_robot_are_refused(name: str, tmp_path: Path) -> None:
    """Rename a relation or bound: refused, as the robot without it is another one; a stall is a note."""
    old, new, words = DECIDING[name]
    with pytest.raises(DescriptionError, match=words):
        load_chain(written(tmp_path, arm().replace(old, new, 1)), tip="tip")
    continuous = arm(limit='velocity="1" effort="10" stall="3.5"', kind="continuous")
    beside = continuous.replace("</joint>", "<tool_frame xyz='0 0 1'/></joint>", 1)  # of a joint with an origin
    notes = describe(written(tmp_path, beside)).notes
    assert ["'stall'" in each or "<tool_frame>" in each for each in notes] == [True, True]


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_version_does_not_have_is_refused(name: str, tmp_path: Path) -> None:
    text, words = REFUSED[name]
    with pytest.raises(DescriptionError, match=words):
        load_chain(written(tmp_path, text))


def test_limits_of_urdf_1_2(tmp_path: Path) -> None:
    stated = f'{LIMIT} acceleration="5" deceleration="4" jerk="inf"'
    (j,) = load_chain(written(tmp_path, arm("1.2", limit=stated))).coordinates
    assert (j.acceleration, j.deceleration, j.jerk) == (5, 4, np.inf)
    (j,) = load_chain(written(tmp_path, arm("1.1", limit=stated))).coordinates
    assert (j.acceleration, j.deceleration, j.jerk) == (np.inf, np.inf, np.inf)  # a vendor's own, before 1.2
    assert load_chain(written(tmp_path, arm("1.2", limit='velocity="1"', kind="continuous"))).dof == 1


@pytest.mark.parametrize("name", ["acceleration", "deceleration", "jerk"])
def test_limits_of_a_later_version_are_named(name: str, tmp_path: Path) -> None:
    limit = f'{LIMIT} {name}="5"'
    for version in ("", "1.0", "1.1"):
        (remark,) = describe(written(tmp_path, arm(version, limit=limit))).remarks
        assert remark == f"1 joint has a limit of {name}, not read before URDF 1.2: j"
    assert describe(written(tmp_path, arm("1.2", limit=limit))).remarks == ()


@pytest.mark.parametrize("version", ["0.9", "1", "one"])
def test_other_words_for_a_version_are_a_note(version: str, tmp_path: Path) -> None:
    (note,) = describe(written(tmp_path, arm(version))).notes
    assert f'version="{version}"' in note and "read as 1.0" in note


VENDORS = {
    "of an inertial": ("<inertial>", '<inertial name="a_inertial">'),
    "of a mass": ('<mass value="1"', '<mass value="1" source="cad"'),
    "of a joint": ('type="revolute"', 'type="revolute" tool_changer="no"'),
    "of a limit": ("<limit", '<limit stall="3.5"'),
    "of an origin": ("<origin", '<origin note="measured"'),
}


@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.DescriptionWarning")
@pytest.mark.parametrize("name", VENDORS)
def test_unknown_attributes_are_a_note(name: str, tmp_path: Path) -> None:
    """Add attributes of vendors: values agree with Pinocchio's, and a note names the attribute."""
    old, new = VENDORS[name]
    text = arm()
    assert old in text
    assert_agrees(written(tmp_path, text.replace(old, new, 1)))
    (note,) = describe(tmp_path / "arm.urdf").notes
    attribute = next(word.split("=")[0] for word in new.split() if "=" in word and word not in old)
    assert f"has no attribute '{attribute}'" in note


def test_ignore_takes_attributes(tmp_path: Path) -> None:
    for change in (('rpy="0 0 0"', 'rpyy="0 0 1"'), ('rpy="0 0 0"', 'spin="0 0 1"'), ('effort="10"', 'efort="10"')):
        file = written(tmp_path, arm("", 'rpy="0 0 0"').replace(*change, 1))
        attribute = change[1].split("=")[0]
        with pytest.raises(DescriptionError, match=rf"ignore=\[.{attribute}.\]"):
            load_chain(file)
        assert load_chain(file, ignore=[attribute]).dof == 1
