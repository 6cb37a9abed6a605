# SPDX-License-Identifier: MIT
"""The example of closed loops: stiffness as the change of the torque, and the committed figure."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from examples import closed_loops as example
from support.project import ROOT


def test_stiffness_is_the_change_of_the_torque_as_the_motors_turn() -> None:
    """A wrench that does not turn, without a spring: the tangent of -G^T J^T F with respect to the motors."""
    robot, start = example.ankle(), np.array([-0.5, -0.4])
    q = np.array(robot.close(start, robot.chain.start)).ravel()
    stiffness = np.array(robot.motors.joint_stiffness(q, example.LOAD, np.zeros((6, 6))))
    for k in range(2):
        step = 1e-6 * np.eye(2)[k]
        ends = [robot.motors.torque(robot.close(start + s * step, q), example.LOAD) for s in (1, -1)]
        change = np.array(ends[0] - ends[1]).ravel() / 2e-6
        np.testing.assert_allclose(-change, stiffness[k], rtol=1e-7, atol=1e-7)


def test_numbers_of_the_page() -> None:
    angles, whole, without = example.ankle_results()
    assert angles[0] == -0.6
    assert (round(whole[0], 2), round(without[0], 2)) == (10.35, 15.49)
    assert abs(whole[12] / without[12] - 1) < 1e-3
    assert round(example.four_bar_results()[1][0], 1) == -4.1


@pytest.mark.slow
def test_figure_is_that_of_the_page() -> None:
    """Text; coordinates may differ in the last digits from machine to machine."""
    pytest.importorskip("matplotlib")
    drawn, committed = example.figure(), (ROOT / "docs" / "figures" / "loops.svg").read_text()

    def words(svg: str) -> list[str]:
        return [
            "".join(each.itertext()) for each in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")
        ]

    assert words(drawn) == words(committed)
