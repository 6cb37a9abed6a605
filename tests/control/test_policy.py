# SPDX-License-Identifier: MIT
"""Policy port: interpolation, late and stale proposals, refusals, and a session with Follow and the controller."""

from __future__ import annotations

import re
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

Q = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
KT, KO = np.diag([400.0, 500, 600]), np.diag([20.0, 30, 40])
SPRINGS = {"translation_stiffness": KT, "rotation_stiffness": KO}
STATED = {"sample_time": 1e-3, "delay_samples": 0, "motor_inertia": 0.3, "heaviest_wrench": (50.0, 10.0)}


def _pose(robot: ModuleType) -> Any:
    return robot.forward_kinematics(Q)


def _port(robot: ModuleType, **settings: float) -> Any:
    return robot.Policy(pose=_pose(robot), now=0.0, **{"heaviest_wrench": (50.0, 10.0), **settings})


def _goal(robot: ModuleType) -> np.ndarray:
    goal = _pose(robot).copy()
    goal[:3, 3] += [0.1, -0.2, 0.05]
    goal[:3, :3] = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix() @ goal[:3, :3]
    return goal


def _numbers(command: Any) -> dict[str, Any]:
    return {**command._asdict()}


def test_an_accepted_pose_is_commanded_at_once(robot: ModuleType) -> None:
    """Bit by bit: the ramps and the smoothing are Follow's."""
    port, goal = _port(robot), _goal(robot)
    np.testing.assert_array_equal(port.command(0.0).pose, _pose(robot))
    assert not port.propose(now=0.0, time=0.0, pose=goal)
    np.testing.assert_array_equal(port.command(0.0).pose, goal)


def test_stiffness_stays_between_its_ends(robot: ModuleType) -> None:
    """On the way, no direction is softer or stiffer than at both ends; the way takes the commander's period."""
    random, port = np.random.default_rng(1), _port(robot)
    old = np.zeros((3, 3))
    for k in range(20):
        A = random.normal(size=(3, 3)) * 20  # A A^T: a stiffness of some 400 N/m in random axes
        port.propose(now=0.05 * k, time=0.05 * k, translation_stiffness=A @ A.T, rotation_stiffness=np.eye(3))
        for now in 0.05 * k + np.linspace(0, 0.05, 4):  # [s] within the period of 50 ms
            inside = port.command(now).translation_stiffness
            x = random.normal(size=3)
            ends = sorted((x @ old @ x, x @ A @ A.T @ x))
            assert ends[0] - 1e-9 <= x @ inside @ x <= ends[1] + 1e-9
        old = port.command(0.05 * (k + 1) - 1e-9).translation_stiffness  # just before the next proposal
        if k:
            np.testing.assert_allclose(old, A @ A.T, rtol=1e-6, atol=1e-3)


def test_late_is_held_and_stale_fades_to_the_share(robot: ModuleType) -> None:
    """Held for hold_time (0.3 s), then faded within fade_time (0.5 s): the springs to stale_share, the wrench to 0."""
    port = _port(robot)
    port.propose(now=0.0, time=0.0, pose=_goal(robot), wrench_command=[5.0, 0, 0, 0, 0, 0], **SPRINGS)
    held = port.command(0.3)
    assert set(port.stage.values()) == {robot.PolicyStage.HOLDING, robot.PolicyStage.WAITING}
    np.testing.assert_array_equal(held.translation_stiffness, KT)
    last = held
    for now in np.linspace(0.3, 0.8, 11)[1:]:
        out = port.command(now)
        assert np.all(np.linalg.eigvalsh(last.rotation_stiffness - out.rotation_stiffness) >= 0.0)
        assert abs(out.wrench_command[0]) <= abs(last.wrench_command[0])
        last = out
    assert port.stage["stiffness"] == robot.PolicyStage.FADED
    np.testing.assert_allclose(last.rotation_stiffness, 0.1 * KO, atol=1e-12)
    np.testing.assert_array_equal(last.wrench_command, 0.0)
    np.testing.assert_array_equal(last.pose, held.pose)


def test_a_stale_pose_alone_fades_the_stiffness(robot: ModuleType) -> None:
    port = _port(robot)
    port.propose(now=0.0, time=0.0, pose=_goal(robot), **SPRINGS)
    for k in range(1, 11):
        port.propose(now=0.1 * k, time=0.1 * k, **SPRINGS)
    np.testing.assert_allclose(port.command(1.09).translation_stiffness, 0.1 * KT, atol=1e-9)
    assert port.stage["pose"] == robot.PolicyStage.FADED and port.stage["stiffness"] == robot.PolicyStage.MOVING


@pytest.mark.parametrize("end", [0.0, 0.1])
@pytest.mark.parametrize("back", [0.0, 0.45])
def test_a_return_is_continuous(robot: ModuleType, end: float, back: float) -> None:
    """Proposals come back fresh or already fading, all parts or the pose alone: stiffness and wrench do not jump."""
    for parts in ({"pose": _goal(robot)}, {"pose": _goal(robot), "wrench_command": np.ones(6), **SPRINGS}):
        for now in (0.5, 0.7, 5.0):
            port = _port(robot, stale_share=end)
            port.propose(now=0.0, time=0.0, pose=_pose(robot), wrench_command=np.ones(6), **SPRINGS)
            before = _numbers(port.command(now))
            assert not port.propose(now=now, time=now - back, **parts)
            for name, value in _numbers(port.command(now)).items():
                if name != "pose":
                    np.testing.assert_allclose(value, before[name], atol=1e-12, err_msg=f"{name} {now}")


def test_refusals_are_named_and_change_nothing(robot: ModuleType) -> None:
    """Propose what is refused: part, reason and number are named, and the command stays."""
    port, why = _port(robot), robot.PolicyRefused
    good: dict[str, Any] = {"pose": _goal(robot), "wrench_command": np.ones(6), **SPRINGS}
    assert not port.propose(now=1.0, time=1.0, **good, gripper=0.25)
    before = _numbers(port.command(1.2))
    skewed, far = KT + np.diag([3.0, 0], 1)[:3, :3], _goal(robot)
    far[0, 3] = 300.0  # millimetres
    cases: list[tuple[dict[str, Any], str, Any, str]] = [
        ({"pose": _goal(robot) * np.nan}, "pose", why.NOT_FINITE, "entry 0"),
        ({"pose": np.diag([1.0, 1, -1, 1])}, "pose", why.POSE, "no rotation"),
        ({"pose": _goal(robot) @ np.diag([1.0, 1.01, 1, 1])}, "pose", why.POSE, "limit 0.001"),
        ({"pose": far}, "pose", why.REACH, "300.*limit 1.37"),
        ({**SPRINGS, "rotation_stiffness": -KO}, "stiffness", why.INDEFINITE, "entry 9 .-40,"),
        ({**SPRINGS, "translation_stiffness": 1e4 * KT}, "stiffness", why.STIFFNESS, "limit 5000"),
        ({**SPRINGS, "translation_stiffness": skewed}, "stiffness", why.ASYMMETRIC, "entry 3 .3,"),
        ({"wrench_command": np.full(6, np.inf)}, "wrench", why.NOT_FINITE, "entry 0"),
        ({"wrench_command": [0, 40.0, 40, 0, 0, 0]}, "wrench", why.WRENCH, "56.5.*limit 50"),
        ({**good, "time": 1.0}, "pose", why.ORDER, "not later"),
        ({**good, "time": 1.3}, "stiffness", why.FUTURE, "0.1, limit 0.005"),
        ({**good, "time": np.inf}, "wrench", why.TIME, "not finite"),
        ({**good, "now": np.nan}, "wrench", why.TIME, "not finite"),
    ]
    for proposal, part, reason, words in cases:
        assert port.propose(**({"now": 1.2, "time": 1.15} | proposal))[part] == reason, proposal
        assert re.search(words, port.refusals[part]), port.refusals
    for name, value in _numbers(port.command(1.2)).items():
        np.testing.assert_array_equal(value, before[name])
    assert port.propose(now=9.0, time=7.0, gripper=1.0) == {"gripper": why.STALE}
    assert port.gripper == 0.25
    assert port.propose(now=9.0, time=[0, 0, 0, 8.9], gripper=np.nan) == {} and np.isnan(port.gripper)


def test_a_stamp_ahead_of_the_clock_blocks_nothing(robot: ModuleType) -> None:
    """Believed, it would put all honest stamps behind it out of order, until the clock has caught up."""
    port = _port(robot)
    assert port.propose(now=1.0, time=500.0, pose=_goal(robot)) == {"pose": robot.PolicyRefused.FUTURE}
    assert not port.propose(now=1.1, time=1.1, pose=_goal(robot))
    assert not port.propose(now=1.2, time=1.204, pose=_pose(robot))  # within clock_tolerance


def test_arguments_are_checked(robot: ModuleType) -> None:
    """Give wrong settings, poses and shapes: each is refused before it reaches the controller."""
    with pytest.raises(TypeError, match="no setting 'hold'"):
        _port(robot, hold=1.0)
    with pytest.raises(ValueError, match="stale_share: must lie between 0 and 1"):
        _port(robot, stale_share=2.0)
    with pytest.raises(TypeError, match="give both"):
        _port(robot).propose(now=0, time=0, translation_stiffness=np.eye(3))
    with pytest.raises(ValueError, match="pose: no pose"):
        robot.Policy(pose=_pose(robot) * 2, now=0.0)
    with pytest.raises(ValueError, match="finite"):
        robot.Policy(pose=_pose(robot), now=np.nan)
    with pytest.raises(ValueError, match="shape"):
        _port(robot).propose(now=0, time=0, pose=np.eye(3))


PERIOD = 0.1


def _noisy(robot: ModuleType, count: int) -> list[np.ndarray]:
    """Poses of a commander at 10 Hz that moves on a line and turns, and scatters by 3 mm and 0.01 rad."""
    random, poses = np.random.default_rng(3), []
    for k in range(count):
        pose = _pose(robot).copy()
        pose[:3, 3] += np.array([0.0, 0.1, -0.05]) * PERIOD * k + 0.003 * random.normal(size=3)
        turn = Rotation.from_rotvec(0.3 * PERIOD * k * np.array([0.0, 0.6, 0.8]) + 0.01 * random.normal(size=3))
        pose[:3, :3] = turn.as_matrix() @ pose[:3, :3]
        poses.append(pose)
    return poses


def _tips(robot: ModuleType, poses: np.ndarray) -> np.ndarray:
    """Return the tip's positions (steps, 3) [m] for q0 of Follow along poses, one per millisecond."""
    q0 = robot.Follow(Q, sample_time=1e-3).run(pose=poses).q0
    return np.asarray(robot.forward_kinematics(q0)[:, :3, 3])


def test_noisy_poses_are_smoothed_behind_the_port(robot: ModuleType) -> None:
    """Follow smooths what the port passes on: less than if the port interpolated (2.3 m/s^2), lagging by 25 mm."""
    poses, steps, passed = _noisy(robot, 25), round(1e3 * PERIOD), []
    port = _port(robot)
    for k in range(steps * len(poses)):
        if k % steps == 0:
            assert not port.propose(now=1e-3 * k, time=1e-3 * k, pose=poses[k // steps])
        passed.append(port.command(1e-3 * k).pose)
    tips, share = _tips(robot, np.array(passed)), np.linspace(0.0, 1.0, steps, endpoint=False)[:, None, None]
    lines = [_between(before, after, share) for before, after in zip([poses[0], *poses], poses, strict=False)]
    # [m/s^2]
    assert _acceleration(tips) < 1.6 < _acceleration(_tips(robot, np.concatenate(lines)))
    way = _pose(robot)[:3, 3] + np.outer(1e-3 * np.arange(len(tips)), [0.0, 0.1, -0.05])
    assert np.linalg.norm((tips - way)[500:], axis=1).max() < 0.03  # [m]


def _between(before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return poses (steps, 4, 4) on a line from one to another; their rotations are near enough to mix."""
    mixed = (1 - share) * before + share * after
    mixed[:, :3, :3] = Rotation.from_matrix(mixed[:, :3, :3]).as_matrix()
    return np.asarray(mixed)


def _acceleration(tips: np.ndarray) -> float:
    """Return the root mean square of the tip's acceleration [m/s^2] without the start."""
    return float(np.sqrt(np.mean(np.sum(np.diff(tips[500:], 2, axis=0) ** 2, axis=1)))) * 1e6


def test_a_session_with_a_poor_commander(robot: ModuleType) -> None:
    """Lost, late and bad proposals, silence and a jump: no fault, no refusal by the controller, a bounded supply."""
    random, port = np.random.default_rng(5), _port(robot)
    controller, follow = robot.Impedance(**STATED), robot.Follow(Q, sample_time=1e-3)
    q, dq, refused = Q, np.zeros(7), set()
    for k in range(4000):
        now = 1e-3 * k
        if k % 50 == 0 and not 1000 <= k < 2200:  # 20 Hz, with a silence of 1.2 s
            goal = _pose(robot) if k % 100 else _goal(robot)
            stamp = now - random.choice([0.0, 0.02, 0.2, -0.5], p=[0.6, 0.2, 0.1, 0.1])  # [s]; below 0: future
            bad = goal * np.nan if random.random() < 0.1 else goal
            found = port.propose(now=now, time=stamp, pose=bad, wrench_command=[3.0, 0, 0, 0, 0, 0], **SPRINGS)
            refused |= set(found.values())
        command = port.command(now)
        q0 = follow.step(pose=command.pose).q0
        rest = {name: value for name, value in _numbers(command).items() if name not in ("pose", "gripper")}
        out = controller.step(q=q, dq=dq, q0=q0, shaped=True, counter=k, **rest)
        assert not out.fault and not out.status & robot.Status.COMMAND_REFUSED, out.text
        q, dq = follow.q0, follow.dq0
    assert {robot.PolicyRefused.FUTURE, robot.PolicyRefused.NOT_FINITE, robot.PolicyRefused.ORDER} <= refused
    assert 0.0 < out.energy_supplied < 1000.0  # [J]
