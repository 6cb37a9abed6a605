# SPDX-License-Identifier: MIT
"""Commands that are impossible: refused by name, argument, entry and number, in step and in the policy port alike."""

from __future__ import annotations

import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stiffgen
from stiffgen.core.opened import open_robot
from support.controller_inputs import KO, KT, SPRING, Q
from support.project import ROOT

ZERO = np.zeros(7)
LIMIT, ROTATION_LIMIT = 5000.0, 500.0
DENORMAL = 7e-318
RAMP_END = 1e-5
"""Distance [rad] by which a ramp of the reference may overshoot its end."""
TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


def pose(robot: ModuleType, **changed: Any) -> np.ndarray:
    """Return the tip's pose at Q, with a factor of the position, another rotation, an entry, or transposed."""
    H = np.array(robot.forward_kinematics(Q))
    H[:3, 3] *= changed.get("scale", 1.0)
    H[:3, :3] = H[:3, :3] @ changed.get("rotation", np.eye(3))
    H.flat[changed.get("entry", 0)] = changed.get("value", H.flat[changed.get("entry", 0)])
    return H.T if changed.get("transposed") else H


def with_entry(K: np.ndarray, entry: int, value: float) -> np.ndarray:
    changed = np.array(K, float)
    changed.flat[entry] = value
    return changed


STIFFNESS = [
    ("STIFFNESS_LIMIT", "translation_stiffness", np.diag([1.0, LIMIT * (1 + 1e-10), 1.0]), 4),
    ("STIFFNESS_LIMIT", "translation_stiffness", np.diag([1.0, 1.0, LIMIT * (1 + 4e-16)]), 8),
    ("STIFFNESS_LIMIT", "translation_stiffness", np.full((3, 3), 1e300), 0),
    ("STIFFNESS_LIMIT", "rotation_stiffness", np.diag([1.0, 1.0, 1e4]), 8),
    ("STIFFNESS_LIMIT", "rotation_stiffness", np.diag([1.0, -1e4, 1.0]), 4),
    ("ASYMMETRIC", "rotation_stiffness", with_entry(30 * np.eye(3), 1, 5.0), 1),
    ("ASYMMETRIC", "translation_stiffness", with_entry(500 * np.eye(3), 7, 1e-3), 5),
    ("ASYMMETRIC", "translation_stiffness", 100 * (np.eye(3) + TURN), 1),
    ("INDEFINITE", "translation_stiffness", np.diag([500.0, 500.0, -1.0]), 0),
    ("INDEFINITE", "rotation_stiffness", with_entry(with_entry(20 * np.eye(3), 1, 30.0), 3, 30.0), 0),
    ("INDEFINITE", "translation_stiffness", np.diag([DENORMAL, -DENORMAL, DENORMAL]), 0),
    ("NOT_FINITE", "translation_stiffness", np.full((3, 3), np.nan), 0),
    ("NOT_FINITE", "translation_stiffness", with_entry(KT, 5, np.inf), 5),
    ("NOT_FINITE", "rotation_stiffness", with_entry(KO, 8, -np.nan), 8),
]
POSES: list[tuple[str, dict[str, Any], int]] = [
    ("REACH", {"scale": 1000.0}, 3),
    ("REACH", {"scale": 100.0}, 3),
    ("REACH", {"scale": 6.0}, 3),
    ("REACH", {"scale": 1e300}, 3),
    ("LAST_ROW", {"transposed": True}, 12),
    ("LAST_ROW", {"entry": 15, "value": 0.0}, 15),
    ("LAST_ROW", {"entry": 14, "value": -0.01}, 14),
    ("LEFT_HANDED", {"rotation": np.diag([1.0, 1.0, -1.0])}, 0),
    ("LEFT_HANDED", {"rotation": -np.eye(3)}, 0),
    ("ROTATION", {"rotation": 2 * np.eye(3)}, 0),
    ("ROTATION", {"rotation": np.zeros((3, 3))}, 0),
    ("ROTATION", {"rotation": np.degrees(TURN)}, 0),
    ("ROTATION", {"rotation": 1e200 * np.eye(3)}, 0),
    ("NOT_FINITE", {"scale": np.nan}, 3),
    ("NOT_FINITE", {"entry": 6, "value": -np.inf}, 6),
    ("NOT_FINITE", {"entry": 15, "value": np.nan}, 15),
]


@pytest.fixture
def controller(robot: ModuleType) -> Any:
    """Return a controller that is engaged at Q and only reports."""
    controller = robot.Impedance(motor_inertia=0.1, errors="ignore")
    for _ in range(5):
        controller.step(q=Q, dq=ZERO, q0=Q, **SPRING)
    return controller


def check(robot: ModuleType, controller: Any, out: Any, refusal: str, argument: str, entry: int) -> None:
    """Check the record of a refusal, that equilibrium and stiffness stay, and that the next command clears it."""
    assert out.status & robot.Status.COMMAND_REFUSED and not out.fault
    assert (out.refusal.name, out.refusal_entry) == (refusal, entry)
    assert np.isfinite([out.refusal_seen, out.refusal_limit]).all()
    assert f"refused: {argument}" in out.text, out.text
    np.testing.assert_array_equal(out.reference, Q)
    np.testing.assert_array_equal(out.translation_stiffness, KT)
    good = controller.step(q=Q, dq=ZERO, q0=Q, **SPRING)
    assert not good.status & robot.Status.COMMAND_REFUSED and "refused" not in good.text
    record = (good.refusal, good.refusal_argument, good.refusal_entry, good.refusal_seen, good.refusal_limit)
    assert record == (0, 0, -1, 0.0, 0.0)


@pytest.mark.parametrize(("refusal", "argument", "value", "entry"), STIFFNESS)
def test_stiffness(
    robot: ModuleType, controller: Any, refusal: str, argument: str, value: np.ndarray, entry: int
) -> None:
    """The controller and the policy port name the same argument, entry and numbers."""
    out = controller.step(q=Q, dq=ZERO, q0=Q, **{**SPRING, argument: value})
    check(robot, controller, out, refusal, argument, entry)
    if refusal == "STIFFNESS_LIMIT":
        limit = LIMIT if argument == "translation_stiffness" else ROTATION_LIMIT
        assert (out.refusal_seen, out.refusal_limit) == (value.flat[entry], limit)
        assert ("apart by" in out.text) == (0 < value.flat[entry] - limit < 1e-3), out.text
    if refusal == "INDEFINITE":
        assert out.refusal_seen == pytest.approx(np.linalg.eigvalsh(value)[0], rel=1e-6)
    if refusal == "ASYMMETRIC":
        assert out.refusal_seen == pytest.approx(np.abs(value - value.T).flat[entry])
    port = robot.Policy(controller, pose=pose(robot), now=0.0)
    port.propose(now=0.1, time=0.1, **{"translation_stiffness": KT, "rotation_stiffness": KO, argument: value})
    assert port.refusals == {"stiffness": out.text.split("refused: ")[1].split("\n")[0]}
    assert not port.propose(now=0.2, time=0.2, translation_stiffness=KT, rotation_stiffness=KO)
    assert port.refusals == {}


@pytest.mark.parametrize("size", [0.0, 5e-324, DENORMAL, 1e-300, 1e-12, LIMIT])
def test_a_stiffness_of_any_size_is_accepted(robot: ModuleType, controller: Any, size: float) -> None:
    """Before: 7e-318 N/m was called indefinite, since its reciprocal overflows."""
    for unit in (np.eye(3), np.diag([1.0, 0.0, 0.0]), 0.99 * TURN @ np.diag([1.0, 0.5, 0.0]) @ TURN.T):
        out = controller.step(q=Q, dq=ZERO, q0=Q, **{**SPRING, "translation_stiffness": size * unit})
        assert not out.refusal and not out.status & robot.Status.COMMAND_REFUSED, out.text
        port = robot.Policy(controller, pose=pose(robot), now=0.0)
        assert not port.propose(now=0.1, time=0.1, translation_stiffness=size * unit, rotation_stiffness=KO)
    for _ in range(300):
        out = controller.step(q=Q + 0.01, dq=ZERO, q0=Q, **{**SPRING, "translation_stiffness": size * np.eye(3)})
        assert np.isfinite(out.torque).all()


@pytest.mark.parametrize(("refusal", "changed", "entry"), POSES)
def test_poses(robot: ModuleType, controller: Any, refusal: str, changed: dict[str, Any], entry: int) -> None:
    out = controller.step(q=Q, dq=ZERO, equilibrium=pose(robot, **changed), posture=Q, **SPRING)
    check(robot, controller, out, refusal, "equilibrium", entry)
    port = robot.Policy(controller, pose=pose(robot), now=0.0)
    port.propose(now=0.1, time=0.1, equilibrium=pose(robot, **changed))
    assert port.refusals == {"pose": out.text.split("refused: ")[1].split("\n")[0]}
    assert not port.propose(now=0.2, time=0.2, equilibrium=pose(robot)) and not port.refusals


def test_reach_is_that_of_the_arm(robot: ModuleType, controller: Any) -> None:
    """A metre more than the arm can reach; a pose just out of reach is followed as far as it goes."""
    out = controller.step(q=Q, dq=ZERO, equilibrium=pose(robot, scale=6.0), posture=Q, **SPRING)
    assert out.refusal_seen == pytest.approx(6 * np.linalg.norm(pose(robot)[:3, 3]))
    random = np.random.default_rng(1).uniform(robot.LOWER, robot.UPPER, (20000, 7))
    farthest = np.linalg.norm(robot.forward_kinematics(random)[:, :3, 3], axis=1).max()
    assert farthest + 1 < out.refusal_limit < 1.2 * farthest + 1
    out = controller.step(q=Q, dq=ZERO, equilibrium=pose(robot, scale=2.0), posture=Q, **SPRING)
    assert not out.refusal and not out.status & robot.Status.COMMAND_REFUSED


def position(robot: ModuleType, joint: int, side: float, beyond: float) -> np.ndarray:
    """Return Q with one joint beyond its limit."""
    limits = robot.UPPER if side > 0 else robot.LOWER
    return with_entry(Q, joint, limits[joint] + side * beyond)


@pytest.mark.parametrize(("joint", "side", "beyond"), [(3, 1, 0.2), (0, -1, 0.1001), (6, 1, 6.28), (1, -1, 1e5)])
def test_positions_beyond_limits(robot: ModuleType, controller: Any, joint: int, side: float, beyond: float) -> None:
    q0 = position(robot, joint, side, beyond)
    limit = (robot.UPPER if side > 0 else robot.LOWER)[joint]
    for command in ({"q0": q0}, {"equilibrium": pose(robot), "posture": q0}):
        out = controller.step(q=Q, dq=ZERO, **command, **SPRING)
        assert not out.status & robot.Status.COMMAND_LIMITED
        assert (out.refusal_seen, out.refusal_limit) == (q0[joint], limit)
        check(robot, controller, out, "POSITION", f"q0 of {robot.JOINTS[joint]}", joint)


@pytest.mark.parametrize("value", [np.nan, -np.nan, np.inf, -1e300])
def test_positions_that_are_no_numbers(robot: ModuleType, controller: Any, value: float) -> None:
    out = controller.step(q=Q, dq=ZERO, q0=with_entry(Q, 5, value), **SPRING)
    check(robot, controller, out, "NOT_FINITE", f"q0 of {robot.JOINTS[5]}", 5)


def test_degrees_for_radians(robot: ModuleType, controller: Any) -> None:
    out = controller.step(q=Q, dq=ZERO, q0=np.degrees(Q), **SPRING)
    check(robot, controller, out, "POSITION", f"q0 of {robot.JOINTS[0]}", 0)


def follow(robot: ModuleType, controller: Any, start: np.ndarray, q0: np.ndarray, limited: int) -> np.ndarray:
    """Let an arm follow the reference from a position; return where it rests. limited: a joint, or -1."""
    q, dq = start, ZERO
    for _ in range(9000):
        out = controller.step(q=q, dq=dq, q0=q0, **SPRING)
        q, dq = out.reference, (out.reference - q) / 1e-3
        assert not out.refusal and not out.fault and out.limited_joint == limited
        assert bool(out.status & robot.Status.COMMAND_LIMITED) == (limited >= 0)
    assert ("limit's zone" in out.text) == (limited >= 0)
    return np.asarray(q)


@pytest.mark.parametrize(("joint", "side", "beyond"), [(3, 1, 0.09), (1, -1, 1e-4)])
def test_positions_a_little_beyond_are_followed_to_the_zone(
    robot: ModuleType, controller: Any, joint: int, side: float, beyond: float
) -> None:
    """The arm rests where the limit avoidance begins. From the limit it does not move back: a stream makes no jump."""
    limit = (robot.UPPER if side > 0 else robot.LOWER)[joint]
    zone, q0 = limit - side * controller.config.limit_zone, position(robot, joint, side, beyond)
    rest = follow(robot, controller, Q, q0, joint)
    np.testing.assert_allclose(rest, with_entry(Q, joint, zone), atol=RAMP_END)
    at_limit = follow(robot, controller, rest, position(robot, joint, side, 0.0), -1)
    np.testing.assert_allclose(at_limit, with_entry(Q, joint, limit), atol=RAMP_END)
    np.testing.assert_allclose(follow(robot, controller, at_limit, q0, joint), at_limit, atol=RAMP_END)


def test_a_start_beyond_a_limit_goes_to_the_limit(robot: ModuleType) -> None:
    """The command is where the arm is: it goes back by no more than it is beyond."""
    start = position(robot, 3, 1, 0.01)
    rest = follow(robot, robot.Impedance(motor_inertia=0.1), start, start, 3)
    np.testing.assert_allclose(rest, position(robot, 3, 1, 0.0), atol=RAMP_END)


def test_a_limit_in_single_precision_is_the_limit(robot: ModuleType, controller: Any) -> None:
    rest = follow(robot, controller, Q, position(robot, 0, -1, 3e-7), -1)
    np.testing.assert_allclose(rest, position(robot, 0, -1, 0.0), atol=RAMP_END)


def test_wrenches(robot: ModuleType, controller: Any) -> None:
    """A wrench is refused by itself: the command is followed."""
    port = robot.Policy(controller, pose=pose(robot), now=0.0)
    for k, (wrench, refusal, entry) in enumerate(
        [
            ([200.0, 0, 0, 0, 0, 0], "WRENCH", 0),
            ([0.0, 0, 0, 0, -20.001, 0], "WRENCH", 3),
            ([0.0, np.nan, 0, 0, 0, 0], "NOT_FINITE", 0),
            ([0.0, 0, 0, 0, 0, 1e300], "NOT_FINITE", 3),
        ]
    ):
        out = controller.step(q=Q, dq=ZERO, q0=Q, wrench_command=wrench, **SPRING)
        assert not out.status & robot.Status.COMMAND_REFUSED and out.status & robot.Status.FEEDFORWARD_REFUSED
        assert (out.refusal.name, out.refusal_entry) == (refusal, entry)
        assert out.text.split("refused: ")[1].startswith("wrench_command, entry")
        port.propose(now=0.1 * k, time=0.1 * k, wrench_command=wrench)
        assert port.refusals == {"wrench": out.text.split("refused: ")[1].split("\n")[0]}
    rounded = np.array([1.0, 1, 1, 0, 0, 0]) * (100.00000000000001 / np.sqrt(3))
    assert not controller.step(q=Q, dq=ZERO, q0=Q, wrench_command=rounded, **SPRING).refusal


def test_refusals_of_the_port_alone(robot: ModuleType, controller: Any) -> None:
    """A coupled stiffness has numbers, a time stamp its reason."""
    port, K = robot.Policy(controller, pose=pose(robot), now=0.0), np.diag([400.0, 400, 400, 20, 20, 20])
    K[1, 4] = K[4, 1] = 3.0
    port.propose(now=0.1, time=0.1, stiffness=K)
    assert port.refusals["stiffness"].startswith("stiffness, entry 10: the springs do not couple")
    assert "seen 3, limit 8.94" in port.refusals["stiffness"]
    port.propose(now=0.1, time=np.nan, equilibrium=pose(robot))
    assert port.refusals == {"pose": "time"}


def test_a_bad_sample_refuses_without_a_reason(robot: ModuleType, controller: Any) -> None:
    """No command is taken with it, whether it is possible or not, and nobody is told of the command."""
    out = controller.step(q=ZERO * np.nan, dq=ZERO, q0=np.full(7, 50.0), **SPRING)
    assert not out.refusal
    assert controller.step(q=Q + 1.0, dq=ZERO, q0=Q, **SPRING).refusal == robot.Refusal.NONE


def test_python_warns_once_or_raises(robot: ModuleType) -> None:
    """A refusal of another kind warns anew; the same one with another value does not."""
    controller = robot.Impedance(motor_inertia=0.1)
    given = {"q": Q, "dq": ZERO, **SPRING}
    with pytest.warns(
        robot.CommandWarning, match=f"command refused: q0 of {robot.JOINTS[0]}: beyond the joint's limit.*; seen"
    ):
        controller.step(q0=np.full(7, 50.0), **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller.step(q0=np.full(7, 60.0), **given)
    with pytest.warns(robot.CommandWarning, match="not finite, or absurdly large$"):
        controller.step(q0=ZERO * np.nan, **given)
    script = robot.Impedance(motor_inertia=0.1, errors="raise")
    script.step(q0=Q, **given)
    with pytest.raises(ValueError, match="command refused: translation_stiffness, entry 0: above"):
        script.step(q0=Q, **{**given, "translation_stiffness": 1e6 * np.eye(3)})
    with pytest.raises(ValueError, match="warn, raise or ignore"):
        robot.Impedance(errors="quiet")


@pytest.mark.slow
def test_reach_with_slides_tools_and_two_tips(tmp_path: Path) -> None:
    """A slide adds its travel, a tool its length. The port knows no tool, and leaves the reach to the step."""
    urdf = ROOT / "tests" / "data" / "dual_arm.urdf"
    folder = stiffgen.generate(urdf, tip=["left hand", "right-hand"], output=tmp_path, runtime_tool=True)
    arm = open_robot(folder).module
    q, tools, limits = (arm.LOWER + arm.UPPER) / 2, np.tile(np.eye(4), (2, 1, 1)), []
    kernels = (arm.left_hand.forward_kinematics, arm.right_hand.forward_kinematics)
    given: dict[str, Any] = {"q": q, "dq": 0 * q, "posture": q}
    given |= {"translation_stiffness": np.stack([KT, KT]), "rotation_stiffness": np.stack([KO, KO])}
    for length in (0.0, 3.0):
        tools[1, 2, 3] = length
        controller = arm.Impedance(motor_inertia=0.3, errors="ignore")
        here = np.stack([kernels[k](q, tools[k]) for k in (0, 1)])
        far = here.copy()
        far[1, 0, 3] += 100.0
        assert not controller.step(equilibrium=here, tool_pose=tools, **given).refusal
        out = controller.step(equilibrium=far, tool_pose=tools, **given)
        assert (out.refusal, out.refusal_entry) == (arm.Refusal.REACH, 19)
        limits.append(out.refusal_limit)
        port = arm.Policy(controller, pose=here, now=0.0)
        assert not port.propose(now=0.1, time=0.1, equilibrium=far)
    random = np.random.default_rng(1).uniform(arm.LOWER, arm.UPPER, (20000, arm.DOF))
    farthest = np.linalg.norm(kernels[1](random, np.eye(4))[:, :3, 3], axis=1).max()
    assert farthest + 1 < limits[0] < 1.6 * farthest + 1
    assert limits[1] == pytest.approx(limits[0] + 3.0)
    tools[1, :3, :3] *= -1
    out = controller.step(equilibrium=here, tool_pose=tools, **given)
    assert (out.refusal, out.refusal_entry) == (arm.Refusal.LEFT_HANDED, 16) and "refused: tool_pose" in out.text
