# SPDX-License-Identifier: MIT
"""Policy port: interpolation, late and stale proposals, refusals, and the hostile commander of the energy search."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

Q = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
K = np.diag([400.0, 500, 600, 20, 30, 40])
TURN = np.array([0.4, -1.1, 0.7])


def _pose(robot: ModuleType) -> Any:
    return robot.forward_kinematics(Q)


def _port(robot: ModuleType, **settings: float) -> Any:
    return robot.Policy(robot.Impedance(), pose=_pose(robot), now=0.0, **settings)


def _goal(robot: ModuleType) -> np.ndarray:
    goal = _pose(robot).copy()
    goal[:3, 3] += [0.1, -0.2, 0.05]
    goal[:3, :3] = Rotation.from_rotvec(TURN).as_matrix() @ _pose(robot)[:3, :3]
    return goal


def test_path_is_a_geodesic(robot: ModuleType) -> None:
    """A first proposal is reached in 0.1 s: along a line, and about one axis at a constant rate."""
    port, goal = _port(robot), _goal(robot)
    assert not port.propose(now=0.0, time=0.0, equilibrium=goal)
    turns = Slerp([0.0, 0.1], Rotation.from_matrix(np.array([_pose(robot)[:3, :3], goal[:3, :3]])))
    for now in np.linspace(0.0, 0.1, 7):
        pose = port.command(now)["equilibrium"]
        np.testing.assert_allclose(pose[:3, :3], turns(now).as_matrix(), atol=1e-12)
        np.testing.assert_allclose(
            pose[:3, 3], _pose(robot)[:3, 3] + now / 0.1 * (goal - _pose(robot))[:3, 3], atol=1e-14
        )
    np.testing.assert_array_equal(port.command(0.1)["equilibrium"][:3, 3], goal[:3, 3])


def test_stiffness_stays_between_its_ends(robot: ModuleType) -> None:
    """On the way, no direction is softer or stiffer than at both ends."""
    random, port = np.random.default_rng(1), _port(robot)
    old = np.zeros((3, 3))
    for k in range(20):
        A = random.normal(size=(3, 3)) * 20
        port.propose(now=0.05 * k, time=0.05 * k, translation_stiffness=A @ A.T, rotation_stiffness=np.eye(3))
        for now in 0.05 * k + np.linspace(0, 0.05, 4):
            inside = port.command(now)["translation_stiffness"]
            x = random.normal(size=3)
            ends = sorted((x @ old @ x, x @ A @ A.T @ x))
            assert ends[0] - 1e-9 <= x @ inside @ x <= ends[1] + 1e-9
        old = port.command(0.05 * (k + 1) - 1e-9)["translation_stiffness"]


def test_late_is_held_and_stale_fades_to_the_share(robot: ModuleType) -> None:
    """Held for hold_time (0.3 s), then faded within fade_time (0.5 s): the springs to stale_share, the wrench to 0."""
    port = _port(robot)
    port.propose(now=0.0, time=0.0, equilibrium=_goal(robot), stiffness=K, wrench_command=[5.0, 0, 0, 0, 0, 0])
    held = port.command(0.3)
    assert set(port.stage.values()) == {robot.Stage.HOLDING, robot.Stage.WAITING}
    np.testing.assert_array_equal(held["translation_stiffness"], K[:3, :3])
    last = held
    for now in np.linspace(0.3, 0.8, 11)[1:]:
        out = port.command(now)
        assert np.all(np.linalg.eigvalsh(last["rotation_stiffness"] - out["rotation_stiffness"]) >= 0.0)
        assert abs(out["wrench_command"][0]) <= abs(last["wrench_command"][0])
        last = out
    assert port.stage["stiffness"] == robot.Stage.FADED
    np.testing.assert_allclose(last["rotation_stiffness"], 0.1 * K[3:, 3:], atol=1e-12)
    np.testing.assert_array_equal(last["wrench_command"], 0.0)
    np.testing.assert_array_equal(last["equilibrium"], held["equilibrium"])


@pytest.mark.parametrize("end", [0.0, 0.1])
@pytest.mark.parametrize("back", [0.0, 0.45])
def test_a_return_is_continuous(robot: ModuleType, end: float, back: float) -> None:
    """Proposals come back fresh or already fading, all parts or the pose alone."""
    for parts in (
        {"equilibrium": _goal(robot)},
        {"equilibrium": _goal(robot), "stiffness": K, "wrench_command": np.ones(6)},
    ):
        for now in (0.5, 0.7, 5.0):
            port = _port(robot, stale_share=end)
            port.propose(now=0.0, time=0.0, equilibrium=_pose(robot), stiffness=K, wrench_command=np.ones(6))
            before = port.command(now)
            assert not port.propose(now=now, time=now - back, **parts)
            for name, value in port.command(now).items():
                np.testing.assert_allclose(value, before[name], atol=1e-12, err_msg=f"{name} {now}")


def test_refusals_are_named_and_change_nothing(robot: ModuleType) -> None:
    """Each refusal names its part and its reason, and what is commanded stays as it was."""
    port = _port(robot)
    good = {"equilibrium": _goal(robot), "stiffness": K, "wrench_command": np.ones(6)}
    assert not port.propose(now=1.0, time=1.0, **good, gripper=0.25)
    before = port.command(1.2)
    spoilt = K.copy()
    spoilt[0, 4] = spoilt[4, 0] = 1.0
    cases: list[tuple[dict[str, Any], str, Any]] = [
        ({"equilibrium": _goal(robot) * np.nan}, "pose", robot.Refused.POSE),
        ({"equilibrium": np.diag([1.0, 1, -1, 1])}, "pose", robot.Refused.POSE),
        ({"stiffness": -K}, "stiffness", robot.Refused.STIFFNESS),
        ({"stiffness": K * 1e4}, "stiffness", robot.Refused.STIFFNESS),
        ({"stiffness": spoilt}, "stiffness", robot.Refused.COUPLING),
        ({"wrench_command": np.full(6, np.nan)}, "wrench", robot.Refused.WRENCH),
        ({"wrench_command": [1e3, 0, 0, 0, 0, 0]}, "wrench", robot.Refused.WRENCH),
        ({**good, "time": 1.0}, "pose", robot.Refused.ORDER),
        ({**good, "time": 1.3}, "stiffness", robot.Refused.FUTURE),
        ({**good, "time": np.inf}, "wrench", robot.Refused.TIME),
        ({**good, "now": np.nan}, "wrench", robot.Refused.TIME),
    ]
    for proposal, part, reason in cases:
        assert port.propose(**({"now": 1.2, "time": 1.15} | proposal))[part] == reason, proposal
    for name, value in port.command(1.2).items():
        np.testing.assert_array_equal(value, before[name])
    assert port.propose(now=9.0, time=7.0, gripper=1.0) == {"gripper": robot.Refused.STALE}
    assert port.gripper == 0.25
    assert port.propose(now=9.0, time=[0, 0, 0, 8.9], gripper=np.nan) == {} and np.isnan(port.gripper)


def test_arguments_are_checked(robot: ModuleType) -> None:
    with pytest.raises(TypeError, match="no setting 'hold'"):
        _port(robot, hold=1.0)
    with pytest.raises(ValueError, match="stale_share"):
        _port(robot, stale_share=2.0)
    with pytest.raises(TypeError, match="either stiffness"):
        _port(robot).propose(now=0, time=0, translation_stiffness=np.eye(3))
    with pytest.raises(ValueError, match="policy_start"):
        robot.Policy(robot.Impedance(), pose=_pose(robot) * 2, now=0.0)


def test_a_jump_costs_no_more_than_the_governor_allows(robot: ModuleType) -> None:
    """Poses that jump every 50 ms wind up an arm that is held by no more than the energy limit."""
    controller = robot.Impedance()
    port = robot.Policy(controller, pose=_pose(robot), now=0.0)
    most, limit = 0.0, 0.0
    for k in range(300):
        if k % 50 == 0:
            goal = _pose(robot) if k % 100 else _goal(robot)
            port.propose(now=1e-3 * k, time=1e-3 * k, equilibrium=goal, stiffness=K)
        out = controller.step(q=Q, dq=np.zeros(7), posture=Q, **port.command(1e-3 * k))
        assert not out.fault and not out.status & robot.Status.COMMAND_REFUSED
        most, limit = max(most, float(out.elastic_energy)), float(out.energy_limit)
    assert 0.0 < most <= limit * (1 + 1e-9)


PERIOD, SHARE = 0.1, 0.5


def _noisy(robot: ModuleType, count: int) -> list[np.ndarray]:
    """Poses of a commander at 10 Hz that moves on a line and turns, and scatters by 1 cm and 0.02 rad."""
    random, poses = np.random.default_rng(3), []
    for k in range(count):
        pose = _pose(robot).copy()
        pose[:3, 3] += np.array([0.0, 0.1, -0.05]) * PERIOD * k + 0.01 * random.normal(size=3)
        turn = Rotation.from_rotvec(0.3 * PERIOD * k * np.array([0.0, 0.6, 0.8]) + 0.02 * random.normal(size=3))
        pose[:3, :3] = turn.as_matrix() @ pose[:3, :3]
        poses.append(pose)
    return poses


def _streamed(port: Any, poses: list[np.ndarray]) -> np.ndarray:
    """Propose a pose per period; return the commanded pose of each millisecond, the proposal's own first."""
    rows = []
    for k in range(round(1e3 * PERIOD) * len(poses)):
        now = 1e-3 * k
        if k % round(1e3 * PERIOD) == 0:
            assert not port.propose(now=now, time=now, equilibrium=poses[k // round(1e3 * PERIOD)])
        rows.append(port.command(now)["equilibrium"])
    return np.array(rows)


def test_smoothing_is_an_alpha_beta_filter(robot: ModuleType) -> None:
    """At the end of each interpolation the pose is the filter's, half a period ahead of the proposal's stamp."""
    poses = _noisy(robot, 12)
    port = _port(robot, smoothing=1 - SHARE)
    rows = _streamed(port, poses)
    x, R = poses[0][:3, 3], Rotation.from_matrix(poses[0][:3, :3])
    v, w, beta = np.zeros(3), np.zeros(3), SHARE**2 / (2 - SHARE)
    for k, pose in enumerate(poses[1:-1], 1):
        x, R = x + PERIOD * v, Rotation.from_rotvec(PERIOD * w) * R
        away, turn = pose[:3, 3] - x, (Rotation.from_matrix(pose[:3, :3]) * R.inv()).as_rotvec()
        x, v = x + SHARE * away, v + beta / PERIOD * away
        R, w = Rotation.from_rotvec(SHARE * turn) * R, w + beta / PERIOD * turn
        end = rows[round(1e3 * PERIOD) * (k + 1)]  # a new proposal begins where the last one ended
        np.testing.assert_allclose(end[:3, 3], x + PERIOD / 2 * v, atol=1e-12)
        ahead = (Rotation.from_rotvec(PERIOD / 2 * w) * R).as_matrix()
        np.testing.assert_allclose(end[:3, :3], ahead, atol=1e-12)


def test_smoothed_poses_have_no_kinks(robot: ModuleType) -> None:
    poses = _noisy(robot, 20)
    bends = []
    for share in (0.0, 1 - SHARE):
        rows = _streamed(_port(robot, smoothing=share), poses)
        speeds = np.diff(rows[200:, :3, 3], axis=0)
        bends.append(np.abs(np.diff(speeds, axis=0)).max())
    assert bends[1] < bends[0] / 20


def test_a_smoothed_pose_stops_when_its_commander_does(robot: ModuleType) -> None:
    """Within another period, at most half a period's way beyond the end of the interpolation."""
    port = _port(robot, smoothing=1 - SHARE)
    rows = _streamed(port, _noisy(robot, 8))
    last = 1e-3 * (len(rows) - 1)
    end, speed = port.command(last + 1e-3)["equilibrium"], np.abs(port._policy["velocity"][0]).max()
    rest = port.command(last + 1e-3 + PERIOD)["equilibrium"]
    assert 0.0 < np.abs(rest[:3, 3] - end[:3, 3]).max() <= PERIOD / 2 * speed + 1e-12
    np.testing.assert_array_equal(port.command(last + 0.2)["equilibrium"], rest)
