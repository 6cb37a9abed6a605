# SPDX-License-Identifier: MIT
"""Reading URDF files: what is refused and with which words, and what real files have that must pass."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.core.errors import DescriptionError, DescriptionWarning, StiffgenError
from stiffgen.core.loading import chain_between
from stiffgen.core.robot.chain import ChainOptions
from stiffgen.core.robot.description import Description
from stiffgen.core.robot.reader import read_description
from stiffgen.core.robot.urdf_format import FORMAT
from support.chains import ARM, INERTIAL, replaced


@pytest.fixture
def read(tmp_path: Path):
    """Return a function that writes a text to arm.urdf and reads it."""

    def reader(content: str | bytes) -> Description:
        file = tmp_path / "arm.urdf"
        file.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_description(file)

    return reader


def all_problems(read, text: str | bytes) -> list[str]:
    try:
        return [problem.text for problem in read(text).problems]
    except DescriptionError as error:
        return list(error.problems)


def test_the_arm_itself_has_no_problem(read):
    description = read(ARM)
    assert description.problems == ()
    assert description.links == ("base", "upper", "lower", "hand", "finger")
    assert (description.root, description.leaves) == ("base", ("finger",))
    elbow = description.joints["elbow"]
    assert (elbow.lower, elbow.upper, elbow.velocity, elbow.effort) == (-1, 1, 4, 20)


# Each: what changes, and words that the one message about it must hold (element, fault, remedy or valid names).
FAULTS = {
    "no robot name": ([(' name="arm"', "")], ["<robot>", "name", "add"]),
    "nameless link": ([('<link name="hand"/>', '<link name="hand"/><link/>')], ["<link> number 5", "no name", "add"]),
    "nameless joint": ([('joint name="wrist"', "joint")], ["<joint> number 3", "no name", "add"]),
    "link twice": (
        [('<link name="hand"/>', '<link name="hand"/><link name="hand"/>')], ["link 'hand'", "twice", "rename"],
    ),
    "joint twice": ([('name="wrist"', 'name="elbow"')], ["joint 'elbow'", "twice", "rename"]),
    "no type": ([(' type="fixed"', "")], ["joint 'wrist'", "no type", "revolute"]),
    "unknown type": ([('"fixed"', '"spherical"')], ["joint 'wrist'", "'spherical'", "prismatic"]),
    "no parent": ([('<parent link="lower"/>', "")], ["joint 'wrist'", "<parent link=", "add"]),
    "no child": ([('<child link="hand"/>', "")], ["joint 'wrist'", "<child link=", "add"]),
    "unknown parent": ([('parent link="lower"', 'parent link="Lower"')], ["joint 'wrist'", "'Lower'", "upper, lower"]),
    "unknown child": ([('child link="hand"', 'child link="hands"')], ["joint 'wrist'", "'hands'", "hand, finger"]),
    "two parents": (
        [('<child link="finger"/>', '<child link="hand"/>')],
        ["link 'hand'", "'wrist'", "'grip'", "one parent joint"],
    ),
    "closed circle": ([('<parent link="base"/>', '<parent link="finger"/>')], ["circle", "finger", "cut one joint"]),
    "two roots": ([('<link name="base"/>', '<link name="base"/><link name="table"/>')], ["root links", "base, table"]),
    "zero axis": ([('xyz="0 1 0"', 'xyz="0 0 0"')], ["joint 'elbow'", "axis", "give the one"]),
    "tiny axis": ([('xyz="0 1 0"', 'xyz="0 1e-300 0"')], ["joint 'elbow'", "axis", "give the one"]),
    "axis without xyz": ([('axis xyz="0 1 0"', "axis")], ["joint 'elbow'", "<axis>", "add"]),
    "two numbers": ([('xyz="0.4 0 0"', 'xyz="0.4 0"')],
                    ["joint 'elbow'", '<origin xyz="0.4 0">', "2 words", "3 numbers"]),
    "nan": ([('xyz="0.4 0 0"', 'xyz="nan 0 0"')], ["joint 'elbow'", "<origin xyz=", "'nan'", "finite"]),
    "inf": ([('xyz="0.4 0 0"', 'xyz="0 inf 0"')], ["joint 'elbow'", "<origin xyz=", "'inf'", "finite"]),
    "1e400": ([('xyz="0.4 0 0"', 'xyz="0 0 1e400"')], ["joint 'elbow'", "<origin xyz=", "'1e400'", "metres"]),
    "1e300": ([('xyz="0.4 0 0"', 'xyz="0 0 1e300"')], ["joint 'elbow'", "<origin xyz=", "'1e300'", "metres"]),
    "underscore": ([('xyz="0.4 0 0"', 'xyz="1_0 0 0"')], ["joint 'elbow'", "'1_0'", "decimal"]),
    "unicode digits": ([('xyz="0.4 0 0"', 'xyz="٣ 0 0"')], ["joint 'elbow'", "'٣'", "decimal"]),
    "unicode space": ([('xyz="0.4 0 0"', 'xyz="1\u00a00 0 0"')], ["joint 'elbow'", "decimal"]),
    "comma": ([('xyz="0.4 0 0"', 'xyz="0,4 0 0"')], ["joint 'elbow'", "'0,4'", "decimal"]),
    "hexadecimal": ([('xyz="0.4 0 0"', 'xyz="0x4 0 0"')], ["joint 'elbow'", "'0x4'", "decimal"]),
    "xacro expression": ([('xyz="0.4 0 0"', 'xyz="${a + 1} 0 0"')], ["joint 'elbow'", "<origin xyz=", "xacro"]),
    "lower above upper": ([('lower="-1" upper="1"', 'lower="1" upper="-1"')], ["joint 'elbow'", "1", "-1", "swap"]),
    "negative velocity": ([('velocity="4"', 'velocity="-4"')], ["joint 'elbow'", "velocity", "the joint's limit"]),
    "negative effort": ([('effort="20"', 'effort="-20"')], ["joint 'elbow'", "effort", "the joint's limit"]),
    "nan limit": ([('upper="1"', 'upper="nan"')], ["joint 'elbow'", "<limit upper=", "'nan'"]),
    "negative mass": ([('mass value="2"', 'mass value="-2"')], ["link 'upper'", "mass", "negative", "correct"]),
    "no mass": ([('<mass value="2"/>', "")], ["link 'upper'", "<mass>", "add"]),
    "empty mass": ([('<mass value="2"/>', "<mass/>")], ["link 'upper'", "<mass>", "'value'", "add"]),
    "no inertia": ([('<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/>', "")],
                   ["link 'upper'", "<inertia>", "add"]),
    "no ixx": ([('ixx="0.02"', "")], ["link 'upper'", "'ixx'", "add"]),
    "negative moment": ([('ixx="0.02"', 'ixx="-0.02"')], ["link 'upper'", "inertia", "--no-masses"]),
    "indefinite": ([('ixy="0"', 'ixy="0.05"')], ["link 'upper'", "inertia", "--no-masses"]),
    "triangle": ([('izz="0.03"', 'izz="0.05"')], ["link 'upper'", "inertia", "sum"]),
    "mimics itself": ([('<axis xyz="0 1 0"/>', '<mimic joint="elbow"/>')], ["joint 'elbow'", "circle", "break"]),
    "mimics nothing": ([('<axis xyz="0 1 0"/>', "<mimic/>")], ["joint 'elbow'", "<mimic>", "add joint="]),
    "mimics a stranger": ([('<axis xyz="0 1 0"/>', '<mimic joint="x"/>')], ["joint 'elbow'", "'x'", "shoulder, elbow"]),
    "bad multiplier": ([('<axis xyz="0 1 0"/>', '<mimic joint="grip" multiplier="two"/>')],
                       ["joint 'elbow'", "<mimic multiplier=", "'two'"]),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_names_element_and_remedy(read, tmp_path, name):
    """Put one fault into a URDF: the message names element and remedy, in few lines."""
    changes, words = FAULTS[name]
    text = replaced(*changes)
    problems = all_problems(read, text)
    matching = [problem for problem in problems if all(word in problem for word in words)]
    assert matching, problems
    with pytest.raises(StiffgenError) as refusal:
        load_chain(tmp_path / "arm.urdf")
    assert "arm.urdf" in str(refusal.value)
    assert str(refusal.value).count("\n") <= 6


def test_a_faulty_bound_is_one_problem(read):
    """It is not compared with the other bound as if it were 0."""
    problems = all_problems(read, replaced(('lower="-1" upper="1"', 'lower="x" upper="-1"')))
    assert [problem for problem in problems if "elbow" in problem and "limit" in problem] == [
        problem for problem in problems if "'x' is not a finite decimal number" in problem
    ]


def test_all_problems_at_once_also_those_of_the_file(read):
    """Put six faults into a URDF: all are listed at once, not one per run."""
    everything = replaced(
        (' name="arm"', ""), ('xyz="0 1 0"', 'xyz="0 0 0"'), ('mass value="2"', 'mass value="-2"'),
        ('child link="hand"', 'child link="hands"'), ('effort="5"', 'effort="-5"'), ('velocity="4"', 'velocity="x"'),
    )  # fmt: skip
    with pytest.raises(DescriptionError) as refusal:
        read(everything)
    for words in (
        "<robot>",
        "joint 'elbow': its axis",
        "mass -2",
        "'hands'",
        '<limit effort="-5">',
        '<limit velocity="x">',
    ):
        assert any(words in problem for problem in refusal.value.problems), words
        assert words in refusal.value.full
    assert "more; 'stiffgen inspect'" in str(refusal.value)


# What real files have and stiffgen must take without a word; each is the same arm as before.
HARMLESS = {
    "comments": [("<robot", "<!-- <robot> --><robot"),
                 ('<link name="hand"/>', '<!-- <link name="x"/> --><link name="hand"/>')],
    "double hyphen in a comment": [("</robot>", "<!-- a -- b --></robot>")],
    "undeclared prefix": [("</robot>", '<drake:x y:z="1"/></robot>'), ("<limit ", '<limit drake:acceleration="1" ')],
    "declared prefix": [("<robot ", '<robot xmlns:gz="http://gz" '), ("</robot>", "<gz:joint/></robot>")],
    "default namespace": [("<robot ", '<robot xmlns="http://drake.mit.edu" ')],
    "xacro's namespace left over": [("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')],
    "strange version": [('version="1.0"', 'version="0.0"')],
    "blank line first": [("<?xml", "\n<?xml")],
    "no declaration": [('<?xml version="1.0"?>', "")],
    "gazebo": [("</robot>", '<gazebo reference="x"><joint name="elbow"/><link name="hand"/></gazebo></robot>')],
    "transmission": [("</robot>",
                      '<transmission><joint name="elbow"><mimic joint="?"/></joint></transmission></robot>')],
    "sensor": [("</robot>", '<sensor name="s"><parent link="nowhere"/><origin xyz="a b c"/></sensor></robot>')],
    "meshes": [('<link name="hand"/>',
                '<link name="hand"><visual><geometry><mesh filename="package://x/y.dae" scale="1 1"/></geometry>'
                '</visual>'
                '<collision><geometry><box size="nan"/></geometry></collision></link>')],
    "fixed joint's zero axis": [('<joint name="wrist" type="fixed">',
                                 '<joint name="wrist" type="fixed"><axis xyz="0 0 0"/>')],
    "fixed joint's junk": [('<joint name="wrist" type="fixed">',
                            '<joint name="wrist" type="fixed"><axis/><limit lower="" upper="x"/><mimic joint="y"/>')],
    "spaces and signs": [('xyz="0.4 0 0"', 'xyz=" +.4\t-0.  0e5\n"')],
    "dynamics": [("<limit ", '<dynamics damping="nan"/><safety_controller k_velocity="x"/><limit ')],
    "two axes of a fixed joint": [('<joint name="wrist" type="fixed">',
                                   '<joint name="wrist" type="fixed"><axis xyz="0 0 1"/><axis xyz="0 1 0"/>')],
    "two of what nobody reads": [("<limit ", '<dynamics damping="1"/><dynamics damping="2"/><limit ')],
}  # fmt: skip


@pytest.mark.parametrize("name", HARMLESS)
def test_what_real_files_have_changes_nothing(read, name):
    expected = read(ARM)
    got = read(replaced(*HARMLESS[name]))
    assert got.problems == ()
    assert got.joints == expected.joints
    assert got.inertials == expected.inertials


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "iso-8859-1"])
def test_encodings(read, encoding):
    text = ARM.replace('version="1.0"', f'version="1.0" encoding="{encoding.removesuffix("-sig")}"').replace(
        "hand", "händ"
    )
    assert "händ" in read(text.encode(encoding)).links


def test_windows_line_ends(read):
    assert read(ARM.replace("\n", "\r\n")).joints == read(ARM).joints


@pytest.mark.parametrize(
    ("limit", "bounds"),
    [
        ("", (-math.inf, math.inf, math.inf, math.inf)),
        ('<limit effort="1" velocity="2"/>', (-math.inf, math.inf, 2, 1)),
        ('<limit upper="1"/>', (0, 1, math.inf, math.inf)),
        ('<limit lower="-1"/>', (-1, 0, math.inf, math.inf)),
        ('<limit lower="-inf" upper="+Infinity"/>', (-math.inf, math.inf, math.inf, math.inf)),
        ('<limit lower="-1.7976931348623157e308" upper="1e30"/>', (-1.7976931348623157e308, 1e30, math.inf, math.inf)),
    ],
)
def test_limits_left_out(read, limit, bounds):
    """Leave limits out, in part or whole: a missing bound is 0 beside a stated one, else infinite."""
    elbow = read(replaced(('<limit lower="-1" upper="1" effort="20" velocity="4"/>', limit))).joints["elbow"]
    assert (elbow.lower, elbow.upper, elbow.velocity, elbow.effort) == bounds


def test_a_continuous_joint_has_no_bounds_whatever_the_file_says(read):
    for lower, upper in (("-1", "1"), ("1", "-1"), ("", "x")):
        text = replaced(('name="elbow" type="revolute"', 'name="elbow" type="continuous"'),
                        ('lower="-1" upper="1"', f'lower="{lower}" upper="{upper}"'))  # fmt: skip
        description = read(text)
        assert description.problems == ()
        assert (description.joints["elbow"].lower, description.joints["elbow"].upper) == (-math.inf, math.inf)


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ("0 0 -2", (0, 0, -1)), ("0 1e-16 1", (0, 0, 1)), ("-1 3e-13 -2e-12", (-1, 0, 0)), ("3 0 4", (0.6, 0, 0.8)),
        ("1e9 0 0", (1, 0, 0)), ("1 1 1", (3**-0.5,) * 3), ("0 1e-5 0", (0, 1, 0)),
    ],
)  # fmt: skip
def test_axes_get_unit_length_and_exact_zeros(read, axis, expected):
    """Read axes of any length: unit length, and tiny components (SNAP of geometry.py) become exactly 0."""
    got = read(replaced(('xyz="0 1 0"', f'xyz="{axis}"'))).joints["elbow"].axis
    assert np.allclose(got, expected, rtol=0, atol=2e-16)
    assert [v == 0 for v in got] == [v == 0 for v in expected]


def test_a_missing_axis_is_x(read):
    assert read(replaced(('<axis xyz="0 1 0"/>', ""))).joints["elbow"].axis == (1, 0, 0)


def test_huge_tensors_are_judged_without_overflow(read):
    text = replaced(('ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"',
                     'ixx="1e12" ixy="0" ixz="0" iyy="1e12" iyz="0" izz="1e-300"'))  # fmt: skip
    assert read(text).problems == ()


HAND = ChainOptions(tip="hand")
GRIP_AXIS = '<axis xyz="1 0 0"/>'
# Faults beside the chain from base to hand. The finger rides on the hand, its joint held at zero: only what moves a
# mass, or a joint off zero, can change the chain.
BESIDE = {
    "zero axis": [(GRIP_AXIS, '<axis xyz="0 0 0"/>')],
    "misspelt axis attribute": [(GRIP_AXIS, '<axis xzy="1 0 0"/>')],
    "two axes": [(GRIP_AXIS, f'{GRIP_AXIS}<axis xyz="0 1 0"/>')],
    "limits": [('lower="0" upper="0.04"', 'lower="9" upper="1"')],
    "misspelt limit": [('lower="0" upper="0.04"', 'lowr="0" upper="0.04"')],
    "no type": [('name="grip" type="prismatic"', 'name="grip"')],
    "unknown type": [('name="grip" type="prismatic"', 'name="grip" type="spherical"')],
    "another limb": [
        ("</robot>", f'<link name="head">{INERTIAL.replace("0.03", "0.5")}</link><joint name="neck" type="revolute">'
                     '<orgin xyz="1 0 0"/><parent link="base"/><child link="head"/><axis xyz="0 0 0"/></joint></robot>')
    ],
}  # fmt: skip
REFUSED_BESIDE = {
    "mimics no joint": [(GRIP_AXIS, f"{GRIP_AXIS}<mimic/>")],
    "mimics a stranger": [(GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="ghost" multiplier="2" offset="0.0"/>')],
    "mimics itself": [(GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="grip"/>')],
    "bad multiplier": [(GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="elbow" multiplier="two"/>')],
    "origin": [('<origin xyz="0 0.05 0"/>', '<origin xyz="0 0.05"/>')],
    "misspelt origin": [('<origin xyz="0 0.05 0"/>', '<orgin xyz="0 0.05 0"/>')],
    "zero axis off zero": [(GRIP_AXIS, '<axis xyz="0 0 0"/><mimic joint="elbow" offset="0.1"/>')],
    "mimics a stranger, on another limb": [
        (
            "</robot>",
            '<link name="disc"/><joint name="crank" type="revolute"><parent link="base"/><child link="disc"/>'
            '<mimic joint="ghost"/></joint></robot>',
        )
    ],
    "misspelt mimic, on another limb": [
        (
            "</robot>",
            '<link name="disc"/><joint name="crank" type="revolute"><parent link="base"/><child link="disc"/>'
            '<mimik joint="elbow"/></joint></robot>',
        )
    ],
    "unreadable offset": [(GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="ghost" offset="0,1"/>')],
    "misspelt offset": [(GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="elbow" ofset="0.1"/>')],
    "unknown type off zero": [
        ('name="grip" type="prismatic"', 'name="grip" type="spherical"'),
        (GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="elbow" offset="0.1"/>'),
    ],
    "unknown type of its master off zero": [
        (GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="crank"/>'),
        (
            "</robot>",
            '<link name="disc"/><joint name="crank" type="wheel"><parent link="base"/><child link="disc"/>'
            '<mimic joint="elbow" offset="0.1"/></joint></robot>',
        ),
    ],
    "misspelt mimic of its master": [
        (GRIP_AXIS, f'{GRIP_AXIS}<mimic joint="crank"/>'),
        (
            "</robot>",
            '<link name="disc"/><joint name="crank" type="revolute"><parent link="base"/><child link="disc"/>'
            '<mimik joint="elbow" offset="0.1"/></joint></robot>',
        ),
    ],
}


@pytest.mark.parametrize("name", BESIDE)
def test_problems_beside_the_chain_are_warned_of(read, name, tmp_path):
    """Put a fault beside the chain: a warning, and the chain is that of the sound file."""
    text = replaced(*BESIDE[name])
    description = read(text)
    assert description.problems
    with pytest.warns(DescriptionWarning, match="without effect on this chain") as caught:
        chain = load_chain(tmp_path / "arm.urdf", tip="hand")
    assert caught[0].message.problems == tuple(problem.text for problem in description.problems)
    sound = chain_between(read(ARM), HAND)
    assert replace(chain, digest="") == replace(sound, digest="")
    if name != "another limb":
        with pytest.raises(DescriptionError):
            chain_between(description, ChainOptions(tip="finger"))


@pytest.mark.parametrize("name", REFUSED_BESIDE)
def test_problems_of_what_rides_on_the_chain_are_refused(read, name):
    description = read(replaced(*REFUSED_BESIDE[name]))
    with pytest.raises(DescriptionError, match=r"grip|crank"):
        chain_between(description, HAND)
    assert chain_between(description, replace(HAND, masses=False)).dof == 2


def test_a_locked_joint_shows_the_axis_of_its_followers(read):
    """The finger, held at zero, leaves it with its master."""
    description = read(replaced((GRIP_AXIS, '<axis xyz="0 0 0"/><mimic joint="elbow"/>')))
    assert chain_between(description, replace(HAND, lock={"elbow": 0.0})).dof == 1
    with pytest.raises(DescriptionError, match="grip"):
        chain_between(description, replace(HAND, lock={"elbow": 0.03}))


# Each: what changes, and the words that name the fault and what was meant.
MISSPELT = {
    "origin": ([('<origin xyz="0.4 0 0"/>', '<orgin xyz="0.4 0 0"/>')], "joint 'elbow': <orgin>", "<origin>"),
    "axis": ([('<axis xyz="0 1 0"/>', '<axes xyz="0 1 0"/>')], "joint 'elbow': <axes>", "<axis>"),
    "limit": ([('<limit lower="-1"', '<limits lower="-1"')], "joint 'elbow': <limits>", "<limit>"),
    "mimic": ([('<axis xyz="0 1 0"/>', '<mimik joint="shoulder"/>')], "joint 'elbow': <mimik>", "<mimic>"),
    "capitals": ([('<origin xyz="0.4 0 0"/>', '<Origin xyz="0.4 0 0"/>')], "joint 'elbow': <Origin>", "<origin>"),
    "of a fixed joint": ([('<origin xyz="0.3 0 0"/>', '<orign xyz="0.3 0 0"/>')], "joint 'wrist': <orign>", "<origin>"),
    "inertial": ([("<inertial>", "<inertail>"), ("</inertial>", "</inertail>")],
                 "link 'upper': <inertail>", "<inertial>"),
    "mass": ([('<mass value="2"/>', '<mas value="2"/>')], "link 'upper': <mas>", "<mass>"),
    "inertia": ([("<inertia ", "<Inertia ")], "link 'upper': <Inertia>", "<inertia>"),
    "xyz": ([('<origin xyz="0.4 0 0"/>', '<origin xzy="0.4 0 0"/>')], "joint 'elbow': <origin>", "'xyz'"),
    "rpy": ([('rpy="0 1.57', 'rpi="0 1.57')], "joint 'shoulder': <origin>", "'rpy'"),
    "axis xyz": ([('<axis xyz="0 1 0"/>', '<axis xzy="0 1 0"/>')], "joint 'elbow': <axis>", "'xyz'"),
    "lower": ([('lower="-1"', 'lowr="-1"')], "joint 'elbow': <limit>", "'lower'"),
    "multiplier": ([('<axis xyz="0 1 0"/>', '<mimic joint="shoulder" multipler="2"/>')],
                   "joint 'elbow': <mimic>", "'multiplier'"),
    "value": ([('<mass value="2"/>', '<mass value="2" valu="3"/>')], "link 'upper': <mass>", "'value'"),
    "ixx": ([('ixx="0.02"', 'ixx="0.02" lxx="1"')], "link 'upper': <inertia>", "'ixx'"),
    "inertial's origin": ([("<inertial>", '<inertial><origin xyz="0 0 0" rpu="0 0 0"/>')],
                          "link 'upper': <origin>", "'rpy'"),
    "parent": ([('<parent link="lower"/>', '<parent link="lower" lnik="x"/>')], "joint 'wrist': <parent>", "'link'"),
    "type": ([('name="wrist" type="fixed"', 'name="wrist" type="fixed" tpye="x"')], "joint 'wrist': <joint>", "'type'"),
    "a quaternion": ([('<origin xyz="0.4 0 0"/>', '<origin xyz="0.4 0 0" quat_xyzw="0 0 0 1"/>')],
                     "joint 'elbow': <origin> has no attribute 'quat_xyzw'", "valid: 'xyz', 'rpy'"),
    "nothing alike in an inertial": ([("<inertial>", "<inertial><zzz/>")], "link 'upper': <zzz>", "valid: <origin>"),
    "a joint": ([('<joint name="wrist" type="fixed">', '<jiont name="wrist" type="fixed">'),
                 ('<child link="hand"/></joint>', '<child link="hand"/></jiont>')], "<jiont>", "<joint>"),
    "a link": ([('<link name="hand"/>', '<link name="hand"/><lnik name="x"/>')], "<lnik>", "<link>"),
    "two origins": ([('<origin xyz="0.4 0 0"/>', '<origin xyz="0.4 0 0"/><origin xyz="0.5 0 0"/>')],
                    "joint 'elbow': <origin> occurs twice", "remove the wrong one"),
    "two axes": ([('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz="0 0 1"/>')],
                 "joint 'elbow': <axis> occurs twice", "remove the wrong one"),
    "two parents": ([('<parent link="lower"/>', '<parent link="lower"/><parent link="upper"/>')],
                    "joint 'wrist' has several <parent>", "keep one"),
    "two children": ([('<child link="hand"/>', '<child link="hand"/><child link="base"/>')],
                     "joint 'wrist' has several <child>", "keep one"),
    "two masses": ([('<mass value="2"/>', '<mass value="2"/><mass value="3"/>')],
                   "link 'upper': <mass> occurs twice", "remove the wrong one"),
    "two inertials": ([("<inertial>", '<inertial><mass value="9"/></inertial><inertial>')],
                      "link 'upper': <inertial> occurs twice", "remove the wrong one"),
}  # fmt: skip


VENDORS = (  # of the joints of FR3, of Gen3 and others
    '<position_based_velocity_limits k="1"><inner/></position_based_velocity_limits>',
    '<soft_limits/><gear ratio="100"/><friction/>',
)


@pytest.mark.parametrize("added", VENDORS)
def test_elements_of_a_vendor_pass_with_a_note(read, tmp_path, added):
    """Add unknown elements of vendors: a note and a warning, and the chain is that of the sound file."""
    description = read(replaced(('<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/>{added}')))
    assert not description.problems
    assert len(description.notes) == added.count("><") - ("inner" in added) * 2 + 1
    with pytest.warns(DescriptionWarning, match="that stiffgen knows; it is ignored"):
        chain = load_chain(tmp_path / "arm.urdf", tip="hand")
    assert replace(chain, digest="") == replace(chain_between(read(ARM), HAND), digest="")


def test_an_element_that_resembles_a_known_one_is_ignored_by_name(read, tmp_path):
    """Misspell an element: refused, unless the user names it in `ignore`."""
    read(replaced(('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axles/>')))
    file = tmp_path / "arm.urdf"
    with pytest.raises(DescriptionError, match=r"<axles> is no element of <joint>.*<axis>.*ignore=\[.axles.\]"):
        load_chain(file, tip="hand")
    chain = load_chain(file, tip="hand", ignore=["axles"])
    assert chain.ignored == ("axles",)
    assert replace(chain, digest="", ignored=()) == replace(chain_between(read(ARM), HAND), digest="")


@pytest.mark.parametrize("name", MISSPELT)
def test_misspelt_and_repeated_names_are_refused(read, tmp_path, name):
    changes, fault, meant = MISSPELT[name]
    problems = all_problems(read, replaced(*changes))
    assert any(fault in problem and meant in problem for problem in problems), problems
    with pytest.raises(DescriptionError):
        load_chain(tmp_path / "arm.urdf")


def test_the_names_of_others_pass(read):
    """Everything that the table calls added, in one file, and with prefixes."""
    text = ARM
    for tag, known in FORMAT.items():
        inside = "".join(f"<{each}/>" for each in known.added_elements) + "<gz:any/>"
        attributes = "".join(f' {each}="1 2"' for each in (*known.added_attributes, "gz:any"))
        text = re.sub(rf"<{tag}( [^>/]*)?(/?)>", rf"<{tag}\1{attributes}\2>", text)
        text = re.sub(rf"</{tag}>", f"{inside}</{tag}>", text)
    text = text.replace("<robot ", '<robot xmlns:gz="http://gz" ')
    assert text.count("joint_properties") == 4 and 'gear_velocity="1 2"' in text
    description = read(text)
    assert description.problems == ()
    assert description.joints == read(ARM).joints


def test_what_is_repeated_word_for_word_passes(read):
    doubled = replaced(('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz=" 0 1  0"/>'))
    assert read(doubled).problems == ()


def test_a_follower_of_a_broken_follower_is_refused(read):
    """Let a joint follow one whose own mimic relation is broken: refused, as its position is unknown."""
    text = replaced(('<axis xyz="0 1 0"/>', '<mimic joint="grip"/>'), ('<axis xyz="1 0 0"/>', '<mimic joint="ghost"/>'))
    description = read(text)
    assert {problem.element for problem in description.problems} == {"joint elbow", "joint grip"}
    text = replaced(('<axis xyz="0 1 0"/>', '<mimic joint="grip"/>'),
                    ('<axis xyz="1 0 0"/>', '<mimic joint="shoulder" multiplier="2,5"/>'))  # fmt: skip
    with pytest.raises(DescriptionError, match="2,5"):
        chain_between(read(text), ChainOptions(tip="lower", masses=False))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ["not well-formed", "give a URDF"]),
        ("hello", ["not well-formed", "give a URDF"]),
        (ARM[:300], ["not well-formed", "give a URDF"]),
        ("<sdf version='1.7'/>", ["SDF", "give a URDF"]),
        ("<mujocoinclude/>", ["part of an MJCF file", "give the file"]),
        ("<html/>", ["<html>", "<robot>"]),
        ("<robot name='s'><group name='arm'/></robot>", ["<link>", "SRDF"]),
        (
            '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>',
            ["only a template is expanded", "name it FILE.xacro"],
        ),
        ('<robot name="a"><xacro:macro name="m"/></robot>', ["only a template is expanded"]),
        ('<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro>', ["not well-formed XML"]),
        (b"\x7fELF\x02\x01\x01" + bytes(range(256)), ["not well-formed", "give a URDF"]),
        (b"<robot name='a\x00'/>", ["not well-formed"]),
        ("<!DOCTYPE robot><robot name='a'/>", ["DOCTYPE", "remove"]),
    ],
)  # fmt: skip
def test_files_that_are_no_urdf(read, content, words):
    """Read files that are no URDF: refused with what the file is and what to give."""
    with pytest.raises(DescriptionError) as refusal:
        read(content)
    message = str(refusal.value)
    assert message.startswith("arm.urdf")
    assert all(word in message for word in words), message


@pytest.mark.parametrize("path", ["no/such.urdf", ".", "", "a\0b", "x" * 5000])
def test_paths_that_are_no_file(path):
    with pytest.raises(DescriptionError) as refusal:
        read_description(path)
    assert "\0" not in str(refusal.value)


def test_names_reach_messages_printable_and_short(read):
    text = replaced(('name="wrist" type="fixed"', f'name="&#155;31m&#10;{"w" * 500}" type="x&#27999;"'))
    (message,) = all_problems(read, text)
    assert "\x9b" not in message and "\n" not in message
    assert "www..." in message and len(message) < 300
