# SPDX-License-Identifier: MIT
"""Plug-in for LeRobot: discovery, frames and units, late and hostile actions, rest, and a recorded episode."""

from __future__ import annotations

import importlib
import logging
import os
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from control.lerobot_base import EPISODE, IS_WHOLE, installed_plugin
from support.pages import blocks
from support.project import ROOT, URDF

POSE = ["ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz"]
PANDA = ROOT / "tests" / "data" / "panda.urdf"
PERIOD = 0.05  # s, of actions


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    """Return the plug-in as LeRobot's own function finds it."""
    with pytest.MonkeyPatch.context() as patch, installed_plugin(tmp_path_factory.mktemp("plugin")):
        patch.setenv("HF_HOME", str(tmp_path_factory.mktemp("home")))
        patch.setenv("HF_HUB_OFFLINE", "1")
        importlib.import_module("lerobot.utils.import_utils").register_third_party_plugins()
        yield importlib.import_module("lerobot_robot_stiffgen")


@pytest.fixture
def make(plugin: ModuleType, robot_folder: Path) -> Iterator[Any]:
    """Make robots by LeRobot's own function; disconnect them in the end."""
    made: list[Any] = []

    def connected(connect: bool = True, **config: Any) -> Any:
        """Return a robot with changed settings, connected unless told otherwise."""
        robots = importlib.import_module("lerobot.robots")
        settings: dict[str, Any] = {"robot": robot_folder, "model": URDF, "motor_inertia": 0.1, "real_time": False}
        chosen = robots.RobotConfig.get_choice_class("stiffgen")(**settings | config)
        made.append(robots.make_robot_from_config(chosen))
        if connect:
            made[-1].connect()
        return made[-1]

    yield connected
    for robot in made:
        if robot.is_connected:
            robot.disconnect()


def _pose(robot: Any) -> dict[str, float]:
    return {name: robot.get_observation()[name] for name in POSE}


def _mujoco() -> mujoco.MjModel:
    """Return MuJoCo's own model of the robot's file, with a site at the tip."""
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False
    spec.body("link_ee").add_site(name="tip")
    return spec.compile()


def _site(model: mujoco.MjModel, seen: dict[str, float]) -> tuple[np.ndarray, Rotation]:
    """Return MuJoCo's own pose of the tip in the base, at the joint positions of an observation."""
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        name = model.joint(joint).name
        data.joint(name).qpos[0] = seen[f"{name}.pos"]
    mujoco.mj_forward(model, data)
    base, rotation = data.body("link_0").xpos, data.body("link_0").xmat.reshape(3, 3)
    tip = data.site("tip")
    return rotation.T @ (tip.xpos - base), Rotation.from_matrix(rotation.T @ tip.xmat.reshape(3, 3))


def test_lerobot_finds_it(plugin: ModuleType, make: Any) -> None:
    """LeRobot makes the robot by its name; observations and actions have the features that it declares."""
    robot = make(connect=False, id="left")
    assert type(robot) is plugin.Stiffgen and robot.name == robot.config.type == "stiffgen"
    assert robot.is_calibrated and not robot.is_connected and str(robot) == "left Stiffgen"
    joints = robot.model.JOINTS
    assert list(robot.action_features) == POSE
    assert list(robot.observation_features) == [*(f"{j}.pos" for j in joints), *(f"{j}.vel" for j in joints), *POSE]
    assert {*robot.action_features.values(), *robot.observation_features.values()} == {float}
    robot.connect()
    assert list(robot.get_observation()) == list(robot.observation_features)
    assert list(robot.send_action(_pose(robot))) == list(robot.action_features)


@pytest.mark.slow
def test_frames_and_units_are_mujocos(make: Any) -> None:
    """Send poses in m and rad: MuJoCo's tip goes there; 8 N move it by 1 cm at 800 N/m."""
    robot, model = make(), _mujoco()
    first = _pose(robot)
    turn = Rotation.from_rotvec([0.1, -0.2, 0.15]) * Rotation.from_rotvec([first[name] for name in POSE[3:]])
    goal = dict(
        zip(POSE, [first["ee.x"] + 0.03, first["ee.y"] - 0.04, first["ee.z"] + 0.05, *turn.as_rotvec()], strict=True)
    )
    for _ in range(60):
        sent = robot.send_action(goal)
    assert sent == pytest.approx(goal, abs=1e-6)
    for seen, tolerance in ((_pose(robot), 1e-12), (goal, 1e-4)):
        position, rotation = _site(model, robot.get_observation())
        np.testing.assert_allclose(position, [seen[name] for name in POSE[:3]], atol=tolerance)
        error = rotation * Rotation.from_rotvec([seen[name] for name in POSE[3:]]).inv()
        assert error.magnitude() <= tolerance
    arm = robot.loop._arm
    arm.data.body("link_ee").xfrc_applied[:3] = [0.0, 0.0, -8.0]  # N
    for _ in range(60):
        robot.send_action(goal)
    moved = _site(model, robot.get_observation())[0] - [goal[name] for name in POSE[:3]]
    np.testing.assert_allclose(moved, [0.0, 0.0, -0.01], atol=5e-4)
    q = [robot.get_observation()[f"{joint}.pos"] for joint in robot.model.JOINTS]
    np.testing.assert_array_equal(q, arm.data.qpos)


def test_late_is_held_stale_fades_and_comes_back(make: Any) -> None:
    """Be late: pose and stiffness are held for 0.2 s and fade within 0.4 s to a tenth; stale actions are refused."""
    arm = make(variable_stiffness=True, validity=0.2, fade_time=0.4)
    action = _pose(arm) | {"stiffness.translation": 500.0, "stiffness.rotation": 25.0}
    assert arm.send_action(action) != action, "the stiffness rises from 0"
    for _ in range(3):
        sent = arm.send_action(action)
    assert sent == pytest.approx(action, abs=1e-6)
    arm.loop.advance(0.14)  # [s] after the last action, within its validity
    assert arm.loop.port.stage["pose"].name == "HOLDING" and arm.loop.in_force[1:] == pytest.approx((500.0, 25.0))
    arm.loop.advance(0.2)
    assert arm.loop.port.stage["pose"].name == "FADING" and 50.0 < arm.loop.in_force[1] < 500.0
    arm.loop.advance(0.4)
    assert arm.loop.port.stage["pose"].name == "FADED"
    assert arm.loop.in_force[1:] == pytest.approx((50.0, 2.5))
    now = arm.loop.now
    for stamp, reason in ((now - 0.7, "STALE"), (now + 1.0, "FUTURE"), (0.0, "ORDER"), (np.nan, "TIME")):
        arm.send_action(action, stamp=stamp)
        assert arm.refused == {"pose": reason, "stiffness": reason}
    for _ in range(3):
        back = arm.send_action(action)
    assert not arm.refused and back == pytest.approx(action, abs=1e-6)


def test_hostile_actions_are_refused_by_name(make: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Send bad actions: a bad number refuses its part, a wrong key the action, and no time passes."""
    arm = make(variable_stiffness=True)
    good = _pose(arm) | {"stiffness.translation": 500.0, "stiffness.rotation": 25.0}
    for _ in range(4):
        before = arm.send_action(good)
    cases = [
        ("ee.x", np.nan, {"pose": "NOT_FINITE"}),
        ("ee.wy", np.inf, {"pose": "NOT_FINITE"}),
        ("ee.z", 1e300, {"pose": "POSE"}),
        ("stiffness.translation", -1.0, {"stiffness": "INDEFINITE"}),
        ("stiffness.rotation", 1e9, {"stiffness": "STIFFNESS"}),
    ]
    for name, value, refused in cases:
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            assert arm.send_action(good | {name: value}) == pytest.approx(before, abs=1e-6), name
        assert arm.refused == refused and "action refused" in caplog.text and name in caplog.text
    now = arm.loop.now
    wrong = [({**good, "x": 0.0}, "'x'"), ({k: good[k] for k in POSE}, "'stiffness.translation'"), ({}, "'ee.wz'")]
    for action, named in wrong:
        with pytest.raises(ValueError, match=f"{named}.*the keys are ee.x"):
            arm.send_action(action)
    assert arm.loop.now == now, "a wrong action advanced the simulation"


def test_a_jump_costs_what_follow_allows(make: Any) -> None:
    """Send a goal 1 m away: the tip moves at Follow's velocity, and no joint beyond its limit."""
    arm = make()
    first, fastest = _pose(arm), 0.0
    goal = first | {"ee.x": first["ee.x"] - 1.0}
    last = first
    for _ in range(30):
        sent = arm.send_action(goal)
        step = np.linalg.norm([sent[name] - last[name] for name in POSE[:3]])
        fastest, last = max(fastest, float(step) / PERIOD), sent
        assert np.all(np.abs(arm.loop.state()[1]) < arm.model.VELOCITY)
    assert 0.3 < fastest < 0.8 + 1e-6, "m/s; 0.8 is the reference's share of tip_velocity_limit"
    assert not arm.refused and arm.loop.fault.name == "NONE"


def test_a_fault_refuses_every_action(make: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Let the arm jump: the fault is described once and refuses actions until the next connection."""
    arm = make()
    action = _pose(arm)
    arm.send_action(action)
    arm.loop._arm.data.qpos[0] += 0.5  # rad: no arm jumps
    for _ in range(2):
        arm.send_action(action)
        assert arm.refused == {"controller": "SENSOR"}
    assert caplog.text.count("JUMP") == 1, "the fault is described once"
    arm.disconnect()
    arm.connect()
    arm.send_action(action)
    assert not arm.refused


def test_disconnect_leaves_the_arm_at_rest(make: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Disconnect in motion: the arm stops within 5 cm, and LeRobot's own errors follow."""
    errors = importlib.import_module("lerobot.utils.errors")
    arm = make()
    first = _pose(arm)
    for _ in range(8):
        arm.send_action(first | {"ee.y": first["ee.y"] + 0.2})
    loop = arm.loop
    before = _site(_mujoco(), arm.get_observation())[0]
    assert np.abs(loop.state()[1]).max() > 0.1, "the arm moves"
    arm.disconnect()
    assert "brakes" not in caplog.text and not np.any(loop.state()[1])
    q = loop.state()[0]
    assert np.linalg.norm(arm.model.forward_kinematics(q)[:3, 3] - before) < 0.05
    for call in (arm.get_observation, arm.disconnect, lambda: arm.send_action(first)):
        with pytest.raises(errors.DeviceNotConnectedError, match="not connected"):
            call()
    arm.connect()
    with pytest.raises(errors.DeviceAlreadyConnectedError, match="already connected"):
        arm.connect()


def test_real_time_follows_the_clock(make: Any) -> None:
    """Run in real time: the thread works without actions, too, and ends with the connection."""
    arm = make(real_time=True, validity=0.1, fade_time=0.1)
    first, end = _pose(arm), time.monotonic() + 5.0
    while _pose(arm)["ee.z"] > first["ee.z"] - 0.005 and time.monotonic() < end:
        arm.send_action(first | {"ee.z": first["ee.z"] - 0.01})
        time.sleep(0.02)
    assert not arm.refused and time.monotonic() < end
    time.sleep(0.3)  # stale by silence
    assert arm.loop.port.stage["pose"].name == "FADED" and arm.loop.in_force[1] == pytest.approx(80.0)
    thread = arm.loop._thread
    arm.disconnect()
    assert not thread.is_alive()


HAND = """<mujoco><worldbody><body><joint name="arm"/><geom size="0.1"/><body pos="0.3 0 0"><joint name="a"/>
<geom size="0.1"/><body pos="0.3 0 0"><joint name="b"/><geom size="0.1"/></body></body></body></worldbody>
<tendon><fixed name="t"><joint joint="a" coef="1"/></fixed></tendon><sensor><jointpos joint="a"/></sensor>
<equality><joint joint1="a" joint2="b"/><tendon tendon1="t"/></equality><keyframe><key qpos="0 0 0"/></keyframe>
<actuator><position joint="arm" kp="1000"/><position tendon="t" kp="9"/></actuator></mujoco>"""


def test_a_hand_of_mjcf_is_fixed_and_actuators_are_off(plugin: ModuleType, tmp_path: Path) -> None:
    file = tmp_path / "hand.xml"
    file.write_text(HAND)
    arm = importlib.import_module(f"{plugin.__name__}.simulation").SimulatedArm(file, ["arm"], [0.7], 0.1, 1e-3)
    arm.step(np.zeros(1))
    assert arm.model.nq == 1 and arm.model.nu == 0 and arm.q == pytest.approx([0.7], abs=1e-9)


def test_a_hand_is_fixed(plugin: ModuleType) -> None:
    """Simulate a Panda with its hand: seven positions only, and a torque moves its own joint."""
    names = [f"panda_joint{k}" for k in range(7, 0, -1)]
    start = np.array([0.1, 1.2, 0.3, -2.0, 0.5, 0.4, 0.7])
    arm = importlib.import_module(f"{plugin.__name__}.simulation").SimulatedArm(PANDA, names, start, 0.1, 1e-3)
    for _ in range(10):
        arm.step(np.eye(7)[0])
    assert arm.model.nq == 7 and arm.data.joint("panda_joint7").qvel[0] == arm.dq[0] > 0.01 > np.abs(arm.dq[1:]).max()
    np.testing.assert_allclose(arm.q, start, atol=1e-3)


def test_what_does_not_fit_is_named(make: Any, robot_folder: Path, plugin: ModuleType) -> None:
    """Connect with another robot's start or model, or settings out of range: each is named."""
    for config, message in (
        ({"start": [0.0]}, "start: 1 positions, but the robot has 7"),
        ({"model": None}, "a folder has no model for MuJoCo; set model"),
        ({"model": PANDA}, "panda.urdf: has no joint A1, A2, .*set model"),
    ):
        with pytest.raises(ValueError, match=message):
            make(**config)
    for name, value in (("command_rate", 0.0), ("validity", -1.0), ("translation_stiffness", np.inf)):
        with pytest.raises(ValueError, match=f"^{name}: "):
            plugin.StiffgenConfig(robot=robot_folder, **{name: value})


@pytest.mark.usefixtures("plugin")
def test_code_of_the_page(
    robot_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Run the blocks of docs/policies.md: they print what the page says."""
    (tmp_path / "generated").symlink_to(robot_folder.parent)
    (tmp_path / "urdf").symlink_to(URDF.parent)
    monkeypatch.chdir(tmp_path)
    for block in blocks(ROOT / "docs" / "policies.md"):
        if block.language == "python" and "lerobot_robot_stiffgen" in block.code:
            exec(block.code, {})
    assert re.fullmatch(r"moved by -0\.0[78]\d m, refused: \{\}\n", capsys.readouterr().out)


def test_the_recorded_arm_turns_and_goes_round_a_circle(plugin: ModuleType) -> None:
    """Compare the recording with MuJoCo's poses and the velocities' integral; the tip is 0.2 s late."""
    episode = importlib.import_module(f"{plugin.__name__}.episode").read(EPISODE)
    model, time = _mujoco(), np.arange(120) * PERIOD
    rows = [dict(zip(episode.state_names, state, strict=True)) for state in episode.states]
    seen = {name: np.array([row[name] for row in rows]) for name in episode.state_names}
    turns = [Rotation.from_rotvec([row[name] for name in POSE[3:]]) for row in rows]
    for row, turn in zip(rows, turns, strict=True):
        position, rotation = _site(model, row)
        np.testing.assert_allclose(position, [row[name] for name in POSE[:3]], atol=1e-6)
        assert (rotation * turn.inv()).magnitude() < 1e-6
    late = 2 * np.pi / 3.0 * np.maximum(time - 0.2, 0.0)  # phase [rad] of a circle of 3 s and 5 cm
    for name, way in (("x", 0.0 * late), ("y", 0.05 * np.sin(late)), ("z", 0.05 * (1 - np.cos(late)))):
        np.testing.assert_allclose(seen[f"ee.{name}"] - seen[f"ee.{name}"][0], way, atol=5e-3)
    for turn, angle in zip(turns, 0.2 * np.sin(late), strict=True):  # the hand turns about x by up to 0.2 rad
        wanted = Rotation.from_rotvec(turns[0].as_rotvec() + np.array([angle, 0.0, 0.0]))
        assert (turn * wanted.inv()).magnitude() < 0.02
    for k in range(1, 8):
        steps, velocity = np.diff(seen[f"A{k}.pos"]), seen[f"A{k}.vel"]
        np.testing.assert_allclose(steps, PERIOD / 2 * (velocity[1:] + velocity[:-1]), atol=1e-3)  # trapezoidal rule
        assert np.ptp(velocity) > 0.02, "rad/s"


@pytest.mark.slow
def test_the_recorded_episode_is_replayed(make: Any, plugin: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replay the episode by the plug-in's function, and by LeRobot's own where it is installed."""
    module = importlib.import_module(f"{plugin.__name__}.episode")
    episode = module.read(EPISODE)
    arm = make(variable_stiffness=True)
    assert episode.action_names == list(arm.action_features)
    assert episode.state_names == list(arm.observation_features) and len(episode.actions) == 120
    assert np.ptp(episode.states[:, episode.state_names.index("ee.y")]) > 0.08, "m"
    np.testing.assert_allclose(module.replay(arm, episode), episode.states, atol=1e-6)
    harder = replace(episode, action_names=episode.action_names[:6], actions=episode.actions[:, :6])
    assert np.abs(module.replay(make(), harder) - episode.states).max() > 1e-3, "the comparison sees a stiffness"
    if IS_WHOLE:
        np.testing.assert_allclose(_replay_by_lerobot(arm.config, monkeypatch), episode.states, atol=1e-6)


def _replay_by_lerobot(config: Any, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Return the states that LeRobot observes before each action of its replay."""
    script = importlib.import_module("lerobot.scripts.lerobot_replay")
    made, states = script.make_robot_from_config(config), []
    observe = made.get_observation
    monkeypatch.setattr(made, "get_observation", lambda: states.append(list(observe().values())) or observe())
    monkeypatch.setattr(script, "make_robot_from_config", lambda _: made)
    monkeypatch.setattr(script, "precise_sleep", lambda _: None)
    dataset = script.DatasetReplayConfig(repo_id="stiffgen/circle", episode=0, root=EPISODE)
    script.replay(script.ReplayConfig(robot=config, dataset=dataset, play_sounds=False))
    assert not made.is_connected and os.environ["HF_HUB_OFFLINE"] == "1"
    return np.array(states)


@pytest.mark.slow
def test_hostile_streams_keep_the_velocity_limits(make: Any) -> None:
    """Actions jump by up to 1 m and 1 rad, their stiffness is random. Before: 5.11 rad/s in joint 6, limit 2.36."""
    random, robot = np.random.default_rng(3), make(variable_stiffness=True)
    first, arm = _pose(robot), robot.loop._arm
    place, turn = (np.array([first[name] for name in names]) for names in (POSE[:3], POSE[3:]))
    fastest = np.zeros(7)
    step = arm.step

    def watched(torque: np.ndarray) -> None:
        step(torque)
        np.maximum(fastest, np.abs(arm.dq), out=fastest)

    arm.step = watched
    for _ in range(160):
        position, rotation = place + random.uniform(-1, 1, 3), Rotation.from_rotvec(random.uniform(-1, 1, 3))
        stiffness = {"stiffness.translation": random.uniform(0, 3000), "stiffness.rotation": random.uniform(0, 300)}
        goal = [*position, *(rotation * Rotation.from_rotvec(turn)).as_rotvec()]
        robot.send_action(dict(zip(POSE, goal, strict=True)) | stiffness)
        assert not robot.loop.fault
    assert np.all(fastest <= 1.05 * robot.model.VELOCITY)
