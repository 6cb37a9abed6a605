# SPDX-License-Identifier: MIT
"""Springs between two tips, and absolute springs of both, in the controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.control.sessions import check_controller
from stiffgen.control.sessions.law import pair_energy
from stiffgen.core.opened import GeneratedRobot, open_robot
from support.project import ROOT, Once

DUAL = ROOT / "tests" / "data" / "dual_arm.urdf"
STATED = {"sample_time": 1e-3, "delay_samples": 0, "motor_inertia": 0.5, "heaviest_wrench": (200.0, 50.0)}
WIDE = {"velocity_limit": 10.0, "effort_limit": 1e3, "torque_rate_limit": 1e6, "tip_velocity_limit": 10.0}
Q = np.array([0.2, 0.5, 0.7, -0.4, 0.6])


def made(once: Once, name: str, **options: Any) -> GeneratedRobot:
    """Return a dual arm with the spring from its right to its left hand, generated once for all workers."""

    def make(folder: Path) -> None:
        chosen: dict[str, Any] = {
            "tip": ["left hand", "right-hand"],
            "pairs": ["right-hand:left hand"],
            "batches": False,
        } | options
        stiffgen.generate(DUAL, name=name, output=folder, **chosen)

    return open_robot(once(f"pair-{name}", make) / name)


@pytest.fixture(scope="module")
def dual(once: Once) -> GeneratedRobot:
    return made(once, "dual")


def stiff(number: float, *springs: int) -> dict[str, np.ndarray]:
    """Return stiffnesses of some of the four springs: tips, pair, absolute."""
    of = np.isin(np.arange(4), springs)[:, None, None]
    return {"translation_stiffness": of * number * np.eye(3), "rotation_stiffness": of * 0.05 * number * np.eye(3)}


def engaged(robot: GeneratedRobot, springs: dict[str, np.ndarray], samples: int = 200, **given: Any) -> Any:
    """Return the last step of a held arm, whose springs are in force."""
    controller = robot.module.Impedance(**STATED, **WIDE, position_quantum=1e-5, errors="raise")
    rest = {"q": Q, "dq": np.zeros(5), "q0": Q, "posture_stiffness": 0.0}
    for counter in range(samples):
        out = controller.step(counter=counter, **{**rest, **given}, **springs)
    return out


def test_every_term_is_that_of_the_law(dual: GeneratedRobot) -> None:
    """Tips, pair and absolute spring at once: torque, stored energy, damping, wrench that holds the reference back."""
    checks = check_controller(dual, 1)
    assert len(checks) > 10 and all(check.passed for check in checks), checks


@pytest.mark.slow
def test_bounded_springs_and_tools(once: Once) -> None:
    """Compare bounded springs of a pair, tips named the other way round, each with a tool."""
    robot = made(once, "tooled", springs=("bounded",), runtime_tool=True)
    checks = check_controller(robot, 2)
    assert len(checks) > 10 and all(check.passed for check in checks), checks
    soft = robot.module.Impedance(**STATED, **WIDE, spring_limit=(5.0, 1.0))
    moved = Q + np.array([0.0, 0.3, 0.0, 0.0, 0.0])
    for counter in range(3):
        rest = {"dq": np.zeros(5), "q0": Q, "posture_stiffness": 0.0}
        out = soft.step(counter=counter, q=Q if counter < 2 else moved, **rest, **stiff(400.0, 2))
    assert 0 < np.abs(out.own_torque).max() < 20.0
    limited_springs_are_those_of_the_kernels(robot)


def limited_springs_are_those_of_the_kernels(robot: GeneratedRobot) -> None:
    """Return whether energy and torque of both springs at their limits are those of the kernels."""
    module, limits, off = robot.module, (5.0, 1.0), Q + np.array([0.1, 0.3, -0.2, 0.2, 0.1])
    tools = np.tile(np.eye(4), (2, 1, 1))
    tools[0, :3, 3], tools[1, :3, :3] = (0.1, -0.05, 0.2), np.diag([-1.0, -1.0, 1.0])
    controller = module.Impedance(**STATED, **WIDE, spring_limit=limits, tool_pose=tools, position_quantum=1e-5)
    for counter in range(300):
        share = np.clip((counter - 50) / 200, 0.0, 1.0)  # the arm is moved within 0.2 s
        at = {"q": Q + share * (off - Q), "dq": (off - Q) / 0.2 if 0 < share < 1 else np.zeros(5)}
        out = controller.step(counter=counter, **at, q0=Q, posture_stiffness=0.0, **stiff(400.0, 2, 3))
    left, right = module.left_hand.forward_kinematics(Q, tools[0]), module.right_hand.forward_kinematics(Q, tools[1])
    rest, middle = np.linalg.inv(right) @ left, right.copy()
    middle[:3, 3] = (left[:3, 3] + right[:3, 3]) / 2
    given = off, tools[::-1]
    K = 400.0 * np.eye(3), 20.0 * np.eye(3)
    energy = module.pair_bounded.energy(*given, rest, *K, *limits) + module.absolute.energy(*given, middle, rest, *K)
    assert out.stored == pytest.approx(float(energy), rel=1e-12)
    torque = module.pair_bounded.torque(*given, rest, *K, *limits) + module.absolute.torque(*given, middle, rest, *K)
    np.testing.assert_allclose(out.own_torque / out.scale, torque, rtol=1e-9)


def test_the_pair_leaves_common_motion_alone(dual: GeneratedRobot) -> None:
    """Turn the joint that carries both arms: nothing is stored between the hands; the absolute spring resists."""
    turned = Q + 0.1 * (np.arange(5) == 0)
    controllers = [dual.module.Impedance(**STATED, **WIDE, position_quantum=1e-5) for _ in range(2)]
    stored = []
    for controller, spring in zip(controllers, (2, 3), strict=True):
        for counter in range(100):
            # 50 ms of rest, then 0.1 rad in 50 ms
            q = Q if counter < 50 else Q + (turned - Q) * min(1.0, (counter - 49) / 50)
            dq = (turned - Q) / 0.05 if 50 <= counter < 99 else np.zeros(5)
            out = controller.step(counter=counter, q=q, dq=dq, q0=Q, posture_stiffness=0.0, **stiff(400.0, spring))
        stored.append(float(out.stored))
    assert stored[0] < 1e-12 < 0.1 < stored[1]


def test_a_squeeze_is_internal(dual: GeneratedRobot) -> None:
    """Command a wrench of the pair: B gets it in A's axes, A its reaction; common joints get nothing."""
    squeeze = np.zeros((3, 6))
    squeeze[2] = (3.0, -20.0, 5.0, 0.4, 0.2, -0.3)  # [N], [N m]; rows 0 and 1 are the tips', 2 the pair's
    out = engaged(dual, stiff(400.0, 2, 3), wrench_command=squeeze)
    assert not out.fault and abs(out.feedforward_torque[0]) < 1e-12
    module = dual.module
    a, b = module.right_hand.forward_kinematics(Q), module.left_hand.forward_kinematics(Q)
    f, m = a[:3, :3] @ squeeze[2, :3], a[:3, :3] @ squeeze[2, 3:]  # in base axes
    on_a = -np.concatenate([f, m + np.cross(b[:3, 3] - a[:3, 3], f)])
    expected = module.left_hand.hybrid.jacobian(Q).T @ np.concatenate([f, m])
    expected = expected + module.right_hand.hybrid.jacobian(Q).T @ on_a
    np.testing.assert_allclose(out.feedforward_torque, expected, rtol=1e-12, atol=1e-12)
    assert np.abs(expected).max() > 1.0


@pytest.mark.parametrize(
    ("way", "heavier"), [((0, 0.3, -0.2, 0.2, 0.1), 1), ((0.3, 0, 0, 0.3, 0.3), 0)], ids=["B", "A"]
)
def test_each_hand_counts_for_the_heaviest_wrench_and_the_purse(
    way: tuple[float, ...], heavier: int, dual: GeneratedRobot
) -> None:
    """Pull on one hand: the reference moves as far as the heavier springs may pull, and each joule is supplied."""
    module, heaviest = dual.module, (20.0, 5.0)  # [N], [N m] to which the reference is held
    controller = module.Impedance(
        **STATED | {"heaviest_wrench": heaviest}, **WIDE, position_quantum=1e-5, tank_initial=1e3
    )
    for counter in range(1500):
        q0 = Q if counter < 50 else Q + np.array(way)
        out = controller.step(counter=counter, q=Q, dq=np.zeros(5), q0=q0, posture_stiffness=0.0, **stiff(400.0, 2, 3))
    a, b = module.right_hand.forward_kinematics(out.reference), module.left_hand.forward_kinematics(out.reference)
    middle, K = a.copy(), (400.0 * np.eye(3), 20.0 * np.eye(3))
    middle[:3, 3] = (a[:3, 3] + b[:3, 3]) / 2
    wrenches = np.reshape(module.bimanual.wrench(Q, middle, np.linalg.inv(a) @ b, *K, *K), (2, 2, 3))
    loads = np.linalg.norm(np.linalg.norm(wrenches, axis=2) / heaviest, axis=1)  # share of each hand
    assert 0.999 < loads[heavier] <= 1.0 and loads[1 - heavier] < 0.9
    assert out.energy_supplied - 1e3 == pytest.approx(out.stored, rel=1e-9) and out.stored > 0.1


def test_an_asymmetric_stiffness_of_a_pair_is_refused_by_its_entry(dual: GeneratedRobot) -> None:
    springs = stiff(400.0, 2, 3)
    springs["rotation_stiffness"][3, 0, 1] = 5.0
    controller = dual.module.Impedance(**STATED, errors="ignore")
    out = controller.step(counter=0, q=Q, dq=np.zeros(5), q0=Q, **springs)
    assert (out.refusal.command, out.refusal.entry) == ("rotation_stiffness", 28)


def test_the_energy_is_that_of_the_generated_kernels(dual: GeneratedRobot) -> None:
    """Compare the energy of the comparison's law with that of the pair's own kernel."""
    module, random = dual.module, np.random.default_rng(3)
    Kt, Ko = (x @ x.T for x in random.normal(size=(2, 3, 3)))
    at, rest = Q, Q + 0.3 * random.normal(size=5)
    a, b, ra, rb = (tip.forward_kinematics(q) for q in (at, rest) for tip in (module.right_hand, module.left_hand))
    seen = np.linalg.inv(ra) @ rb
    assert pair_energy(a, b, (ra, rb), Kt, Ko) == pytest.approx(float(module.pair.energy(at, seen, Kt, Ko)), rel=1e-12)


def test_lines_of_the_page(dual: GeneratedRobot) -> None:
    """docs/whole_body.md: the hands squeeze an object."""
    page = (ROOT / "docs" / "whole_body.md").read_text()
    lines = page.split("### Two arms in the controller")[1].split("```python\n")[1].split("```")[0]
    module, q, dq = dual.module, Q.copy(), np.zeros(5)
    arms = module.Impedance(**STATED, position_quantum=1e-5, errors="raise")
    poses = np.array([tip.forward_kinematics(q) for tip in (module.left_hand, module.right_hand)])
    follow, object_pose, grasps = module.Follow(q, sample_time=1e-3), np.eye(4), poses
    found: dict[str, Any] = {}
    for k in range(60):
        given = {"np": np, "arms": arms, "follow": follow, "object_pose": object_pose, "grasps": grasps}
        exec(lines, given | {"k": k, "q": q, "dq": dq}, found)
        assert not found["out"].fault and not found["out"].refusal
    assert np.abs(found["out"].feedforward_torque).max() > 1.0
