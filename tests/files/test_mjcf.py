# SPDX-License-Identifier: MIT
"""Compare chains of MJCF files with MuJoCo, which reads the file itself: frames, masses, couplings, sites, meshes."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import stiffgen
from stiffgen.cli import main
from stiffgen.control.presets import motor_tables
from stiffgen.core.errors import DescriptionError, MissingExtraError, StiffgenError
from stiffgen.core.loading import chain_between, describe
from stiffgen.core.robot.chain import ChainOptions
from support.chain_checks import disagreements
from support.mujoco_oracle import MujocoChain

INERTIAL = '<inertial mass="1.5" pos="0.01 0.02 0.1" quat="0.9 0.1 0.3 -0.2" diaginertia="0.03 0.02 0.015"/>'
ARM = f"""<mujoco model="arm"><compiler angle="degree" eulerseq="zyx"/>
<default><joint armature="0.05" damping="1"/>
 <default class="big"><joint armature="0.2" range="-120 150"/></default></default>
<worldbody><geom type="plane" size="1 1 1"/><body name="base" pos="0.1 0 0.2" euler="10 20 30">{INERTIAL}
 <body name="shoulder" pos="0 0 0.3" euler="33 -90 12"><joint name="yaw" class="big" axis="0 0 1" ref="25"/>
  <joint name="pitch" axis="1 2 0.5" pos="0.05 -0.1 0.2" ref="-40"/>
  <joint name="lift" type="slide" axis="0 1 1" ref="0.1"/>
  {INERTIAL}
  <body name="elbow" pos="0.4 0 0" axisangle="1 1 0 50"><joint name="roll" axis="0 1 0" pos="0.1 0 0.03"/>
   <geom type="capsule" size="0.04" fromto="0 0 0 0.3 0 0.1"/><site name="side" pos="0 0.1 0" zaxis="1 1 1"/>
   <body name="palm" pos="0.3 0 0.1" quat="0.3 0.1 -0.4 0.6">{INERTIAL}<site name="tool" pos="0 0 0.12" euler="0 90 0"/>
    <body name="left" pos="0 0.05 0"><joint name="left" type="slide" axis="0 1 0" ref="0.02"/>{INERTIAL}</body>
    <body name="right" pos="0 -0.05 0"><joint name="right" type="slide" axis="0 -1 0"/>{INERTIAL}</body>
    <body name="thumb" pos="0.1 0 0"><joint name="thumb" axis="0 0 1"/>{INERTIAL}</body>
    <body name="pendulum" pos="0 0 -0.2"><joint name="ball" type="ball"/>{INERTIAL}</body></body></body></body></body>
 <body name="box" pos="1 0 0"><freejoint name="box"/><geom type="box" size="0.1 0.2 0.3"/></body></worldbody>
<tendon><fixed name="grip"><joint joint="left" coef="2"/><joint joint="thumb" coef="-0.5"/></fixed></tendon>
<equality><joint name="fingers" joint1="right" joint2="left" polycoef="0.01 0.8 0 0 0"/>
 <tendon name="thumb" tendon1="grip" polycoef="0.003 0 0 0 0"/></equality>
<actuator><motor joint="yaw" ctrllimited="true" ctrlrange="-3 3" gear="20"/><general joint="roll" forcelimited="true"
 forcerange="-7 5"/></actuator></mujoco>"""
FREE = f"""<mujoco model="walker"><worldbody>
 <body name="trunk" pos="0 0 1" quat="0.5 0.1 0.2 0.6">
  <freejoint/>{INERTIAL}
 <body name="leg" pos="0.1 0.2 0"><joint name="hip" axis="0 1 0" pos="0 0 0.1"/>{INERTIAL}
  <body name="foot" pos="0 0 -0.5"><joint name="knee" axis="1 0 0"/>{INERTIAL}</body></body></body>
</worldbody></mujoco>"""


def written(folder: Path, text: str) -> Path:
    (folder / "arm.xml").write_text(text)
    return folder / "arm.xml"


def assert_agrees(file: Path, seed: int = 1, **options: object) -> stiffgen.core.robot.chain.Chain:
    chain = chain_between(describe(file), ChainOptions(**options))
    oracle = MujocoChain(file, chain.tip, chain.base, [c.name for c in chain.coordinates])
    assert disagreements(chain, oracle, np.random.default_rng(seed)) == {}
    assert [c.motor_inertia for c in chain.coordinates] == pytest.approx(oracle.motor_inertia, rel=1e-12)
    return chain


@pytest.mark.parametrize(("tip", "dof"), [("tool", 4), ("side", 4), ("left", 5), ("right", 5), ("thumb", 5)])
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_chain_agrees_with_mujoco(tmp_path, tip, dof):
    chain = assert_agrees(written(tmp_path, ARM), tip=tip)
    assert chain.dof == dof
    assert (chain.robot, chain.base) == ("arm", "world")


@pytest.mark.usefixtures("mjcf_in_this_process")
def test_limits_forces_and_motors(tmp_path):
    """Compare limits, efforts and rotor inertias with those of the model."""
    chain = assert_agrees(written(tmp_path, ARM), tip="tool")
    yaw, pitch, lift, roll = chain.coordinates
    assert (yaw.lower, yaw.upper, yaw.effort, yaw.type) == (*np.radians([-120, 150]), 60.0, "revolute")
    assert (pitch.type, pitch.upper, pitch.effort, lift.type) == ("continuous", np.inf, np.inf, "prismatic")
    assert (roll.effort, yaw.motor_inertia, roll.motor_inertia) == (5.0, 0.2, 0.05)
    (thumb,) = (c for c in chain_between(describe(tmp_path / "arm.xml"), ChainOptions(tip="thumb")).coordinates[4:])
    assert thumb.motor_inertia > 0.05  # its own, and those of the fingers that move with it


@pytest.mark.usefixtures("mjcf_in_this_process")
def test_a_free_root_is_a_floating_base(tmp_path):
    file = written(tmp_path, FREE)
    chain = chain_between(describe(file), ChainOptions(tip="foot"))
    assert (chain.floating, chain.base, [c.name for c in chain.coordinates]) == (True, "trunk", ["hip", "knee"])
    assert_agrees(written(tmp_path, FREE.replace("<freejoint/>", "")), tip="foot")


@pytest.mark.usefixtures("mjcf_in_this_process")
def test_ball_joint_on_the_chain_is_refused(tmp_path):
    with pytest.raises(StiffgenError, match="joint 'ball' between 'world' and 'pendulum' is ball"):
        stiffgen.load_chain(written(tmp_path, ARM), tip="pendulum")


@pytest.mark.slow
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_constraints_that_no_mimic_expresses(tmp_path):
    """Read constraints that are not linear or determine no joint: refused where they matter, held where constant."""
    file = written(tmp_path, ARM.replace("0.01 0.8 0 0 0", "0.01 0.8 0.5 0 0"))
    with pytest.raises(DescriptionError, match="'fingers' of right, left is not linear"):
        stiffgen.load_chain(file, tip="right")
    with pytest.warns(stiffgen.core.errors.DescriptionWarning, match="is not linear"):
        stiffgen.load_chain(file, tip="side", masses=False)
    again = '<joint name="again" joint1="left" joint2="right" polycoef="0 1 0 0 0"/></equality>'
    with pytest.raises(DescriptionError, match="'again' of left, right determines no joint that another constraint"):
        stiffgen.load_chain(written(tmp_path, ARM.replace("</equality>", again)), tip="right")
    held = ARM.replace('joint2="left" polycoef="0.01 0.8 0 0 0"', 'polycoef="0.03 0 0 0 0"')
    assert_agrees(written(tmp_path, held), tip="right")  # the constraint holds the finger at 0.03 m
    inactive = ARM.replace('name="fingers"', 'name="fingers" active="false"')
    assert assert_agrees(written(tmp_path, inactive), tip="right").dof == 5


@pytest.mark.parametrize("flag", ["equality", "constraint"])
@pytest.mark.usefixtures("mjcf_in_this_process")
def test_constraints_that_a_flag_disables(tmp_path, flag):
    """MuJoCo enforces none of them: the finger has a coordinate of its own, and no loop is closed."""
    loop = '<connect name="bar" body1="left" body2="palm" anchor="0 0 0"/></equality>'
    disabled = f'<option><flag {flag}="disable"/></option><equality>'
    file = written(tmp_path, ARM.replace("</equality>", loop).replace("<equality>", disabled))
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert (model.neq, data.ne) == (3, 0)
    description = describe(file)
    assert chain_between(description, ChainOptions(tip="right")).dof == 5
    assert description.loops == ()


def test_loops_are_named(tmp_path, capsys):
    """Read a model with loop constraints: a warning names them with their bodies."""
    loops = """<connect name="bar" body1="left" body2="palm" anchor="0 0 0"/><weld site1="tool" site2="side"/>
      <connect name="off" active="false" body1="left" body2="palm" anchor="0 0 0"/>"""
    file = written(tmp_path, ARM.replace("</equality>", f"{loops}</equality>"))
    with pytest.warns(stiffgen.errors.LoopWarning, match=r"2 constraints .*bar.*\(left, palm\), weld.*\(tool, side\)"):
        stiffgen.load_chain(file, tip="tool")
    assert main(["inspect", str(file)]) == 0
    assert "connect 'bar' (left, palm)" in capsys.readouterr().out


def test_the_controller_takes_the_armature(tmp_path):
    """Read rotor inertias (armature): the controller takes them before the maker's and before estimates."""
    chain = stiffgen.load_chain(written(tmp_path, ARM), tip="tool")
    motors = motor_tables(chain)
    assert (motors.motor_inertia, motors.inertia_source) == ((0.2, 0.05, 0.05, 0.05), "armature of the file")
    panda = replace(chain, robot="panda")
    assert motor_tables(panda).motor_inertia == (0.2, 0.05, 0.05, 0.05)  # the file's, before the maker's
    rest = [replace(c, motor_inertia=0.0, effort=50.0, velocity=2.0) for c in chain.coordinates[1:]]
    partly = motor_tables(replace(chain, coordinates=(chain.coordinates[0], *rest)))
    assert partly.motor_inertia == (0.2, 0.125, 0.125, 0.125)
    assert partly.inertia_source.startswith("armature of the file; where it is 0, estimate")


MESHES = """<mujoco><compiler meshdir="assets" angle="radian"/><asset><texture name="t" type="2d" file="no.png"/>
<material name="m" texture="t"/><mesh name="a" file="no.stl"/><hfield name="h" file="no.png" size="1 1 1 1"/></asset>
<worldbody><geom type="hfield" hfield="h"/><body name="link"><joint name="j"/>{}
<geom type="mesh" mesh="a" material="m"/>
<site name="tip" material="m"/></body></worldbody><sensor><touch site="tip"/></sensor></mujoco>"""


def test_missing_meshes_matter_only_for_inertias_from_them(tmp_path):
    chain = stiffgen.load_chain(written(tmp_path, MESHES.format(INERTIAL)))
    assert (chain.tip, chain.joints[0].body.mass) == ("tip", 1.5)
    file = written(tmp_path, MESHES.format(""))
    with pytest.raises(DescriptionError, match=r"link 'link': its inertia comes from the mesh 'no.stl'.*masses=False"):
        stiffgen.load_chain(file)
    assert stiffgen.load_chain(file, masses=False).dof == 1


def test_files_that_went_in_are_recorded(tmp_path):
    """Include a file: its path and digest are recorded, so that a change is noticed."""
    part = '<mujocoinclude><body name="link"><joint name="j"/><geom size="0.1"/></body></mujocoinclude>'
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "part.xml").write_text(part)
    text = '<mujoco><worldbody><include file="sub/part.xml"/></worldbody></mujoco>'
    chain = stiffgen.load_chain(written(tmp_path, text))
    assert [(each.file, each.digest) for each in chain.inputs] == [
        ("sub/part.xml", hashlib.sha256(part.encode()).hexdigest())
    ]
    assert chain.robot == "arm"  # the model has no name: the file's


def test_inspect_says_what_the_functions_leave_out(tmp_path, capsys):
    assert main(["inspect", str(written(tmp_path, ARM))]) == 0
    assert "joints have damping, which the functions do not contain" in capsys.readouterr().out


HOSTILE = {
    "not well formed": ("<mujoco><worldbody></mujoco>", "MuJoCo refuses it"),
    "unknown element": ("<mujoco><worldbody><bdy/></worldbody></mujoco>", "unrecognized element"),
    "missing include": ('<mujoco><include file="no.xml"/></mujoco>', "MuJoCo refuses it.*no.xml"),
    "include of a device": ('<mujoco><include file="/dev/zero"/></mujoco>', "."),
    "include of another file": ('<mujoco><include file="/etc/passwd"/></mujoco>', "MuJoCo refuses it"),
    "include of itself": ('<mujoco><include file="arm.xml"/></mujoco>', "MuJoCo refuses it"),
    "not a number": (ARM.replace("0 0 0.3", "nan 0 0.3"), "."),
    "huge number": (ARM.replace("0 0 0.3", "1e300 0 0.3"), "not finite or beyond 1e\\+12"),
    "infinite": (ARM.replace("0 0 0.3", "1e999 0 0.3"), "."),
    "no moving part": ("<mujoco><worldbody/></mujoco>", "no moving joint|has no"),
    "entities": ("<!DOCTYPE a [<!ENTITY a 'b'>]><mujoco>&a;</mujoco>", "DOCTYPE"),
    "deep": ("<mujoco><worldbody>" + "<body>" * 5000 + "</body>" * 5000 + "</worldbody></mujoco>", "."),
    "fragment": ("<mujocoinclude><body/></mujocoinclude>", "part of an MJCF file.*give the file that includes it"),
    "arguments": (ARM, "takes no arguments"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_sentence(tmp_path, capsys, name):
    """Read hostile models: exit code 2, one sentence, and no other file."""
    text, words = HOSTILE[name]
    before = {"arm.xml"}
    file = written(tmp_path, text)
    code = main(
        ["generate", str(file), "--no-build", "--output", str(tmp_path), *(["a:=1"] if name == "arguments" else [])]
    )
    error = " ".join(capsys.readouterr().err.split())
    assert code == 2, error
    assert re.search(words, error), error
    assert "root:" not in error and "Traceback" not in error
    assert {path.name for path in tmp_path.iterdir()} == before


def test_without_mujoco_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("stiffgen.files.confined.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[mjcf\]"):
        describe(written(tmp_path, ARM))
