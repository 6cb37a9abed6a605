# SPDX-License-Identifier: MIT
"""Forces of MJCF models against MuJoCo's own dynamics: efforts of actuators, and the forces that are left out."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from stiffgen import StiffnessModel, load_chain
from stiffgen.core.errors import OmissionWarning
from stiffgen.core.loading import describe

pytestmark = pytest.mark.usefixtures("mjcf_in_this_process")

BODY = '<inertial pos="0.2 0 0.01" mass="{}" diaginertia="0.01 0.02 0.02"/>'
MODEL = """<mujoco model="arm">{compiler}<compiler angle="radian"/>{option}<worldbody>
<site name="peg" pos="0.1 0.2 0.9"/>
<body name="b1" pos="0 0 0.3" {body}><joint name="j1" axis="0 1 0" range="-2 2" {joint}/>{one}
 <body name="b2" pos="0.3 0 0"><joint name="j2" axis="0 1 0.2" range="-1 2"/>{two}
  <body name="b3" pos="0.3 0 0"><joint name="j3" type="slide" axis="1 0 0" range="-1 1"/>{two}
   <site name="tool" pos="0.4 0 0"/></body></body></body></worldbody>
<tendon><fixed name="t" {tendon}><joint joint="j3" coef="2"/></fixed><fixed name="u"><joint joint="j1" coef="-3"/>
<joint joint="j2" coef="0.5"/></fixed>{spatial}</tendon><actuator>{actuator}</actuator></mujoco>"""


def model(folder: Path, **parts: str) -> Path:
    names = ("compiler", "option", "body", "joint", "tendon", "spatial", "actuator")
    text = MODEL.format(**dict.fromkeys(names, "") | parts, one=BODY.format(2), two=BODY.format(1))
    (folder / "arm.xml").write_text(text)
    return folder / "arm.xml"


ACTUATORS = {
    "asymmetric": '<motor joint="j1" gear="10" ctrlrange="-4 1"/>',
    "in the parent": '<motor jointinparent="j2" gear="5" ctrlrange="-2 2"/>',
    "in the parent, a slide": '<motor jointinparent="j3" gear="-4" ctrlrange="-3 1"/>',
    "in the parent, and not": '<motor jointinparent="j1" ctrlrange="-6 2"/><motor joint="j1" ctrlrange="-1 1"/>',
    "tendon": '<motor tendon="t" ctrlrange="-3 3"/>',
    "negative gear": '<motor joint="j1" gear="-10" ctrlrange="-4 1"/><motor joint="j3" gear="2" ctrlrange="-1 5"/>',
    "two on one joint": '<motor joint="j1" gear="3" ctrlrange="-4 2"/><motor joint="j1" ctrlrange="-1 6"/>',
    "tendon over two joints": '<motor tendon="u" gear="2" ctrlrange="-3 1"/><motor joint="j2" ctrlrange="-1 4"/>',
    "force and control": '<general joint="j2" gainprm="7" ctrlrange="-2 3" forcerange="-9 20" gear="-2"/>',
}
CLAMPS = {
    "joint": ({"joint": 'actuatorfrcrange="-7 30"'}, '<motor joint="j1" gear="10" ctrlrange="-4 1"/>'),
    "tendon": ({"tendon": 'actuatorfrcrange="-2 1.5"'}, '<motor tendon="t" ctrlrange="-3 3"/>'),
    "tendon, two": (
        {"tendon": 'actuatorfrcrange="-2 1.5"'},
        '<motor tendon="t" gear="2" ctrlrange="-1 1"/><motor tendon="t" gear="2" ctrlrange="-1 1"/>',
    ),
    "tendon, gear": ({"tendon": 'actuatorfrcrange="-2 1.5"'}, '<motor tendon="t" gear="3" ctrlrange="-3 3"/>'),
}
GROUPS = '<option actuatorgroupdisable="1 30"/>'
TWO = '<motor joint="j1" gear="3" ctrlrange="-4 2"/><motor joint="j1" ctrlrange="-1 6" group="{}"/>'
DISABLED = {f"group {group}": ({"option": GROUPS}, TWO.format(group)) for group in (1, 30, 31)}
PLAIN = {name: ({}, text) for name, text in ACTUATORS.items()}
CASES = {**PLAIN, **{f"clamp, {k}": v for k, v in CLAMPS.items()}, **DISABLED}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_effort_is_available_in_both_directions(name: str, tmp_path: Path) -> None:
    """Drive all corners of MuJoCo's controls: the effort limit is the largest that both directions reach."""
    parts, actuator = CASES[name]
    file = model(tmp_path, actuator=actuator, **parts)
    m = mujoco.MjModel.from_xml_path(str(file))
    d = mujoco.MjData(m)
    forces = []
    for corner in itertools.product((0, 1), repeat=m.nu):
        d.ctrl[:] = [m.actuator_ctrlrange[k][end] for k, end in enumerate(corner)]
        mujoco.mj_forward(m, d)
        forces.append(d.qfrc_actuator.copy())
    driven = np.abs(forces).max(axis=0) > 0
    efforts = np.array([c.effort for c in load_chain(file, tip="tool").coordinates])
    assert np.isinf(efforts[~driven]).all()
    expected = np.minimum(-np.min(forces, axis=0), np.max(forces, axis=0))[driven]
    assert efforts[driven] == pytest.approx(expected, rel=1e-12)


def test_actuators_that_push_one_way_only(tmp_path: Path) -> None:
    file = model(tmp_path, actuator='<motor joint="j1" ctrlrange="0 5"/>')
    assert math.isinf(load_chain(file, tip="tool").coordinates[0].effort)  # not stated: a limit of 0 would be no limit
    assert any("j1" in remark and "without force in one direction" in remark for remark in describe(file).remarks)


def test_inertias_that_actuators_reflect(tmp_path: Path) -> None:
    """Compare reflected rotor inertias with the change of MuJoCo's mass matrix."""
    file = model(tmp_path, actuator='<motor joint="j1" gear="10" armature="0.5"/>', joint='armature="0.25"')
    m = mujoco.MjModel.from_xml_path(str(file))
    d = mujoco.MjData(m)
    masses = []
    for scale in (1, 0):
        m.dof_armature[:] *= scale
        m.actuator_armature[:] *= scale
        mujoco.mj_forward(m, d)
        full = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, full)
        masses.append(full)
    reflected = np.diag(masses[0] - masses[1])
    assert [c.motor_inertia for c in load_chain(file, tip="tool").coordinates] == pytest.approx(reflected, abs=1e-12)


SPRING = 'stiffness="30" springlength="0.5"'
ROPE = '<spatial name="rope" {}><site site="peg"/><site site="tool"/></spatial>'
COMPENSATED = {"joint": 'actuatorgravcomp="true"', "actuator": '<motor joint="j1"/>'}
LEFT_OUT = {
    "gravcomp": ({"body": 'gravcomp="1"'}, "gravcomp"),
    "half gravcomp": ({"body": 'gravcomp="0.5"'}, "gravcomp"),
    "gravcomp above one": ({"body": 'gravcomp="1.5"'}, "gravcomp"),
    "actuatorgravcomp": ({"body": 'gravcomp="1"', **COMPENSATED}, "actuatorgravcomp"),
    "actuatorgravcomp, half": ({"body": 'gravcomp="0.5"', **COMPENSATED}, "actuatorgravcomp"),
    "actuatorgravcomp, spring": (
        {"body": 'gravcomp="1"', **COMPENSATED, "joint": 'actuatorgravcomp="true" stiffness="2"'},
        "actuatorgravcomp",
    ),
    "joint spring": ({"joint": 'stiffness="3" springref="0.4"'}, "a spring.*j1"),
    "joint damping": ({"joint": 'damping="3"'}, "damping.*j1"),
    "joint friction": ({"joint": 'frictionloss="3"'}, "dry friction.*j1"),
    "polynomial damping": ({"joint": 'damping="0 2"'}, "dof_dampingpoly.*j1"),
    "tendon spring": ({"tendon": SPRING}, "a spring.*: t"),
    "tendon damping": ({"tendon": 'damping="3"'}, "damping.*: t"),
    "tendon armature": ({"tendon": 'armature="3"'}, "armature.*: t"),
    "tendon spring, dead zone": ({"tendon": 'stiffness="9" springlength="0.1 0.2"'}, "a spring.*: t"),
    "rope spring": ({"spatial": ROPE.format(SPRING)}, "a spring.*: rope"),
    "tendon damping, little": ({"tendon": 'damping="0.01"'}, "damping.*: t"),
    "rope damping": ({"spatial": ROPE.format('damping="3"')}, "damping.*: rope"),
    "tendon armature, little": ({"tendon": 'armature="0.01"'}, "armature.*: t"),
    "rope armature": ({"spatial": ROPE.format('armature="0.5"')}, "armature.*: rope"),
    "actuator damping": ({"actuator": '<motor name="m" joint="j1" damping="2"/>'}, "actuator_damping.*: m"),
    "servo": ({"actuator": '<position name="m" joint="j1" kp="2"/>'}, "control law of their own.*: m"),
    "back EMF": (
        {"actuator": '<dcmotor name="m" joint="j1" motorconst="0.1" resistance="1"/>'},
        "control law of their own.*: m",
    ),
    "servo and damper": (
        {"actuator": '<position name="m" joint="j1"/><damper name="n" joint="j1" kv="3" ctrlrange="0 2"/>'},
        "2 actuators have a control law of their own.*: m, n",
    ),
    "no gravity": ({"option": '<option><flag gravity="disable"/></option>'}, r"the flag gravity \(disable\)"),
    "medium": ({"option": '<option density="1000" viscosity="2"/>'}, "density.*viscosity"),
    "wind": ({"option": '<option density="1.2" wind="9 0 0"/>'}, "wind"),
    "gravity": ({"option": '<option gravity="0 0 -1.62"/>'}, "gravity"),
}
AT_REST = {name for name in LEFT_OUT if "gravcomp" in name or "spring" in name or name == "wind"}


def needed(file: Path) -> list[np.ndarray]:
    """Return what motors must add at random states, the first at rest, by MuJoCo with the largest controls."""
    m = mujoco.MjModel.from_xml_path(str(file))
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    random, torques = np.random.default_rng(7), []
    for state in range(4):
        d = mujoco.MjData(m)
        d.qpos[:] = random.uniform(-0.5, 0.5, m.nq)
        d.qvel[:], d.qacc[:] = random.uniform(-1, 1, (2, m.nv)) if state else np.zeros((2, m.nv))
        d.ctrl[:] = m.actuator_ctrlrange[:, 1]
        mujoco.mj_inverse(m, d)
        mujoco.mj_fwdVelocity(m, d)
        mujoco.mj_fwdActuation(m, d)
        torques.append(d.qfrc_inverse - d.qfrc_actuator)
    return torques


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::stiffgen.core.errors.OmissionWarning")
@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_changes_the_dynamics_of_mujoco_is_named(name: str, tmp_path: Path) -> None:
    """Add springs, friction and the like: each changes MuJoCo's dynamics, and a remark names it."""
    parts, words = LEFT_OUT[name]
    plain = needed(model(tmp_path))
    file = model(tmp_path, **parts)
    changes = [float(np.abs(a - b).max()) for a, b in zip(needed(file), plain, strict=True)]
    assert max(changes) > 1e-6, "the case has no effect, so that it tests nothing"
    description = describe(file)
    assert any(re.search(words, remark) for remark in description.remarks), description.remarks
    if name != "gravity":  # of the world, no force of a joint
        assert bool(description.forces_at_rest) == (name in AT_REST)
    if name in AT_REST:
        with pytest.warns(OmissionWarning, match="push joints j.* at rest"):
            load_chain(file, tip="tool")


WITHOUT_EFFECT = {
    "nothing": {},
    "a flag of the solver": {"option": '<option><flag eulerdamp="disable" contact="disable"/></option>'},
    "solver": {"joint": 'solreflimit="0.01 1" solimplimit="0.8 0.9 0.01" margin="0.1" group="3"'},
    "step": {"option": '<option timestep="0.001" integrator="implicitfast" iterations="7" cone="elliptic"/>'},
    "gravity of a site": {"option": '<option gravity="0 0 -9.80665"/>'},
    "display": {"tendon": 'group="2"'},
    "no spring": {"tendon": 'springlength="0.5"'},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHOUT_EFFECT)
def test_settings_without_forces_are_not_named(name: str, tmp_path: Path) -> None:
    assert describe(model(tmp_path, **WITHOUT_EFFECT[name])).remarks == ()


WRAP = """<mujoco model="wrap"><compiler angle="radian" {compiler}/><asset><material name="red" rgba="1 0 0 1"/>
<texture name="no" type="2d" file="no.png"/><material name="no" texture="no"/></asset>
<worldbody><site name="s0" pos="0 0.1 0.5"/><body name="upper" pos="0 0 0.3"><joint name="j1" axis="0 1 0"/>
<inertial pos="0.2 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
<geom name="w" class="" type="sphere" size="0.03" pos="0.1 0 0" material="no"/><site name="side" pos="0.1 0 0.05"/>
<body name="lower" pos="0.4 0 0"><joint name="j2" axis="0 1 0"/>
<inertial pos="0.2 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
<body name="hand" pos="0.4 0 0"><inertial pos="0 0 0.02" mass="0.3" diaginertia="0.001 0.002 0.0025"/></body>
<site name="tool" pos="0.4 0 0"/></body></body></worldbody>
<tendon><spatial name="t" {tendon}><site site="s0"/><geom geom="w" {side}/><site site="tool"/></spatial></tendon>
{more}</mujoco>""".replace(' class=""', "")
NAMED = {
    "a geom that a tendon wraps": {},
    "a side site": {"side": 'sidesite="side"'},
    "the material of a tendon": {"tendon": 'material="no"'},
    "a muscle and a sensor": {
        "more": '<actuator><muscle tendon="t"/></actuator><sensor><tendonpos tendon="t"/></sensor>'
    },
    "an actuator that a sensor names": {
        "more": '<actuator><position name="m" tendon="t" kp="3"/></actuator>'
        '<sensor><actuatorfrc actuator="m"/></sensor>'
    },
    "a tuple and a key": {
        "more": '<actuator><muscle name="m" tendon="t"/></actuator><custom><tuple name="x"><element objtype="geom" '
        'objname="w" prm="1"/></tuple></custom><keyframe><key qpos="0 0" act="0.5"/></keyframe>'
    },
    "a body that a sensor keeps from fusion": {
        "compiler": 'fusestatic="true"', "more": '<sensor><framepos objtype="body" objname="hand"/></sensor>'
    },
    "a body that an excluded contact keeps from fusion": {
        "compiler": 'fusestatic="true"', "more": '<contact><exclude body1="hand" body2="upper"/></contact>'
    },
    "a body that is fused": {"compiler": 'fusestatic="true"'},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMED)
def test_no_part_is_removed_while_another_names_it(name: str, tmp_path: Path) -> None:
    """Read models whose parts name each other: masses and pose agree with MuJoCo's."""
    text = WRAP.format(**dict.fromkeys(("compiler", "tendon", "side", "more"), "") | NAMED[name])
    (tmp_path / "wrap.xml").write_text(text)
    m = mujoco.MjModel.from_xml_string(text.replace('<texture name="no" type="2d" file="no.png"/>', "").replace(
        ' texture="no"', ""))  # fmt: skip
    chain = load_chain(tmp_path / "wrap.xml", tip="hand")
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    masses = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, d, masses)
    ours = StiffnessModel(chain)
    assert np.array(ours.mass_matrix(np.zeros(2))) == pytest.approx(masses, rel=1e-12)
    assert np.array(ours.forward_kinematics(np.zeros(2)))[:3, 3] == pytest.approx([0.8, 0, 0.3], abs=1e-12)
