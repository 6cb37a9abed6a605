"""Reading URDF files: what is refused and with which words, and what real files have that must pass."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from stiffgen import load_chain
from stiffgen.errors import DescriptionError, StiffgenError
from stiffgen.robot.chain import chain_between
from stiffgen.robot.description import Description, read_description
from support.chains import ARM, replaced


@pytest.fixture
def read(tmp_path: Path):
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
    "zero axis": ([('xyz="0 1 0"', 'xyz="0 0 0"')], ["joint 'elbow'", "axis", 'xyz="0 0 1"']),
    "tiny axis": ([('xyz="0 1 0"', 'xyz="0 1e-300 0"')], ["joint 'elbow'", "axis", 'xyz="0 0 1"']),
    "axis without xyz": ([('axis xyz="0 1 0"', "axis")], ["joint 'elbow'", "<axis>", "add"]),
    "two numbers": ([('xyz="0.4 0 0"', 'xyz="0.4 0"')],
                    ["joint 'elbow'", '<origin xyz="0.4 0">', "2 words", "3 numbers"]),
    "nan": ([('xyz="0.4 0 0"', 'xyz="nan 0 0"')], ["joint 'elbow'", "<origin xyz=", "'nan'", "finite"]),
    "inf": ([('xyz="0.4 0 0"', 'xyz="0 inf 0"')], ["joint 'elbow'", "<origin xyz=", "'inf'", "finite"]),
    "1e400": ([('xyz="0.4 0 0"', 'xyz="0 0 1e400"')], ["joint 'elbow'", "<origin xyz=", "'1e400'", "finite"]),
    "1e300": ([('xyz="0.4 0 0"', 'xyz="0 0 1e300"')], ["joint 'elbow'", "<origin xyz=", "'1e300'", "metres"]),
    "underscore": ([('xyz="0.4 0 0"', 'xyz="1_0 0 0"')], ["joint 'elbow'", "'1_0'", "decimal"]),
    "unicode digits": ([('xyz="0.4 0 0"', 'xyz="٣ 0 0"')], ["joint 'elbow'", "'٣'", "decimal"]),
    "unicode space": ([('xyz="0.4 0 0"', 'xyz="1\u00a00 0 0"')], ["joint 'elbow'", "decimal"]),
    "comma": ([('xyz="0.4 0 0"', 'xyz="0,4 0 0"')], ["joint 'elbow'", "'0,4'", "decimal"]),
    "hexadecimal": ([('xyz="0.4 0 0"', 'xyz="0x4 0 0"')], ["joint 'elbow'", "'0x4'", "decimal"]),
    "xacro expression": ([('xyz="0.4 0 0"', 'xyz="${a + 1} 0 0"')], ["joint 'elbow'", "<origin xyz=", "xacro"]),
    "lower above upper": ([('lower="-1" upper="1"', 'lower="1" upper="-1"')], ["joint 'elbow'", "1", "-1", "swap"]),
    "negative velocity": ([('velocity="4"', 'velocity="-4"')], ["joint 'elbow'", "velocity", "magnitude"]),
    "negative effort": ([('effort="20"', 'effort="-20"')], ["joint 'elbow'", "effort", "magnitude"]),
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
    changes, words = FAULTS[name]
    text = replaced(*changes)
    problems = all_problems(read, text)
    matching = [problem for problem in problems if all(word in problem for word in words)]
    assert matching, problems
    with pytest.raises(StiffgenError) as refusal:
        load_chain(tmp_path / "arm.urdf")
    assert "arm.urdf" in str(refusal.value)
    assert str(refusal.value).count("\n") <= 6


def test_all_problems_at_once_also_those_of_the_file(read):
    everything = replaced(
        (' name="arm"', ""), ('xyz="0 1 0"', 'xyz="0 0 0"'), ('mass value="2"', 'mass value="-2"'),
        ('child link="hand"', 'child link="hands"'), ('effort="5"', 'effort="-5"'), ('velocity="4"', 'velocity="x"'),
    )  # fmt: skip
    with pytest.raises(DescriptionError) as refusal:
        read(everything)
    for words in ("<robot>", "joint 'elbow': its axis", "mass -2", "'hands'", "<limit effort>", '<limit velocity="x">'):
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
    "mass of zero": [("</robot>", "</robot>")],
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
    got = read(replaced(('xyz="0 1 0"', f'xyz="{axis}"'))).joints["elbow"].axis
    assert np.allclose(got, expected, rtol=0, atol=2e-16)
    assert [v == 0 for v in got] == [v == 0 for v in expected]


def test_a_missing_axis_is_x(read):
    assert read(replaced(('<axis xyz="0 1 0"/>', ""))).joints["elbow"].axis == (1, 0, 0)


def test_huge_tensors_are_judged_without_overflow(read):
    text = replaced(('ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"',
                     'ixx="1e12" ixy="0" ixz="0" iyy="1e12" iyz="0" izz="1e-300"'))  # fmt: skip
    assert read(text).problems == ()


def test_problems_beside_the_chain_refuse_nothing(read):
    bad_finger = read(replaced(('xyz="1 0 0"', 'xyz="0 0 0"'), ('mass value="2"', 'mass value="2"')))
    assert len(bad_finger.problems) == 1
    with pytest.raises(DescriptionError, match="grip"):  # hand carries the finger
        chain_between(bad_finger, tip="hand")
    assert chain_between(bad_finger, tip="hand", masses=False).dof == 2
    assert chain_between(read(replaced(('lower="0" upper="0.04"', 'lower="9" upper="1"'))), tip="hand").dof == 2


def test_a_follower_of_a_broken_follower_is_refused(read):
    text = replaced(('<axis xyz="0 1 0"/>', '<mimic joint="grip"/>'), ('<axis xyz="1 0 0"/>', '<mimic joint="ghost"/>'))
    description = read(text)
    assert {problem.element for problem in description.problems} == {"joint elbow", "joint grip"}
    text = replaced(('<axis xyz="0 1 0"/>', '<mimic joint="grip"/>'),
                    ('<axis xyz="1 0 0"/>', '<mimic joint="shoulder" multiplier="2,5"/>'))  # fmt: skip
    with pytest.raises(DescriptionError, match="2,5"):
        chain_between(read(text), tip="lower", masses=False)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ["not well-formed", "give a URDF"]),
        ("hello", ["not well-formed", "give a URDF"]),
        (ARM[:300], ["not well-formed", "give a URDF"]),
        ("<sdf version='1.7'/>", ["SDF", "give a URDF"]),
        ("<mujoco/>", ["MJCF", "give a URDF"]),
        ("<html/>", ["<html>", "<robot>"]),
        ("<robot name='s'><group name='arm'/></robot>", ["<link>", "SRDF"]),
        (
            '<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="m"/></robot>',
            ["xacro INPUT"],
        ),
        ('<robot name="a" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include/></robot>', ["xacro INPUT"]),
        ('<robot name="a"><xacro:macro name="m"/></robot>', ["xacro INPUT"]),
        ('<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro>', ["xacro INPUT"]),
        (b"\x7fELF\x02\x01\x01" + bytes(range(256)), ["not well-formed", "give a URDF"]),
        (b"<robot name='a\x00'/>", ["not well-formed"]),
        ("<!DOCTYPE robot><robot name='a'/>", ["DOCTYPE", "remove"]),
    ],
)  # fmt: skip
def test_files_that_are_no_urdf(read, content, words):
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
    with pytest.raises(DescriptionError) as refusal:
        read(text)
    message = str(refusal.value)
    assert "\x9b" not in message and "\n" not in message
    assert "www..." in message and len(message) < 300
