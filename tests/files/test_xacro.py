# SPDX-License-Identifier: MIT
"""Xacro templates: constructs of vendors' descriptions, arguments, packages, the record of files, faults."""

from __future__ import annotations

import hashlib
import math
import re
from pathlib import Path

import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.core.errors import StiffgenError
from stiffgen.core.loading import describe
from stiffgen.core.robot.description import Reading

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
PACKAGE = '<package format="2"><name>{}</name><version>0.0.0</version></package>'


def segment(params: str, origin: str, lower: str, upper: str) -> str:
    """Return a macro of a link and its joint."""
    return f"""<xacro:macro name="segment" params="name parent {params}"><link name="${{name}}"/>
      <joint name="to_${{name}}" type="revolute"><parent link="${{parent}}"/><child link="${{name}}"/>{origin}
      <axis xyz="0 0 1"/><limit lower="{lower}" upper="{upper}" effort="5" velocity="2"/></joint></xacro:macro>"""


VENDORS = {
    # FR3: limits of a YAML file by joint, arguments passed on, an end effector by its file's name, a block of links
    "yaml by joint, include by argument": {
        "robots/arm.urdf.xacro": f"""<robot {XACRO} name="arm">
          <xacro:arg name="type" default="one"/><xacro:arg name="hand" default="true"/>
          <xacro:arg name="ee" default="claw"/>
          <xacro:include filename="$(find arms)/robots/common/arm.xacro"/>
          <xacro:property name="ee" value="$(arg ee)"/>
          <xacro:arm limits="${{xacro.load_yaml('$(find arms)/robots/$(arg type)/limits.yaml')}}"/>
          <xacro:if value="$(arg hand)"><xacro:include filename="$(find arms)/ends/${{ee}}.xacro"/>
            <xacro:claw parent="a"/></xacro:if></robot>""",
        "robots/common/arm.xacro": f"""<robot {XACRO}><link name="base"/>
          <xacro:macro name="limited" params="name config">
            <xacro:property name="bounds" value="${{config[name]['limit']}}"/>
            <limit lower="${{bounds['lower']}}" upper="${{bounds.upper}}" effort="5" velocity="2"/></xacro:macro>
          <xacro:macro name="arm" params="limits:=^"><link name="a"/><joint name="j1" type="revolute">
            <parent link="base"/><child link="a"/><axis xyz="0 0 1"/><xacro:limited name="j1" config="${{limits}}"/>
            </joint></xacro:macro></robot>""",
        "robots/one/limits.yaml": "j1: {limit: {lower: -2.5, upper: 2.75}}\n",
        "ends/claw.xacro": f"""<robot {XACRO}><xacro:macro name="claw" params="parent rpy:='0 0 ${{-pi/4}}'">
          <link name="claw"/><joint name="grip" type="fixed"><parent link="${{parent}}"/><child link="claw"/>
          <origin rpy="${{rpy}}" xyz="0 0 0.5"/></joint></xacro:macro></robot>""",
    },
    # UR: calibration in YAML, units, properties of parent scope, values of dictionaries in other files
    "yaml with units and scope": {
        "urdf/arm.urdf.xacro": f"""<robot {XACRO} name="arm"><link name="base"/>
          <xacro:include filename="inc/load.xacro"/><xacro:load file="$(find arms)/config/limits.yaml"/>
          {segment("*origin", '<xacro:insert_block name="origin"/>', "${low}", "${high}")}
          <xacro:segment name="a" parent="base"><origin xyz="0 0 ${{kin['a']['z']}}"/></xacro:segment></robot>""",
        "urdf/inc/load.xacro": f"""<robot {XACRO}><xacro:macro name="load" params="file">
          <xacro:property name="data" value="${{xacro.load_yaml(file)}}"/>
          <xacro:property name="kin" value="${{data['kinematics']}}" scope="parent"/>
          <xacro:property name="low" value="${{data['limits']['low']}}" scope="parent"/>
          <xacro:property name="high" value="${{data['limits']['high']}}" scope="parent"/></xacro:macro></robot>""",
        "config/limits.yaml": "limits: {low: !radians -2.5, high: !degrees 90}\n"
        "kinematics: {a: {z: !millimeters 500}}\n",
    },
    # Gen3: a macro file chosen by degrees of freedom, arguments with defaults in parameters, unless
    "macro file by number": {
        "robots/arm.urdf.xacro": f"""<robot {XACRO} name="arm"><xacro:arg name="dof" default="7"/>
          <xacro:arg name="vision" default="false"/><link name="base"/>
          <xacro:include filename="$(find arms)/arms/${{'gen'}}/$(arg dof)dof/macro.xacro"/>
          <xacro:gen parent="base" prefix=""/>
          <xacro:unless value="$(arg vision)"><link name="plate"/><joint name="plate" type="fixed"><parent link="a"/>
            <child link="plate"/></joint></xacro:unless></robot>""",
        "arms/gen/7dof/macro.xacro": f"""<robot {XACRO}>
          {segment("z:=0.5", '<origin xyz="0 0 ${z}"/>', "${-2.5}", "${pi/2 + 0}")}
          <xacro:macro name="gen" params="parent prefix"><xacro:segment name="${{prefix}}a" parent="${{parent}}"/>
          </xacro:macro></robot>""",
    },
    # xArm: strings of several numbers, chained conditions, macro names by xacro:call
    "call and conditions": {
        "urdf/arm.urdf.xacro": f"""<robot {XACRO} name="arm"><xacro:arg name="dof" default="6"/>
          <xacro:property name="dof" value="$(arg dof)"/><link name="base"/>
          <xacro:property name="origin" value="0 0 0.5"/>
          {segment("xyz", '<origin xyz="${xyz}" rpy="0 0 0"/>', "-2.5", "1.5")}
          <xacro:if value="${{dof == 6 or dof == 7}}">
            <xacro:call macro="segment" name="a" parent="base" xyz="${{origin}}"/>
          </xacro:if><xacro:if value="${{dof not in [6, 7]}}"><link name="never"/></xacro:if></robot>""",
    },
    # OpenArm: two arms by a prefix and a reflection, lists of YAML, multiplied numbers
    "two arms by reflection": {
        "urdf/arm.urdf.xacro": f"""<robot {XACRO} name="arm"><xacro:arg name="both" default="false"/><link name="base"/>
          <xacro:property name="config" value="${{xacro.load_yaml('../config/arm.yaml')}}"/>
          {segment("side:=1", '<origin xyz="0 0 ${config.offsets[0]}"/>', "${-2.5 * side}", "${4 + side}")}
          <xacro:segment name="a" parent="base"/>
          <xacro:if value="$(arg both)"><xacro:segment name="b" parent="base" side="-1"/></xacro:if></robot>""",
        "config/arm.yaml": "offsets: [0.5, 0.25]\n",
    },
    # Rizon: arguments handed to macros as parameters, default properties, namespaces of includes
    "namespace of an include": {
        "urdf/arm.urdf.xacro": f"""<robot {XACRO} name="arm"><xacro:arg name="prefix" default=""/><link name="base"/>
          <xacro:include filename="$(dirname)/macros.xacro" ns="m"/><xacro:property name="z" default="0.5"/>
          <xacro:m.segment name="$(arg prefix)a" parent="base" z="${{z}}"/></robot>""",
        "urdf/macros.xacro": f"""<robot {XACRO}><xacro:property name="low" value="-2.5"/>
          {segment("z", '<origin xyz="0 0 ${z}"/>', "${low}", "${python.abs(low) - 1}")}</robot>""",
    },
}


def written(folder: Path, files: dict[str, str]) -> Path:
    """Write a package 'arms' and return its template."""
    for name, text in ({"package.xml": PACKAGE.format("arms")} | files).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / next(name for name in files if name.endswith(".urdf.xacro"))


@pytest.mark.parametrize("vendor", VENDORS)
def test_constructs_of_vendors(tmp_path, vendor):
    """Expand the constructs that makers use: the joints, and the digests of all files that went in."""
    files = VENDORS[vendor]
    description = describe(written(tmp_path, files))
    assert description.problems == ()
    first = next(joint for joint in description.joints.values() if joint.type == "revolute")
    z = sum(joint.xyz[2] for joint in description.joints.values())  # the FR3's is at its hand
    assert (first.parent, first.child, first.lower, z) == ("base", "a", -2.5, 0.5)
    template = next(name for name in files if name.endswith(".urdf.xacro"))
    folder = Path(template).parent
    expected = {Path(name).relative_to(folder).as_posix() if Path(name).is_relative_to(folder) else f"../{name}": text
                for name, text in files.items() if name != template}  # fmt: skip
    if any("$(find arms)" in text for text in files.values()):
        expected["../package.xml"] = PACKAGE.format("arms")
    found = {each.file: each.digest for each in description.inputs}
    assert found == {name: hashlib.sha256(text.encode()).hexdigest() for name, text in expected.items()}


def test_arguments_change_the_robot_and_stand_in_the_manifest(tmp_path, capsys):
    """Give an argument of a template: another tip, recorded in the manifest and read again."""
    template = written(tmp_path, VENDORS["yaml by joint, include by argument"])
    chain = stiffgen.load_chain(template, arguments={"hand": "false"})
    assert (chain.tip, chain.arguments, len(chain.inputs)) == ("a", (("hand", "false"),), 3)
    assert stiffgen.load_chain(template).tip == "claw"
    words = ["hand:=false", "--output", str(tmp_path / "out"), "--no-build", "--no-controller", "--kernels", "hybrid"]
    assert main(["generate", str(template), *words]) == 0
    manifest = stiffgen.open_robot(tmp_path / "out" / "arm").manifest
    assert manifest["urdf"]["arguments"] == {"hand": "false"}
    assert set(manifest["urdf"]["inputs"]) == {"../package.xml", "common/arm.xacro", "one/limits.yaml"}
    assert stiffgen.open_robot(tmp_path / "out" / "arm").chain == chain
    assert main(["inspect", "hand:=false", str(template)]) == 0
    assert "│ claw" not in capsys.readouterr().out


def test_packages_by_path_and_environment(tmp_path, monkeypatch):
    """Find a package by --package-path and by ROS_PACKAGE_PATH."""
    files = {
        "arm.urdf.xacro": f'<robot {XACRO} name="arm"><xacro:include filename="$(find lone_parts)/a.xacro"/></robot>'
    }
    template = written(tmp_path / "arms", files)
    part = tmp_path / "deep" / "lone_parts" / "a.xacro"
    part.parent.mkdir(parents=True)
    part.write_text('<robot><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
                    '<child link="b"/></joint></robot>')  # fmt: skip
    with pytest.raises(StiffgenError, match=r"needs the package 'lone_parts'.*--package-path DIR"):
        describe(template)
    for place in (tmp_path / "deep", tmp_path / "deep" / "lone_parts"):  # a folder of packages, a package without XML
        (found,) = describe(template, Reading(package_path=(place,))).inputs
        assert found.file == "package://lone_parts/a.xacro"
    (part.parent / "package.xml").write_text(PACKAGE.format("lone_parts"))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "deep"))
    assert stiffgen.load_chain(template).tip == "b"


FAULTS = {
    "no robot": (f'<robot {XACRO}><xacro:macro name="m"><link name="a"/></xacro:macro></robot>', "robot without links"),
    "missing argument": (f'<robot {XACRO} name="$(arg model)"/>', "value for its argument 'model'; add model:=VALUE"),
    "missing package": (f'<robot {XACRO} name="$(find absent)"/>', "the package 'absent', which is not found"),
    "missing file": (f'<robot {XACRO} name="a"><xacro:include filename="b.xacro"/></robot>', "cannot read '"),
    "no such property": (f'<robot {XACRO} name="${{x}}"/>', "name 'x' is not defined"),
    "no such macro": (f'<robot {XACRO} name="a"><xacro:arm/></robot>', "unknown macro name: xacro:arm"),
    "not well formed": (f'<robot {XACRO} name="a"><xacro:arm></robot>', "not well-formed XML"),
    "empty": ("", "not well-formed XML"),
    "circle of macros": (
        f'<robot {XACRO} name="a"><xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/></robot>', "without end"),
    "circle of files": (f'<robot {XACRO} name="a"><xacro:include filename="t.xacro"/></robot>', "without end"),
    "a folder": (f'<robot {XACRO} name="a"><xacro:include filename="."/></robot>', "not a regular file"),
    "no name": (f'<robot {XACRO} name="a"><xacro:include/></robot>', "include.*correct"),
    "no namespace": ('<robot name="a"><xacro:macro name="m"/></robot>', "prefix.*correct"),
    "entities": ("<!DOCTYPE r [<!ENTITY a 'ha'>]><robot name='&a;'/>", "has a DOCTYPE"),
    "not a number": (
        f'<robot {XACRO} name="a"><link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/>'
        '<child link="b"/><origin xyz="${1e300 * 1e300} 0 ${nan}"/></joint></robot>', "not a finite decimal number"),
    "misspelt argument": (f'<robot {XACRO} name="a"><xacro:arg name="hand" default=""/><link name="a"/></robot>',
                          "has no argument 'hnad'; its arguments: hand"),
    "arguments of a URDF": ('<robot name="a"><link name="a"/></robot>', r"takes no arguments \(hnad:=1\)"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_sentence(tmp_path, capsys, fault):
    """Put faults into templates: one line each, with where."""
    text, sentence = FAULTS[fault]
    file = tmp_path / ("t.urdf" if fault == "arguments of a URDF" else "t.xacro")
    file.write_text(text)
    words = ["hnad:=1"] if "argument" in fault and "missing" not in fault else []
    code = main(["inspect", str(file), *words])
    out, error = capsys.readouterr()
    said = out if fault == "not a number" else error
    assert code == (1 if fault == "not a number" else 2), said
    assert re.search(sentence, " ".join(said.split())), said
    assert fault == "not a number" or error.count("\n") == 1


def test_without_xacrodoc_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("stiffgen.files.confined.find_spec", lambda name: None)
    template = written(tmp_path, VENDORS["call and conditions"])
    with pytest.raises(stiffgen.core.errors.MissingExtraError, match=r"pip install .*\[xacro\]"):
        describe(template)


def test_quaternion_equals_angles():
    """Compare a pose from a quaternion of any length with one from angles: within one rounding."""
    from stiffgen.core.robot.geometry import Pose

    angle = 0.3
    half = (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)
    by_quaternion = Pose.placed((1.0, 2.0, 3.0), [2.5 * v for v in half]).rounded()
    by_angles = Pose.placed((1.0, 2.0, 3.0), (0.0, angle, 0.0)).rounded()
    for row, other in zip(by_quaternion[0], by_angles[0], strict=True):
        assert row == pytest.approx(other, abs=2e-16)
    exact = Pose.placed((0.0, 0.0, 0.0), (math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0)).rounded()[0]
    assert exact == ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
