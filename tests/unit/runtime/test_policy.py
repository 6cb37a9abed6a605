# SPDX-License-Identifier: MIT
"""Policy port: interpolation, late and stale proposals, refusals, and the hostile commander of the energy search."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from generated import iiwa14
from generated.iiwa14 import Refused, Stage

Q = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
POSE = iiwa14.forward_kinematics(Q)
K = np.diag([400.0, 500, 600, 20, 30, 40])
TURN = np.array([0.4, -1.1, 0.7])


def _port(**settings: float) -> Any:
    return iiwa14.Policy(iiwa14.Impedance(), pose=POSE, now=0.0, **settings)


def _goal() -> np.ndarray:
    goal = POSE.copy()
    goal[:3, 3] += [0.1, -0.2, 0.05]
    goal[:3, :3] = Rotation.from_rotvec(TURN).as_matrix() @ POSE[:3, :3]
    return goal


def test_path_is_a_geodesic() -> None:
    port, goal = _port(), _goal()
    assert not port.propose(now=0.0, time=0.0, equilibrium=goal)
    turns = Slerp([0.0, 0.1], Rotation.from_matrix(np.array([POSE[:3, :3], goal[:3, :3]])))
    for now in np.linspace(0.0, 0.1, 7):
        pose = port.command(now)["equilibrium"]
        np.testing.assert_allclose(pose[:3, :3], turns(now).as_matrix(), atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], POSE[:3, 3] + now / 0.1 * (goal - POSE)[:3, 3], atol=1e-14)
    np.testing.assert_array_equal(port.command(0.1)["equilibrium"][:3, 3], goal[:3, 3])


def test_stiffness_stays_between_its_ends() -> None:
    random, port = np.random.default_rng(1), _port()
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


def test_late_is_held_and_stale_fades_to_the_share() -> None:
    port = _port()
    port.propose(now=0.0, time=0.0, equilibrium=_goal(), stiffness=K, wrench_command=[5.0, 0, 0, 0, 0, 0])
    held = port.command(0.3)
    assert set(port.stage.values()) == {Stage.HOLDING, Stage.WAITING}
    np.testing.assert_array_equal(held["translation_stiffness"], K[:3, :3])
    last = held
    for now in np.linspace(0.3, 0.8, 11)[1:]:
        out = port.command(now)
        assert np.all(np.linalg.eigvalsh(last["rotation_stiffness"] - out["rotation_stiffness"]) >= 0.0)
        assert abs(out["wrench_command"][0]) <= abs(last["wrench_command"][0])
        last = out
    assert port.stage["stiffness"] == Stage.FADED
    np.testing.assert_allclose(last["rotation_stiffness"], 0.1 * K[3:, 3:], atol=1e-12)
    np.testing.assert_array_equal(last["wrench_command"], 0.0)
    np.testing.assert_array_equal(last["equilibrium"], held["equilibrium"])


@pytest.mark.parametrize("end", [0.0, 0.1])
@pytest.mark.parametrize("back", [0.0, 0.45])
def test_a_return_is_continuous(end: float, back: float) -> None:
    """Proposals come back fresh or already fading, all parts or the pose alone."""
    for parts in ({"equilibrium": _goal()}, {"equilibrium": _goal(), "stiffness": K, "wrench_command": np.ones(6)}):
        for now in (0.5, 0.7, 5.0):
            port = _port(stale_share=end)
            port.propose(now=0.0, time=0.0, equilibrium=POSE, stiffness=K, wrench_command=np.ones(6))
            before = port.command(now)
            assert not port.propose(now=now, time=now - back, **parts)
            for name, value in port.command(now).items():
                np.testing.assert_allclose(value, before[name], atol=1e-12, err_msg=f"{name} {now}")


def test_refusals_are_named_and_change_nothing() -> None:
    port = _port()
    good = {"equilibrium": _goal(), "stiffness": K, "wrench_command": np.ones(6)}
    assert not port.propose(now=1.0, time=1.0, **good, gripper=0.25)
    before = port.command(1.2)
    spoilt = K.copy()
    spoilt[0, 4] = spoilt[4, 0] = 1.0
    cases: list[tuple[dict[str, Any], str, Refused]] = [
        ({"equilibrium": _goal() * np.nan}, "pose", Refused.POSE),
        ({"equilibrium": np.diag([1.0, 1, -1, 1])}, "pose", Refused.POSE),
        ({"stiffness": -K}, "stiffness", Refused.STIFFNESS),
        ({"stiffness": K * 1e4}, "stiffness", Refused.STIFFNESS),
        ({"stiffness": spoilt}, "stiffness", Refused.COUPLING),
        ({"wrench_command": np.full(6, np.nan)}, "wrench", Refused.WRENCH),
        ({"wrench_command": [1e3, 0, 0, 0, 0, 0]}, "wrench", Refused.WRENCH),
        ({**good, "time": 1.0}, "pose", Refused.ORDER),
        ({**good, "time": 1.3}, "stiffness", Refused.FUTURE),
        ({**good, "time": np.inf}, "wrench", Refused.TIME),
        ({**good, "now": np.nan}, "wrench", Refused.TIME),
    ]
    for proposal, part, reason in cases:
        assert port.propose(**({"now": 1.2, "time": 1.15} | proposal))[part] == reason, proposal
    for name, value in port.command(1.2).items():
        np.testing.assert_array_equal(value, before[name])
    assert port.propose(now=9.0, time=7.0, gripper=1.0) == {"gripper": Refused.STALE}
    assert port.gripper == 0.25
    assert port.propose(now=9.0, time=[0, 0, 0, 8.9], gripper=np.nan) == {} and np.isnan(port.gripper)


def test_arguments_are_checked() -> None:
    with pytest.raises(TypeError, match="no setting 'hold'"):
        _port(hold=1.0)
    with pytest.raises(ValueError, match="stale_share"):
        _port(stale_share=2.0)
    with pytest.raises(TypeError, match="either stiffness"):
        _port().propose(now=0, time=0, translation_stiffness=np.eye(3))
    with pytest.raises(ValueError, match="policy_start"):
        iiwa14.Policy(iiwa14.Impedance(), pose=POSE * 2, now=0.0)


def test_a_jump_costs_no_more_than_the_governor_allows() -> None:
    controller = iiwa14.Impedance()
    port = iiwa14.Policy(controller, pose=POSE, now=0.0)
    most, limit = 0.0, 0.0
    for k in range(300):
        if k % 50 == 0:
            goal = POSE if k % 100 else _goal()
            port.propose(now=1e-3 * k, time=1e-3 * k, equilibrium=goal, stiffness=K)
        out = controller.step(q=Q, dq=np.zeros(7), posture=Q, **port.command(1e-3 * k))
        assert not out.fault and not out.status & iiwa14.Status.COMMAND_REFUSED
        most, limit = max(most, float(out.elastic_energy)), float(out.energy_limit)
    assert 0.0 < most <= limit * (1 + 1e-9)
