# SPDX-License-Identifier: MIT
"""Compare the part controller of robosuite with MuJoCo: frames, units, torque order, bias forces counted once."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from examples.robosuite import tables
from oracle.examples import robosuite_stub
from support.project import ROOT

pytestmark = pytest.mark.slow

AXES = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 -1 0", "0 0 1")
LENGTHS = (0.3, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1)  # m
Q = np.array([0.3, 0.5, -0.2, -1.6, 0.4, 1.2, 0.5])  # rad
NAMES = [f"robot0_joint{k}" for k in (2, 1, 3, 4, 7, 6, 5)]  # order of robosuite's arm: not the chain's
KP = (300.0, 500.0, 700.0, 30.0, 40.0, 50.0)  # N/m, N m/rad, in the base's axes
LIMIT = 87.0  # N m


def inertial(mass: float, place: str, inertia: float) -> str:
    """Return an inertial element."""
    return f'<inertial mass="{mass}" pos="{place}" diaginertia="{inertia} {inertia} {inertia}"/>'


def arm() -> str:
    """Return the MJCF of an arm on a rotated base, with a gripper whose fingers have springs."""
    body = (
        inertial(0.7, "0 0.01 0.03", 0.002) + '<site name="gripper0_right_grip_site" pos="0 0.01 0.1" euler="0 0.3 0"/>'
    )
    for side in (-1, 1):
        joint = f'<joint name="finger{side}" type="slide" axis="0 1 0" stiffness="1e5" damping="200"/>'
        body += f'<body name="finger{side}" pos="0 {0.01 * side} 0.05">{joint}{inertial(0.05, "0 0 0", 1e-5)}</body>'
    body = f'<body name="gripper0_hand" pos="0 0 0.1" euler="0.2 0 0.8">{body}</body>'
    motors = ""
    for k in range(7, 0, -1):
        name = f"robot0_joint{k}"
        limits = 'range="-2.9 2.9"' if k < 7 else 'limited="false"'  # the last joint turns without end
        joint = f'<joint name="{name}" axis="{AXES[k - 1]}" {limits} armature="{0.8 / k:.3f}"/>'
        content = joint + inertial(4 - 0.4 * k, "0.01 0 0.08", 0.02) + body
        body = f'<body name="robot0_link{k}" pos="0 0 {LENGTHS[k - 1]}">{content}</body>'
        motors += f'<motor name="torq_j{k}" joint="{name}" ctrllimited="true" ctrlrange="-{LIMIT} {LIMIT}"/>'
    center = '<site name="robot0_right_center" pos="0.02 0 0.05" euler="0 0 0.5"/>'
    link = f'<body name="robot0_link0" pos="0 0 0.1">{inertial(4, "0 0 0.05", 0.4)}{center}{body}</body>'
    base = f'<body name="robot0_base" pos="-0.5 0.2 0.9" euler="0.1 -0.15 1.2">{link}</body>'
    return (
        '<mujoco model="arm"><compiler angle="radian"/><option timestep="0.002"/>'
        f"<worldbody>{base}</worldbody><actuator>{motors}</actuator></mujoco>"
    )


@pytest.fixture(scope="module")
def register(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STIFFGEN_CACHE", str(tmp_path_factory.mktemp("cache")))
        register = robosuite_stub.install(patch)
        patch.delitem(sys.modules, "examples.robosuite.controller", raising=False)
        import examples.robosuite.controller  # noqa: F401  registers itself

        yield register
        sys.modules.pop("examples.robosuite.controller")


class Run:
    """Arm in MuJoCo, driven by the part controller as robosuite drives it."""

    def __init__(self, register: dict[str, Any], frame: str = "world", **fields: Any) -> None:
        self.sim = robosuite_stub.Simulation(arm())
        indexes = self.sim.joints(NAMES)
        self.columns = indexes["qvel"]
        self.motors = [self.sim.plain.actuator(name.replace("robot0_joint", "torq_j")).id for name in NAMES]
        self.sim.data.qpos[self.sim.joints([f"robot0_joint{k}" for k in range(1, 8)])["qpos"]] = Q
        mujoco.mj_forward(self.sim.plain, self.sim.data)
        efforts = np.full(7, LIMIT)
        config = {"type": "STIFFGEN_IMPEDANCE", "sim": self.sim, "ref_name": "gripper0_right_grip_site",
                  "robot_name": "Arm", "joint_indexes": indexes, "actuator_range": (-efforts, efforts),
                  "part_name": "right", "naming_prefix": "robot0_", "input_ref_frame": frame, "kp": KP,
                  "impedance": {"velocity_limit": np.full(7, 2.5)}} | fields  # fmt: skip
        model = SimpleNamespace(get_xml=arm)
        parts = register["STIFFGEN"](model, {"right": config, "right_gripper": {"type": "GRIP"}}).part_controllers
        assert parts["right_gripper"] == "GRIP"
        self.part = parts["right"]
        self.part.reset_goal()
        self.site = self.sim.data.site("gripper0_right_grip_site")
        self.center = self.sim.data.site("robot0_right_center")

    def steps(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.002)):
            self.part.update_origin(self.center.xpos, self.center.xmat.reshape(3, 3))
            self.sim.data.ctrl[self.motors] = self.part.run_controller()
            assert not self.part.output.fault, self.part.output.reason
            mujoco.mj_step(self.sim.plain, self.sim.data)
            mujoco.mj_forward(self.sim.plain, self.sim.data)


def test_masses_of_arm_and_gripper(register: dict[str, Any]) -> None:
    run = Run(register)
    part, mass = run.part, np.zeros((run.sim.plain.nv, run.sim.plain.nv))
    mujoco.mj_fullM(run.sim.plain, run.sim.data, mass)
    columns = np.asarray(run.columns)[part.order]
    own = part.module.mass_matrix(Q) + np.diag(part.settings["motor_inertia"])
    np.testing.assert_allclose(own, mass[np.ix_(columns, columns)], rtol=0, atol=1e-12)


def test_the_arm_neither_sinks_nor_rises(register: dict[str, Any]) -> None:
    run = Run(register)
    first = run.site.xpos.copy()
    run.steps(0.3)
    assert np.abs(run.site.xpos - first).max() < 1e-5


@pytest.mark.parametrize("frame", ["world", "base"])
def test_the_tip_reaches_its_goal(register: dict[str, Any], frame: str) -> None:
    run = Run(register, frame)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0]))  # 0.2 rad about the world's x
    position = run.site.xpos + np.array([0.05, -0.03, 0.04])
    rotation = turn.reshape(3, 3) @ run.site.xmat.reshape(3, 3)
    run.part.goal_pos, run.part.goal_ori = position, rotation
    if frame == "base":
        origin = run.center.xmat.reshape(3, 3)
        run.part.goal_pos, run.part.goal_ori = origin.T @ (position - run.center.xpos), origin.T @ rotation
    run.steps(3.0)
    assert np.abs(run.site.xpos - position).max() < 1e-3
    assert np.abs(run.site.xmat.reshape(3, 3) - rotation).max() < 5e-3


@pytest.mark.parametrize("axis", [0, 2])
def test_stiffness_in_newtons_per_metre(register: dict[str, Any], axis: int) -> None:
    impedance = {"velocity_limit": np.full(7, 2.5), "posture_stiffness": 0.0}  # this spring adds some per cent
    run = Run(register, kp=KP[:3] + (100.0,) * 3, impedance=impedance)
    first = run.site.xpos.copy()
    base = run.sim.data.body("robot0_link0").xmat.reshape(3, 3)
    force, tip = 5.0 * base[:, axis], run.sim.data.body("gripper0_hand")
    run.steps(0.1)
    tip.xfrc_applied[:3] = force
    tip.xfrc_applied[3:] = np.cross(run.site.xpos - tip.xipos, force)
    run.steps(4.0)
    moved = base.T @ (run.site.xpos - first)
    np.testing.assert_allclose(moved, 5.0 / KP[axis] * np.eye(3)[axis], atol=0.01 * 5.0 / KP[axis])


def test_goals_are_interpolated(register: dict[str, Any]) -> None:
    """A goal that jumps by 5 mm at 20 Hz moves the equilibrium at 0.1 m/s, with little on top."""
    run = Run(register)
    run.steps(0.2)
    places = [run.part.output.equilibrium[:3, 3].copy()]
    for _ in range(4):
        run.part.goal_pos = run.part.goal_pos + np.array([0.0, 0.0, 0.005])
        for _ in range(25):
            run.steps(0.002)
            places.append(run.part.output.equilibrium[:3, 3].copy())
    moves = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert moves.sum() > 0.01
    assert moves.max() < 0.0004


def test_an_old_goal_keeps_its_stiffness(register: dict[str, Any]) -> None:
    run = Run(register)
    run.steps(1.5)
    np.testing.assert_allclose(np.diag(run.part.output.translation_stiffness), KP[:3])


def test_limits_that_the_file_lacks_are_named(register: dict[str, Any]) -> None:
    module = Run(register).part.module
    with pytest.raises(ValueError, match=r"lacks velocity or effort limits of joints; set velocity_limit, reference"):
        module.Impedance()
    with pytest.raises(
        ValueError, match=r"sample_time: must lie between"
    ):  # and not lower_limit, which may be infinite
        module.Impedance(velocity_limit=2.5, reference_velocity_limit=2.0, sample_time=-1.0)


def test_gains_of_equal_stiffness(register: dict[str, Any]) -> None:
    from examples.robosuite.measures import STIFFNESS, equal_gains

    random = np.random.default_rng(1)
    J, root = random.normal(size=(6, 7)), random.normal(size=(7, 7))
    M, K = root @ root.T + np.eye(7), np.diag(STIFFNESS)
    joint = M @ np.diag(equal_gains("JOINT_POSITION", J, M))  # torque = M kp error
    np.testing.assert_allclose(np.diag(joint), np.diag(J.T @ K @ J))
    for half in (slice(0, 3), slice(3, 6)):
        inertia = np.linalg.inv(J[half] @ np.linalg.inv(M) @ J[half].T)
        force = inertia @ np.diag(equal_gains("OSC_POSE", J, M)[half])
        np.testing.assert_allclose(np.diag(force), STIFFNESS[half])


def test_a_tip_closes_across_an_object(register: dict[str, Any]) -> None:
    from examples.robosuite import motions

    closing = np.array([0.6, 0.8, 0.0])
    now = np.diag([1.0, -1.0, -1.0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motions, "closing_axis", lambda env: closing)
        patch.setattr(motions, "tip_pose", lambda env: motions.placed(now, 0.0, 0.0, 0.0))
        rotation = motions.grasp_from_above(None, np.array([2.0, 1.0, 0.3]))
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, -1], atol=1e-12)
    assert abs(abs((rotation @ closing) @ [2.0, 1.0, 0.0]) / np.sqrt(5.0) - 1.0) < 1e-12
    assert np.trace(now.T @ rotation) > 1.0


def test_targets_reach_every_pose_of_the_motion(register: dict[str, Any]) -> None:
    from examples.robosuite.motions import Leg, placed, targets

    turned = np.diag([-1.0, -1.0, 1.0])
    legs = [Leg(placed(np.eye(3), 0.1, 0.0, 0.0), 1.0, -1.0), Leg(placed(turned, 0.1, 0.2, 0.0), 2.0, 1.0)]
    found = targets(np.eye(4), legs, 0.05)
    assert len(found) == 60
    np.testing.assert_allclose(found[19][0], legs[0].pose, atol=1e-12)
    np.testing.assert_allclose(found[-1][0], legs[1].pose, atol=1e-12)
    places = np.array([pose[:3, 3] for pose, _ in found])
    np.testing.assert_allclose(np.diff(places[:20, 0]), 0.005)


@pytest.mark.parametrize(("fields", "message"), [
    ({"impedance": None}, "velocity_limit"),
    ({"impedance_mode": "variable"}, "variable_kp"),
    ({"interpolation": "linear"}, "governor"),
])  # fmt: skip
def test_refusals(register: dict[str, Any], fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Run(register, **fields)


def test_tables_of_the_page() -> None:
    text = (ROOT / "docs" / "robosuite.csv").read_text()
    records = list(csv.DictReader(text.splitlines()))
    assert tables.csv_text(records) == text
    page = (ROOT / "docs" / "robosuite.md").read_text()
    assert page.partition("writes all below this line -->")[2].endswith(tables.tables(records))
