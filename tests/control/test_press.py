# SPDX-License-Identifier: MIT
"""Press: a force along an axis with a sensor's wrench, on simulated arms and by its rules."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from support.arms.arms import Arm
from support.project import Once

Q = np.array([0.3, 0.6, -0.4, -1.3, 0.2, 0.9, -0.5])
SPRINGS = {"translation_stiffness": 600.0 * np.eye(3), "rotation_stiffness": 30.0 * np.eye(3)}
STATED = {"sample_time": 1e-3, "delay_samples": 1, "motor_inertia": 0.1, "heaviest_wrench": (100.0, 20.0)}
AXIS = np.array([0.6, 0.0, -0.8])


class Pressed:
    """Press before a controller whose arm stands still; the sensor says what it is told."""

    def __init__(self, robot: ModuleType, **fields: Any) -> None:
        self.controller = robot.Impedance(**STATED, position_quantum=2e-6)
        self.press = robot.Press(self.controller, **fields)
        self.pose = robot.forward_kinematics(Q)
        self.last = self.controller.step(q=Q, dq=0 * Q, q0=Q, counter=0, **SPRINGS)

    def step(self, felt: float, force: float = 15.0, **inputs: Any) -> Any:
        """Return the result of a step with a force felt against the axis [N]."""
        wrench = np.r_[-felt * AXIS, 0.0, 0.0, 0.0]
        given = {"pose": self.pose, "last": self.last, "wrench": wrench, "axis": AXIS, "force": force}
        return self.press.step(**(given | SPRINGS | inputs))

    def run(self, steps: int, felt: float, **inputs: Any) -> Any:
        for _ in range(steps):
            made = self.step(felt, **inputs)
        return made

    def ahead(self, made: Any) -> float:
        """Return how far the pose is before the commanded one along the axis [m]; beside it, nothing."""
        moved = made.pose[:3, 3] - self.pose[:3, 3]
        np.testing.assert_allclose(np.cross(moved, AXIS), 0.0, atol=1e-12)
        np.testing.assert_array_equal(made.pose[:3, :3], self.pose[:3, :3])
        return float(moved @ AXIS)


def test_an_approach_is_slow_and_stays_near_the_tip(robot: ModuleType) -> None:
    """3 cm/s along the axis, and at most 3 cm before the tip."""
    pressed = Pressed(robot)
    assert pressed.ahead(pressed.run(100, 0.0)) == pytest.approx(0.003)
    made = pressed.run(2000, 0.0)
    assert pressed.ahead(made) == pytest.approx(0.03)
    assert made.stage == robot.PressStage.APPROACH and not made.wrench_command.any()


def test_contact_integrates_and_hands_over(robot: ModuleType) -> None:
    """Touch for three samples: contact begins; then force and spring grow by the gain until the spring bears all."""
    pressed = Pressed(robot)
    start = pressed.ahead(pressed.run(99, 0.0))
    assert pressed.run(2, 4.0).stage == robot.PressStage.APPROACH  # two samples of 4 N are not yet a contact
    made = pressed.run(1, 4.0)
    assert made.stage == robot.PressStage.CONTACT
    start = pressed.ahead(made)
    made = pressed.run(50, 10.0)
    np.testing.assert_allclose(np.cross(made.wrench_command[:3], AXIS), 0.0, atol=1e-12)
    grown = float(made.wrench_command[:3] @ AXIS) + 600.0 * (pressed.ahead(made) - start)
    assert 4.0 < pressed.press.gain < 20.0  # [1/s]
    # 50 samples of 1 ms at an error of 15 - 10 N; 600 N/m is the spring's stiffness.
    assert grown == pytest.approx(50 * 1e-3 * pressed.press.gain * 5.0, rel=1e-9)
    made = pressed.run(3000, 15.0)  # handed over
    assert abs(made.wrench_command[:3] @ AXIS) < 1e-3 and pressed.ahead(made) > start


@pytest.mark.parametrize("search", [False, True])
def test_lost_contact(robot: ModuleType, search: bool) -> None:
    """0.15 s without a force: the pose is at the tip, without a wrench; it stops there, or looks again."""
    pressed = Pressed(robot)
    pressed.run(103, 10.0)
    stages = [pressed.step(0.0, search=search).stage for _ in range(151)]
    assert stages[148] == robot.PressStage.CONTACT
    made = pressed.run(500, 0.0, search=search)
    assert made.stage == (robot.PressStage.APPROACH if search else robot.PressStage.LOST)
    assert not made.wrench_command.any()
    assert pressed.ahead(made) == pytest.approx(0.015 if search else 0.0, abs=6e-4)
    if not search:  # a force of 0 ends it, and the next one begins anew
        assert pressed.run(2, 0.0, force=0.0).stage == robot.PressStage.OFF
        assert pressed.run(1, 0.0).stage == robot.PressStage.APPROACH


def test_what_is_refused(robot: ModuleType) -> None:
    """Give bad axes, forces [N] and wrenches: each is refused and named."""
    pressed = Pressed(robot)
    for match, inputs in (
        ("axis", {"axis": (0.0, 0.0, 0.0)}),
        ("axis", {"axis": (0.0, np.nan, 1.0)}),
        ("force", {"force": -1.0}),
        ("force", {"force": 51.0}),
        ("not finite", {"wrench": np.full(6, np.inf)}),
    ):
        with pytest.raises(ValueError, match=match):
            pressed.step(0.0, **inputs)
    with pytest.raises(TypeError, match="there are: approach_speed"):
        robot.Press(pressed.controller, speed=1)


@pytest.fixture(scope="module")
def iiwa(once: Once) -> Arm:
    folder = once("arms-iiwa14", lambda folder: Arm("iiwa14", folder))
    return Arm("iiwa14", folder)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e3, 1e5])
def test_a_wall_feels_the_force(iiwa: Arm, stiffness: float) -> None:
    """Press on any wall: 15 N within 0.4 N rms, and an impact of at most 35 N; the short form of the campaign."""
    samples, random = 6000, np.random.default_rng(1)
    pose = iiwa.module.forward_kinematics(iiwa.posture)
    plant = iiwa.plant(
        flexible=True, makers=1, wall_stiffness=stiffness, wall_point=pose[:3, 3] - [0, 0, 0.02], wrench_delay=1
    )
    # noise [N, N m]; axis and force [N] to press
    noise, press = 0.3 * random.normal(size=(samples, 6)), (0.0, 0.0, -1.0, 15.0, 0.0)
    config = iiwa.config(position_quantum=1e-6)
    rows = iiwa.run(plant, samples, config, goal=iiwa.posture, pose=pose, press=press, wrench_noise=noise)
    force = rows["contact"][:, 2]
    error = float(np.sqrt(np.mean((force[-2000:] - 15.0) ** 2)))
    print(f"{stiffness:g} N/m: {error:.2f} N rms, impact {force.max():.1f} N")
    assert not rows["faulted"].any()
    assert error <= 0.4 and force.max() <= 35.0


def pressed_rows(arm: Arm, samples: int, axis: tuple[float, float, float], stiffness: float, **plant: float) -> Any:
    """Return the rows of an arm whose tip presses with 15 N on a wall of 1e4 N/m that is 2 cm away, if it is down."""
    pose = arm.module.forward_kinematics(arm.posture)
    wall = {"wall_stiffness": 1e4, "wall_point": pose[:3, 3] - [0, 0, 0.02], "wrench_delay": 1}
    noise, press = 0.3 * np.random.default_rng(1).normal(size=(samples, 6)), (*axis, 15.0, 1.0)
    sensors = arm.maker.sensors
    config = arm.config(position_quantum=sensors.position_quantum, velocity_noise=sensors.velocity_noise)
    return arm.run(
        arm.plant(flexible=True, makers=1, **wall, **plant), samples, config, goal=arm.posture, pose=pose,
        press=press, wrench_noise=noise, translation=stiffness,
    )  # fmt: skip


def test_a_slow_approach_has_its_time(robot: ModuleType) -> None:
    """5 s count from where the pose is 27 mm before a tip that stands, 5.4 s at 5 mm/s: not from contact's 3 N on."""
    pressed = Pressed(robot, approach_speed=0.005)
    follow, stages = robot.Follow(Q, sample_time=1e-3), []
    for counter in range(1, 11000):
        made = pressed.step(0.0)
        q0 = follow.step(pose=made.pose).q0
        pressed.last = pressed.controller.step(q=Q, dq=0 * Q, q0=q0, shaped=True, counter=counter, **SPRINGS)
        stages.append(made.stage)
    assert 10.3 < 1e-3 * stages.index(robot.PressStage.DOUBTED) < 10.5


@pytest.mark.slow
def test_an_approach_on_a_sensor_that_says_nothing_ends(iiwa: Arm) -> None:
    """Press with a sensor that says nothing: 3 cm of spring, 18 N, for 5 s, and then no force; before, for good."""
    rows = pressed_rows(iiwa, 9000, (0.0, 0.0, -1.0), 600.0, wrench_gain=0.0)
    force = rows["contact"][:, 2]
    print(f"most {force.max():.1f} N, for {1e-3 * (force > 9.0).sum():.1f} s, at the end {force[-500:].mean():.1f} N")
    assert rows["detail"][-1, 1] == iiwa.module.PressStage.DOUBTED
    assert 15.0 < force.max() < 20.0 and (force > 9.0).sum() < 6000 and force[-500:].max() < 1.0


@pytest.mark.slow
def test_friction_ends_no_approach(once: Once) -> None:
    """Approach with a UR5's friction, some 20 N at the tip, against 9 N of spring: the tip creeps on."""
    ur5 = Arm("ur5", once("arms-ur5", lambda folder: Arm("ur5", folder)))
    rows = pressed_rows(ur5, 9000, (0.0, 1.0, 0.0), 300.0)
    way = 1e3 * (rows["pose"].reshape(-1, 4, 4)[[2000, -1], 1, 3] - rows["pose"].reshape(-1, 4, 4)[0, 1, 3])
    print(f"{way[0]:.1f} mm in 2 s, {way[1]:.1f} mm in 9 s")
    assert way[1] - way[0] < 60.0  # 210 mm without friction
    assert (rows["detail"][1:, 1] == ur5.module.PressStage.APPROACH).all()


@pytest.mark.slow
def test_a_sensor_that_says_too_little(iiwa: Arm) -> None:
    """Freeze the sensor in contact, or let it say a fifth: the tip lets go before 80 N."""
    down = (0.0, 0.0, -1.0)
    touched = int(np.argmax(pressed_rows(iiwa, 8000, down, 600.0)["contact"][:, 2] > 5.0))
    for fault in ({"wrench_last": touched}, {"wrench_gain": 0.2}):
        rows = pressed_rows(iiwa, 8000, down, 600.0, **fault)
        force = rows["contact"][:, 2]
        print(f"{fault}: most {force.max():.1f} N, at the end {force[-500:].mean():.1f} N")
        assert rows["detail"][-1, 1] == iiwa.module.PressStage.DOUBTED
        assert force.max() <= 80.0 and force[-500:].mean() < 1.0
