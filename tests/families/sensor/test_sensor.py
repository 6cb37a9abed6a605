# SPDX-License-Identifier: MIT
"""Kernels of a force-torque sensor against the oracles of verify, and against MuJoCo's sensor in motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import stiffgen
from stiffgen.core.errors import ChainError
from stiffgen.core.robot.chain import Chain
from stiffgen.core.symbolic.kernels import Kernel, chain_kernels
from stiffgen.core.symbolic.model import casadi_function, folded
from stiffgen.core.verify.kernels.missing import function_of_stacks
from stiffgen.core.verify.kernels.oracles import check_oracles, check_robot
from stiffgen.core.verify.kernels.samples import argument_samples
from stiffgen.families.derivatives.check import check_derivatives
from stiffgen.families.sensor.kernels import GROUP
from support.chains import ARM, chain_urdf
from support.exact_tree import tree_urdf
from support.project import ROOT

SENSOR = stiffgen.Sensor("l3", (0.01, -0.02, 0.04), (0.3, -0.5, 1.1))
TREE = replace(SENSOR, link="right", sign="robot", gravity=(1.5, -2.0, -9.0))
CASES = {
    "serial": (chain_urdf("rpr"), {"sensor": SENSOR}),
    "mimic, sign of the robot": (chain_urdf("rrm"), {"sensor": replace(SENSOR, sign="robot")}),
    "tool at run time": (chain_urdf("rpr"), {"sensor": SENSOR, "runtime_tool": True}),
    "second of two tips": (tree_urdf(7, 6), {"tip": ["left", "right"], "sensor": TREE}),
    "floating base": (tree_urdf(7, 6), {"tip": ["left", "right"], "floating_base": True, "sensor": TREE}),
}


def load(folder: Path, text: str, options: dict) -> Chain:
    file = folder / "robot.urdf"
    file.write_text(text)
    return stiffgen.load_chain(file, **options)


def kernels_of(chain: Chain) -> list[Kernel]:
    return [kernel for kernel in chain_kernels(chain) if kernel.group == GROUP]


def value(chain: Chain, kernel: Kernel, given: dict) -> np.ndarray:
    shaped = [np.reshape(given[a.name], folded(a.array(chain).shape) or (1,)) for a in kernel.arguments]
    return np.array(casadi_function(chain, kernel)(*shaped))


@pytest.mark.parametrize("case", CASES)
def test_oracles_of_verify(case, tmp_path):
    """Run the oracles of ``stiffgen verify`` and the gradients on chains of each kind."""
    chain = load(tmp_path, *CASES[case])
    options = stiffgen.KernelOptions(derivatives=True)
    table = [kernel for kernel in chain_kernels(chain, options) if kernel.group == GROUP]
    assert len(table) == 8
    functions = {kernel.qualified_name: function_of_stacks(chain, kernel) for kernel in table}
    checks = check_oracles(table) + check_robot(functions, chain, 3, 0, None, table)
    checks += check_derivatives(functions, tuple(table), chain, argument_samples(chain, 2, 0, options))
    assert len(checks) >= 9
    assert [check for check in checks if not check.passed] == []


def test_only_the_sensors_tip_has_the_group(tmp_path):
    chain = load(tmp_path, *CASES["second of two tips"])
    assert {kernel.tip.name for kernel in kernels_of(chain)} == {"right"}
    assert kernels_of(stiffgen.load_chain(ROOT / "urdf" / "iiwa14.urdf")) == []


def pose_of(chain: Chain) -> Kernel:
    return next(kernel for kernel in chain_kernels(chain) if kernel.name == "forward_kinematics")


def test_tool_fixed_at_generation(tmp_path):
    """Fix a tool: the sensor stays at its link while the tip moves to the tool."""
    tool = stiffgen.Tool(xyz=(0.1, 0.0, 0.2), rpy=(0.4, 0.0, 0.3))
    plain, tooled = (load(tmp_path, chain_urdf("rpr"), {"sensor": SENSOR, **more}) for more in ({}, {"tool": tool}))
    pool = argument_samples(plain, 1, 0)
    of_plain, of_tooled = (next(k for k in kernels_of(chain) if k.name == "tip_wrench") for chain in (plain, tooled))
    given = {argument.name: pool[argument][0] for argument in of_plain.arguments}
    here, there = value(plain, of_plain, given).ravel(), value(tooled, of_tooled, given).ravel()
    poses = [value(chain, pose_of(chain), given) for chain in (plain, tooled)]
    arm = poses[1][:3, 3] - poses[0][:3, 3]
    np.testing.assert_allclose(there, [*here[:3], *(here[3:] - np.cross(arm, here[:3]))], rtol=0, atol=1e-12)


ARM_WITH_SENSOR = """
<mujoco><compiler angle="radian" eulerseq="XYZ"/><option gravity="0 0 -9.81"><flag contact="disable"/></option>
<worldbody><body name="base">
 <body name="l1" pos="0.1 0 0.3" euler="0.2 0.1 0.4"><joint name="j1" axis="0 0 1"/>
  <geom type="box" size="0.05 0.05 0.1" mass="2"/>
  <body name="l2" pos="0 0.1 0.4" euler="0.5 0 0"><joint name="j2" axis="0 1 0"/>
   <geom type="box" size="0.05 0.04 0.1" mass="1.5"/>
   <body name="l3" pos="0.2 0 0.1"><joint name="j3" type="slide" axis="1 0 0"/>
    <geom type="box" size="0.03 0.04 0.1" mass="1"/>
    <body name="flange" pos="0 0 0.2" euler="0.1 0.7 -0.3"><joint name="j4" axis="0.6 0 0.8"/>
     <geom type="box" size="0.03 0.03 0.02" mass="0.5"/>
     <body name="tool" pos="0.01 0.02 0.05" euler="0 0 0.4">
      <inertial pos="0.03 -0.02 0.09" mass="1.3" fullinertia="0.01 0.012 0.008 0.001 -0.002 0.0015"/>
      <site name="sensor" pos="0.005 0 0.01" euler="0.3 -0.2 0.9"/>
      <body name="tip" pos="0.02 0.01 0.25" euler="0.2 0 1"><geom type="sphere" size="0.01" mass="0.2"/></body>
     </body>
    </body></body></body></body></body></worldbody>
<sensor><force site="sensor"/><torque site="sensor"/></sensor></mujoco>
"""


def test_mujoco_in_motion(tmp_path):
    """Compare with MuJoCo's sensor in motion: payload and a wrench at the tip, robot on the tool."""
    file = tmp_path / "arm.xml"
    file.write_text(ARM_WITH_SENSOR)
    model = mujoco.MjModel.from_xml_path(str(file))
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    sensor = stiffgen.Sensor("tool", (0.005, 0.0, 0.01), (0.3, -0.2, 0.9), "robot")
    chain = stiffgen.load_chain(file, tip="tip", sensor=sensor)
    kernel = next(k for k in kernels_of(chain) if k.name == "tip_wrench_dynamic")
    for _ in range(5):
        data.qpos[:], data.qvel[:] = random.uniform(-1, 1, 4), random.normal(size=4)
        data.qfrc_applied[:] = random.normal(size=4) * 20
        wrench, tip = random.normal(size=6) * [20, 20, 20, 3, 3, 3], model.body("tip").id
        mujoco.mj_kinematics(model, data)
        arm = data.xipos[tip] - data.xpos[tip]  # xfrc_applied acts at the centre of mass, the wrench at the tip
        data.xfrc_applied[tip] = [*wrench[:3], *(wrench[3:] - np.cross(arm, wrench[:3]))]
        mujoco.mj_forward(model, data)
        given = {
            "q": data.qpos, "velocity": data.qvel, "acceleration": data.qacc, "reading": data.sensordata,
            "bias": np.zeros(6), "payload": payload_of(model, data),
        }  # fmt: skip
        assert np.abs(data.qacc).max() > 1  # [rad/s^2] the inertia of the payload matters
        found = value(chain, kernel, given).ravel()
        np.testing.assert_allclose(found, wrench, rtol=0, atol=1e-6)


def payload_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the ten parameters of tool and tip in sensor axes, from MuJoCo's bodies in world axes."""
    R, origin = data.site("sensor").xmat.reshape(3, 3), data.site("sensor").xpos
    mass, moment, tensor = 0.0, np.zeros(3), np.zeros((3, 3))
    for name in ("tool", "tip"):
        k = model.body(name).id
        axes, arm, m = R.T @ data.ximat[k].reshape(3, 3), R.T @ (data.xipos[k] - origin), model.body_mass[k]
        mass, moment = mass + m, moment + m * arm
        tensor += axes @ np.diag(model.body_inertia[k]) @ axes.T + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return np.array([mass, *moment, *tensor[np.triu_indices(3)]])


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (stiffgen.Sensor("handy"), "link 'handy' does not exist; valid names: base, upper, lower, hand, finger"),
        (stiffgen.Sensor("base"), "is moved by no joint of the chain"),
        (stiffgen.Sensor("upper"), "a joint lies between the sensor=... link 'upper' and tip hand"),
        (stiffgen.Sensor("finger"), "joint 'grip' moves the sensor=... link 'finger'"),
        (stiffgen.Sensor("hand", sign="both"), r"sensor=Sensor\(sign=both\) is not one of environment, robot"),
        (stiffgen.Sensor("hand", xyz=(0.0, np.inf, 0.0)), r"sensor=Sensor\(xyz=...\) must be three finite numbers"),
        (stiffgen.Sensor("hand", rpy=(0.0, 0.0)), r"sensor=Sensor\(rpy=...\) must be three finite numbers"),
    ],
)
def test_refused(sensor, message, tmp_path):
    """Describe sensors that do not fit the chain: refused, and the link is named."""
    with pytest.raises(ChainError, match=message):
        load(tmp_path, ARM, {"tip": "hand", "sensor": sensor})


def test_a_locked_joint_carries_the_sensor(tmp_path):
    """A finger that is locked moves rigidly with the hand; its position counts."""
    sensor = stiffgen.Sensor("finger")
    chain = load(tmp_path, ARM, {"tip": "hand", "lock": {"grip": 0.03}, "sensor": sensor})
    np.testing.assert_allclose(chain.sensor.translation, [0.03, 0.05, 0.0], atol=1e-15)
