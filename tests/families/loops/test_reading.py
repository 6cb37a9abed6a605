# SPDX-License-Identifier: MIT
"""Loops of files and options: what is read, which equations and motors are chosen, and refusals."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from stiffgen import StiffnessModel, generate, load_chain
from stiffgen.core.errors import ChainError, LoopWarning
from stiffgen.core.symbolic.choices import KernelOptions
from stiffgen.core.symbolic.kernels import chain_kernels
from stiffgen.core.symbolic.model import casadi_function
from stiffgen.core.verify.folder.files import check_urdf

pytestmark = pytest.mark.usefixtures("mjcf_in_this_process")

LOOP = "coupler:0.35,0,0=rocker:0.25,0,0"


def bar(name: str, parent: str, xyz: str, axis: str = "0 0 1", kind: str = "revolute", limit: float = 3) -> str:
    return (
        f'<link name="{name}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/>'
        f'<limit lower="-{limit}" upper="{limit}" effort="9" velocity="1"/></joint>'
    )


CRANK, COUPLER = bar("crank", "ground", "0 0 0"), bar("coupler", "crank", "0.15 0 0")
ROCKER = bar("rocker", "ground", "0.3 0 0")
MASS = '><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
_SIDE = math.acos((0.5**2 + 0.3**2 - 0.25**2) / (2 * 0.5 * 0.3))  # triangle of ground, crank with coupler, and rocker
DEAD = (_SIDE, 0.0, math.atan2(0.5 * math.sin(_SIDE), 0.5 * math.cos(_SIDE) - 0.3))
"""Dead centre of the four-bar with the rocker as motor: crank and coupler in line."""


def loaded(folder: Path, *bars: str, **options):
    file = folder / "bars.urdf"
    file.write_text(f'<robot name="bars"><link name="ground"/>{"".join(bars)}</robot>')
    return load_chain(file, **{"tip": "coupler", "masses": False} | options)


def test_a_planar_loop_has_two_equations(tmp_path):
    """Read a four-bar linkage: two equations, one motor, and a start that closes the loop."""
    chain = loaded(tmp_path, CRANK, COUPLER, ROCKER, loop=[LOOP], actuated=["crank"])
    assert [each.name for each in chain.coordinates] == ["crank", "coupler", "rocker"]
    assert chain.actuated == (0,)
    (loop,) = chain.loops
    assert loop.rows == (0, 1)
    model = StiffnessModel(chain, kernels="close")
    q = np.array(model.close(chain.start[0], chain.start)).ravel()
    first = 0.15 * np.exp(1j * q[0]) + 0.35 * np.exp(1j * (q[0] + q[1]))
    assert abs(first - 0.3 - 0.25 * np.exp(1j * q[2])) < 1e-12


@pytest.mark.parametrize("masses", [True, False])
def test_vectors_of_joints_have_room_for_every_coordinate(masses, tmp_path):
    """Print posture and limits of a loop: vectors sized by joints have room for all coordinates."""
    bars = [bar.replace("/><joint", MASS + "<joint") for bar in (CRANK, COUPLER, ROCKER)]
    chain = loaded(tmp_path, *bars, loop=[LOOP], actuated=["crank"], masses=masses)
    of_coordinates = [k for k in chain_kernels(chain) if "posture" in k.qualified_name or "limits" in k.qualified_name]
    assert len(of_coordinates) == 10
    assert all(len(kernel.scope(chain).joints) >= chain.dof for kernel in of_coordinates)


def test_at_a_dead_centre_nothing_is_a_number(tmp_path):
    """Align crank and coupler, the rocker as motor: no finite leverage, so NaN."""
    chain = loaded(tmp_path, CRANK, COUPLER, ROCKER, loop=[LOOP], actuated=["rocker"])
    names = ("residual", "joint_stiffness", "jacobian", "condition")
    model = StiffnessModel(chain, kernels=[f"motors.{name}" for name in names])
    dead = np.array(DEAD)
    assert np.abs(np.array(model.motors.residual(dead))).max() < 1e-15
    load = dead, np.ones(6), np.eye(6)
    assert np.isnan(np.array(model.motors.joint_stiffness(*load))).all()
    for away, is_singular in ((0.0, True), (1e-10, True), (1e-8, False), (1e-3, False)):
        q = np.add(dead, [0, away, 0])
        motion, condition = np.array(model.motors.jacobian(q)).ravel(), float(model.motors.condition(q))
        assert np.isnan(motion).tolist() == [is_singular, is_singular, False]
        assert np.isnan(condition) == is_singular
        assert is_singular or np.abs(motion[:2]).max() < condition < 10 * np.abs(motion[:2]).max()


def test_a_passive_joint_without_leverage_is_near_a_singularity(tmp_path):
    """Fold crank and coupler: near a singularity, which columns of length 1 would hide."""
    chain = loaded(tmp_path, CRANK, COUPLER, ROCKER, loop=["coupler:0.15,0,0=rocker:0.3,0,0"], actuated=["coupler"])
    model = StiffnessModel(chain, kernels=("motors.residual", "motors.condition"))
    for fold in (1e-2, 1e-5):
        coupler = np.pi - fold
        along = np.arccos(np.cos(coupler / 2) / 2)  # direction from the crank's axis to the point
        crank = along - coupler / 2
        point = 0.15 * np.exp(1j * crank) + 0.15 * np.exp(1j * (crank + coupler))
        q = np.array([crank, coupler, np.angle(point - 0.3)])
        assert np.abs(np.array(model.motors.residual(q))).max() < 1e-15
        columns = 1j * np.array([point, 0.15 * np.exp(1j * (crank + coupler)), -(point - 0.3)])
        C = np.array([columns.real, columns.imag])
        expected = np.linalg.norm(C) * np.linalg.norm(np.linalg.inv(C[:, [0, 2]])) - 1
        assert abs(float(model.motors.condition(q)) / expected - 1) < 1e-9
        assert expected > 1 / fold


def test_one_unit_of_length(tmp_path):
    """Scale a slider-crank tenfold: the condition number stays."""
    conditions = []
    for size in (0.1, 1.0):
        crank, rod = bar("crank", "ground", "0 0 0"), bar("rod", "crank", f"{0.2 * size} 0 0")
        piston = bar("piston", "ground", "0 0 0", axis="1 0 0", kind="prismatic", limit=3 * size)
        chain = loaded(
            tmp_path, crank, rod, piston, loop=[f"rod:{0.5 * size},0,0=piston:0,0,0"], actuated=["crank"], tip="rod"
        )
        model = StiffnessModel(chain, kernels=("close", "motors.condition"))
        q = np.array(model.close(0.7, chain.start)).ravel()
        conditions.append(float(model.motors.condition(q)))
    assert 1 < conditions[0] < 20
    assert abs(conditions[1] / conditions[0] - 1) < 1e-12


WELD = """<mujoco><compiler angle="radian"/><worldbody>
<body name="crank"><joint name="crank" axis="0 0 1"/><geom size="0.01"/>
 <body name="coupler" pos="0.15 0 0"><joint name="coupler" axis="0 0 1"/><geom size="0.01"/>
  <body name="end" pos="0.15 0 0"><joint name="end" axis="0 0 1"/><geom size="0.01"/>
   <site name="a"/></body></body></body>
<body name="rocker" pos="0.3 0 0"><joint name="rocker" axis="0 0 1"/><geom size="0.01"/>
 <site name="b" pos="0.25 0 0"/></body></worldbody>
<equality><weld site1="a" site2="b"/></equality><actuator><motor joint="crank"/></actuator></mujoco>"""


def test_a_welded_loop_is_singular_where_its_passive_joints_are_in_line(tmp_path):
    """Compare the condition number with complex numbers; frames a half turn apart are not closed."""
    file = tmp_path / "weld.xml"
    file.write_text(WELD)
    chain = load_chain(file, tip="end", close_loops=True, masses=False)
    assert [each.name for each in chain.coordinates] == ["crank", "coupler", "end", "rocker"]
    model = StiffnessModel(chain, kernels=("close", "motors.residual", "motors.jacobian", "motors.condition"))
    # angle of the crank that has coupler and rocker in line: a triangle of sides 0.15, 0.3 and 0.15 + 0.25
    straight = math.acos((0.15**2 + 0.3**2 - 0.4**2) / (2 * 0.15 * 0.3))
    for away, is_singular in ((0.0, True), (1e-3, False)):
        elbow = 0.15 * np.exp(1j * (straight - away))
        to_ground = 0.3 - elbow
        bend = math.acos((abs(to_ground) ** 2 + 0.15**2 - 0.25**2) / (0.3 * abs(to_ground))) if away else 0.0
        direction = np.angle(to_ground) + bend
        point = elbow + 0.15 * np.exp(1j * direction)
        rocker = np.angle(point - 0.3)
        q = np.array([straight - away, direction - (straight - away), rocker - direction, rocker])
        assert np.abs(np.array(model.motors.residual(q))).max() < 1e-15
        assert np.isnan(np.array(model.motors.jacobian(q))).any() == is_singular
        # velocity of the weld's gap at unit rates of crank, coupler, end (none) and rocker
        levers = 1j * np.array([point, point - elbow, 0, 0.3 - point])
        levers /= np.sqrt(np.mean(np.abs(levers[[0, 1, 3]]) ** 2))  # lengths in units of their mean, beside angles
        C = np.array([levers.real, levers.imag, [1, 1, 1, -1]])
        expected = np.linalg.norm(C) * np.linalg.norm(np.linalg.inv(C[:, 1:])) - 2
        if not is_singular:
            assert abs(float(model.motors.condition(q)) / expected - 1) < 1e-9
    q = np.array(model.close(chain.start[0], chain.start)).ravel()
    assert np.isfinite(q).all()
    assert np.isnan(np.array(model.close(q[0], np.add(q, [0, 0, np.pi, 0])))).all()


@pytest.mark.parametrize("block", ["", "2"])
def test_the_condition_is_that_of_the_worst_block(block, tmp_path):
    """Combine two loops: the condition is that of the worse one, also where it is NaN."""
    second = bar("crank2", "coupler", "0.2 0.1 0"), bar("coupler2", "crank2", "0.15 0 0")
    links = CRANK, COUPLER, ROCKER, *second, bar("rocker2", "coupler", "0.5 0.1 0")
    loops = [LOOP, "coupler2:0.35,0,0=rocker2:0.25,0,0"]
    chain = loaded(tmp_path, *links, loop=loops, actuated=["rocker", "rocker2"], tip="coupler2")
    condition = StiffnessModel(chain, kernels="motors.condition").motors.condition
    place = dict(zip([each.name for each in chain.coordinates], chain.start, strict=True))
    assert 1 < float(condition(list(place.values()))) < 100
    place |= {f"crank{block}": DEAD[0], f"coupler{block}": 1e-3, f"rocker{block}": DEAD[2]}
    alone = loaded(tmp_path, CRANK, COUPLER, ROCKER, loop=[LOOP], actuated=["rocker"])
    worst = float(StiffnessModel(alone, kernels="motors.condition").motors.condition(np.add(DEAD, [0, 1e-3, 0])))
    assert abs(float(condition(list(place.values()))) / worst - 1) < 1e-9
    place[f"coupler{block}"] = 0.0
    assert np.isnan(float(condition(list(place.values()))))


def test_where_loops_do_not_close_no_motor_has_a_gradient(tmp_path):
    """Differentiate the closure at motors that close and do not: all finite, or none, motors outside of the loops
    included.
    """
    links = CRANK, COUPLER, ROCKER, bar("tool", "coupler", "0.1 0 0")
    chain = loaded(tmp_path, *links, loop=["coupler:0.2,0,0=rocker:0.1,0,0"], actuated=["rocker"], tip="tool")
    kernels = chain_kernels(chain, KernelOptions(derivatives=True))
    close, gradient = (casadi_function(chain, k) for k in kernels if k.qualified_name in ("close", "close_vjp"))
    outside = [chain.coordinates[k].name for k in chain.actuated].index("tool")
    near, far = np.array(chain.start)[list(chain.actuated)], np.zeros(2)
    for motors, is_closed in ((near, True), (far, False)):
        assert np.isfinite(np.array(close(motors, chain.start))).all() == is_closed
        found = np.array(gradient(motors, chain.start, np.arange(1.0, 5.0))[0]).ravel()
        assert np.isfinite(found).all() == np.isfinite(found).any() == is_closed
        assert not is_closed or found[outside] == 1 + [each.name for each in chain.coordinates].index("tool")


def test_positions_out_of_reach_are_not_numbers(tmp_path):
    chain = loaded(tmp_path, CRANK, COUPLER, ROCKER, loop=["coupler:0.2,0,0=rocker:0.1,0,0"], actuated=["rocker"])
    close = StiffnessModel(chain, kernels="close").close
    assert np.isnan(np.array(close(0.0, chain.start))).all()  # 0.4 m from the crank's axis


REFUSALS = {
    "is not LINK:X,Y,Z=LINK:X,Y,Z": {"loop": ["coupler:0,0=rocker:0,0,0"]},
    "does not exist": {"loop": ["copler:0,0,0=rocker:0,0,0"]},
    "joint '.*' of a closed loop is passive but free": {"extra": bar("knee", "rocker", "0.1 0 0")},
    "motor '.*' cannot move by itself": {"actuated": ["crank", "coupler"]},
    "does not close: its ends stay 0.2": {"loop": ["coupler:0.35,0,0=rocker:0.25,0,0.2"]},
    "actuated=... crnk: is no joint of a closed loop; these are: crank, coupler, rocker": {"actuated": ["crnk"]},
    "no joint of the closed loops has a motor": {"actuated": []},
    "has no constraints that close loops": {"loop": [], "close_loops": True},
    "actuated=... names the motors of closed loops, and none is closed": {"loop": []},
    "has no moving joint": {"loop": ["ground:0,0,0=ground:1,0,0"]},
    "starts at 'ground', before base 'crank'; use base='ground', or leave the loop out": {"base": "crank"},
}


@pytest.mark.parametrize("message", REFUSALS)
def test_refused(message, tmp_path):
    """Describe loops that cannot be closed or driven: refused with the reason."""
    options = {"loop": [LOOP], "actuated": ["crank"]} | REFUSALS[message]
    bars = [CRANK, COUPLER, ROCKER, options.pop("extra", "")]
    if bars[3]:
        options["loop"] = ["coupler:0.35,0,0=knee:0.15,0,0"]
    with pytest.raises(ChainError, match=message):
        loaded(tmp_path, *bars, **options)


@pytest.mark.parametrize("masses", [True, False])
@pytest.mark.parametrize(
    ("mount", "base", "place"),
    [
        ("ground", "arm", "'ground', before"),
        ("mount", "arm", "'mount', which is not beyond"),
        ("hand", "end", "'hand', before"),
    ],
)
def test_a_loop_beside_the_base_is_refused_with_a_base_that_works(mount, base, place, masses, tmp_path):
    """On a branch without the base, no joint of the loop is a mimic joint, and none has to have a mass."""
    frames = [bar("arm", "ground", "0 0 0.5"), bar("hand", "arm", "0.2 0 0"), bar("end", "hand", "0.2 0 0")]
    frames += [bar("tip", "end", "0.1 0 0"), bar("mount", "ground", "0 0 0", kind="fixed")]
    loop = [each.replace('parent link="ground"', f'parent link="{mount}"') for each in (CRANK, COUPLER, ROCKER)]
    bars = [each.replace("/><joint", MASS + "<joint") for each in (*frames, *loop)]
    options = {"tip": "tip", "loop": [LOOP], "actuated": ["crank"], "masses": masses}
    with pytest.raises(ChainError, match=rf"loop coupler:.* starts at {place} base '{base}'; use base=") as refusal:
        loaded(tmp_path, *bars, base=base, **options)
    (remedy,) = re.findall(r"base='(\w+)', or leave the loop out$", str(refusal.value))
    assert "mimic" not in str(refusal.value) and len(loaded(tmp_path, *bars, base=remedy, **options).loops) == 1


def test_floats_do_not_go_with_loops(tmp_path):
    file = tmp_path / "bars.urdf"
    loaded(tmp_path, CRANK, COUPLER, ROCKER)
    with pytest.raises(ChainError, match="closed loops"):
        generate(file, tip="coupler", masses=False, loop=[LOOP], actuated="crank", output=tmp_path, scalar="float")


def test_a_ball_joint_in_a_loop_is_refused(tmp_path):
    pytest.importorskip("mujoco")
    file = four_bar(tmp_path, MJCF.replace('name="rocker" axis="0 0 1"', 'name="rocker" type="ball"'))
    with pytest.raises(ChainError, match=r"joint 'rocker' is ball, .* replace it by hinges"):
        load_chain(file, tip="coupler", close_loops=True)


MJCF = """<mujoco><compiler angle="radian"/><worldbody>
<body name="crank"><joint name="crank" axis="0 0 1"/><inertial pos="0.1 0 0" mass="1" diaginertia=".1 .1 .1"/>
 <body name="coupler" pos="0.15 0 0"><joint name="coupler" axis="0 0 1" ref="0.2"/>
  <inertial pos="0.1 0 0" mass="1" diaginertia=".1 .1 .1"/>
  <site name="end" pos="0.2 0.1 0" euler="0 0 0.7"/></body></body>
<body name="rocker" pos="0.3 0 0" euler="0 0 1"><joint name="rocker" axis="0 0 1"/>
 <inertial pos="0.1 0 0" mass="1" diaginertia=".1 .1 .1"/>
 <body name="pin" pos="0.2 0 0"><joint name="pin" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
 <site name="other" pos="0.01 0.02 0" euler="0 0 0.3"/></body></body>
</worldbody><equality>EQUALITY</equality><actuator><motor joint="crank"/></actuator></mujoco>"""
EQUALITIES = {
    "connect": ('<connect name="c" body1="coupler" body2="pin" anchor="0.1 0.05 0"/>', (0, 1)),
    "weld": ('<weld body1="coupler" body2="pin" anchor="0.02 0.01 0" relpose="0.2 0.1 0 1 0 0 0.1"/>', (0, 1, 5)),
    "weld of sites": ('<weld site1="end" site2="other"/>', (0, 1, 5)),
    "connect of sites": ('<connect site1="end" site2="other"/>', (0, 1)),
}


def four_bar(folder: Path, text: str = MJCF, equality: str = EQUALITIES["weld"][0]) -> Path:
    file = folder / "bars.xml"
    file.write_text(text.replace("EQUALITY", equality))
    return file


@pytest.mark.parametrize("kind", EQUALITIES)
def test_constraints_of_mujoco(kind, tmp_path):
    """Closed configurations fulfil MuJoCo's own constraint; the pin is a motor where a point leaves it free."""
    mujoco = pytest.importorskip("mujoco")
    equality, rows = EQUALITIES[kind]
    file = four_bar(tmp_path, equality=equality)
    actuated = ["crank", "pin"] if kind.startswith("connect") else []
    chain = load_chain(file, tip="coupler", close_loops=True, actuated=actuated)
    assert chain.loops[0].rows == rows
    assert [chain.coordinates[k].name for k in chain.actuated] == (actuated or ["crank"])
    close = StiffnessModel(chain, kernels="close").close
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    names = [each.name for each in chain.coordinates]
    for away in (-0.1, 0.0, 0.1):
        start = np.array(chain.start)
        q = np.array(close(start[list(chain.actuated)] + away, start)).ravel()
        for k in range(model.njnt):
            data.qpos[model.jnt_qposadr[k]] = q[names.index(model.joint(k).name)]
        mujoco.mj_forward(model, data)
        equations = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        assert len(equations) and np.abs(equations).max() < 1e-9


def test_without_the_option_loops_stay_open(tmp_path):
    pytest.importorskip("mujoco")
    with pytest.warns(LoopWarning, match=r"--close-loops \(in Python close_loops=True\) closes them"):
        chain = load_chain(four_bar(tmp_path), tip="coupler")
    assert chain.loops == () and [each.name for each in chain.coordinates] == ["crank", "coupler"]


def test_each_option_closes_its_own_loops(tmp_path):
    """--loop closes no loop of the file, and --actuated closes none; verify reads the file with the same options."""
    pytest.importorskip("mujoco")
    file, own = four_bar(tmp_path, equality=EQUALITIES["connect"][0]), "coupler:0.2,0.1,0=pin:0.01,0.02,0"
    motors = {"tip": "coupler", "actuated": ["crank", "pin"]}
    with pytest.warns(LoopWarning, match="1 constraint that closes a loop is left out"):
        chain = load_chain(file, loop=[own], **motors)
    assert [loop.option for loop in chain.loops] == [own]
    with pytest.warns(LoopWarning):
        assert check_urdf(chain, file).passed
    with pytest.raises(ChainError, match="add close_loops=True"):
        load_chain(file, **motors)
    chain = load_chain(file, close_loops=True, **motors)
    assert [loop.option for loop in chain.loops] == [""] and check_urdf(chain, file).passed
