# SPDX-License-Identifier: MIT
"""Presets of laws: what is refused by name, and shapes with several tips; test_laws.py has their numbers."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

import stiffgen
from stiffgen.core.opened import open_robot
from support.controller_inputs import Q
from support.project import ROOT, Once


@pytest.fixture(scope="module")
def two_arms(once: Once) -> ModuleType:
    urdf, options = ROOT / "tests" / "data" / "dual_arm.urdf", {"kernels": ("spring.energy",), "name": "arms"}
    tips = ["left hand", "right-hand"]
    folder = once("two arms", lambda output: stiffgen.generate(urdf, tip=tips, output=output, **options))
    return open_robot(folder / "arms").module


def test_names_without_a_preset_are_refused(robot: ModuleType) -> None:
    with pytest.raises(ValueError, match=r'no preset "droit"; there are: crisp, droid, droid_400, serl'):
        robot.Impedance.preset("droit")
    for name in ("robosuite", "isaac_lab", "newton"):
        with pytest.raises(ValueError, match=rf'preset "{name}": its stiffness is a gain times the inertia'):
            robot.Impedance.preset(name)
    with pytest.raises(ValueError, match="generate it with --spring bounded"):
        robot.Impedance.preset("serl")


def test_fields_that_are_passed_replace_those_of_the_preset(robot: ModuleType) -> None:
    controller, _ = robot.Impedance.preset("droid", config={"damping_ratio": 0.9}, heaviest_wrench=[30, 5], record=2)
    assert set(controller.config.damping_ratio) == {0.9}
    assert controller.config.posture_stiffness[3] == 25
    assert controller.config.heaviest_wrench[1] == 5
    assert robot.Impedance.preset("droid", posture_stiffness=3)[0].config.posture_stiffness[0] == 3
    with pytest.raises(TypeError, match="no configuration field 'damping'"):
        robot.Impedance.preset("droid", damping=1)


def test_the_port_takes_what_a_preset_returns(robot: ModuleType) -> None:
    """The stiffness is in force after the proposals' interval."""
    controller, springs = robot.Impedance.preset("droid")
    pose = robot.forward_kinematics(Q)
    port = robot.Policy(controller, pose=pose, now=0.0)
    for k in range(400):
        if k % 60 == 0:
            assert not port.propose(now=k / 1e3, time=k / 1e3, equilibrium=pose, **springs)
        out = controller.step(q=Q, dq=np.zeros(7), posture=Q, **port.command(k / 1e3))
    assert out.translation_stiffness == pytest.approx(750 * np.eye(3))
    assert out.rotation_stiffness == pytest.approx(15 * np.eye(3))


def test_other_numbers_of_joints_and_tips(two_arms: ModuleType) -> None:
    """Seven numbers fit no other arm; one number for all joints does, and every tip has the springs."""
    n, limits = two_arms.DOF, {"effort_limit": 100.0, "velocity_limit": 2.0, "reference_velocity_limit": 1.0}
    limits["torque_rate_limit"] = 1e6
    with pytest.raises(ValueError, match=rf"that of 7 joints, and arms has {n}; pass posture_stiffness= with {n}"):
        two_arms.Impedance.preset("droid", motor_inertia=0.3, **limits)
    controller, springs = two_arms.Impedance.preset("crisp", motor_inertia=0.3, **limits)
    assert {each.shape for each in springs.values()} == {(2, 3, 3)}
    assert controller.config.posture_stiffness == pytest.approx(np.ones(n))
    controller.step(q=np.zeros(n), dq=np.zeros(n), q0=np.zeros(n), **springs)
