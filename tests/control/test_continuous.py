# SPDX-License-Identifier: MIT
"""Joints without limits: measured positions and commands count modulo a turn."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import stiffgen
from stiffgen.control.page import controller_page
from stiffgen.core.lower.scalar import DOUBLE
from stiffgen.core.symbolic.placement import Placement
from support.controller_inputs import STATED, Arm
from support.small_robots import part, turning_arm

TURN = 2 * np.pi
START = np.array([2.8, 0.6, -2.9])
APART, FIRST = np.array([1.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
SPRING = {"translation_stiffness": 200 * np.eye(3), "rotation_stiffness": 10 * np.eye(3)}
MIMIC = '<mimic joint="one" multiplier="{}"/>'


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    folder = tmp_path_factory.mktemp("turning")
    (folder / "arm.urdf").write_text(turning_arm().urdf)
    chosen: dict[str, Any] = {"kernels": "limits", "batches": False, "tip": "three"}
    return stiffgen.open_robot(stiffgen.generate(folder / "arm.urdf", output=folder, **chosen)).module


def wrapped(q: Any) -> np.ndarray:
    """Return what an encoder shows that begins its turn again at half a turn."""
    return np.asarray((np.asarray(q) + np.pi) % TURN - np.pi)


def spin(robot: ModuleType, shown: Any, commanded: Any, steps: int = 3000, **config: Any) -> list[Any]:
    """Let the first joint make two turns, the last one back, under a load; `steps` are samples of 1 ms."""
    controller, arm, outs = robot.Impedance(**STATED, tip_velocity_limit=(10.0, 20.0), **config), Arm(robot, START), []
    for k in range(steps):
        q0 = START + max(0.0, 1e-3 * (k - 200)) * np.array([4.0, 0.0, -3.0])  # rates [rad/s] from 0.2 s on
        pushed = np.array([8.0, -5.0, 3.0, 0, 0, 0]) * (k > 1000)  # wrench [N, N m] on the tip from 1 s on
        outs.append(controller.step(q=shown(arm.q), dq=arm.dq, q0=commanded(q0, k), counter=k, **SPRING))
        arm.step(outs[-1].torque, pushed)
    return outs


@pytest.mark.slow
def test_a_wrapped_encoder_gives_the_torque_of_one_that_counts(turning: ModuleType) -> None:
    """Wrap the encoder of a turning joint: the torque of one that counts. Before, a jump of a turn was a fault."""
    counted = spin(turning, lambda q: q, lambda q0, k: q0)
    outs = spin(turning, wrapped, lambda q0, k: wrapped(q0))
    assert abs(counted[-1].position[[0, 2]] - START[[0, 2]]).min() > TURN
    for mine, other in zip(outs, counted, strict=True):
        assert not mine.fault and mine.status == other.status, mine.text
        np.testing.assert_allclose(mine.torque, other.torque, atol=1e-9)
        np.testing.assert_allclose(mine.position, other.position, atol=1e-12)
        np.testing.assert_allclose(mine.reference, other.reference, atol=1e-12)
        for energy in ("energy_supplied", "tank", "stored"):
            assert getattr(mine, energy) == pytest.approx(getattr(other, energy), abs=1e-9), energy


@pytest.mark.slow
def test_a_command_a_turn_away_is_the_same_command(turning: ModuleType) -> None:
    """Turns that change from call to call bring in no work, and the joint goes the shorter way."""
    turns = np.array([1.0, 0.0, -2.0]) * TURN
    same = [spin(turning, lambda q: q, lambda q0, k: q0, steps=1500)[-1] for _ in range(2)]
    other = spin(turning, lambda q: q, lambda q0, k: q0 + turns * (k % 3 - 1), steps=1500)[-1]
    assert same[0].energy_supplied == same[1].energy_supplied
    np.testing.assert_allclose(other.torque, same[0].torque, atol=1e-9)
    assert other.energy_supplied == pytest.approx(same[0].energy_supplied, abs=1e-9)
    controller, arm = turning.Impedance(**STATED), Arm(turning, START)
    for k in range(1500):
        out = controller.step(q=arm.q, dq=arm.dq, q0=START * [-1, 1, -1], counter=k, **SPRING)
        arm.step(out.torque)
    np.testing.assert_allclose(arm.q, START * [-1, 1, -1] + [TURN, 0, -TURN], atol=0.01)


@pytest.mark.slow
def test_a_gap_in_which_the_turn_is_lost_costs_the_most(turning: ModuleType) -> None:
    """Lose samples while a joint moves by more than half a turn: the energy counts the worst way, not the shorter."""
    held = {"missed_limit": 100, "tank_initial": 300.0, "velocity_limit": 60.0, "position_quantum": 2e-6}
    controller = turning.Impedance(**STATED, call_gap_limit=1, **held)
    for k in range(300):
        out = controller.step(q=START, dq=np.zeros(3), q0=START + 0.1 * FIRST, counter=k, **SPRING)
    torque, before = out.torque[0], out.tank + out.stored  # [N m], [J]
    assert torque > 0.5
    # more than half a turn: by the encoder alone it could be -2.2 rad
    out = controller.step(q=wrapped(START + 4.1 * FIRST), dq=[-27.6, 0, 0], q0=START, counter=300 + 79, **SPRING)
    assert before - out.tank - out.stored >= torque * 4.1


@pytest.mark.parametrize(("last", "turns"), [
    ("", [1, 0, 1]),
    (part("two", "three", more=MIMIC.format("-2")), [1, 0]),
    (part("two", "three", more=MIMIC.format("0.5")), [0, 0]),
    (part("two", "three", "prismatic", more=MIMIC.format("1")), [0, 0]),
])  # fmt: skip
def test_gears_and_screws_are_not_the_same_a_turn_farther(last: str, turns: list[int], tmp_path: Path) -> None:
    """Let another joint follow the turning one: a turn is the same place only for whole multipliers and no screw."""
    chain = turning_arm(last).load(tmp_path)
    page = controller_page("small", chain, DOUBLE, Placement(), bounded=False)
    assert page is not None and page.turns == turns
